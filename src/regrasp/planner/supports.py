"""Passive contacts (paper §3): where the faces, edges and vertices of the object touch static bodies, which carry it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.cores import POINT
from regrasp.kernels.distances import Geoms, bounds_far
from regrasp.kernels.features import TOUCH
from regrasp.kernels.native import heap
from regrasp.kernels.patches import ROOM, SCRATCH, SLOTS, contact, patch
from regrasp.kernels.rotations import multiply, rotate
from regrasp.planner.hand import Hand, geom_index
from regrasp.scene.world import World

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.uint8]

SEPARATE, STICK, SLIDE = 0, 1, 2

COINCIDE = 1e-6  # m: slots of one support this close are one contact
STEPS, EXACT = 16, 1e-10  # steps that put the object onto a support, and m to which they do


@dataclass(frozen=True)
class Support:
    """A static body that may touch and carry the object: its index into Hand.geoms, and the friction between them."""

    name: str
    geom: int
    mu: float


@dataclass(frozen=True)
class Patch:
    """Where a support touches the object.

    n_W (3,): unit normal into the object. polygon (c, 3): corners in order, in W, on the object's surface: 1 is a point,
    2 are the ends of a line.
    """

    n_W: Array
    polygon: Array


@dataclass(frozen=True)
class Touches:
    """Slots of A supports at S poses: present (S, A, B SLOTS), p_W (S, A, B SLOTS, 3), n_W (S, A, B SLOTS, 3).

    The B parts of the object have SLOTS (`kernels.patches`) each, part after part.
    """

    n_W: Array
    present: NDArray[np.bool_]
    p_W: Array


def supports_of(world: World, hand: Hand) -> tuple[Support, ...]:
    """The scene's supports in their order."""
    index = geom_index(world)
    given = zip(world.support_names, world.support_geoms, world.support_friction, strict=True)
    return tuple(Support(name, index[int(geom)][0], float(mu)) for name, geom, mu in given)


def facing(hand: Hand, support: Support, R_WO: Array, p_WO: Array) -> tuple[float, Array]:
    """Distance of object and support, m (negative: how deep they overlap), and the unit normal in W, into the object."""
    return min((met(hand, support, o, R_WO, p_WO) for o in bodies_of(hand)), key=lambda found: found[0])


def bodies_of(hand: Hand) -> range:
    """Indices into Hand.geoms of the object's parts."""
    return range(hand.object_geom, len(hand.geoms.kind))


def met(hand: Hand, support: Support, o: int, R_WO: Array, p_WO: Array) -> tuple[float, Array]:
    """`facing` of the object's part o alone."""
    geoms, s = hand.geoms, support.geom
    height, n = contact(
        geoms.kind[s], geoms.core[s], geoms.radius[s], geoms.R_LG[s], geoms.p_LG[s],
        geoms.kind[o], geoms.core[o], geoms.radius[o], *placed(hand, o, R_WO, p_WO),
    )  # fmt: skip
    return height, np.array(n)


def placed(hand: Hand, o: int, R_WO: Array, p_WO: Array) -> tuple[Array, Array]:
    """The pose of the object's part o in W."""
    R_OP, p_OP = hand.geoms.R_LG[o], hand.geoms.p_LG[o]
    return np.ascontiguousarray(R_WO @ R_OP), np.ascontiguousarray(R_WO @ p_OP + p_WO)


def gap(hand: Hand, support: Support, R_WO: Array, p_WO: Array) -> float:
    """Distance of the object from the support, m (negative: how deep they overlap)."""
    return facing(hand, support, R_WO, p_WO)[0]


def on_surface(hand: Hand, support: Support, p_W: Array) -> bool:
    """Whether a point touches the support."""
    geoms, s = hand.geoms, support.geom
    height, _ = contact(
        geoms.kind[s], geoms.core[s], geoms.radius[s], geoms.R_LG[s], geoms.p_LG[s],
        POINT, np.zeros(3), 0.0, np.eye(3), np.ascontiguousarray(p_W),
    )  # fmt: skip
    return abs(height) <= TOUCH


def moved_onto(hand: Hand, support: Support, R_WO: Array, p_WO: Array) -> Array:
    """p_WO such that the object, not turned, touches the support: moved along their normal, again and again.

    Bodies apart keep their nearest points on the way, so that one step does; for such as overlap it is the way out.
    """
    for _ in range(STEPS):
        height, n_W = facing(hand, support, R_WO, p_WO)
        if abs(height) <= EXACT:
            break
        p_WO = p_WO - height * n_W
    return p_WO


def patch_of(hand: Hand, support: Support, R_WO: Array, p_WO: Array) -> Patch | None:
    """The contact patch of the support and the object at pose X_WO, if they touch."""
    height, n_W = facing(hand, support, R_WO, p_WO)
    if abs(height) > TOUCH:
        return None
    geoms, s, found = hand.geoms, support.geom, []
    for o in bodies_of(hand):
        if met(hand, support, o, R_WO, p_WO)[0] > TOUCH:
            continue
        polygon, present, points = np.empty((ROOM, 3)), np.zeros(SLOTS, np.uint8), np.zeros((SLOTS, 3))
        count = patch(
            geoms.kind[s], geoms.core[s], geoms.R_LG[s], geoms.p_LG[s],
            geoms.kind[o], geoms.core[o], geoms.radius[o], *placed(hand, o, R_WO, p_WO),
            (n_W[0], n_W[1], n_W[2]), np.empty((SCRATCH, ROOM, 4)), polygon, present, points,
        )  # fmt: skip
        found.append(polygon[:count])
    return Patch(n_W, found[0] if len(found) == 1 else around(np.concatenate(found), n_W))


def around(points: Array, n_W: Array) -> Array:
    """Corners, in order, of the least convex polygon across n that holds the points (P, 3)."""
    from scipy.spatial import ConvexHull

    x = np.cross(n_W, np.eye(3)[np.argmin(np.abs(n_W))])
    flat = (points - points[0]) @ np.stack([x, np.cross(n_W, x)]).T / np.linalg.norm(x)
    middle = flat.mean(axis=0)
    _, axes = np.linalg.eigh((flat - middle).T @ (flat - middle))
    along = (flat - middle) @ axes[:, 1]
    if np.ptp((flat - middle) @ axes[:, 0]) <= TOUCH:
        ends = [int(np.argmin(along)), int(np.argmax(along))]
        return points[ends[: 1 if np.ptp(along) <= TOUCH else 2]]
    return points[ConvexHull(flat).vertices]


def touching(hand: Hand, support: Support, R_WO: Array, p_WO: Array) -> list[tuple[Array, Array]]:
    """Contacts of the object with the support at pose X_WO, none of them twice: [(p_O, n_W)], n into the object."""
    touches = patches_along(hand, (support,), R_WO[None], p_WO[None])
    found: list[tuple[Array, Array]] = []
    there = touches.present[0, 0]
    for p_W, n_W in zip(touches.p_W[0, 0][there], touches.n_W[0, 0][there], strict=True):
        if all(np.linalg.norm(p_W - other) > COINCIDE for other, _ in found):
            found.append((p_W, n_W))
    return [(R_WO.T @ (p_W - p_WO), n_W) for p_W, n_W in found]


def patches_along(hand: Hand, supports: tuple[Support, ...], R_WO: Array, p_WO: Array) -> Touches:
    """The slots of the supports that touch the object at poses R_WO (S, 3, 3), p_WO (S, 3)."""
    S, A, B = len(p_WO), len(supports), len(bodies_of(hand))
    n, present, points = np.zeros((S, A, B, 3)), np.zeros((S, A, B, SLOTS), np.uint8), np.zeros((S, A, B, SLOTS, 3))
    ids = np.array([support.geom for support in supports], np.int64)
    _along(
        hand.geoms, hand.object_geom, ids, np.ascontiguousarray(R_WO), np.ascontiguousarray(p_WO), n, present, points
    )
    flat = present.reshape(S, A, B * SLOTS).astype(bool)
    return Touches(np.repeat(n, SLOTS, axis=2), flat, points.reshape(S, A, B * SLOTS, 3))


@heap
def _along(
    geoms: Geoms, first: int, ids: Ints, R_WO: Array, p_WO: Array, n_W: Array, present: Flags, p_W: Array
) -> None:  # fmt: skip
    """Write the fields of `Touches` for the geoms `ids` and the object, whose parts are the geoms from `first` on."""
    scratch, polygon = np.empty((SCRATCH, ROOM, 4)), np.empty((ROOM, 3))
    R, p = np.empty((3, 3)), np.empty(3)
    for sample in range(len(p_WO)):
        for o in range(first, len(geoms.kind)):
            part = o - first
            multiply(R_WO[sample], geoms.R_LG[o], R)
            rotate(R_WO[sample], geoms.p_LG[o], p)
            for x in range(3):
                p[x] += p_WO[sample, x]
            for a in range(len(ids)):
                s = ids[a]
                R_S, p_S = geoms.R_LG[s], geoms.p_LG[s]
                if bounds_far(p_S, geoms.bound[s], p, geoms.bound[o], TOUCH):
                    continue
                height, n = contact(
                    geoms.kind[s], geoms.core[s], geoms.radius[s], R_S, p_S,
                    geoms.kind[o], geoms.core[o], geoms.radius[o], R, p,
                )  # fmt: skip
                n_W[sample, a, part, 0], n_W[sample, a, part, 1], n_W[sample, a, part, 2] = n
                if abs(height) <= TOUCH:
                    patch(
                        geoms.kind[s], geoms.core[s], R_S, p_S, geoms.kind[o], geoms.core[o], geoms.radius[o], R, p, n,
                        scratch, polygon, present[sample, a, part], p_W[sample, a, part],
                    )  # fmt: skip
