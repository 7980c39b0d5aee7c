"""Convex cores of the collision bodies and their support functions.

A core's size `core` (3,) is its half extents in its own frame: POINT (0, 0, 0), SEGMENT (0, 0, half length) along z,
BOX half edges, CYLINDER (R, R, half height) about z, ELLIPSOID semi-axes; PLANE is the half-space z ≤ 0 (core unused).
"""

import math

from numba import njit

from regrasp.kernels.rotations import Array, Triple

POINT, SEGMENT, BOX, CYLINDER, ELLIPSOID, PLANE = 0, 1, 2, 3, 4, 5


@njit(cache=True, nogil=True)
def support(kind: int, core: Array, R: Array, d: Triple) -> Triple:
    """Point of the core furthest along d (any length, not zero), from the core's centre; R its orientation in W.

    Both in W. Not for PLANE, which has none.
    """
    if kind == POINT:
        return 0.0, 0.0, 0.0
    z = R[0, 2] * d[0] + R[1, 2] * d[1] + R[2, 2] * d[2]
    if kind == SEGMENT:
        z = core[2] if z >= 0.0 else -core[2]
        return R[0, 2] * z, R[1, 2] * z, R[2, 2] * z
    x = R[0, 0] * d[0] + R[1, 0] * d[1] + R[2, 0] * d[2]
    y = R[0, 1] * d[0] + R[1, 1] * d[1] + R[2, 1] * d[2]
    if kind == BOX:
        x = core[0] if x >= 0.0 else -core[0]
        y = core[1] if y >= 0.0 else -core[1]
        z = core[2] if z >= 0.0 else -core[2]
    elif kind == CYLINDER:
        s = math.sqrt(x * x + y * y)
        s = core[0] / s if s > 0.0 else 0.0
        x, y = s * x, s * y
        z = core[2] if z >= 0.0 else -core[2]
    else:
        a, b, c = core[0], core[1], core[2]
        s = 1.0 / math.sqrt((a * x) ** 2 + (b * y) ** 2 + (c * z) ** 2)
        x, y, z = s * a * a * x, s * b * b * y, s * c * c * z
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )
