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


@heap
def cast(shapes: Shapes, origin: Array, rays: Array, geom: Ids, distance: Array, normal: Array) -> None:
    """First hits of unit rays (n, 3) from `origin`, W: geom (n,) or −1, distance (n,) in m or inf, normal (n, 3)."""
    away, start = from_point(shapes, origin)
    room = np.empty((2, 3))
    for ray in range(len(rays)):
        geom[ray], distance[ray] = first(shapes, away, start, rays[ray], room, normal[ray])


@heap
def from_point(shapes: Shapes, origin: Array) -> tuple[Array, Array]:
    """What all rays from `origin` (W) share: every geom's centre relative to it in W, and it in every geom's frame."""
    away, start = shapes.p - origin, np.empty((len(shapes.id), 3))
    for i in range(len(shapes.id)):
        start[i] = -shapes.R[i].T @ away[i]
    return away, start


@kernel
def first(shapes: Shapes, away: Array, start: Array, ray: Array, room: Array, normal: Array) -> tuple[int, float]:
    """Geom (−1: none) and distance (m, inf) of the first hit of one unit ray from a point (see `from_point`); the normal
    there, W, is written if there is one. room (2, 3): to work in."""
    local, n = room[0], room[1]
    dx, dy, dz = ray[0], ray[1], ray[2]
    geom, distance = -1, np.inf
    for i in range(len(shapes.id)):
        if shapes.bound[i] > 0.0:
            x, y, z = away[i, 0], away[i, 1], away[i, 2]
            along = x * dx + y * dy + z * dz
            if x * x + y * y + z * z - along * along > shapes.bound[i] ** 2:
                continue
            if along - shapes.bound[i] > distance:
                continue
        R = shapes.R
        for c in range(3):
            local[c] = R[i, 0, c] * dx + R[i, 1, c] * dy + R[i, 2, c] * dz
        t = _hit(shapes, i, start[i], local, n)
        if 0.0 < t < distance:
            geom, distance = shapes.id[i], t
            length = math.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
            for c in range(3):
                normal[c] = (R[i, c, 0] * n[0] + R[i, c, 1] * n[1] + R[i, c, 2] * n[2]) / length
    return geom, distance


@kernel
def _hit(shapes: Shapes, i: int, o: Array, d: Array, n: Array) -> float:
    """Distance along a ray (o, d) in the frame of geom i to its surface, inf for a miss; n: a normal of any length."""
    kind, size = shapes.kind[i], shapes.size[i]
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
        return _mesh(shapes.triangles[shapes.first[i] : shapes.last[i]], o, d, n)
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
