"""Distances between convex bodies: a core (`cores`) with a radius, or a half-space.

A sphere is a POINT with a radius, a capsule a SEGMENT with one; kinds and core sizes are those of `cores`.
"""

import math

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.cores import BOX, PLANE, POINT, SEGMENT, support
from regrasp.kernels.gjk import gap
from regrasp.kernels.native import kernel
from regrasp.kernels.records import Record
from regrasp.kernels.rotations import Array

STATIC, OBJECT = -1, -2  # owners of the geoms that are no agent's


class Geoms(Record):
    """G collision geometries, each in the frame L of what carries it."""

    kind: NDArray[np.int64]  # (G,)
    core: Array  # (G, 3) m, or (G, 4 + 4 V) where there are hulls of at most V vertices (`cores`)
    radius: Array  # (G,) m
    R_LG: Array  # (G, 3, 3) in the agent's link, in the object (OBJECT) or in the world (STATIC)
    p_LG: Array  # (G, 3)
    bound: Array  # (G,) radius of the ball around the geom's origin that holds it; inf for a half-space
    agent: NDArray[np.int64]  # (G,) index of the agent, STATIC or OBJECT
    link: NDArray[np.int64]  # (G,) index into the poses that chains.forward writes; 0 for STATIC and OBJECT


@kernel
def bounds_far(p_A: Array, bound_A: float, p_B: Array, bound_B: float, limit: float) -> bool:
    """Whether the bounding balls alone show that two bodies are more than limit ≥ 0 apart."""
    x, y, z = p_B[0] - p_A[0], p_B[1] - p_A[1], p_B[2] - p_A[2]
    reach = bound_A + bound_B + limit
    return x * x + y * y + z * z > reach * reach


@kernel
def boxes_far(
    core_A: Array, r_A: float, R_A: Array, p_A: Array, core_B: Array, r_B: float, R_B: Array, p_B: Array, limit: float
) -> bool:
    """Whether an axis of A's or B's frame alone shows that two bodies (not PLANE) are more than limit apart.

    Cores lie in boxes of their half extents, so this is the separating axis test of boxes on their six face normals.
    """
    x, y, z = p_B[0] - p_A[0], p_B[1] - p_A[1], p_B[2] - p_A[2]
    reach = r_A + r_B + limit
    b0, b1, b2 = core_B[0], core_B[1], core_B[2]  # A's extents along B's axes are added below
    c0, c1, c2 = b0 + reach, b1 + reach, b2 + reach
    for i in range(3):
        u, v, w = R_A[0, i], R_A[1, i], R_A[2, i]
        m0 = abs(u * R_B[0, 0] + v * R_B[1, 0] + w * R_B[2, 0])
        m1 = abs(u * R_B[0, 1] + v * R_B[1, 1] + w * R_B[2, 1])
        m2 = abs(u * R_B[0, 2] + v * R_B[1, 2] + w * R_B[2, 2])
        if abs(u * x + v * y + w * z) > core_A[i] + m0 * b0 + m1 * b1 + m2 * b2 + reach:
            return True
        c0 += m0 * core_A[i]
        c1 += m1 * core_A[i]
        c2 += m2 * core_A[i]
    return (
        abs(x * R_B[0, 0] + y * R_B[1, 0] + z * R_B[2, 0]) > c0
        or abs(x * R_B[0, 1] + y * R_B[1, 1] + z * R_B[2, 1]) > c1
        or abs(x * R_B[0, 2] + y * R_B[1, 2] + z * R_B[2, 2]) > c2
    )


@kernel
def _plane(R: Array, p: Array, kind: int, core: Array, R_B: Array, p_B: Array) -> float:
    """Signed distance of a core's lowest point above the half-space; −inf between two half-spaces (they do overlap)."""
    if kind == PLANE:
        return -math.inf
    s = support(kind, core, R_B, (-R[0, 2], -R[1, 2], -R[2, 2]))
    return R[0, 2] * (p_B[0] + s[0] - p[0]) + R[1, 2] * (p_B[1] + s[1] - p[1]) + R[2, 2] * (p_B[2] + s[2] - p[2])


@kernel
def _segments(a: float, R_A: Array, p_A: Array, b: float, R_B: Array, p_B: Array) -> float:
    """Distance between two segments of half lengths a, b ≥ 0 (0: a point) along the z axes of their frames."""
    x, y, z = p_B[0] - p_A[0], p_B[1] - p_A[1], p_B[2] - p_A[2]
    u0, u1, u2 = R_A[0, 2], R_A[1, 2], R_A[2, 2]
    v0, v1, v2 = R_B[0, 2], R_B[1, 2], R_B[2, 2]
    k = u0 * v0 + u1 * v1 + u2 * v2
    ou, ov = x * u0 + y * u1 + z * u2, x * v0 + y * v1 + z * v2
    # Nearest points of the lines, p_A + s u and p_B + t v; clamp s, then t, then s again (Ericson 2005, §5.1.9).
    det = 1.0 - k * k
    s = (ou - k * ov) / det if det > 1e-14 else ou
    s = min(max(s, -a), a)
    t = min(max(k * s - ov, -b), b)
    s = min(max(k * t + ou, -a), a)
    x, y, z = x + t * v0 - s * u0, y + t * v1 - s * u1, z + t * v2 - s * u2
    return math.sqrt(x * x + y * y + z * z)


@kernel
def _point_box(p: Array, core: Array, R: Array, p_B: Array) -> float:
    """Signed distance of a point from a box."""
    outside, inside = 0.0, -math.inf
    for i in range(3):
        t = abs(R[0, i] * (p[0] - p_B[0]) + R[1, i] * (p[1] - p_B[1]) + R[2, i] * (p[2] - p_B[2])) - core[i]
        inside = max(inside, t)
        if t > 0.0:
            outside += t * t
    return math.sqrt(outside) if outside > 0.0 else inside


@kernel
def distance(
    kind_A: int, core_A: Array, r_A: float, R_A: Array, p_A: Array,
    kind_B: int, core_B: Array, r_B: float, R_B: Array, p_B: Array,
    limit: float,
) -> float:  # fmt: skip
    """Distance in m between bodies A and B, each a core with a radius at a pose (R, p) in W.

    To 1e-7 m (core distance minus radii) where the bodies are apart or overlap by less than r_A + r_B. Where even the
    cores overlap: a value ≤ −(r_A + r_B), at least as deep as the overlap; exact for half-spaces and points in boxes.
    May return early with any value > limit once a lower bound of the distance exceeds limit (inf: never).
    """
    radii = r_A + r_B
    if kind_A == PLANE:
        return _plane(R_A, p_A, kind_B, core_B, R_B, p_B) - radii
    if kind_B == PLANE:
        return _plane(R_B, p_B, kind_A, core_A, R_A, p_A) - radii
    if kind_A <= SEGMENT and kind_B <= SEGMENT:
        return _segments(core_A[2], R_A, p_A, core_B[2], R_B, p_B) - radii
    if kind_A == POINT and kind_B == BOX:
        return _point_box(p_A, core_B, R_B, p_B) - radii
    if kind_B == POINT and kind_A == BOX:
        return _point_box(p_B, core_A, R_A, p_A) - radii
    return gap(kind_A, core_A, R_A, p_A, kind_B, core_B, R_B, p_B, limit + radii) - radii
