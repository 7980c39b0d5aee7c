"""Choices of a candidate for every agent (paper §3): what a grasp costs, and choices that get cheaper agent by agent."""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.basis import Program, program
from regrasp.kernels.forces import EDGES
from regrasp.kernels.native import inlined, kernel
from regrasp.kernels.records import Record
from regrasp.planner.ahead import OUT, Ahead
from regrasp.planner.balance import balance
from regrasp.planner.collision import hits
from regrasp.planner.follow import wanders
from regrasp.planner.hand import Hand
from regrasp.planner.motions import STAY, whole
from regrasp.planner.path import Path
from regrasp.planner.reserve import Margins
from regrasp.planner.scan import LOOKS, look_ahead
from regrasp.planner.supports import STICK
from regrasp.planner.terms import Terms

Array = NDArray[np.float64]
Choice = tuple[int, ...]
Fixed = tuple[Hand, Path, Terms, NDArray[np.int64], Array, Array]


class Weighing(Record):
    """What the cost of a choice is worked out with: the force program, its last basis for each question, who stands where.

    bases (LOOKS + 1 + k, ·): of the looks, then of the start without agent i. For all agents (k,): which, their row of `Ahead`
    or −1; bears; codes; contacts p, n, t (k, 3).
    """

    lp: Program
    bases: NDArray[np.int64]
    which: NDArray[np.int64]
    bears: NDArray[np.uint8]
    codes: NDArray[np.int16]
    p: Array
    n: Array
    t: Array


def new_weighing(hand: Hand, path: Path) -> Weighing:
    """Nothing weighed yet."""
    k = len(hand.tip_geom)
    lp = program(EDGES * (k + path.support_mode.shape[1]), k)
    return Weighing(
        lp, np.tile(lp.basis, (LOOKS + 1 + k, 1)), np.full(k, -1), np.zeros(k, np.uint8), np.full(k, STAY, np.int16),
        np.zeros((k, 3)), np.zeros((k, 3)), np.zeros((k, 3)),
    )  # fmt: skip


@kernel
def weighed(hand: Hand, path: Path, j: int, s: int, margins: Margins, question: int, w: Weighing) -> tuple[bool, float]:
    """(whether the contacts hold the object at sample s of interval j, Σ of their normal forces). question: a row of bases."""
    basis = w.bases[question]
    w.lp.basis[:] = basis
    held, value, _ = balance(hand, path, j, s, w.bears, w.codes, w.p, w.n, w.t, margins, True, w.lp)
    basis[:] = w.lp.basis
    return held, value


@kernel
def with_indispensable(
    hand: Hand, path: Path, terms: Terms, margins: Margins, cost: float, bound: float, w: Weighing
) -> float:
    """A cost, and `outlook` times the part of the agents that bear without any one of which the others, at rest, don't hold
    the object at the path's start; inf as soon as it is known not to be below the bound."""
    count, lost, total = 0, 0, cost
    for i in range(len(w.bears)):
        count += w.bears[i]
    for i in range(len(w.bears)):
        if w.bears[i]:
            w.bears[i] = 0
            held, _ = weighed(hand, path, whole(0), whole(0), margins, LOOKS + 1 + i, w)
            w.bears[i] = 1
            lost += not held
            total = cost + terms.outlook * (lost / count)
            if total >= bound:
                return np.inf
    return total


@kernel
def grasp_cost(
    hand: Hand, path: Path, terms: Terms, agents: NDArray[np.int64], rest_R: Array, rest_p: Array,
    choice: NDArray[np.int64], margins: Margins, ahead: Ahead, bound: float, w: Weighing,
) -> float:  # fmt: skip
    """Σ of the contact forces at the path's two ends with agent agents[a] on candidate choice[a], plus what is lost ahead.

    An agent whose choice is OUT is off. As in a relocation: where contacts leave reach, where the object is not held on the
    way, and agents that could not be relocated as the others don't hold; beside these, contacts on edges. rest_R, rest_p
    (k, g_max, …): all agents' bodies at rest. inf without equilibrium, where two agents collide at the start, where no agent
    touches, or as soon as it is known not to be below the bound.
    """
    n, m = path.R_WO.shape[0], path.R_WO.shape[1] - 1
    w.which[:] = -1
    w.bears[:] = 0
    cost, start, stick, looks = 0.0, whole(0), 0, path.support_mode.shape[1] > 0
    for a in range(len(agents)):
        if choice[a] == OUT:
            continue
        i = agents[a]
        w.which[i], w.bears[i] = a, 1
        stick += 1
        cost += terms.outlook * (1.0 - ahead.kept[a, choice[a]] + ahead.sharp[a, choice[a]])
        looks = looks or wanders(hand, i)
    if stick == 0 or cost >= bound:
        return np.inf
    for column in range(path.support_mode.shape[1]):
        if path.support_mode[n // 2, column] == STICK:
            stick += 1
    cost += terms.stability * max(0, hand.needed - stick)
    contacts_at(choice, ahead, start, w)
    held, value = weighed(hand, path, start, start, margins, start, w)
    if not held or cost + value >= bound:
        return np.inf
    cost += value
    contacts_at(choice, ahead, whole(LOOKS), w)
    held, value = weighed(hand, path, n - 1, m, margins, whole(LOOKS), w)
    cost += value if held else 2.0 * terms.outlook
    if looks:
        for look in range(1, LOOKS):
            if cost >= bound:
                return np.inf
            contacts_at(choice, ahead, look, w)
            held, _ = weighed(hand, path, min(look_ahead(n, start, look), n - 1), start, margins, look, w)
            if not held:
                cost += 2.0 * terms.outlook / LOOKS
    if cost >= bound:
        return np.inf
    contacts_at(choice, ahead, start, w)
    cost = with_indispensable(hand, path, terms, margins, cost, bound, w)
    if cost >= bound:
        return np.inf
    return with_collisions(hand, terms, rest_R, rest_p, choice, ahead, cost, bound, w)


@kernel
def with_collisions(
    hand: Hand, terms: Terms, rest_R: Array, rest_p: Array, choice: NDArray[np.int64], ahead: Ahead, cost: float,
    bound: float, w: Weighing,
) -> float:  # fmt: skip
    """A cost, and what it costs that agents collide ahead; inf where two do at the start, or if it is not below the bound."""
    for look in range(LOOKS + 1):
        for i in range(len(w.which)):
            R_I, p_I = bodies(rest_R, rest_p, choice, ahead, i, look, w)
            for c in range(i + 1, len(w.which)):
                R_C, p_C = bodies(rest_R, rest_p, choice, ahead, c, look, w)
                if hits(hand, i, c, R_I, p_I, R_C, p_C, terms.clearance):
                    cost += np.inf if look == 0 else terms.outlook / LOOKS
                    if cost >= bound:
                        return np.inf
    return cost


@inlined
def bodies(
    rest_R: Array, rest_p: Array, choice: NDArray[np.int64], ahead: Ahead, i: int, look: int, w: Weighing
) -> tuple[Array, Array]:
    """Poses of agent i's bodies at a look ahead, on its candidate or at rest."""
    a = w.which[i]
    if a >= 0:
        return ahead.R_WG[a, choice[a], look], ahead.p_WG[a, choice[a], look]
    return rest_R[i], rest_p[i]


@kernel
def contacts_at(choice: NDArray[np.int64], ahead: Ahead, look: int, w: Weighing) -> None:
    """w.p, w.n: the contacts at a look ahead of the agents that touch, on their candidates."""
    for i in range(len(w.which)):
        a = w.which[i]
        if a >= 0:
            for x in range(3):
                w.p[i, x] = ahead.p_O[a, choice[a], look, x]
                w.n[i, x] = ahead.n_O[a, choice[a], look, x]


@kernel
def improve(
    hand: Hand, path: Path, terms: Terms, agents: NDArray[np.int64], rest_R: Array, rest_p: Array,
    choice: NDArray[np.int64], margins: Margins, ahead: Ahead, cost: float, w: Weighing,
) -> float:  # fmt: skip
    """Change one agent's candidate at a time as long as the cost falls; choice in and out. Returns the cost.

    An agent may only be off where supports can hold the object without it.
    """
    first = OUT if path.support_mode.shape[1] > 0 else 0
    a, alike = whole(0), 0  # agents in turn whose best candidate stays what it was
    while alike < len(agents):
        alike += 1
        for c in range(first, ahead.kept.shape[1]):
            if c >= 0 and ahead.kept[a, c] < 0.0:
                continue
            before = choice[a]
            choice[a] = c
            value = grasp_cost(hand, path, terms, agents, rest_R, rest_p, choice, margins, ahead, cost, w)
            if value < cost - 1e-9:
                cost, alike = value, 1
            else:
                choice[a] = before
        a = (a + 1) % len(agents)
    return cost


@kernel
def drawn(
    hand: Hand, path: Path, terms: Terms, agents: NDArray[np.int64], rest_R: Array, rest_p: Array,
    choice: NDArray[np.int64], margins: Margins, ahead: Ahead, w: Weighing,
    legal: NDArray[np.int64], counts: NDArray[np.int64], u: Array, at: int,
) -> tuple[int, float]:  # fmt: skip
    """The next random choice that holds: (row of u after it, its cost), inf where the numbers run out before; choice out.

    legal (agents, ·): candidates, counts (agents,) of them; u (tries, agents): uniform on [0, 1), used from row `at` on.
    """
    for row in range(at, len(u)):
        for a in range(len(agents)):
            choice[a] = legal[a, whole(u[row, a] * counts[a])]
        cost = grasp_cost(hand, path, terms, agents, rest_R, rest_p, choice, margins, ahead, np.inf, w)
        if cost < np.inf:
            return row + 1, cost
    return len(u), np.inf


def choices(
    fixed: Fixed, margins: Margins, ahead: Ahead, w: Weighing, legal: list[NDArray[np.int64]], u: Array, restarts: int
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
        at, cost = drawn(*fixed, choice, margins, ahead, w, table, counts, u, at)
        if cost == np.inf:
            break
        cost = improve(*fixed, choice, margins, ahead, cost, w)
        found.setdefault(tuple(choice.tolist()), cost)
    return found
