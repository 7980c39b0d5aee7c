"""Grasps: which agents touch the object where; the start grasp, given by the scene or found by a scan."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from regrasp.kernels.basis import Program, program
from regrasp.kernels.chains import forward
from regrasp.kernels.forces import EDGES
from regrasp.kernels.surfaces import project
from regrasp.planner.balance import balance
from regrasp.planner.collision import block_hit, place, tip_hit
from regrasp.planner.energy import Terms
from regrasp.planner.hand import Hand
from regrasp.planner.motions import STAY, whole
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Path
from regrasp.planner.relocation import (
    LOOKS,
    Scan,
    candidate_free,
    hold_on,
    indispensable,
    outlook_of,
    touch,
    touch_down,
)
from regrasp.planner.reserve import Margins
from regrasp.planner.state import State, empty_state
from regrasp.scene.schema import Contact

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GraspSearch:
    """How a start grasp is found: random choices among the candidates, each improved agent by agent.

    restarts: choices improved. friction_use: part of μ the start grasp may use, so that the motion has some left.
    """

    restarts: int = 6
    friction_use: float = 0.6


@dataclass(frozen=True)
class Grasp:
    """Contacts and joints at one object pose: rows of `State`.

    q (nq,); holds (k,); p_OC, p_TC (k, 3); R_OT (k, 3, 3).
    """

    q: Array
    holds: NDArray[np.uint8]
    p_OC: Array
    p_TC: Array
    R_OT: Array


def grasp_at(state: State, j: int) -> Grasp:
    """The grasp of configuration j."""
    return Grasp(*(row[j].copy() for row in (state.q, state.holds, state.p_OC, state.p_TC, state.R_OT)))


def put(hand: Hand, grasp: Grasp, state: State) -> None:
    """Write the grasp into configuration 0 of the state, bodies included."""
    state.q[0], state.holds[0] = grasp.q, grasp.holds
    state.p_OC[0], state.p_TC[0], state.R_OT[0] = grasp.p_OC, grasp.p_TC, grasp.R_OT
    for i in range(len(hand.tip_geom)):
        first, last = hand.chains.start[i], hand.chains.start[i + 1]
        R_WL, p_WL = np.empty((last - first + 1, 3, 3)), np.empty((last - first + 1, 3))
        forward(hand.chains, i, state.q[0, first:last], R_WL, p_WL)
        place(hand, hand.geom_start[i], hand.geom_start[i + 1], R_WL, p_WL, state.R_WG[0], state.p_WG[0])


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
        if not touch_down(hand, i, R_WO, p_WO, foot, n, 0.0, direction, q, R_WL, p_WL):
            return Failure(
                "reach", "start.grasp", contact.agent, f"cannot reach the contact at {np.round(foot, 4).tolist()}",
                "a point nearer to the agent's base, or a larger hand",
            )  # fmt: skip
        found[i] = (q, foot, n)
    return build_grasp(hand, R_WO, found)


@njit(cache=True, nogil=True)
def grasp_cost(
    hand: Hand, path: Path, scan: Scan, state: State, terms: Terms, agents: NDArray[np.int64],
    choice: NDArray[np.int64], margins: Margins, kept: Array, ahead: Array,
    bound: float, lp: Program,
) -> float:  # fmt: skip
    """Σ of the contact forces at the path's two ends with agent agents[a] on candidate choice[a], plus what is lost ahead.

    As in a relocation: where contacts leave reach, and agents that could not be relocated as the others don't hold.
    kept (agents, C): part of the path on which each can keep its contact; ahead (agents, C, LOOKS + 1, n_max): its joints
    there. inf without equilibrium, where two agents collide at the start, or
    as soon as it is known not to be below the bound.
    """
    k, n, m = len(hand.tip_geom), path.R_WO.shape[0], path.R_WO.shape[1] - 1
    bears, codes = np.zeros(k, np.uint8), np.full(k, STAY, np.int8)
    p, normal, t = np.zeros((k, 3)), np.zeros((k, 3)), np.zeros((k, 3))
    cost, start = 0.0, whole(0)
    for a in range(len(agents)):
        i = agents[a]
        bears[i] = 1
        p[i] = scan.p[i, 0, choice[a]]
        normal[i] = scan.n[i, 0, choice[a]]
        cost += terms.outlook * (1.0 - kept[a, choice[a]])
    if cost >= bound:
        return np.inf
    held, value, _ = balance(hand, path, start, start, bears, codes, p, normal, t, margins, lp)
    if not held:
        return np.inf
    cost += value + terms.outlook * indispensable(hand, path, start, start, bears, p, normal, margins, lp)
    held, value, _ = balance(hand, path, n - 1, m, bears, codes, p, normal, t, margins, lp)
    if not held:
        cost += 2.0 * terms.outlook
    else:
        cost += value
    if cost >= bound:
        return np.inf
    for look in range(LOOKS + 1):
        R_WG, p_WG = state.R_WG[0].copy(), state.p_WG[0].copy()
        for a in range(len(agents)):
            i = agents[a]
            n_a = hand.chains.start[i + 1] - hand.chains.start[i]
            R_WL, p_WL = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3))
            forward(hand.chains, i, ahead[a, choice[a], look, :n_a], R_WL, p_WL)
            place(hand, hand.geom_start[i], hand.geom_start[i + 1], R_WL, p_WL, R_WG, p_WG)
        for a in range(k):
            for c in range(a + 1, k):
                if block_hit(hand, a, c, R_WG, p_WG, terms.clearance):
                    if look == 0:
                        return np.inf
                    cost += terms.outlook / LOOKS
    return cost


def find_grasp(
    hand: Hand, path: Path, scan: Scan, terms: Terms, off: tuple[int, ...], names: tuple[str, ...],
    settings: GraspSearch, rng: np.random.Generator,
) -> Grasp | Failure:  # fmt: skip
    """A start grasp (`auto`): all agents that are not off, on candidates of the scan, with the least cost found."""
    k = len(hand.tip_geom)
    agents = np.array([i for i in range(k) if i not in off], np.int64)
    state = empty_state(hand, path)
    put(hand, build_grasp(hand, path.R_WO[0, 0], {}), state)
    lp = program(EDGES * (k + path.support_mode.shape[1]), k)
    count = len(scan.p_O)
    kept = np.zeros((len(agents), count))
    ahead = np.zeros((len(agents), count, LOOKS + 1, scan.q.shape[3]))
    legal = []
    for a, i in enumerate(agents):
        standing = [c for c in range(count) if candidate_free(hand, path, scan, state, 0, i, c, terms.clearance)]
        if not standing:
            return Failure(
                "reach", "start", names[i], "reaches no point of the object that is clear of everything",
                "move the object nearer to its base, or list the agent in start.off",
            )  # fmt: skip
        for c in standing:
            kept[a, c] = outlook_of(hand, path, scan, state, 0, i, c, terms.clearance)
            p_TC, R_OT = np.empty(3), np.empty((3, 3))
            touch(hand, path, scan, 0, i, c, p_TC, R_OT)
            joints = np.zeros((LOOKS + 1, hand.chains.start[i + 1] - hand.chains.start[i]))
            joints[0] = scan.q[i, 0, c, : joints.shape[1]]
            reached = hold_on(hand, path, 0, i, scan.p[i, 0, c], p_TC, R_OT, joints)
            joints[reached + 1 :] = joints[reached]
            ahead[a, c, :, : joints.shape[1]] = joints
        legal.append(np.array(standing))
    for i in off:
        if any(block_hit(hand, i, c, state.R_WG[0], state.p_WG[0], 0.0) for c in (k, k + 1)) or tip_hit(
            hand, i, state.R_WG[0], state.p_WG[0], 0.0
        ):
            return Failure("collision", "start", names[i], "its rest posture collides", "another home for the agent")
    best, best_choice = np.inf, None
    most = max(terms.margins.friction, 1.0 - settings.friction_use)
    margins = Margins(most, terms.margins.grip, terms.margins.disturbance, terms.margins.slide)
    tries = 0
    improved = 0
    while improved < settings.restarts and tries < 200 * settings.restarts:
        tries += 1
        choice = np.array([rng.choice(free) for free in legal])
        cost = grasp_cost(hand, path, scan, state, terms, agents, choice, margins, kept, ahead, np.inf, lp)
        if cost == np.inf:
            continue
        improved += 1
        changed = True
        while changed:
            changed = False
            for a, candidates in enumerate(legal):
                for c in candidates:
                    trial = choice.copy()
                    trial[a] = c
                    value = grasp_cost(hand, path, scan, state, terms, agents, trial, margins, kept, ahead, cost, lp)
                    if value < cost - 1e-9:
                        cost, choice, changed = value, trial, True
        if cost < best:
            best, best_choice = cost, choice
    if best_choice is None:
        return Failure(
            "equilibrium", "start", "", "no grasp within reach holds the object",
            "more friction, a larger max_force, a lighter object, or another agent",
        )  # fmt: skip
    contacts = {}
    for a, i in enumerate(agents):
        n_a = hand.chains.start[i + 1] - hand.chains.start[i]
        c = best_choice[a]
        contacts[int(i)] = (scan.q[i, 0, c, :n_a].copy(), scan.p[i, 0, c].copy(), scan.n[i, 0, c].copy())
    return build_grasp(hand, path.R_WO[0, 0], contacts)
