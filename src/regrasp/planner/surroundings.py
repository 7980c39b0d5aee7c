"""The object among the static bodies: how near it is to each, and how far it may go along an arc."""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.distances import bounds_far, distance
from regrasp.kernels.features import TOUCH
from regrasp.kernels.native import heap, kernel
from regrasp.kernels.records import Record
from regrasp.kernels.rotations import exp, multiply, rotate
from regrasp.kernels.stack import stack
from regrasp.planner.hand import Hand
from regrasp.planner.supports import Support

Array = NDArray[np.float64]
Flags = NDArray[np.uint8]

SINK = 1e-7  # m: a body that carries the object is reached, or left behind, to this accuracy
HALVINGS = 32


class Surroundings(Record):
    """B static bodies that the object may meet, each a core with a radius, and the object's own parts.

    kind, radius, bound, carries (B,), core (B, C), R_WB (B, 3, 3), p_WB (B, 3): carries is 1 for those that the object may
    touch, all others are obstacles. geom (B,): where they stand in Hand.geoms. kind_O, radius_O, bound_O (O,), core_O
    (O, C), R_OP (O, 3, 3), p_OP (O, 3): the object's parts, in O.
    """

    kind: NDArray[np.int64]
    core: Array
    radius: Array
    bound: Array
    R_WB: Array
    p_WB: Array
    carries: Flags
    geom: NDArray[np.int64]
    kind_O: NDArray[np.int64]
    core_O: Array
    radius_O: Array
    bound_O: Array
    R_OP: Array
    p_OP: Array


def surroundings_of(hand: Hand, supports: tuple[Support, ...]) -> Surroundings:
    """The obstacles that the object may not touch, and the supports; the latter first, in their order."""
    k = len(hand.tip_geom)
    met = hand.pairs[hand.block[k, k] : hand.block[k, k + 1]]
    obstacles = [int(g) for g in np.unique(met) if g < hand.object_geom]
    geom = np.array([*(support.geom for support in supports), *obstacles], np.int64)
    geoms, own = hand.geoms, slice(hand.object_geom, len(hand.geoms.kind))
    return Surroundings(
        geoms.kind[geom], geoms.core[geom].reshape(-1, geoms.core.shape[1]), geoms.radius[geom], geoms.bound[geom],
        geoms.R_LG[geom].reshape(-1, 3, 3), geoms.p_LG[geom].reshape(-1, 3),
        (np.arange(len(geom)) < len(supports)).astype(np.uint8), geom,
        geoms.kind[own], geoms.core[own], geoms.radius[own], geoms.bound[own], geoms.R_LG[own], geoms.p_LG[own],
    )  # fmt: skip


@kernel
def gap_to(around: Surroundings, b: int, R: Array, p: Array, limit: float) -> float:
    """Distance of the object at pose (R, p) from body b, m; any value above the limit where it is farther."""
    least, R_WP, p_WP = limit + 1.0, stack((3, 3)), stack(3)
    for o in range(len(around.kind_O)):
        multiply(R, around.R_OP[o], R_WP)
        rotate(R, around.p_OP[o], p_WP)
        for x in range(3):
            p_WP[x] += p[x]
        if bounds_far(around.p_WB[b], around.bound[b], p_WP, around.bound_O[o], limit):
            continue
        gap = distance(
            around.kind[b], around.core[b], around.radius[b], around.R_WB[b], around.p_WB[b],
            around.kind_O[o], around.core_O[o], around.radius_O[o], R_WP, p_WP, limit,
        )  # fmt: skip
        least = min(least, gap)
    return least


@kernel
def gaps_at(around: Surroundings, R: Array, p: Array, limit: float, gaps: Array) -> None:
    """gaps (B,) = `gap_to` each body."""
    for b in range(len(gaps)):
        gaps[b] = gap_to(around, b, R, p, limit)


@heap
def along(R_0: Array, p_0: Array, w: Array, c: Array, d: Array, u: float, R: Array, p: Array) -> None:
    """Pose (R, p) at part u of an arc: a turn by the vector u w about the point c, which moves by u d meanwhile."""
    E, v = np.empty((3, 3)), np.empty(3)
    for x in range(3):
        v[x] = u * w[x]
    exp(v, E)
    multiply(E, R_0, R)
    for x in range(3):
        p[x] = c[x] + u * d[x]
        for y in range(3):
            p[x] += E[x, y] * (p_0[y] - c[y])


@kernel
def stopped(around: Surroundings, least: Array, R: Array, p: Array) -> int:
    """The first body that is nearer than it may be, least (B,), at a pose, or −1."""
    for b in range(len(least)):
        if gap_to(around, b, R, p, least[b]) < least[b]:
            return b
    return -1


@heap
def go(
    around: Surroundings, R_0: Array, p_0: Array, w: Array, c: Array, d: Array, steps: int, clearance: float,
    held: Flags, kept: Flags,
) -> tuple[float, int]:  # fmt: skip
    """How far the object gets along an arc (`along`): (part u of it, the body that stops it or −1).

    Obstacles stop it at the clearance, or where the start is nearer than that, at once if it came nearer still; a body that
    may carry it, where it touches. held (B,) in: the carriers that it touches at the start; kept out: those of them that it
    touches all the way to u. Looked at in `steps` steps, the stop found by halving.
    """
    B = len(around.kind)
    least, gaps = np.zeros(B), np.empty(B)
    R, p = np.empty((3, 3)), np.empty(3)
    gaps_at(around, R_0, p_0, clearance, gaps)
    for b in range(B):
        kept[b] = held[b]
        least[b] = min(-SINK if around.carries[b] else clearance, gaps[b] - SINK)
    before = 0.0
    for step in range(1, steps + 1):
        u = step / steps
        along(R_0, p_0, w, c, d, u, R, p)
        body = stopped(around, least, R, p)
        if body >= 0:
            low, high = before, u
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                along(R_0, p_0, w, c, d, middle, R, p)
                hit = stopped(around, least, R, p)
                if hit >= 0:
                    high, body = middle, hit
                else:
                    low = middle
            return low, body
        for b in range(B):
            if kept[b] and gap_to(around, b, R, p, TOUCH) > TOUCH:
                kept[b] = 0
        before = u
    return 1.0, -1
