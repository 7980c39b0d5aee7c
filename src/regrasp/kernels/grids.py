"""Signed distances on grids: tricubic (C²) value, gradient and curvature, and the closest point of their zero level.

A grid's values at its nodes are interpolated by the tensor product of uniform cubic B-splines. Inside the grid F is that
spline; its zero level is the surface, up to O(h⁴) of the distance that was sampled, h the spacing, where that is smooth.
Outside, F continues as the distance to a point of the surface: the foot of the nearest point of the grid.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import kernel
from regrasp.kernels.records import Record
from regrasp.kernels.rotations import Array, Triple, Vector, cross, dot, minus, norm, plus, unit

Ints = NDArray[np.int64]
Four = tuple[float, float, float, float]

ITERATIONS = 30  # of Newton's method for a closest point; three or four from nearby
CLOSEST = 1e-13  # m: a foot closer to its place than this is there
FLATTEST = 0.1  # eigenvalue of I + d S by which a step is divided, at least
ROUND_OFF = 1e-14  # of a squared distance, whose last digits say nothing of where the foot is


class Grids(Record):
    """All signed-distance grids of a scene, one after another; grid m is the surface of size (m, ·, ·, ·).

    coefficients (N,): of the B-splines, m, grid m's from start[m] on, (shape + 2) of them in C order: one beyond the nodes on
    either side. start (g,); shape (g, 3): nodes along x, y, z; origin (g, 3): the first node in the surface's frame, m;
    spacing (g,): h, m.
    """

    coefficients: Array
    start: Ints
    shape: Ints
    origin: Array
    spacing: Array


def grids_of(sampled: Sequence[tuple[Array, float, Array]]) -> Grids:
    """Grids from (origin (3,), spacing, values (nx, ny, nz) at the nodes), m; none for scenes without meshes.

    Raises ValueError for fewer than four nodes along an axis, which determine no cubic.
    """
    coefficients = [splines(np.asarray(values, np.float64)) for _, _, values in sampled]
    shape = np.array([values.shape for _, _, values in sampled], np.int64).reshape(-1, 3)
    return Grids(
        coefficients=np.concatenate([np.zeros(0), *(c.ravel() for c in coefficients)]),
        start=np.cumsum([0, *(c.size for c in coefficients)])[:-1].astype(np.int64),
        shape=shape,
        origin=np.array([origin for origin, _, _ in sampled], np.float64).reshape(-1, 3),
        spacing=np.array([spacing for _, spacing, _ in sampled], np.float64),
    )


def splines(values: Array) -> Array:
    """B-spline coefficients (nx + 2, …) of values (nx, …) at the nodes, exact for cubics up to the grid's boundary.

    Along each axis: (c_i + 4 c_{i+1} + c_{i+2})/6 = v_i, and no jump of the third derivative at the second and the last but one
    node ("not a knot"), that is, fourth differences of zero at both ends.
    """
    if min(values.shape) < 4:
        raise ValueError(f"a grid of {values.shape} nodes: at least 4 along every axis are needed")
    c = values
    for axis in range(3):
        n = c.shape[axis]
        rows = np.zeros((n + 2, n + 2))
        for i in range(n):
            rows[i + 1, i : i + 3] = 1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0
        rows[0, :5] = rows[-1, -5:] = 1.0, -4.0, 6.0, -4.0, 1.0
        c = np.moveaxis(np.tensordot(np.linalg.inv(rows)[:, 1:-1], c, (1, axis)), 0, axis)
    return np.ascontiguousarray(c)


NO_GRIDS = grids_of(())
"""What surfaces without meshes take."""


@kernel
def _weights(u: float) -> tuple[Four, Four, Four]:
    """The four B-splines over a cell at u in [0, 1] of it, and their first and second derivatives by u."""
    v = 1.0 - u
    return (
        (
            v * v * v / 6.0,
            (4.0 + u * u * (3.0 * u - 6.0)) / 6.0,
            (4.0 + v * v * (3.0 * v - 6.0)) / 6.0,
            u * u * u / 6.0,
        ),
        (-0.5 * v * v, u * (1.5 * u - 2.0), -v * (1.5 * v - 2.0), 0.5 * u * u),
        (v, 3.0 * u - 2.0, 3.0 * v - 2.0, u),
    )


@kernel
def _cell(grids: Grids, m: int, axis: int, x: float) -> tuple[int, float]:
    """(cell, place in it) of a coordinate, or of the end of the grid that is nearest to it."""
    t, last = (x - grids.origin[m, axis]) / grids.spacing[m], grids.shape[m, axis] - 1
    if not t > 0.0:
        return 0, 0.0
    if t >= last:
        return last - 1, 1.0
    i = min(int(t), last - 1)
    return i, t - i


@kernel
def _spline(grids: Grids, m: int, p: Vector) -> tuple[float, Triple]:
    """(F, ∇F) of the spline at the point of the grid that is nearest to p."""
    i, u = _cell(grids, m, 0, p[0])
    j, v = _cell(grids, m, 1, p[1])
    k, w = _cell(grids, m, 2, p[2])
    a, da, _ = _weights(u)
    b, db, _ = _weights(v)
    c, dc, _ = _weights(w)
    rows, deep = grids.shape[m, 1] + 2, grids.shape[m, 2] + 2
    first = grids.start[m] + (i * rows + j) * deep + k
    values = grids.coefficients
    F, x, y, z = 0.0, 0.0, 0.0, 0.0
    for r in range(4):
        s, s_y, s_z = 0.0, 0.0, 0.0
        for q in range(4):
            at = first + (r * rows + q) * deep
            line = c[0] * values[at] + c[1] * values[at + 1] + c[2] * values[at + 2] + c[3] * values[at + 3]
            slope = dc[0] * values[at] + dc[1] * values[at + 1] + dc[2] * values[at + 2] + dc[3] * values[at + 3]
            s, s_y, s_z = s + b[q] * line, s_y + db[q] * line, s_z + b[q] * slope
        F, x, y, z = F + a[r] * s, x + da[r] * s, y + a[r] * s_y, z + a[r] * s_z
    h = grids.spacing[m]
    return F, (x / h, y / h, z / h)


@kernel
def _beyond(grids: Grids, m: int, p: Vector) -> tuple[bool, Triple]:
    """(whether p is outside the grid, the point of the grid nearest to it)."""
    o, n, h = grids.origin, grids.shape, grids.spacing[m]
    x = min(max(p[0], o[m, 0]), o[m, 0] + h * (n[m, 0] - 1))
    y = min(max(p[1], o[m, 1]), o[m, 1] + h * (n[m, 1] - 1))
    z = min(max(p[2], o[m, 2]), o[m, 2] + h * (n[m, 2] - 1))
    return x != p[0] or y != p[1] or z != p[2], (x, y, z)


@kernel
def grid_field(grids: Grids, m: int, p: Vector) -> tuple[float, Triple]:
    """(F [m], ∇F) of grid m at the point p, in the grid's frame."""
    F, g = _spline(grids, m, p)
    outside, edge = _beyond(grids, m, p)
    if not outside:
        return F, g
    away = plus(minus(p, edge), F / dot(g, g), g)
    d = norm(away)
    return d, (away[0] / d, away[1] / d, away[2] / d)


@kernel
def grid_bends(grids: Grids, m: int, p: Vector, d: Vector, e: Vector) -> tuple[Triple, Triple]:
    """(∇²F d, ∇²F e) of grid m at the point p; outside the grid that of the distance to a point."""
    outside, _ = _beyond(grids, m, p)
    if outside:
        F, g = grid_field(grids, m, p)
        along, across = dot(g, d), dot(g, e)
        return (
            ((d[0] - along * g[0]) / F, (d[1] - along * g[1]) / F, (d[2] - along * g[2]) / F),
            ((e[0] - across * g[0]) / F, (e[1] - across * g[1]) / F, (e[2] - across * g[2]) / F),
        )
    i, u = _cell(grids, m, 0, p[0])
    j, v = _cell(grids, m, 1, p[1])
    k, w = _cell(grids, m, 2, p[2])
    a, da, dda = _weights(u)
    b, db, ddb = _weights(v)
    c, dc, ddc = _weights(w)
    rows, deep = grids.shape[m, 1] + 2, grids.shape[m, 2] + 2
    first = grids.start[m] + (i * rows + j) * deep + k
    values = grids.coefficients
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for r in range(4):
        s, s_y, s_z, s_yy, s_yz, s_zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for q in range(4):
            at = first + (r * rows + q) * deep
            v0, v1, v2, v3 = values[at], values[at + 1], values[at + 2], values[at + 3]
            line = c[0] * v0 + c[1] * v1 + c[2] * v2 + c[3] * v3
            slope = dc[0] * v0 + dc[1] * v1 + dc[2] * v2 + dc[3] * v3
            curve = ddc[0] * v0 + ddc[1] * v1 + ddc[2] * v2 + ddc[3] * v3
            s, s_y, s_yy = s + b[q] * line, s_y + db[q] * line, s_yy + ddb[q] * line
            s_z, s_yz, s_zz = s_z + b[q] * slope, s_yz + db[q] * slope, s_zz + b[q] * curve
        xx, xy, xz = xx + dda[r] * s, xy + da[r] * s_y, xz + da[r] * s_z
        yy, yz, zz = yy + a[r] * s_yy, yz + a[r] * s_yz, zz + a[r] * s_zz
    per_m2 = 1.0 / (grids.spacing[m] * grids.spacing[m])
    xx, xy, xz, yy, yz, zz = per_m2 * xx, per_m2 * xy, per_m2 * xz, per_m2 * yy, per_m2 * yz, per_m2 * zz
    return (
        (xx * d[0] + xy * d[1] + xz * d[2], xy * d[0] + yy * d[1] + yz * d[2], xz * d[0] + yz * d[1] + zz * d[2]),
        (xx * e[0] + xy * e[1] + xz * e[2], xy * e[0] + yy * e[1] + yz * e[2], xz * e[0] + yz * e[1] + zz * e[2]),
    )


@kernel
def _onto(grids: Grids, m: int, x: Triple) -> tuple[Triple, Triple]:
    """(point of the surface near x, outward unit normal there), by Newton's method along ∇F."""
    F, g = grid_field(grids, m, x)
    for _ in range(ITERATIONS):
        slope = dot(g, g)
        if abs(F) <= 1e-15 * math.sqrt(slope * dot(x, x)):
            break
        x = plus(x, -F / slope, g)
        F, g = grid_field(grids, m, x)
    return x, unit(g)


@kernel
def grid_project(grids: Grids, m: int, p: Vector) -> tuple[float, Triple, Triple]:
    """(signed distance [m], closest point of the surface, outward normal there) of a point p.

    F leads near the closest point, however hollow the surface; from there Newton's method minimises |p − x| on it: with
    p − x = d n + t, t tangent, (I + d S) δ = t. A step that leads away is halved.
    """
    x, n = _onto(grids, m, (p[0], p[1], p[2]))
    r = minus(p, x)
    for _ in range(ITERATIONS):
        d = dot(r, n)
        t = plus(r, -d, n)
        length = norm(t)
        if length <= CLOSEST:
            break
        e = (t[0] / length, t[1] / length, t[2] / length)
        f = cross(n, e)
        _, g = grid_field(grids, m, x)
        k = d / norm(g)
        bend_e, bend_f = grid_bends(grids, m, x, e, f)
        ee, ef, ff = 1.0 + k * dot(e, bend_e), k * dot(f, bend_e), 1.0 + k * dot(f, bend_f)
        determinant = ee * ff - ef * ef
        if determinant > 1e-3 and ee > 0.0:
            along, across = length * ff / determinant, -length * ef / determinant
        else:  # beyond a centre of curvature: Newton's step with the eigenvalues' absolute values, a I + b (I + d S)
            middle, half = 0.5 * (ee + ff), math.hypot(0.5 * (ee - ff), ef)
            first, second = 1.0 / max(abs(middle + half), FLATTEST), 1.0 / max(abs(middle - half), FLATTEST)
            b = 0.5 * (first - second) / max(half, ROUND_OFF)
            along, across = length * (first - b * (middle + half - ee)), length * b * ef
        far, part, closer = dot(r, r), 1.0, False
        while part > 1e-3:
            y, n_y = _onto(grids, m, plus(plus(x, part * along, e), part * across, f))
            r_y = minus(p, y)
            closer = dot(r_y, r_y) <= far * (1.0 + ROUND_OFF)
            if closer:
                x, n, r = y, n_y, r_y
                break
            part *= 0.5
        if not closer:
            break
    return dot(r, n), x, n
