"""Passive contacts (paper §3): where static surfaces touch and carry the object."""

from dataclasses import dataclass

import numpy as np
from mujoco import mjtGeom, mju_quat2Mat
from numpy.typing import NDArray

from regrasp.errors import InputError
from regrasp.kernels.surfaces import BOX, CAPSULE, CYLINDER, ELLIPSOID
from regrasp.planner.hand import Hand, geom_index
from regrasp.scene.world import World

Array = NDArray[np.float64]

SEPARATE, STICK, SLIDE = 0, 1, 2

TOUCH = 2e-5  # m: an object this close to a support touches it


@dataclass(frozen=True)
class Support:
    """A flat static surface: its outward normal and a point on it (W), friction, and the extent of a bounded face.

    geom: index into Hand.geoms.
    axes_W (2, 3), half (2,): directions and half sizes of the face about the point; half is inf for a plane.
    """

    name: str
    n_W: Array
    p_W: Array
    axes_W: Array
    half: Array
    mu: float
    geom: int

    def height(self, p_W: Array) -> float:
        """Height of a point above the surface, m."""
        return float(self.n_W @ (p_W - self.p_W))

    def carries(self, p_W: Array) -> bool:
        """Whether the point's foot lies on the face."""
        return bool(np.all(np.abs(self.axes_W @ (p_W - self.p_W)) <= self.half))


def supports_of(world: World, hand: Hand) -> tuple[Support, ...]:
    """The scene's supports as flat surfaces: a plane, or the face of a box that looks against gravity.

    Raises InputError for other shapes.
    """
    index = geom_index(world)
    found = []
    g = np.array(world.scene.gravity)
    for name, geom, mu in zip(world.scene.supports, world.support_geoms, world.support_friction, strict=True):
        flat = np.empty(9)
        mju_quat2Mat(flat, world.model.geom_quat[geom])
        R, p = flat.reshape(3, 3), np.array(world.model.geom_pos[geom])
        size = world.model.geom_size[geom]
        match mjtGeom(int(world.model.geom_type[geom])):
            case mjtGeom.mjGEOM_PLANE:
                found.append(Support(name, R[:, 2], p, R[:, :2].T, np.full(2, np.inf), float(mu), index[int(geom)]))
            case mjtGeom.mjGEOM_BOX:
                axis = int(np.argmax(np.abs(R.T @ g)))
                n = R[:, axis] * (-1.0 if R[:, axis] @ g > 0.0 else 1.0)
                others = [a for a in range(3) if a != axis]
                found.append(
                    Support(name, n, p + size[axis] * n, R[:, others].T, size[others], float(mu), index[int(geom)])
                )
            case other:
                shape = other.name.removeprefix("mjGEOM_").lower()
                raise InputError("supports", f"{name!r} is a {shape}", "a plane or a box")
    return tuple(found)


def lowest_points(kind: int, size: Array, d: Array) -> Array:
    """Points (c, 3) of the object's surface, in O, that can carry it on a flat surface whose inward direction is d (unit).

    The touching set of a convex body is a point, a line or a face; it is given by its corners: end points of a line, the
    corners of a box face, four points of a cylinder's face.
    """
    if kind == BOX:
        corner = size[:3] - size[3]
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        return np.asarray(signs * corner + size[3] * d)
    if kind == CAPSULE:
        ends = np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]])
        return np.asarray(ends + size[0] * d)
    if kind == CYLINDER:
        ring, half = size[0] - size[3], size[1] - size[3]
        across = np.array([d[0], d[1], 0.0])
        length = float(np.linalg.norm(across))
        u = across / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
        v = np.array([-u[1], u[0], 0.0])
        z = np.array([0.0, 0.0, 1.0])
        rim = [u, -u, v, -v]
        return np.array([ring * r + h * z + size[3] * d for h in (-half, half) for r in rim])
    if kind == ELLIPSOID:
        scaled = size[:3] * d
        return np.asarray((size[:3] * scaled / np.linalg.norm(scaled))[None, :])
    return np.asarray((size[0] * d)[None, :])


def touching(support: Support, kind: int, size: Array, R_WO: Array, p_WO: Array) -> list[tuple[Array, Array]]:
    """Contacts of the object with the support at pose X_WO: [(p_O, n_W)], n from the support into the object."""
    points = lowest_points(kind, size, R_WO.T @ -support.n_W)
    found = []
    for p_O in points:
        p_W = R_WO @ p_O + p_WO
        if abs(support.height(p_W)) <= TOUCH and support.carries(p_W):
            found.append((p_O, support.n_W))
    return found


def gap(support: Support, kind: int, size: Array, R_WO: Array, p_WO: Array) -> float:
    """Height of the object's lowest point above the support's surface, m (negative: below)."""
    points = lowest_points(kind, size, R_WO.T @ -support.n_W)
    return min(support.height(R_WO @ p + p_WO) for p in points)
