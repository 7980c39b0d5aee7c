"""Stances: grasps found by a scan (`auto`), for the way that lies ahead."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.basis import Program, program
from regrasp.kernels.chains import forward
from regrasp.kernels.forces import EDGES
from regrasp.kernels.native import heap, kernel
from regrasp.kernels.records import Record
from regrasp.kernels.rotations import dot
from regrasp.kernels.stack import stack
from regrasp.kernels.surfaces import shape_operator
from regrasp.planner.balance import balance
from regrasp.planner.chain import ContactMotions
from regrasp.planner.collision import hits, object_row, place_agent, tip_hits
from regrasp.planner.configurations import Grasp, bodies_along
from regrasp.planner.follow import wanders
from regrasp.planner.grasp import build_grasp
from regrasp.planner.hand import Hand
from regrasp.planner.motions import OFF, STAY, whole
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Path, base_at
from regrasp.planner.reserve import Margins
from regrasp.planner.scan import LOOKS, Scan, candidate_free, clear_on, look_ahead, stay_on
from regrasp.planner.supports import STICK
from regrasp.planner.terms import Terms

Array = NDArray[np.float64]
Choice = tuple[int, ...]
Fixed = tuple[Hand, Path, Scan, Terms, NDArray[np.int64], Array, Array]
OUT = -1  # the choice of an agent that stays off
SLACK = 1e-3  # m by which the object may be off when it is touched
ROUNDS = 24  # grasps that are followed along the whole way, until one lasts
MORE = 3  # times as many restarts where agents have few joints: most contacts leave their reach on the way
PROMISING = 20  # candidates of such an agent among which random choices are drawn, those that tie included


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


@dataclass(frozen=True)
class Stance:
    """A grasp that was found, and the candidates of the scan on which its agents stand (k,), OUT where they are off.

    kept: the least part of the path along which one of its contacts can be kept.
    """

    grasp: Grasp
    candidates: NDArray[np.int64]
    kept: float


@dataclass(frozen=True)
class GraspSearch:
    """How a start grasp is found: random choices among the candidates, each improved agent by agent.

    restarts: choices improved; tries: made at most to find so many that hold. friction_use: part of μ the start grasp may
    use, so that the motion has some left.
    """

    restarts: int = 6
    tries: int = 20_000
    friction_use: float = 0.6


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
            held, _, _ = balance(hand, path, start, start, left, codes, p, n, t, margins, False, lp)
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
    held, value, _ = balance(hand, path, start, start, bears, codes, p, normal, t, margins, False, lp)
    if not held or cost + value >= bound:
        return np.inf
    cost += value
    contacts_at(which, choice, ahead, whole(LOOKS), p, normal)
    held, value, _ = balance(hand, path, n - 1, m, bears, codes, p, normal, t, margins, False, lp)
    cost += value if held else 2.0 * terms.outlook
    if looks:
        for look in range(1, LOOKS):
            if cost >= bound:
                return np.inf
            j = look_ahead(n, start, look)
            contacts_at(which, choice, ahead, whole(look), p, normal)
            held, value, _ = balance(hand, path, min(j, n - 1), start, bears, codes, p, normal, t, margins, False, lp)
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
def look_over(
    hand: Hand, path: Path, scan: Scan, R_WB: Array, p_WB: Array, i: int, terms: Terms, row: int, ahead: Ahead
) -> int:
    """Every candidate for agent i at the path's start: how many it can stand on; its row of `ahead` out."""
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
        reached = stay_on(hand, path, scan, terms.commands, start, i, c, whole(1), q, p, n_O)
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


def nothing_ahead(agents: int, candidates: int, geoms: int) -> Ahead:
    """An `Ahead` with nothing known yet."""
    shape = (agents, candidates, LOOKS + 1)
    return Ahead(
        np.zeros(shape[:2]), np.zeros(shape[:2]), np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros((*shape, geoms, 3, 3)),
        np.zeros((*shape, geoms, 3)),
    )  # fmt: skip


def find_grasp(
    hand: Hand, path: Path, scan: Scan, terms: Terms, off: tuple[int, ...], names: tuple[str, ...],
    settings: GraspSearch, rng: np.random.Generator, holding: Grasp | None = None,
) -> tuple[Stance, ...] | Failure:  # fmt: skip
    """Grasps on candidates of the scan, what each restart leads to, the one of the least cost first.

    All agents hold that are not off; where supports carry the object, as many as it costs least. holding: the grasp at hand,
    in whose way nobody may stand; else those who are off are at rest.
    """
    k, count, geoms = len(hand.tip_geom), len(scan.p_O), int(np.max(np.diff(hand.geom_start)))
    agents = np.array([i for i in range(k) if i not in off], np.int64)
    carried = path.support_mode.shape[1] > 0
    R_WB, p_WB = bodies_along(hand, path)
    lp = program(EDGES * (k + path.support_mode.shape[1]), k)
    ahead = nothing_ahead(len(agents), count, geoms)
    for a, i in enumerate(agents):
        reached = look_over(hand, path, scan, R_WB, p_WB, i, terms, a, ahead)
        if not reached and not carried:
            return Failure(
                "reach", "start", names[i], "reaches no point of the object that is clear of everything",
                "move the object nearer to its base, or list the agent in start.off",
            )  # fmt: skip
    legal = [np.append(np.flatnonzero(row >= 0.0), [OUT] if carried else []).astype(np.int64) for row in ahead.kept]
    if all(len(choices) == 1 for choices in legal) and carried:
        return Failure(
            "reach", "start", "", "no agent reaches a point of the object that is clear of everything",
            "agents nearer to the object",
        )  # fmt: skip
    rest_R, rest_p = np.zeros((k, geoms, 3, 3)), np.zeros((k, geoms, 3))
    for i in range(k):
        first, last = hand.chains.start[i], hand.chains.start[i + 1]
        R_WL, p_WL = np.empty((last - first + 1, 3, 3)), np.empty((last - first + 1, 3))
        forward(hand.chains, i, (hand.home if holding is None else holding.q)[first:last], R_WL, p_WL)
        place_agent(
            hand, i, path.R_WP[hand.base[i], 0, 0], path.p_WP[hand.base[i], 0, 0], R_WL, p_WL, rest_R[i], rest_p[i]
        )
    own = object_row(hand)
    for i in off:
        if holding is not None and holding.holds[i]:
            continue
        if (
            hits(hand, i, k, rest_R[i], rest_p[i], R_WB[0], p_WB[0], 0.0)
            or hits(hand, i, k + 1, rest_R[i], rest_p[i], R_WB[0, own:], p_WB[0, own:], 0.0)
            or tip_hits(hand, i, rest_R[i], rest_p[i], R_WB[0, own:], p_WB[0, own:], 0.0)
        ):
            return Failure("collision", "start", names[i], "its rest posture collides", "another home for the agent")
    wandering = any(wanders(hand, i) for i in agents)
    most = max(terms.margins.friction, 1.0 - settings.friction_use)
    margins = Margins(most, terms.margins.grip, terms.margins.disturbance, terms.margins.slide)
    fixed = (hand, path, scan, terms, agents, rest_R, rest_p)
    u = rng.random((settings.tries, len(agents)))
    safe = None if wandering else lasting_choice(fixed, margins, ahead, lp, legal, u)
    drawn_from = [longest(row, free) if wandering else free for row, free in zip(ahead.kept, legal, strict=True)]
    restarts = settings.restarts * (MORE if wandering else 1)
    found = choices(fixed, margins, ahead, lp, drawn_from, u, restarts)
    best = sorted(found, key=lambda each: found[each])
    if safe is not None:
        best = [safe, *(each for each in best if each != safe)]
    if not best:
        return Failure(
            "equilibrium", "start", "", "no grasp within reach holds the object",
            "more friction, a larger max_force, a lighter object, or another agent",
        )  # fmt: skip
    return tuple(stance_of(hand, path, scan, agents, choice, ahead.kept) for choice in best)


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


def lasting_choice(
    fixed: Fixed, margins: Margins, ahead: Ahead, lp: Program, legal: list[NDArray[np.int64]], u: Array
) -> Choice | None:
    """Candidates on which all agents can stay along the whole path, if some are found soon.

    Among those that every look ahead finds lasting; which of them are not, between the looks, is seen by following the
    choice's contacts, and is written to ahead.kept.
    """
    hand, path, scan, terms, agents, _, _ = fixed
    sure = replace(ahead, kept=np.where(ahead.kept >= 1.0, 1.0, -1.0))
    for row in range(ROUNDS):
        among = [free[(free == OUT) | (kept[free] >= 0.0)] for kept, free in zip(sure.kept, legal, strict=True)]
        if any(len(free) == 0 for free in among):
            return None
        found = choices(fixed, margins, sure, lp, among, u[row::ROUNDS], 1)
        for choice in found:
            lost = lost_on(hand, path, scan, terms, stance_of(hand, path, scan, agents, choice, ahead.kept).grasp)
            if not lost:
                return choice
            for a, i in enumerate(agents.tolist()):
                if i in lost:
                    ahead.kept[a, choice[a]], sure.kept[a, choice[a]] = lost[i], -1.0
        if not found:
            return None
    return None


def lost_on(hand: Hand, path: Path, scan: Scan, terms: Terms, grasp: Grasp) -> dict[int, float]:
    """After which part of the path agents that keep their contacts lose them, or touch a static body or the object.

    Looked at at the end of every interval, of which the looks of a scan pass over many.
    """
    n = len(path.R_WO)
    V = np.tile(np.where(grasp.holds == 1, STAY, OFF).astype(np.int16), (n, 1))
    problem = ContactMotions(hand, path, scan, terms, grasp, V)
    at = problem.current.at[1:]
    failed = (problem.found.lost[at] != 0) | (problem.found.own[at] != 0)
    return {int(i): float(np.argmax(failed[:, i])) / n for i in np.flatnonzero(failed.any(axis=0) & (grasp.holds == 1))}


def longest(kept: Array, legal: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those of the legal candidates that can be kept as long as the PROMISING best of them; OUT stays."""
    on = kept[legal[legal != OUT]]
    if len(on) <= PROMISING:
        return legal
    least = np.sort(on)[-PROMISING]
    return legal[(legal == OUT) | (kept[legal] >= least)]


def stance_of(hand: Hand, path: Path, scan: Scan, agents: NDArray[np.int64], choice: Choice, kept: Array) -> Stance:
    """The grasp at the path's start with agent agents[a] on candidate choice[a]; kept: as in `Ahead`."""
    contacts, candidates = {}, np.full(len(hand.tip_geom), OUT)
    for i, c in zip(agents.tolist(), choice, strict=True):
        n_a = hand.chains.start[i + 1] - hand.chains.start[i]
        if c != OUT:
            candidates[i], row = c, scan.row[i, 0, c]
            contacts[i] = (scan.q[row, :n_a].copy(), scan.p[row].copy(), scan.n[row].copy())
    least = min(kept[a, c] for a, c in enumerate(choice) if c != OUT)
    return Stance(build_grasp(hand, path, contacts), candidates, float(least))
