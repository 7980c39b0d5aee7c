"""The agents' tips at the object: which of their points touches, where they stand then, and how far they are from it."""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.contact import OK, contact_rates
from regrasp.kernels.gaps import gap
from regrasp.kernels.gauss import support_point
from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import multiply_back, norm, rotate, rotate_back
from regrasp.kernels.stack import stack
from regrasp.kernels.surfaces import CAPSULE, ELLIPSOID, MESH, SPHERE
from regrasp.planner.hand import Hand

Array = NDArray[np.float64]

RUNS = 1.0  # m per rad: a contact that runs faster as the tip turns is one of faces that are all but flat
CUT = 1e-5  # m: a tip that is deeper in the object somewhere else than at its contact does not fit there


@kernel
def under(hand: Hand, i: int, R_OT: Array, n_O: Array, p_TC: Array) -> None:
    """p_TC, the point of agent i's tip that touches where the object's normal is n_O: its normal there is −R_OTᵀ n_O."""
    rotate_back(R_OT, n_O, p_TC)
    p_TC[0], p_TC[1], p_TC[2] = support_point(
        hand.kind_T[i], hand.size_T[i], hand.grids, (-p_TC[0], -p_TC[1], -p_TC[2])
    )


@kernel
def over(
    hand: Hand, i: int, R_WO: Array, p_WO: Array, p_O: Array, n_O: Array, height: float, R_WT: Array, p_WT: Array
) -> None:
    """p_WT, where agent i's tip, turned as R_WT, stands `height` over the object's point p_O, along the normal n_O there."""
    if hand.kind_T[i] == SPHERE:
        height += hand.size_T[i, 0]
    for x in range(3):
        p_WT[x] = p_O[x] + height * n_O[x]
    rotate(R_WO, p_WT, p_WT)
    for x in range(3):
        p_WT[x] += p_WO[x]
    if hand.kind_T[i] != SPHERE:
        R_OT, p_TC = stack((3, 3)), stack(3)
        multiply_back(R_WO, R_WT, R_OT)
        under(hand, i, R_OT, n_O, p_TC)
        for x in range(3):
            for y in range(3):
                p_WT[x] -= R_WT[x, y] * p_TC[y]


@kernel
def plain(hand: Hand, i: int) -> bool:
    """Whether agent i's tip is a ball and the object convex: then a contact is always defined and nothing else touches."""
    return bool(hand.kind_T[i] == SPHERE and hand.kind_O != MESH)


@kernel
def tip_gap(hand: Hand, i: int, R_OT: Array, p_OT: Array, p_O: Array, n_O: Array) -> float:
    """Distance of agent i's tip from the object, m, negative inside; p_O, n_O: the object's nearest point, its normal there."""
    p_TC = stack(3)
    _, distance = gap(hand.kind_O, hand.size_O, hand.kind_T[i], hand.size_T[i], hand.grids, R_OT, p_OT, p_O, p_TC, n_O)
    return distance


@kernel
def fits(hand: Hand, i: int, p_OC: Array, p_TC: Array, R_OT: Array) -> bool:
    """Whether agent i's tip, in contact, touches the object nowhere else: two sides of a hollow, say."""
    if plain(hand, i):
        return True
    p_OT, p, n = stack(3), stack(3), stack(3)
    for x in range(3):
        p_OT[x] = p_OC[x]
        for y in range(3):
            p_OT[x] -= R_OT[x, y] * p_TC[y]
    return bool(tip_gap(hand, i, R_OT, p_OT, p, n) > -CUT)


@kernel
def touches_in_a_point(hand: Hand, i: int, p_OC: Array, p_TC: Array, R_OT: Array) -> bool:
    """Whether agent i's contact is one that can move, and the only one: no line, no face, no second point.

    The faces of a mesh are flat but for the errors of its grid: a contact that runs off when the tip turns lies on one.
    """
    if plain(hand, i):
        return True
    w_O, still, pdot, cdot = stack(3), stack(3), stack(3), stack(3)
    for x in range(3):
        w_O[x] = still[x] = 0.0
    for x in range(3):
        w_O[x] = 1.0
        status = contact_rates(
            hand.kind_O,
            hand.size_O,
            hand.kind_T[i],
            hand.size_T[i],
            hand.grids,
            p_OC,
            p_TC,
            R_OT,
            w_O,
            still,
            pdot,
            cdot,
        )
        if status != OK or norm(pdot) > RUNS:
            return False
        w_O[x] = 0.0
    return fits(hand, i, p_OC, p_TC, R_OT)


def sharpest(kind: int, size: Array) -> float:
    """The smallest radius of curvature of a tip, m: a ball of it touches from within the tip wherever one likes."""
    if kind == ELLIPSOID:
        return float(np.min(size[:3]) ** 2 / np.max(size[:3]))
    return float(size[0] if kind in (SPHERE, CAPSULE) else size[3])
