"""Grasps: which agents touch the object where; the start grasp, given by the scene or found by a scan."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from regrasp.kernels.basis import Program, program
from regrasp.kernels.chains import forward
from regrasp.kernels.forces import EDGES
from regrasp.kernels.inverse import inverse_point
from regrasp.kernels.surfaces import project
from regrasp.planner.balance import balance
from regrasp.planner.collision import hits, place_agent, tip_hits
from regrasp.planner.configurations import Grasp, bodies_along
from regrasp.planner.follow import REACHED
from regrasp.planner.hand import Hand
from regrasp.planner.motions import STAY, whole
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Path
from regrasp.planner.reserve import Margins
from regrasp.planner.scan import LOOKS, Scan, candidate_free, hold_on, look_ahead, outlook_of, touch, touch_down
from regrasp.planner.supports import STICK
from regrasp.planner.terms import Terms
from regrasp.scene.schema import Contact

Array = NDArray[np.float64]
OUT = -1  # the choice of an agent that stays off


@dataclass(frozen=True)
class Stance:
    """A grasp that was found, and the candidates of the scan on which its agents stand (k,), OUT where they are off."""

    grasp: Grasp
    candidates: NDArray[np.int64]


@dataclass(frozen=True)
class GraspSearch:
    """How a start grasp is found: random choices among the candidates, each improved agent by agent.

    restarts: choices improved; tries: made at most to find so many that hold. friction_use: part of μ the start grasp may
    use, so that the motion has some left.
    """

    restarts: int = 6
    tries: int = 20_000
    friction_use: float = 0.6


def contact_from(hand: Hand, i: int, R_WO: Array, q: Array, p_O: Array, n_O: Array) -> tuple[Array, Array, Array]:
    """(p_OC, p_TC, R_OT) of a spherical tip that touches the object at p_O with joints q."""
    count = len(q)
    R_WL, p_WL = np.empty((count + 1, 3, 3)), np.empty((count + 1, 3))
    forward(hand.chains, i, q, R_WL, p_WL)
    R_OT = R_WO.T @ R_WL[count]
    return p_O, -hand.size_T[i, 0] * (R_OT.T @ n_O), R_OT


def build_grasp(hand: Hand, R_WO: Array, contacts: dict[int, tuple[Array, Array, Array]]) -> Grasp:
    """The grasp with agent i at contacts[i] = (q, p_O, n_O); all others at rest."""
    k = len(hand.tip_geom)
    q, holds = hand.home.copy(), np.zeros(k, np.uint8)
    p_OC, p_TC, R_OT = np.zeros((k, 3)), np.zeros((k, 3)), np.tile(np.eye(3), (k, 1, 1))
    for i, (joints, p_O, n_O) in contacts.items():
        q[hand.chains.start[i] : hand.chains.start[i + 1]] = joints
        p_OC[i], p_TC[i], R_OT[i] = contact_from(hand, i, R_WO, joints, p_O, n_O)
        holds[i] = 1
    return Grasp(q, holds, p_OC, p_TC, R_OT)


def near(hand: Hand, i: int, p_WT: Array, a_W: Array, seed: Array, q: Array, R_WL: Array, p_WL: Array) -> bool:
    """Joints q of agent i, from the seed, with the tip at p_WT and pointing along a_W as well as it can; whether it gets there.

    What `touch_down` does for chains without a closed form; arms that have one point their tools exactly there or not at all.
    """
    q[:] = seed
    return bool(inverse_point(hand.chains, i, p_WT, hand.axis_T[i], a_W, q, R_WL, p_WL)[0] < REACHED)


def given_grasp(hand: Hand, path: Path, contacts: tuple[Contact, ...], names: tuple[str, ...]) -> Grasp | Failure:
    """The scene's own start contacts: points on the object are reached by inverse kinematics from the rest posture."""
    R_WO, p_WO = path.R_WO[0, 0], path.p_WO[0, 0]
    found: dict[int, tuple[Array, Array, Array]] = {}
    for contact in contacts:
        i = names.index(contact.agent)
        first, last = hand.chains.start[i], hand.chains.start[i + 1]
        R_WL, p_WL = np.empty((last - first + 1, 3, 3)), np.empty((last - first + 1, 3))
        foot, n = np.empty(3), np.empty(3)
        if contact.joints is not None:
            q = np.array(contact.joints, float)
            if len(q) != last - first:
                return Failure("grasp", "start.grasp", contact.agent, f"{len(q)} joint values", f"give {last - first}")
            forward(hand.chains, i, q, R_WL, p_WL)
            centre = R_WO.T @ (p_WL[last - first] - p_WO)
            gap = project(hand.kind_O, hand.size_O, centre, foot, n) - hand.size_T[i, 0]
            if abs(gap) > 1e-3:
                return Failure(
                    "grasp", "start.grasp", contact.agent, f"its tip is {1e3 * gap:.1f} mm from the object's surface",
                    "joints that touch within 1 mm, or give the contact's point",
                )  # fmt: skip
            direction = R_WO.T @ R_WL[last - first] @ hand.axis_T[i]
        else:
            q = hand.home[first:last].copy()
            project(hand.kind_O, hand.size_O, np.array(contact.point, float), foot, n)
            direction = -n
        seed = q.copy()
        if not touch_down(hand, i, R_WO, p_WO, foot, n, 0.0, direction, q, R_WL, p_WL) and not near(
            hand, i, R_WO @ (foot + hand.size_T[i, 0] * n) + p_WO, R_WO @ direction, seed, q, R_WL, p_WL
        ):
            return Failure(
                "reach", "start.grasp", contact.agent, f"cannot reach the contact at {np.round(foot, 4).tolist()}",
                "a point nearer to the agent's base, or a larger hand",
            )  # fmt: skip
        found[i] = (q, foot, n)
    return build_grasp(hand, R_WO, found)


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def grasp_cost(
    hand: Hand, path: Path, scan: Scan, terms: Terms, agents: NDArray[np.int64], rest_R: Array, rest_p: Array,
    choice: NDArray[np.int64], margins: Margins, kept: Array, ahead_R: Array, ahead_p: Array,
    bound: float, lp: Program,
) -> float:  # fmt: skip
    """Σ of the contact forces at the path's two ends with agent agents[a] on candidate choice[a], plus what is lost ahead.

    An agent whose choice is OUT is off. As in a relocation: where contacts leave reach, where the object is not held on the
    way, and agents that could not be relocated as the others don't hold. kept (agents, C): part of the path on which each can
    keep its contact; ahead_R, ahead_p (agents, C, LOOKS + 1, g_max, …): its bodies there; rest_R, rest_p (k, g_max, …): all
    agents' bodies at rest. inf without equilibrium, where two agents collide at the start, where no agent touches, or as soon
    as it is known not to be below the bound.
    """
    k, n, m = len(hand.tip_geom), path.R_WO.shape[0], path.R_WO.shape[1] - 1
    bears, codes = np.zeros(k, np.uint8), np.full(k, STAY, np.int16)
    p, normal, t = np.zeros((k, 3)), np.zeros((k, 3)), np.zeros((k, 3))
    which = np.full(k, -1)
    cost, start, stick = 0.0, whole(0), 0
    for a in range(len(agents)):
        if choice[a] == OUT:
            continue
        i = agents[a]
        which[i] = a
        bears[i] = 1
        stick += 1
        p[i] = scan.p[i, 0, choice[a]]
        normal[i] = scan.n[i, 0, choice[a]]
        cost += terms.outlook * (1.0 - kept[a, choice[a]])
    if stick == 0 or cost >= bound:
        return np.inf
    for column in range(path.support_mode.shape[1]):
        if path.support_mode[n // 2, column] == STICK:
            stick += 1
    cost += terms.stability * max(0, hand.needed - stick)
    held, value, _ = balance(hand, path, start, start, bears, codes, p, normal, t, margins, False, lp)
    if not held or cost + value >= bound:
        return np.inf
    cost += value
    held, value, _ = balance(hand, path, n - 1, m, bears, codes, p, normal, t, margins, False, lp)
    cost += value if held else 2.0 * terms.outlook
    if path.support_mode.shape[1] > 0:
        for look in range(1, LOOKS):
            if cost >= bound:
                return np.inf
            j = look_ahead(n, start, look)
            held, value, _ = balance(hand, path, min(j, n - 1), start, bears, codes, p, normal, t, margins, False, lp)
            if not held:
                cost += 2.0 * terms.outlook / LOOKS
    if cost >= bound:
        return np.inf
    cost += terms.outlook * indispensable(hand, path, bears, p, normal, margins, lp)
    if cost >= bound:
        return np.inf
    for look in range(LOOKS + 1):
        for a in range(k):
            R_A, p_A = rest_R[a], rest_p[a]
            if which[a] >= 0:
                R_A, p_A = ahead_R[which[a], choice[which[a]], look], ahead_p[which[a], choice[which[a]], look]
            for c in range(a + 1, k):
                R_C, p_C = rest_R[c], rest_p[c]
                if which[c] >= 0:
                    R_C, p_C = ahead_R[which[c], choice[which[c]], look], ahead_p[which[c], choice[which[c]], look]
                if hits(hand, a, c, R_A, p_A, R_C, p_C, terms.clearance):
                    if look == 0:
                        return np.inf
                    cost += terms.outlook / LOOKS
                    if cost >= bound:
                        return np.inf
    return cost


@njit(cache=True, nogil=True)
def look_over(
    hand: Hand, path: Path, scan: Scan, R_WB: Array, p_WB: Array, i: int, clearance: float,
    kept: Array, ahead_R: Array, ahead_p: Array,
) -> int:  # fmt: skip
    """Every candidate for agent i at the path's start: how many it can stand on; kept and bodies as in `grasp_cost`, out.

    kept (C,) is −1 where it can't.
    """
    n_a, count = hand.chains.start[i + 1] - hand.chains.start[i], 0
    start = whole(0)
    joints, p_TC, R_OT = np.zeros((LOOKS + 1, n_a)), np.empty(3), np.empty((3, 3))
    R_WL, p_WL = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3))
    for c in range(len(scan.p_O)):
        kept[c] = -1.0
        if not candidate_free(hand, path, scan, R_WB[0], p_WB[0], start, i, c, clearance):
            continue
        count += 1
        kept[c] = outlook_of(hand, path, scan, R_WB, p_WB, start, i, c, clearance)
        touch(hand, path, scan, start, i, c, p_TC, R_OT)
        joints[0] = scan.q[i, 0, c, :n_a]
        reached = hold_on(hand, path, start, i, scan.p[i, 0, c], p_TC, R_OT, joints)
        for look in range(LOOKS + 1):
            forward(hand.chains, i, joints[min(look, reached)], R_WL, p_WL)
            place_agent(hand, i, R_WL, p_WL, ahead_R[c, look], ahead_p[c, look])
    return count


@njit(cache=True, nogil=True)
def improve(
    hand: Hand, path: Path, scan: Scan, terms: Terms, agents: NDArray[np.int64], rest_R: Array, rest_p: Array,
    choice: NDArray[np.int64], margins: Margins, kept: Array, ahead_R: Array, ahead_p: Array, cost: float, lp: Program,
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
                if c >= 0 and kept[a, c] < 0.0:
                    continue
                before = choice[a]
                choice[a] = c
                value = grasp_cost(
                    hand, path, scan, terms, agents, rest_R, rest_p, choice, margins, kept, ahead_R, ahead_p, cost, lp
                )
                if value < cost - 1e-9:
                    cost, changed = value, True
                else:
                    choice[a] = before
    return cost


@njit(cache=True, nogil=True)
def drawn(
    hand: Hand, path: Path, scan: Scan, terms: Terms, agents: NDArray[np.int64], rest_R: Array, rest_p: Array,
    choice: NDArray[np.int64], margins: Margins, kept: Array, ahead_R: Array, ahead_p: Array, lp: Program,
    legal: NDArray[np.int64], counts: NDArray[np.int64], u: Array, at: int,
) -> tuple[int, float]:  # fmt: skip
    """The next random choice that holds: (row of u after it, its cost), inf where the numbers run out before; choice out.

    legal (agents, ·): candidates, counts (agents,) of them; u (tries, agents): uniform on [0, 1), used from row `at` on.
    """
    for row in range(at, len(u)):
        for a in range(len(agents)):
            choice[a] = legal[a, whole(u[row, a] * counts[a])]
        cost = grasp_cost(
            hand, path, scan, terms, agents, rest_R, rest_p, choice, margins, kept, ahead_R, ahead_p, np.inf, lp
        )
        if cost < np.inf:
            return row + 1, cost
    return len(u), np.inf


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
    kept = np.zeros((len(agents), count))
    ahead_R, ahead_p = (
        np.zeros((len(agents), count, LOOKS + 1, geoms, 3, 3)),
        np.zeros((len(agents), count, LOOKS + 1, geoms, 3)),
    )
    for a, i in enumerate(agents):
        reached = look_over(hand, path, scan, R_WB, p_WB, i, terms.clearance, kept[a], ahead_R[a], ahead_p[a])
        if not reached and not carried:
            return Failure(
                "reach", "start", names[i], "reaches no point of the object that is clear of everything",
                "move the object nearer to its base, or list the agent in start.off",
            )  # fmt: skip
    legal = [np.append(np.flatnonzero(row >= 0.0), [OUT] if carried else []).astype(np.int64) for row in kept]
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
        place_agent(hand, i, R_WL, p_WL, rest_R[i], rest_p[i])
    for i in off:
        if holding is not None and holding.holds[i]:
            continue
        if (
            hits(hand, i, k, rest_R[i], rest_p[i], R_WB[0], p_WB[0], 0.0)
            or hits(hand, i, k + 1, rest_R[i], rest_p[i], R_WB[0, -1:], p_WB[0, -1:], 0.0)
            or tip_hits(hand, i, rest_R[i], rest_p[i], R_WB[0, -1], p_WB[0, -1], 0.0)
        ):
            return Failure("collision", "start", names[i], "its rest posture collides", "another home for the agent")
    most = max(terms.margins.friction, 1.0 - settings.friction_use)
    margins = Margins(most, terms.margins.grip, terms.margins.disturbance, terms.margins.slide)
    counts, table = np.array([len(free) for free in legal]), np.full((len(agents), max(map(len, legal))), OUT)
    for row, free in zip(table, legal, strict=True):
        row[: len(free)] = free
    u, at = rng.random((settings.tries, len(agents))), 0
    fixed, choice = (hand, path, scan, terms, agents, rest_R, rest_p), np.zeros(len(agents), np.int64)
    found: dict[tuple[int, ...], float] = {}
    for _ in range(settings.restarts):
        at, cost = drawn(*fixed, choice, margins, kept, ahead_R, ahead_p, lp, table, counts, u, at)
        if cost == np.inf:
            break
        cost = improve(*fixed, choice, margins, kept, ahead_R, ahead_p, cost, lp)
        found.setdefault(tuple(choice.tolist()), cost)
    if not found:
        return Failure(
            "equilibrium", "start", "", "no grasp within reach holds the object",
            "more friction, a larger max_force, a lighter object, or another agent",
        )  # fmt: skip
    return tuple(stance_of(hand, path, scan, agents, choice) for choice in sorted(found, key=lambda each: found[each]))


def stance_of(hand: Hand, path: Path, scan: Scan, agents: NDArray[np.int64], choice: tuple[int, ...]) -> Stance:
    """The grasp at the path's start with agent agents[a] on candidate choice[a]."""
    contacts, candidates = {}, np.full(len(hand.tip_geom), OUT)
    for i, c in zip(agents.tolist(), choice, strict=True):
        n_a = hand.chains.start[i + 1] - hand.chains.start[i]
        if c != OUT:
            candidates[i] = c
            contacts[i] = (scan.q[i, 0, c, :n_a].copy(), scan.p[i, 0, c].copy(), scan.n[i, 0, c].copy())
    return Stance(build_grasp(hand, path.R_WO[0, 0], contacts), candidates)
