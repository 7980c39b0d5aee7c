"""The motion of one arc in full: every sample's joints, contacts and forces from V, and every constraint looked at again."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from regrasp.kernels.chains import forward
from regrasp.kernels.contact import advance
from regrasp.kernels.surfaces import project, tangents
from regrasp.planner.balance import balance
from regrasp.planner.collision import hits, place, place_agent, tip_hits
from regrasp.planner.configurations import Configurations
from regrasp.planner.energy import Terms, Work, moves_freely
from regrasp.planner.follow import is_full, reach_tip, short_step
from regrasp.planner.hand import RANGE_MARGIN, Hand
from regrasp.planner.motions import OFF, ONTO, RELOCATE, is_sliding, plain, slide_direction, whole
from regrasp.planner.passage import free_motion
from regrasp.planner.path import Path
from regrasp.planner.splines import FINE, values
from regrasp.planner.state import State
from regrasp.planner.turns import from_rotvec, rotvec

Array = NDArray[np.float64]

GRAZE = 5e-5  # m: a tip may come so far into the surface between two samples of its lift
LIMIT = RANGE_MARGIN  # rad or m: a joint may use up the margin between two samples
UNEVEN = 0.006  # rad: second difference of the samples above which their spline strays from the contact
SAME = 1e-4  # rad: joints traced sample by sample and found in one step must agree, else there is a singularity between


@dataclass(frozen=True)
class Violation:
    """A constraint of paper §2 that does not hold: which one, in which interval, for which agents or bodies."""

    constraint: str
    interval: int
    who: str
    detail: str


@dataclass(frozen=True)
class Motion:
    """One arc: n intervals of m + 1 samples, k agents, P support slots. Units and frames as in `regrasp.plan.Plan`.

    violations: empty if every constraint holds at every sample.
    """

    path: Path
    V: NDArray[np.int8]
    joints: Array
    twist: Array
    p_OC_O: Array
    n_O: Array
    x_O: Array
    violations: tuple[Violation, ...]


@njit(cache=True, nogil=True)
def trace_contact(
    hand: Hand, path: Path, command: Array, j: int, i: int,
    p_OC: Array, p_TC: Array, R_OT: Array, x_O: Array, q: Array, n_O: Array,
) -> bool:  # fmt: skip
    """`follow` with every sample kept: row 0 of all arrays (m + 1, …) is the start, the other rows are written."""
    m = path.R_WO.shape[1] - 1
    y, foot = np.empty(3), np.empty(3)
    n_a = q.shape[1]
    R_WL, p_WL = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3))
    step = command / m
    project(hand.kind_O, hand.size_O, p_OC[0], foot, n_O[0])
    tangents(n_O[0], x_O[0], y)
    fine = True
    for s in range(m):
        p_OC[s + 1], p_TC[s + 1], R_OT[s + 1], x_O[s + 1], q[s + 1] = p_OC[s], p_TC[s], R_OT[s], x_O[s], q[s]
        if is_full(hand, i):
            advance(
                hand.kind_O, hand.size_O, hand.kind_T[i], hand.size_T[i], step, whole(1),
                p_OC[s + 1], p_TC[s + 1], R_OT[s + 1], x_O[s + 1],
            )  # fmt: skip
            if not reach_tip(hand, path, j, s + 1, i, p_OC[s + 1], p_TC[s + 1], R_OT[s + 1], q[s + 1], R_WL, p_WL):
                fine = False
        elif not short_step(
            hand, path, j, s, i, step, p_OC[s + 1], p_TC[s + 1], R_OT[s + 1], x_O[s + 1], q[s + 1], R_WL, p_WL
        ):
            fine = False
        project(hand.kind_O, hand.size_O, p_OC[s + 1], foot, n_O[s + 1])
    return fine


@njit(cache=True, nogil=True)
def sample_hits(
    hand: Hand, path: Path, j: int, q: Array, holds: NDArray[np.uint8], ends: NDArray[np.uint8], clearance: float,
    R_B: Array, p_B: Array, found: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Blocks that collide at any sample of interval j: found (k, k + 2). q (m + 1, nq) joints of all agents.

    holds (k,): in contact all through; ends (k,): in contact at the start (1), the end (2) or both (3) of a free motion,
    near which its tip may be close to the object. R_B, p_B: static bodies, then the object, which is moved.
    """
    m, k, last = q.shape[0] - 1, len(holds), len(R_B) - 1
    geoms = np.max(np.diff(hand.geom_start))
    R_G, p_G = np.empty((k, geoms, 3, 3)), np.empty((k, geoms, 3))
    obj, obj_p = np.zeros((1, 3, 3)), np.zeros((1, 3))
    rise = m // 4
    joints = np.max(np.diff(hand.chains.start))
    R_WL, p_WL = np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3))
    for s in range(m + 1):
        obj[0], obj_p[0] = path.R_WO[j, s], path.p_WO[j, s]
        place(hand, hand.object_geom, hand.object_geom + 1, obj, obj_p, R_B[last:], p_B[last:])
        for i in range(k):
            forward(hand.chains, i, q[s, hand.chains.start[i] : hand.chains.start[i + 1]], R_WL, p_WL)
            place_agent(hand, i, R_WL, p_WL, R_G[i], p_G[i])
        for a in range(k):
            near = (ends[a] & 1 and s <= rise) or (ends[a] & 2 and s >= m - rise)
            for c in range(a, k):
                if hits(hand, a, c, R_G[a], p_G[a], R_G[c], p_G[c], clearance):
                    found[a, c] = 1
            if hits(hand, a, k, R_G[a], p_G[a], R_B, p_B, clearance):
                found[a, k] = 1
            if hits(hand, a, k + 1, R_G[a], p_G[a], R_B[last:], p_B[last:], clearance) or (
                holds[a] == 0 and not near and tip_hits(hand, a, R_G[a], p_G[a], R_B[last], p_B[last], clearance)
            ):
                found[a, k + 1] = 1


def detail(
    hand: Hand, path: Path, terms: Terms, found: Configurations, state: State, work: Work, names: tuple[str, ...]
) -> Motion:  # fmt: skip
    """The Motion of a V, whose interval ends stand in the state as `evaluate` left them."""
    V = state.V
    n, k = V.shape
    m = path.R_WO.shape[1] - 1
    joints = np.zeros((n, m + 1, len(hand.home)))
    p_OC, n_O, x_O = (np.full((n, m + 1, k, 3), np.nan) for _ in range(3))
    twist = np.zeros((n, k, 4))
    broken: list[Violation] = []
    holds = found.holds[state.at]
    # Any contact motion of an agent that is not in contact means that it stays off.
    said = (V >= ONTO) | (holds[:n] == 1)
    for j in range(n):
        bears = ((V[j] < RELOCATE) & (holds[j] == 1)).astype(np.uint8)
        ends = np.zeros(k, np.uint8)
        for i in range(k):
            first, last = hand.chains.start[i], hand.chains.start[i + 1]
            here, there = state.at[j, i], state.at[j + 1, i]
            q = np.zeros((m + 1, last - first))
            q[0] = found.q[here, : last - first]
            if bears[i]:
                p, p_T, x, nn = (np.zeros((m + 1, 3)) for _ in range(4))
                R = np.zeros((m + 1, 3, 3))
                p[0], p_T[0], R[0] = found.p_OC[here], found.p_TC[here], found.R_OT[here]
                traced = trace_contact(hand, path, terms.commands[V[j, i]], j, i, p, p_T, R, x, q, nn)
                if found.lost[there] or not traced or np.max(np.abs(q[m] - found.q[there, : last - first])) > SAME:
                    broken.append(Violation("reach", j, names[i], "leaves its workspace while in contact"))
                q[m] = found.q[there, : last - first]
                p_OC[j, :, i], n_O[j, :, i], x_O[j, :, i] = p, nn, x
                twist[j, i] = achieved(hand, i, terms.commands[V[j, i]], R, x, nn)
            elif moves_freely(V[j, i], holds[j, i]) and not state.behind[j, i] and state.way[j, i] >= 0:
                free_motion(hand, path, found, j, i, state.at[j], state.at[j + 1], terms.high, terms.clearance, q)
                ends[i] = holds[j, i] + 2 * holds[j + 1, i]
                if least_gap(hand, path, j, i, q) < -GRAZE:
                    broken.append(
                        Violation("collision", j, names[i], "grazes the object as it lifts off or touches down")
                    )
            else:
                q[:] = q[0]
                if moves_freely(V[j, i], holds[j, i]):
                    broken.append(Violation("reach", j, names[i], "finds no free way to or from a contact"))
            joints[j, :, first:last] = q
            fine = between(q)
            if bears[i] and np.max(np.abs(np.diff(q, 2, axis=0))) > UNEVEN:
                broken.append(Violation("reach", j, names[i], "comes too near to a singularity while in contact"))
            if np.any(fine < hand.chains.lower[first:last] - LIMIT) or np.any(
                fine > hand.chains.upper[first:last] + LIMIT
            ):
                broken.append(Violation("reach", j, names[i], "passes a joint limit between two samples"))
        if sum(moves_freely(V[j, i], holds[j, i]) for i in range(k)) > 1:
            broken.append(Violation("collision", j, "", "more than one agent moves freely at a time"))
        touched = np.zeros((k, k + 2), np.uint8)
        sample_hits(
            hand,
            path,
            j,
            joints[j],
            bears,
            ends,
            0.5 * terms.clearance,
            found.R_WB[j].copy(),
            found.p_WB[j].copy(),
            touched,
        )
        for a, c in zip(*np.nonzero(touched), strict=True):
            other = names[c] if c < k else ("a static body", "the object")[c - k]
            broken.append(Violation("collision", j, names[a], f"touches {other if c != a else 'itself'}"))
        if not balanced(hand, path, terms, j, bears, V[j], p_OC[j], n_O[j], x_O[j], work):
            broken.append(Violation("equilibrium", j, "", "no contact forces hold the object"))
    return Motion(path, np.where(said, plain(V), OFF).astype(np.int8), joints, twist, p_OC, n_O, x_O, tuple(broken))


def between(q: Array) -> Array:
    """Joints on the spline that a plan follows (`regrasp.plan`), FINE times as dense as the samples q (m + 1, n_a)."""
    return values(len(q) - 1) @ q


def least_gap(hand: Hand, path: Path, j: int, i: int, q: Array) -> float:
    """Least distance of agent i's tip from the object's surface in interval j, between the samples too, m."""
    fine, m = between(q), len(q) - 1
    n_a = q.shape[1]
    R_WL, p_WL = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3))
    foot, n, least = np.empty(3), np.empty(3), np.inf
    R_WO = path.R_WO[j]
    part = np.arange(FINE)[:, None] / FINE
    # Between neighbouring samples the object turns about one axis.
    steps = from_rotvec(part * rotvec(R_WO[1:] @ np.swapaxes(R_WO[:-1], 1, 2))[:, None]) @ R_WO[:-1, None]
    turns = np.concatenate([steps.reshape(-1, 3, 3), R_WO[m:]])
    for row, turn, place_W in zip(fine, turns, between(path.p_WO[j]), strict=True):
        forward(hand.chains, i, row, R_WL, p_WL)
        centre = turn.T @ (p_WL[n_a] - place_W)
        least = min(least, project(hand.kind_O, hand.size_O, centre, foot, n) - hand.size_T[i, 0])
    return least


def achieved(hand: Hand, i: int, command: Array, R_OT: Array, x_O: Array, n_O: Array) -> Array:
    """The relative motion over the interval, in C: as commanded for six joints, as the joints allowed for fewer."""
    if is_full(hand, i):
        return command
    y_O = np.cross(n_O, x_O)
    total = command.copy()
    total[:2] = 0.0
    for s in range(len(R_OT) - 1):
        skew = R_OT[s + 1] @ R_OT[s].T
        turn = 0.5 * np.array([skew[2, 1] - skew[1, 2], skew[0, 2] - skew[2, 0], skew[1, 0] - skew[0, 1]])
        total[0] += turn @ (0.5 * (x_O[s] + x_O[s + 1]))
        total[1] += turn @ (0.5 * (y_O[s] + y_O[s + 1]))
    return total


@njit(cache=True, nogil=True)
def balanced(
    hand: Hand, path: Path, terms: Terms, j: int, bears: NDArray[np.uint8], codes: NDArray[np.int16],
    p_OC: Array, n_O: Array, x_O: Array, work: Work,
) -> bool:  # fmt: skip
    """Whether contact forces hold the object at every sample of interval j; p_OC, n_O, x_O (m + 1, k, 3)."""
    m, k = len(p_OC) - 1, len(bears)
    t, y = np.zeros((k, 3)), np.zeros(3)
    work.signature[0] = -1
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
