"""Where every agent and contact is at the ends of all intervals, under one matrix V."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from regrasp.kernels.records import Record
from regrasp.planner.hand import Hand
from regrasp.planner.path import Path

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.uint8]


class State(Record):
    """Configurations j = 0 … n (rows of the first group), intervals j = 0 … n − 1 (rows of the second).

    q (n + 1, nq); holds (n + 1, k): in contact; p_OC, p_TC (n + 1, k, 3), R_OT (n + 1, k, 3, 3): the contact on the object
    and on the tip, the tip's orientation; R_WG (n + 1, G, 3, 3), p_WG (n + 1, G, 3): poses of all bodies.

    V (n, k): contact motions; n_O, t_O (n, 2, k, 3): normal and slip direction at start and end of the interval;
    chosen (n, k): where a relocating agent went (candidate, −1 none) and way (n, k): how; lost (n, k): workspace condition
    broken; hits (n, k, k + 2): collisions at the interval's end; c, e, f, h (n,): the interval's share of Eq. (1);
    end (n,): the sum of forces at the interval's end, inf without equilibrium.
    """

    q: Array
    holds: Flags
    p_OC: Array
    p_TC: Array
    R_OT: Array
    R_WG: Array
    p_WG: Array
    V: NDArray[np.int8]
    n_O: Array
    t_O: Array
    chosen: Ints
    way: Ints
    lost: Flags
    hits: Flags
    c: Array
    e: Array
    f: Array
    h: Array
    end: Array


def empty_state(hand: Hand, path: Path) -> State:
    """A State of the right shapes with the object and the static bodies in place."""
    n, samples = path.R_WO.shape[:2]
    k = len(hand.tip_geom)
    count = len(hand.geoms.kind)
    state = State(
        q=np.zeros((n + 1, len(hand.home))),
        holds=np.zeros((n + 1, k), np.uint8),
        p_OC=np.zeros((n + 1, k, 3)),
        p_TC=np.zeros((n + 1, k, 3)),
        R_OT=np.zeros((n + 1, k, 3, 3)),
        R_WG=np.zeros((n + 1, count, 3, 3)),
        p_WG=np.zeros((n + 1, count, 3)),
        V=np.zeros((n, k), np.int8),
        n_O=np.zeros((n, 2, k, 3)),
        t_O=np.zeros((n, 2, k, 3)),
        chosen=np.full((n, k), -1),
        way=np.zeros((n, k), np.int64),
        lost=np.zeros((n, k), np.uint8),
        hits=np.zeros((n, k, k + 2), np.uint8),
        c=np.zeros(n),
        e=np.zeros(n),
        f=np.zeros(n),
        h=np.zeros(n),
        end=np.zeros(n),
    )
    static = slice(hand.geom_start[k], hand.object_geom)
    state.R_WG[:, static] = hand.geoms.R_LG[static]
    state.p_WG[:, static] = hand.geoms.p_LG[static]
    for j in range(n + 1):
        at = (j, 0) if j < n else (n - 1, samples - 1)
        R, p = path.R_WO[at], path.p_WO[at]
        state.R_WG[j, hand.object_geom] = R @ hand.geoms.R_LG[hand.object_geom]
        state.p_WG[j, hand.object_geom] = R @ hand.geoms.p_LG[hand.object_geom] + p
    return state


@njit(cache=True, nogil=True)
def copy_agent(hand: Hand, source: State, target: State, j: int, i: int) -> None:
    """Copy agent i's configuration j."""
    for a in range(hand.chains.start[i], hand.chains.start[i + 1]):
        target.q[j, a] = source.q[j, a]
    target.holds[j, i] = source.holds[j, i]
    target.p_OC[j, i] = source.p_OC[j, i]
    target.p_TC[j, i] = source.p_TC[j, i]
    target.R_OT[j, i] = source.R_OT[j, i]
    for g in range(hand.geom_start[i], hand.geom_start[i + 1]):
        target.R_WG[j, g] = source.R_WG[j, g]
        target.p_WG[j, g] = source.p_WG[j, g]


@njit(cache=True, nogil=True)
def copy_motion(source: State, target: State, j: int, i: int) -> None:
    """Copy what agent i does in interval j."""
    target.V[j, i] = source.V[j, i]
    for end in range(2):
        target.n_O[j, end, i] = source.n_O[j, end, i]
        target.t_O[j, end, i] = source.t_O[j, end, i]
    target.chosen[j, i] = source.chosen[j, i]
    target.way[j, i] = source.way[j, i]
    target.lost[j, i] = source.lost[j, i]


@njit(cache=True, nogil=True)
def copy_terms(source: State, target: State, j: int) -> None:
    """Copy the share of interval j in Eq. (1)."""
    target.c[j], target.e[j], target.f[j], target.h[j] = source.c[j], source.e[j], source.f[j], source.h[j]
    target.end[j] = source.end[j]


@njit(cache=True, nogil=True)
def same_agent(hand: Hand, a: State, b: State, j: int, i: int) -> bool:
    """Whether agent i's configuration j is the same in both, to the last bit."""
    if a.holds[j, i] != b.holds[j, i]:
        return False
    for x in range(hand.chains.start[i], hand.chains.start[i + 1]):
        if a.q[j, x] != b.q[j, x]:
            return False
    if a.holds[j, i]:
        for x in range(3):
            if a.p_OC[j, i, x] != b.p_OC[j, i, x]:
                return False
    return True
