"""First hits of rays on MuJoCo's shapes, in closed form and on the triangles of meshes; height fields are not seen.

MuJoCo's own `mj_multiRay` is not used: its angular culling loses parts of geoms (3.17). `mj_ray` is the tests' oracle.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import heap, kernel
from regrasp.kernels.rotations import cross, dot, minus

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = 0, 2, 3, 4, 5, 6, 7
"""MuJoCo's codes of geom types."""


class Shapes(NamedTuple):
    """Geoms in W: id, kind (MuJoCo's codes), size (n, 3), pose R (n, 3, 3), p (n, 3), bounding radius (0: unbounded).

    triangles (t, 3, 3) holds the corners of all meshes in their geoms' frames, geom i's from first[i] to last[i] − 1.
    """

    id: Ids
    kind: Ids
    size: Array
    R: Array
    p: Array
    bound: Array
    triangles: Array
    first: Ids
    last: Ids


def shapes(model: mujoco.MjModel, data: mujoco.MjData, groups: Sequence[int]) -> Shapes:
    """The geoms of these geom groups, where `data` (after mj_kinematics) has them."""
    id = np.flatnonzero(np.isin(model.geom_group, groups))
    corners, first, last, count = [np.empty((0, 3, 3))], [], [], 0
    for geom in id:
        first.append(count)
        if model.geom_type[geom] == MESH:
            mesh = model.geom_dataid[geom]
            faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
            corners.append(model.mesh_vert[model.mesh_vertadr[mesh] + faces].astype(float))
            count += len(faces)
        last.append(count)
    return Shapes(
        id, model.geom_type[id].astype(np.int64), model.geom_size[id].copy(), data.geom_xmat[id].reshape(-1, 3, 3),
        data.geom_xpos[id].copy(), model.geom_rbound[id].copy(), np.concatenate(corners),
        np.array(first, np.int64), np.array(last, np.int64),
    )  # fmt: skip


BUNDLE = 64
"""Rays next to one another that are sorted out together."""


@heap
def cast(shapes: Shapes, origin: Array, rays: Array, geom: Ids, distance: Array, normal: Array) -> None:
    """First hits of unit rays (n, 3) from `origin`, W: geom (n,) or −1, distance (n,) in m or inf, normal (n, 3)."""
    away, start = from_point(shapes, origin)
    for begin in range(0, len(rays), BUNDLE):
        end = min(begin + BUNDLE, len(rays))
        first(shapes, away, start, rays[begin:end], geom[begin:end], distance[begin:end], normal[begin:end])


@kernel
def cone(rays: Array, axis: Array) -> float:
    """Half opening angle of a cone that holds all unit rays (n, 3), rad; its axis is written."""
    for c in range(3):
        axis[c] = 0.0
        for r in range(len(rays)):
            axis[c] += rays[r, c]
    length = math.sqrt(dot(axis, axis))
    for c in range(3):
        axis[c] /= length
    least = 1.0
    for r in range(len(rays)):
        least = min(least, dot(axis, rays[r]))
    return math.acos(max(least, -1.0)) + 1e-6


@kernel
def near(shapes: Shapes, away: Array, axis: Array, wide: float, among: Ids) -> int:
    """How many shapes rays within a cone may hit, by their bounding spheres; their indices are written to `among`."""
    count = 0
    for i in range(len(shapes.id)):
        bound, far = shapes.bound[i], math.sqrt(dot(away[i], away[i]))
        if 0.0 < bound < far:
            apart = math.acos(max(min(dot(axis, away[i]) / far, 1.0), -1.0))
            if apart > wide + math.asin(bound / far):
                continue
        among[count] = i
        count += 1
    return count


@heap
def facets(triangles: Array, o: Array, axis: Array, wide: float, chosen: Array) -> int:
    """How many triangles (n, 3, 3) rays from o within a cone may hit; they are copied to `chosen`.

    The triangle and o span a pyramid. No ray of the cone is inside if the axis is outside of one of its three sides by
    more than the cone's half angle, which is less than a right angle.
    """
    sine, count = math.sin(wide) + 1e-12, 0
    corner, side = np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(triangles)):
        for i in range(3):
            corner[i, 0], corner[i, 1], corner[i, 2] = minus(triangles[k, i], o)
        for i in range(3):
            side[i, 0], side[i, 1], side[i, 2] = cross(corner[i], corner[(i + 1) % 3])
        inwards = math.copysign(1.0, dot(side[0], corner[2]))
        hit = True
        for i in range(3):
            inside = inwards * dot(side[i], axis)
            hit = hit and (inside >= 0.0 or inside * inside <= sine * sine * dot(side[i], side[i]))
        if hit:
            chosen[count] = triangles[k]
            count += 1
    return count


@heap
def from_point(shapes: Shapes, origin: Array) -> tuple[Array, Array]:
    """What all rays from `origin` (W) share: every geom's centre relative to it in W, and it in every geom's frame."""
    away, start = shapes.p - origin, np.empty((len(shapes.id), 3))
    for i in range(len(shapes.id)):
        start[i] = -shapes.R[i].T @ away[i]
    return away, start


@heap
def first(shapes: Shapes, away: Array, start: Array, rays: Array, geom: Ids, distance: Array, normal: Array) -> None:
    """`cast` for one bundle from a point of which `from_point` says away and start. Shape after shape, as handing the
    shapes over for every ray would take longer than its hits."""
    among, local, n, axis = np.empty(len(shapes.id), np.int64), np.empty(3), np.empty(3), np.empty(3)
    chosen = np.empty((np.max(shapes.last - shapes.first) if len(shapes.id) else 0, 3, 3))
    for r in range(len(rays)):
        geom[r], distance[r] = -1, np.inf
    wide = cone(rays, axis)
    for i in among[: near(shapes, away, axis, wide, among)]:
        kind, size, R, o, bound = shapes.kind[i], shapes.size[i], shapes.R[i], start[i], shapes.bound[i]
        triangles = chosen[:0]
        if kind == MESH:
            for c in range(3):
                local[c] = R[0, c] * axis[0] + R[1, c] * axis[1] + R[2, c] * axis[2]
            triangles = chosen[: facets(shapes.triangles[shapes.first[i] : shapes.last[i]], o, local, wide, chosen)]
        x, y, z = away[i, 0], away[i, 1], away[i, 2]
        for r in range(len(rays)):
            dx, dy, dz = rays[r, 0], rays[r, 1], rays[r, 2]
            if bound > 0.0:
                along = x * dx + y * dy + z * dz
                if x * x + y * y + z * z - along * along > bound * bound or along - bound > distance[r]:
                    continue
            for c in range(3):
                local[c] = R[0, c] * dx + R[1, c] * dy + R[2, c] * dz
            t = _hit(kind, size, triangles, o, local, n)
            if 0.0 < t < distance[r]:
                geom[r], distance[r] = shapes.id[i], t
                length = math.sqrt(dot(n, n))
                for c in range(3):
                    normal[r, c] = (R[c, 0] * n[0] + R[c, 1] * n[1] + R[c, 2] * n[2]) / length


@kernel
def _hit(kind: int, size: Array, triangles: Array, o: Array, d: Array, n: Array) -> float:
    """Distance along a ray (o, d) in a geom's frame to its surface, inf for a miss; n: a normal of any length."""
    if kind == PLANE:
        return _plane(size, o, d, n)
    if kind == SPHERE:
        return _ellipsoid(size[0], size[0], size[0], 0.0, o, d, n)
    if kind == ELLIPSOID:
        return _ellipsoid(size[0], size[1], size[2], 0.0, o, d, n)
    if kind in (CAPSULE, CYLINDER):
        return _round(size, kind == CAPSULE, o, d, n)
    if kind == BOX:
        return _box(size, o, d, n)
    if kind == MESH:
        return _mesh(triangles, o, d, n)
    return np.inf


@kernel
def _plane(size: Array, o: Array, d: Array, n: Array) -> float:
    """The plane z = 0, seen from above; a half extent of 0 is without end."""
    if d[2] >= 0.0:
        return np.inf
    t = -o[2] / d[2]
    for c in range(2):
        if size[c] > 0.0 and abs(o[c] + t * d[c]) > size[c]:
            return np.inf
    n[:] = 0.0
    n[2] = 1.0
    return t


@kernel
def _ellipsoid(a: float, b: float, c: float, z: float, o: Array, d: Array, n: Array) -> float:
    """The ellipsoid with semi-axes a, b, c around (0, 0, z)."""
    px, py, pz = o[0] / a, o[1] / b, (o[2] - z) / c
    qx, qy, qz = d[0] / a, d[1] / b, d[2] / c
    A, B, C = qx * qx + qy * qy + qz * qz, px * qx + py * qy + pz * qz, px * px + py * py + pz * pz - 1.0
    D = B * B - A * C
    if D < 0.0:
        return np.inf
    t = (-B - math.sqrt(D)) / A
    n[0], n[1], n[2] = (px + t * qx) / a, (py + t * qy) / b, (pz + t * qz) / c
    return t


@kernel
def _round(size: Array, capped: bool, o: Array, d: Array, n: Array) -> float:
    """Cylinder about z, radius size[0], half height size[1]; ends closed by half spheres (capped) or discs."""
    r, h = size[0], size[1]
    A, B, C = d[0] * d[0] + d[1] * d[1], o[0] * d[0] + o[1] * d[1], o[0] * o[0] + o[1] * o[1] - r * r
    D = B * B - A * C
    if A > 1e-14 and D >= 0.0:
        t = (-B - math.sqrt(D)) / A
        if abs(o[2] + t * d[2]) <= h:
            n[0], n[1], n[2] = o[0] + t * d[0], o[1] + t * d[1], 0.0
            return t
    best = np.inf
    for sign in (-1.0, 1.0):
        if capped:
            nx, ny, nz = n[0], n[1], n[2]
            t = _ellipsoid(r, r, r, sign * h, o, d, n)
            if not t < best:
                n[0], n[1], n[2] = nx, ny, nz
            best = min(best, t)
        elif sign * d[2] < 0.0:
            t = (sign * h - o[2]) / d[2]
            if (o[0] + t * d[0]) ** 2 + (o[1] + t * d[1]) ** 2 <= r * r:
                n[0], n[1], n[2] = 0.0, 0.0, sign
                best = t
    return best


@kernel
def _box(size: Array, o: Array, d: Array, n: Array) -> float:
    """The box with half extents `size`."""
    enter, leave, axis = -np.inf, np.inf, 0
    for c in range(3):
        if abs(d[c]) < 1e-14:
            if abs(o[c]) > size[c]:
                return np.inf
            continue
        near, far = (-size[c] - o[c]) / d[c], (size[c] - o[c]) / d[c]
        if near > far:
            near, far = far, near
        if near > enter:
            enter, axis = near, c
        leave = min(leave, far)
    if enter > leave:
        return np.inf
    n[:] = 0.0
    n[axis] = -math.copysign(1.0, d[axis])
    return enter


@kernel
def _mesh(triangles: Array, o: Array, d: Array, n: Array) -> float:
    """Möller and Trumbore 1997 on every triangle, either side."""
    best = np.inf
    for i in range(len(triangles)):
        corners = triangles[i]
        e, f = minus(corners[1], corners[0]), minus(corners[2], corners[0])
        p = cross(d, f)
        det = dot(e, p)
        if abs(det) < 1e-18:
            continue
        s = minus(o, corners[0])
        u = dot(s, p) / det
        q = cross(s, e)
        v = dot(d, q) / det
        t = dot(f, q) / det
        if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and 0.0 < t < best:
            best = t
            n[0], n[1], n[2] = cross(e, f)
    return best
