"""Choices of a candidate for every agent (paper §3): what a grasp costs, and choices that get cheaper agent by agent."""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.basis import Program
from regrasp.kernels.native import heap, kernel
from regrasp.planner.ahead import OUT, Ahead
from regrasp.planner.balance import balance
from regrasp.planner.collision import hits
from regrasp.planner.follow import wanders
from regrasp.planner.hand import Hand
from regrasp.planner.motions import STAY, whole
from regrasp.planner.path import Path
from regrasp.planner.reserve import Margins
from regrasp.planner.scan import LOOKS, Scan, look_ahead
from regrasp.planner.supports import STICK
from regrasp.planner.terms import Terms

Array = NDArray[np.float64]
Choice = tuple[int, ...]
Fixed = tuple[Hand, Path, Scan, Terms, NDArray[np.int64], Array, Array]


@heap
def indispensable(
    hand: Hand, path: Path, bears: NDArray[np.uint8], p: Array, n: Array, margins: Margins, lp: Program
) -> float:
    """Part of the agents that bear without any one of which the others, at rest, don't hold the object at the path's start."""
    codes, t = np.full(len(bears), STAY, np.int16), np.zeros((len(bears), 3))
    left, start = bears.copy(), whole(0)
    count, lost = 0, 0
    for a in range(len(bears)):
        if bears[a]:
            count += 1
            left[a] = 0
            held, _, _ = balance(hand, path, start, start, left, codes, p, n, t, margins, True, lp)
            left[a] = 1
            if not held:
                lost += 1
    return lost / max(count, 1)


@heap
def grasp_cost(
    hand: Hand, path: Path, scan: Scan, terms: Terms, agents: NDArray[np.int64], rest_R: Array, rest_p: Array,
    choice: NDArray[np.int64], margins: Margins, ahead: Ahead, bound: float, lp: Program,
) -> float:  # fmt: skip
    """Σ of the contact forces at the path's two ends with agent agents[a] on candidate choice[a], plus what is lost ahead.

    An agent whose choice is OUT is off. As in a relocation: where contacts leave reach, where the object is not held on the
    way, and agents that could not be relocated as the others don't hold; beside these, contacts on edges. rest_R, rest_p
    (k, g_max, …): all agents' bodies at rest. inf without equilibrium, where two agents collide at the start, where no agent
    touches, or as soon as it is known not to be below the bound.
    """
    k, n, m = len(hand.tip_geom), path.R_WO.shape[0], path.R_WO.shape[1] - 1
    bears, codes = np.zeros(k, np.uint8), np.full(k, STAY, np.int16)
    p, normal, t = np.zeros((k, 3)), np.zeros((k, 3)), np.zeros((k, 3))
    which = np.full(k, -1)
    cost, start, stick, looks = 0.0, whole(0), 0, path.support_mode.shape[1] > 0
    for a in range(len(agents)):
        if choice[a] == OUT:
            continue
        i = agents[a]
        which[i] = a
        bears[i] = 1
        stick += 1
        cost += terms.outlook * (1.0 - ahead.kept[a, choice[a]] + ahead.sharp[a, choice[a]])
        looks = looks or wanders(hand, i)
    if stick == 0 or cost >= bound:
        return np.inf
    for column in range(path.support_mode.shape[1]):
        if path.support_mode[n // 2, column] == STICK:
            stick += 1
    cost += terms.stability * max(0, hand.needed - stick)
    contacts_at(which, choice, ahead, whole(0), p, normal)
    held, value, _ = balance(hand, path, start, start, bears, codes, p, normal, t, margins, True, lp)
    if not held or cost + value >= bound:
        return np.inf
    cost += value
    contacts_at(which, choice, ahead, whole(LOOKS), p, normal)
    held, value, _ = balance(hand, path, n - 1, m, bears, codes, p, normal, t, margins, True, lp)
    cost += value if held else 2.0 * terms.outlook
    if looks:
        for look in range(1, LOOKS):
            if cost >= bound:
                return np.inf
            j = look_ahead(n, start, look)
            contacts_at(which, choice, ahead, whole(look), p, normal)
            held, value, _ = balance(hand, path, min(j, n - 1), start, bears, codes, p, normal, t, margins, True, lp)
            if not held:
                cost += 2.0 * terms.outlook / LOOKS
    if cost >= bound:
        return np.inf
    contacts_at(which, choice, ahead, whole(0), p, normal)
    cost += terms.outlook * indispensable(hand, path, bears, p, normal, margins, lp)
    if cost >= bound:
        return np.inf
    for look in range(LOOKS + 1):
        for a in range(k):
            R_A, p_A = rest_R[a], rest_p[a]
            if which[a] >= 0:
                R_A, p_A = ahead.R_WG[which[a], choice[which[a]], look], ahead.p_WG[which[a], choice[which[a]], look]
            for c in range(a + 1, k):
                R_C, p_C = rest_R[c], rest_p[c]
                if which[c] >= 0:
                    R_C, p_C = (
                        ahead.R_WG[which[c], choice[which[c]], look],
                        ahead.p_WG[which[c], choice[which[c]], look],
                    )
                if hits(hand, a, c, R_A, p_A, R_C, p_C, terms.clearance):
                    if look == 0:
                        return np.inf
                    cost += terms.outlook / LOOKS
                    if cost >= bound:
                        return np.inf
    return cost


@kernel
def contacts_at(
    which: NDArray[np.int64], choice: NDArray[np.int64], ahead: Ahead, look: int, p: Array, n: Array
) -> None:
    """p, n (k, 3): the contacts at a look ahead of the agents with a row in `ahead`, which[i] ≥ 0, on their candidates."""
    for i in range(len(which)):
        if which[i] >= 0:
            for x in range(3):
                p[i, x] = ahead.p_O[which[i], choice[which[i]], look, x]
                n[i, x] = ahead.n_O[which[i], choice[which[i]], look, x]


@heap
def improve(
    hand: Hand, path: Path, scan: Scan, terms: Terms, agents: NDArray[np.int64], rest_R: Array, rest_p: Array,
    choice: NDArray[np.int64], margins: Margins, ahead: Ahead, cost: float, lp: Program,
) -> float:  # fmt: skip
    """Change one agent's candidate at a time as long as the cost falls; choice in and out. Returns the cost.

    An agent may only be off where supports can hold the object without it.
    """
    changed = True
    first = OUT if path.support_mode.shape[1] > 0 else 0
    while changed:
        changed = False
        for a in range(len(agents)):
            for c in range(first, len(scan.p_O)):
                if c >= 0 and ahead.kept[a, c] < 0.0:
                    continue
                before = choice[a]
                choice[a] = c
                value = grasp_cost(hand, path, scan, terms, agents, rest_R, rest_p, choice, margins, ahead, cost, lp)
                if value < cost - 1e-9:
                    cost, changed = value, True
                else:
                    choice[a] = before
    return cost


@heap
def drawn(
    hand: Hand, path: Path, scan: Scan, terms: Terms, agents: NDArray[np.int64], rest_R: Array, rest_p: Array,
    choice: NDArray[np.int64], margins: Margins, ahead: Ahead, lp: Program,
    legal: NDArray[np.int64], counts: NDArray[np.int64], u: Array, at: int,
) -> tuple[int, float]:  # fmt: skip
    """The next random choice that holds: (row of u after it, its cost), inf where the numbers run out before; choice out.

    legal (agents, ·): candidates, counts (agents,) of them; u (tries, agents): uniform on [0, 1), used from row `at` on.
    """
    for row in range(at, len(u)):
        for a in range(len(agents)):
            choice[a] = legal[a, whole(u[row, a] * counts[a])]
        cost = grasp_cost(hand, path, scan, terms, agents, rest_R, rest_p, choice, margins, ahead, np.inf, lp)
        if cost < np.inf:
            return row + 1, cost
    return len(u), np.inf


def choices(
    fixed: Fixed, margins: Margins, ahead: Ahead, lp: Program, legal: list[NDArray[np.int64]], u: Array, restarts: int
) -> dict[Choice, float]:
    """What random choices among legal candidates of the agents lead to when they are improved, and their costs.

    fixed: the first arguments of `grasp_cost`; u (tries, agents): uniform on [0, 1).
    """
    counts, table = np.array([len(free) for free in legal]), np.full((len(legal), max(map(len, legal))), OUT)
    for row, free in zip(table, legal, strict=True):
        row[: len(free)] = free
    choice, at = np.zeros(len(legal), np.int64), 0
    found: dict[Choice, float] = {}
    for _ in range(restarts):
        at, cost = drawn(*fixed, choice, margins, ahead, lp, table, counts, u, at)
        if cost == np.inf:
            break
        cost = improve(*fixed, choice, margins, ahead, cost, lp)
        found.setdefault(tuple(choice.tolist()), cost)
    return found
