"""What becomes of the contacts on the candidates of a scan if they are kept along the way ahead."""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.chains import forward
from regrasp.kernels.native import heap
from regrasp.kernels.records import Record
from regrasp.kernels.rotations import dot
from regrasp.kernels.stack import stack
from regrasp.kernels.surfaces import shape_operator
from regrasp.planner.collision import place_agent
from regrasp.planner.follow import wanders
from regrasp.planner.hand import Hand
from regrasp.planner.motions import whole
from regrasp.planner.path import Path, base_at
from regrasp.planner.scan import LOOKS, Scan, candidate_free, clear_on, look_ahead, stay_on
from regrasp.planner.terms import Terms

Array = NDArray[np.float64]
OUT = -1  # the choice of an agent that stays off
SLACK = 1e-3  # m by which the object may be off when it is touched
PROMISING = 20  # candidates of an agent of few joints among which random choices are drawn, those that tie included


class Ahead(Record):
    """What becomes of the contacts of the agents (A,) on the candidates (A, C) if they are kept along the path.

    kept (A, C): part of the path on which that is possible, −1 where the agent can't stand. sharp (A, C): by how much the
    normal turns, rad, where the contact is by SLACK elsewhere, in the mean over the looks; 0 for agents of six joints. At the
    start and the looks ahead, (A, C, LOOKS + 1, …): p_O, n_O, where the contact is and its normal; R_WG, p_WG (…, g_max, …),
    the agent's bodies.
    """

    kept: Array
    sharp: Array
    p_O: Array
    n_O: Array
    R_WG: Array
    p_WG: Array


def nothing_ahead(agents: int, candidates: int, geoms: int) -> Ahead:
    """An `Ahead` with nothing known yet."""
    shape = (agents, candidates, LOOKS + 1)
    return Ahead(
        np.zeros(shape[:2]), np.zeros(shape[:2]), np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros((*shape, geoms, 3, 3)),
        np.zeros((*shape, geoms, 3)),
    )  # fmt: skip


@heap
def look_over(
    hand: Hand, path: Path, scan: Scan, R_WB: Array, p_WB: Array, i: int, terms: Terms, row: int, ahead: Ahead,
    stride: int,
) -> int:  # fmt: skip
    """Every candidate for agent i at the path's start: how many it can stand on; its row of `ahead` out.

    stride: intervals at once in which contacts of agents of few joints are followed (`scan.hold_on`).
    """
    n_a, count = hand.chains.start[i + 1] - hand.chains.start[i], 0
    start = whole(0)
    q = np.zeros((LOOKS + 1, n_a))
    R_WL, p_WL, S = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3)), stack((3, 3))
    for c in range(len(scan.p_O)):
        ahead.kept[row, c] = -1.0
        if not candidate_free(hand, path, scan, R_WB[0], p_WB[0], start, i, c, terms.clearance):
            continue
        count += 1
        p, n_O = ahead.p_O[row, c], ahead.n_O[row, c]
        reached = stay_on(hand, path, scan, terms.commands, start, i, c, stride, q, p, n_O)
        ahead.kept[row, c] = clear_on(hand, path, scan, R_WB, p_WB, start, i, reached, q, terms.clearance) / LOOKS
        sharp = 0.0
        for look in range(LOOKS + 1):
            last = min(look, reached)
            p[look], n_O[look] = p[last], n_O[last]
            if wanders(hand, i):
                shape_operator(hand.kind_O, hand.size_O, hand.grids, p[look], n_O[look], S)
                bend = 0.0
                for x in range(3):
                    bend += dot(S[x], S[x])
                sharp += SLACK * np.sqrt(bend) / (LOOKS + 1)
            forward(hand.chains, i, q[last], R_WL, p_WL)
            R_WP, p_WP = base_at(path, hand.base[i], look_ahead(len(path.R_WO), start, look))
            place_agent(hand, i, R_WP, p_WP, R_WL, p_WL, ahead.R_WG[row, c, look], ahead.p_WG[row, c, look])
        ahead.sharp[row, c] = sharp
    return count


def longest(kept: Array, legal: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those of the legal candidates that can be kept as long as the PROMISING best of them; OUT stays."""
    on = kept[legal[legal != OUT]]
    if len(on) <= PROMISING:
        return legal
    least = np.sort(on)[-PROMISING]
    return legal[(legal == OUT) | (kept[legal] >= least)]
