"""First hits of rays on MuJoCo's shapes, in closed form and on the triangles of meshes; height fields are not seen.

MuJoCo's own `mj_multiRay` is not used: its angular culling loses parts of geoms (3.17). `mj_ray` is the tests' oracle.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray

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


@njit(cache=True, nogil=True)
def cast(shapes: Shapes, origin: Array, rays: Array, geom: Ids, distance: Array, normal: Array) -> None:
    """First hits of unit rays (n, 3) from `origin`, W: geom (n,) or −1, distance (n,) in m or inf, normal (n, 3)."""
    away, start = from_point(shapes, origin)
    for begin in range(0, len(rays), BUNDLE):
        end = min(begin + BUNDLE, len(rays))
        first(shapes, away, start, rays[begin:end], geom[begin:end], distance[begin:end], normal[begin:end])


@njit(cache=True, nogil=True)
def near(shapes: Shapes, away: Array, rays: Array, among: Ids) -> int:
    """How many shapes some of the unit rays (n, 3) may hit; their indices are written to `among`, which has room for all.

    A shape counts unless its bounding sphere is outside the cone about all rays.
    """
    axis = np.zeros(3)
    for r in range(len(rays)):
        for c in range(3):
            axis[c] += rays[r, c]
    axis /= math.sqrt(dot(axis, axis))
    least = 1.0
    for r in range(len(rays)):
        least = min(least, dot(axis, rays[r]))
    wide = math.acos(max(least, -1.0)) + 1e-6
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


@njit(cache=True, nogil=True)
def dot(a: Array, b: Array) -> float:
    """a · b of vectors (3,), which need not be contiguous."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True)
def from_point(shapes: Shapes, origin: Array) -> tuple[Array, Array]:
    """What all rays from `origin` (W) share: every geom's centre relative to it in W, and it in every geom's frame."""
    away, start = shapes.p - origin, np.empty((len(shapes.id), 3))
    for i in range(len(shapes.id)):
        start[i] = -shapes.R[i].T @ away[i]
    return away, start


@njit(cache=True, nogil=True)
def first(shapes: Shapes, away: Array, start: Array, rays: Array, geom: Ids, distance: Array, normal: Array) -> None:
    """`cast` for one bundle from a point of which `from_point` says away and start. Shape after shape, as handing the
    shapes over for every ray would take longer than its hits."""
    among, local, n = np.empty(len(shapes.id), np.int64), np.empty(3), np.empty(3)
    for r in range(len(rays)):
        geom[r], distance[r] = -1, np.inf
    for i in among[: near(shapes, away, rays, among)]:
        kind, size, R, o, bound = shapes.kind[i], shapes.size[i], shapes.R[i], start[i], shapes.bound[i]
        triangles = shapes.triangles[shapes.first[i] : shapes.last[i]]
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _mesh(triangles: Array, o: Array, d: Array, n: Array) -> float:
    """Möller and Trumbore 1997 on every triangle, either side; in numbers, as small arrays cost more than all the rest."""
    best = np.inf
    dx, dy, dz = d[0], d[1], d[2]
    for k in range(len(triangles)):
        ax, ay, az = triangles[k, 0, 0], triangles[k, 0, 1], triangles[k, 0, 2]
        ex, ey, ez = triangles[k, 1, 0] - ax, triangles[k, 1, 1] - ay, triangles[k, 1, 2] - az
        fx, fy, fz = triangles[k, 2, 0] - ax, triangles[k, 2, 1] - ay, triangles[k, 2, 2] - az
        px, py, pz = dy * fz - dz * fy, dz * fx - dx * fz, dx * fy - dy * fx
        det = ex * px + ey * py + ez * pz
        if abs(det) < 1e-18:
            continue
        sx, sy, sz = o[0] - ax, o[1] - ay, o[2] - az
        u = (sx * px + sy * py + sz * pz) / det
        if u < 0.0 or u > 1.0:
            continue
        qx, qy, qz = sy * ez - sz * ey, sz * ex - sx * ez, sx * ey - sy * ex
        v = (dx * qx + dy * qy + dz * qz) / det
        t = (fx * qx + fy * qy + fz * qz) / det
        if v >= 0.0 and u + v <= 1.0 and 0.0 < t < best:
            best = t
            n[0], n[1], n[2] = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    return best
