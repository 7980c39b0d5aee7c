"""One arc sample by sample: what all agents do in every interval, whom they touch, and whether the object is held."""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.chains import forward
from regrasp.kernels.native import heap
from regrasp.kernels.stack import stack
from regrasp.kernels.surfaces import project, tangents
from regrasp.planner.balance import balance
from regrasp.planner.collision import hits, moving_row, object_row, place, place_agent, tip_hits
from regrasp.planner.configurations import Configurations
from regrasp.planner.follow import is_full, reach_tip, roll, short_step
from regrasp.planner.hand import Hand
from regrasp.planner.motions import RELOCATE, is_sliding, slide_direction, whole
from regrasp.planner.passage import along
from regrasp.planner.path import Path
from regrasp.planner.state import State
from regrasp.planner.terms import Terms, Work, moves_freely

Array = NDArray[np.float64]
Flags = NDArray[np.uint8]

SAME = 1e-4  # rad: joints traced sample by sample and found in one step must agree, else there is a singularity between
LOST, NO_WAY = 1, 2


@heap
def trace_contact(
    hand: Hand, path: Path, command: Array, j: int, i: int,
    p_OC: Array, p_TC: Array, R_OT: Array, x_O: Array, q: Array, n_O: Array,
) -> bool:  # fmt: skip
    """`follow` with every sample kept: row 0 of all arrays (m + 1, …) is the start, the other rows are written."""
    m = path.R_WO.shape[1] - 1
    y, foot, b = stack(3), stack(3), hand.base[i]
    n_a = q.shape[1]
    R_WL, p_WL = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3))
    step = command / m
    project(hand.kind_O, hand.size_O, hand.grids, p_OC[0], foot, n_O[0])
    tangents(n_O[0], x_O[0], y)
    fine = True
    for s in range(m):
        p_OC[s + 1], p_TC[s + 1], R_OT[s + 1], x_O[s + 1], q[s + 1] = p_OC[s], p_TC[s], R_OT[s], x_O[s], q[s]
        if is_full(hand, i):
            kept = roll(hand, i, step, whole(1), p_OC[s + 1], p_TC[s + 1], R_OT[s + 1], x_O[s + 1])
            if (
                not reach_tip(
                    hand, path, j, s + 1, i, q[s], p_OC[s + 1], p_TC[s + 1], R_OT[s + 1], q[s + 1], R_WL, p_WL
                )
                or not kept
            ):
                fine = False
        elif not short_step(
            hand, path.R_PO[b, j, s], path.p_PO[b, j, s], path.R_PO[b, j, s + 1], path.p_PO[b, j, s + 1], i, step, 1.0,
            p_OC[s + 1], p_TC[s + 1], R_OT[s + 1], x_O[s + 1], q[s + 1], R_WL, p_WL,
        ):  # fmt: skip
            fine = False
        project(hand.kind_O, hand.size_O, hand.grids, p_OC[s + 1], foot, n_O[s + 1])
    return fine


@heap
def sample_hits(
    hand: Hand, path: Path, j: int, q: Array, holds: NDArray[np.uint8], ends: NDArray[np.uint8], clearance: float,
    R_B: Array, p_B: Array, found: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Blocks that collide at any sample of interval j: found (k, k + 2). q (m + 1, nq) joints of all agents.

    holds (k,): in contact all through; ends (k,): in contact at the start (1), the end (2) or both (3) of a free motion,
    near which its tip may be close to the object. R_B, p_B: static bodies, then the arms' and the object's, which are moved.
    """
    m, k, first, last = q.shape[0] - 1, len(holds), moving_row(hand), object_row(hand)
    # Without np.max and np.diff, for whose sake numba would load SciPy's linear algebra.
    geoms, joints = 0, 0
    for i in range(k):
        geoms = max(geoms, hand.geom_start[i + 1] - hand.geom_start[i])
        joints = max(joints, hand.chains.start[i + 1] - hand.chains.start[i])
    R_G, p_G = np.empty((k, geoms, 3, 3)), np.empty((k, geoms, 3))
    obj, obj_p = np.zeros((1, 3, 3)), np.zeros((1, 3))
    rise = m // 4
    R_WL, p_WL = np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3))
    for s in range(m + 1):
        obj[0], obj_p[0] = path.R_WO[j, s], path.p_WO[j, s]
        place(hand, hand.object_geom, len(hand.geoms.kind), obj, obj_p, R_B[last:], p_B[last:])
        for g in range(last - first):
            R_B[first + g], p_B[first + g] = path.R_WG[j, s, g], path.p_WG[j, s, g]
        for i in range(k):
            b = hand.base[i]
            forward(hand.chains, i, q[s, hand.chains.start[i] : hand.chains.start[i + 1]], R_WL, p_WL)
            place_agent(hand, i, path.R_WP[b, j, s], path.p_WP[b, j, s], R_WL, p_WL, R_G[i], p_G[i])
        for a in range(k):
            near = (ends[a] & 1 and s <= rise) or (ends[a] & 2 and s >= m - rise)
            for c in range(a, k):
                if hits(hand, a, c, R_G[a], p_G[a], R_G[c], p_G[c], clearance):
                    found[a, c] = 1
            if hits(hand, a, k, R_G[a], p_G[a], R_B, p_B, clearance):
                found[a, k] = 1
            if hits(hand, a, k + 1, R_G[a], p_G[a], R_B[last:], p_B[last:], clearance) or (
                holds[a] == 0 and not near and tip_hits(hand, a, R_G[a], p_G[a], R_B[last:], p_B[last:], clearance)
            ):
                found[a, k + 1] = 1


@heap
def balanced(
    hand: Hand, path: Path, terms: Terms, j: int, bears: NDArray[np.uint8], codes: NDArray[np.int16],
    p_OC: Array, n_O: Array, x_O: Array, work: Work,
) -> bool:  # fmt: skip
    """Whether contact forces hold the object at every sample of interval j; p_OC, n_O, x_O (m + 1, k, 3)."""
    m, k = len(p_OC) - 1, len(bears)
    t, y = np.zeros((k, 3)), np.zeros(3)
    for s in range(m + 1):
        for i in range(k):
            if bears[i] and is_sliding(whole(codes[i])):
                n, x = n_O[s, i], x_O[s, i]
                for a in range(3):
                    y[a] = n[(a + 1) % 3] * x[(a + 2) % 3] - n[(a + 2) % 3] * x[(a + 1) % 3]
                slide_direction(whole(codes[i]), x, y, t[i])
        held, _, _ = balance(hand, path, j, s, bears, codes, p_OC[s], n_O[s], t, terms.margins, s > 0, work.lp)
        if not held:
            return False
    return True


@heap
def trace(
    hand: Hand, path: Path, terms: Terms, found: Configurations, state: State, work: Work,
    joints: Array, p_OC: Array, n_O: Array, x_O: Array, R_OT: Array, bears: Flags, ends: Flags, broken: Flags,
    touched: Flags, held: Flags,
) -> None:  # fmt: skip
    """Every sample of the path's intervals under a V, whose interval ends stand in the state as `evaluate` left them.

    Written: joints (n, m + 1, nq); p_OC, n_O, x_O (n, m + 1, k, 3), R_OT (n, m + 1, k, 3, 3) where bears (n, k); ends (n, k):
    as in `sample_hits`; broken (n, k): LOST in contact, or NO_WAY to or from one; touched (n, k, k + 2): blocks that collide;
    held (n,): the object is, at every sample.
    """
    n, k = len(path.R_WO), state.V.shape[1]
    m = path.R_WO.shape[1] - 1
    for j in range(n):
        for i in range(k):
            first, last = hand.chains.start[i], hand.chains.start[i + 1]
            n_a = last - first
            here, there = state.at[j, i], state.at[j + 1, i]
            code, holds = whole(state.V[j, i]), found.holds[here]
            q = np.zeros((m + 1, n_a))
            q[0] = found.q[here, :n_a]
            if code < RELOCATE and holds:
                bears[j, i] = 1
                p, p_T, x, normal = (
                    np.zeros((m + 1, 3)),
                    np.zeros((m + 1, 3)),
                    np.zeros((m + 1, 3)),
                    np.zeros((m + 1, 3)),
                )
                R = np.zeros((m + 1, 3, 3))
                p[0], p_T[0], R[0] = found.p_OC[here], found.p_TC[here], found.R_OT[here]
                traced = trace_contact(hand, path, terms.commands[code], j, i, p, p_T, R, x, q, normal)
                apart = 0.0
                for a in range(n_a):
                    apart = max(apart, abs(q[m, a] - found.q[there, a]))
                    q[m, a] = found.q[there, a]
                if found.lost[there] or not traced or apart > SAME:
                    broken[j, i] = LOST
                for s in range(m + 1):
                    p_OC[j, s, i], n_O[j, s, i], x_O[j, s, i], R_OT[j, s, i] = p[s], normal[s], x[s], R[s]
            elif moves_freely(code, holds) and not state.behind[j, i] and state.way[j, i] >= 0:
                along(hand, path, found, j, i, here, there, whole(state.way[j, i]), terms.high, q)
                ends[j, i] = holds + 2 * found.holds[there]
            else:
                for s in range(m):
                    q[s + 1] = q[0]
                if moves_freely(code, holds):
                    broken[j, i] = NO_WAY
            joints[j, :, first:last] = q
        sample_hits(
            hand, path, j, joints[j], bears[j], ends[j], 0.5 * terms.clearance, found.R_WB[j].copy(), found.p_WB[j].copy(),
            touched[j],
        )  # fmt: skip
        held[j] = balanced(hand, path, terms, j, bears[j], state.V[j], p_OC[j], n_O[j], x_O[j], work)
