"""Convex cores of the collision bodies and their support functions.

A core's size `core` (3,) is its half extents in its own frame: POINT (0, 0, 0), SEGMENT (0, 0, half length) along z,
BOX half edges, CYLINDER (R, R, half height) about z, ELLIPSOID semi-axes; PLANE is the half-space z ≤ 0 (core unused).
A HULL is the convex hull of V vertices, centred on its bounding box: behind the half extents its core has V, then x, y, z
and the number (`features`) of each vertex, (4 + 4 V,) or longer.
"""

import math

from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import Array, Triple

POINT, SEGMENT, BOX, CYLINDER, ELLIPSOID, PLANE, HULL = 0, 1, 2, 3, 4, 5, 6
COUNT, FIRST, ROW = 3, 4, 4  # where a HULL's core has V and its first vertex, and how many numbers each vertex takes


@kernel
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
    elif kind == HULL:
        best, at = -math.inf, FIRST
        for i in range(FIRST, FIRST + ROW * int(core[COUNT]), ROW):
            s = x * core[i] + y * core[i + 1] + z * core[i + 2]
            if s > best:
                best, at = s, i
        x, y, z = core[at], core[at + 1], core[at + 2]
    else:
        a, b, c = core[0], core[1], core[2]
        s = 1.0 / math.sqrt((a * x) ** 2 + (b * y) ** 2 + (c * z) ** 2)
        x, y, z = s * a * a * x, s * b * b * y, s * c * c * z
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )
