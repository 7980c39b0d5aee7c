"""The motion of one arc in full: every sample's joints, contacts and forces from V, and every constraint looked at again."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.chains import forward
from regrasp.kernels.native import heap
from regrasp.kernels.rotations import multiply_back, rotate_back
from regrasp.planner.configurations import Configurations
from regrasp.planner.follow import is_full
from regrasp.planner.hand import RANGE_MARGIN, Hand
from regrasp.planner.motions import OFF, ONTO, plain
from regrasp.planner.path import Path
from regrasp.planner.splines import FINE, values
from regrasp.planner.state import State
from regrasp.planner.terms import Terms, Work
from regrasp.planner.tips import tip_gap
from regrasp.planner.trace import LOST, NO_WAY, trace
from regrasp.planner.turns import from_rotvec, rotvec

Array = NDArray[np.float64]
Flags = NDArray[np.uint8]

GRAZE = 5e-5  # m: a tip may come so far into the surface between two samples of its lift
LIMIT = RANGE_MARGIN  # rad or m: a joint may use up the margin between two samples
UNEVEN = 0.005  # rad: third difference of the samples above which their cubic spline strays from the contact


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


def detail(
    hand: Hand, path: Path, terms: Terms, found: Configurations, state: State, work: Work, names: tuple[str, ...]
) -> Motion:  # fmt: skip
    """The Motion of a V along a path, or the head of one; its interval ends stand in the state as `evaluate` left them."""
    V = state.V[: len(path.R_WO)]
    n, k = V.shape
    m = path.R_WO.shape[1] - 1
    joints = np.zeros((n, m + 1, len(hand.home)))
    p_OC, n_O, x_O = (np.full((n, m + 1, k, 3), np.nan) for _ in range(3))
    R_OT = np.full((n, m + 1, k, 3, 3), np.nan)
    bears, ends, broken = (np.zeros((n, k), np.uint8) for _ in range(3))
    touched, held = np.zeros((n, k, k + 2), np.uint8), np.zeros(n, np.uint8)
    trace(hand, path, terms, found, state, work, joints, p_OC, n_O, x_O, R_OT, bears, ends, broken, touched, held)
    twist = np.zeros((n, k, 4))
    for j, i in zip(*np.nonzero(bears), strict=True):
        twist[j, i] = achieved(hand, i, terms.commands[V[j, i]], R_OT[j, :, i], x_O[j, :, i], n_O[j, :, i])
    violations = violated(hand, path, joints, V, found.holds[state.at[:n]], bears, ends, broken, touched, held, names)
    joints = np.concatenate([joints, path.arm_q], axis=2)
    # Any contact motion of an agent that is not in contact means that it stays off.
    said = (V >= ONTO) | (found.holds[state.at[:n]] == 1)
    return Motion(path, np.where(said, plain(V), OFF).astype(np.int8), joints, twist, p_OC, n_O, x_O, violations)


def violated(
    hand: Hand, path: Path, joints: Array, V: NDArray[np.int16], holds: Flags, bears: Flags, ends: Flags, broken: Flags,
    touched: Flags, held: Flags, names: tuple[str, ...],
) -> tuple[Violation, ...]:  # fmt: skip
    """What breaks the constraints of paper §2, in the order of time, from what `trace` wrote and between its samples too."""
    found: list[Violation] = []
    k, start = len(names), hand.chains.start
    fine = between(joints)
    past = (fine < hand.chains.lower - LIMIT) | (fine > hand.chains.upper + LIMIT)
    outside = np.logical_or.reduceat(past.any(axis=1), start[:-1], axis=1)
    bends = np.abs(np.diff(joints, 3, axis=1)).max(axis=1) > UNEVEN
    bent = np.logical_or.reduceat(bends, start[:-1], axis=1) & (bears == 1)
    arms = between(path.arm_q)
    stray = np.any((arms < hand.arms.lower - LIMIT) | (arms > hand.arms.upper + LIMIT), axis=(1, 2))
    stray |= np.any(np.abs(np.diff(path.arm_q, 3, axis=1)) > UNEVEN, axis=(1, 2))
    grazes = np.zeros(ends.shape, np.bool_)
    for j, i in zip(*np.nonzero(ends), strict=True):
        grazes[j, i] = least_gap(hand, path, j, i, fine[j][:, start[i] : start[i + 1]].copy()) < -GRAZE
    crowded = np.sum((V >= ONTO) | ((V == OFF) & (holds == 1)), axis=1) > 1
    said = {LOST: "leaves its workspace while in contact", NO_WAY: "finds no free way to or from a contact"}
    wrong = np.any((broken > 0) | grazes | bent | outside | touched.any(axis=2), axis=1) | crowded | (held == 0) | stray
    for j in np.flatnonzero(wrong).tolist():
        for i in range(k):
            if broken[j, i]:
                found.append(Violation("reach", j, names[i], said[int(broken[j, i])]))
            if grazes[j, i]:
                found.append(Violation("collision", j, names[i], "grazes the object as it lifts off or touches down"))
            if bent[j, i]:
                found.append(Violation("reach", j, names[i], "comes too near to a singularity while in contact"))
            if outside[j, i]:
                found.append(Violation("reach", j, names[i], "passes a joint limit between two samples"))
        if stray[j]:
            found.append(Violation("reach", j, "", "an arm comes too near to a singularity or a joint limit"))
        if crowded[j]:
            found.append(Violation("collision", j, "", "more than one agent moves freely at a time"))
        for a, c in zip(*np.nonzero(touched[j]), strict=True):
            other = names[c] if c < k else ("a static body", "the object")[c - k]
            found.append(Violation("collision", j, names[a], f"touches {other if c != a else 'itself'}"))
        if not held[j]:
            found.append(Violation("equilibrium", j, "", "no contact forces hold the object"))
    return tuple(found)


def between(q: Array) -> Array:
    """Joints on the spline that a plan follows (`regrasp.plan`), FINE times as dense as the samples q (…, m + 1, n_a)."""
    return np.asarray(values(q.shape[-2] - 1) @ q)


def least_gap(hand: Hand, path: Path, j: int, i: int, fine: Array) -> float:
    """Least distance of agent i's tip from the object's surface in interval j, m; its joints as `between` gives them."""
    R_PO, p_PO = path.R_PO[hand.base[i], j], path.p_PO[hand.base[i], j]
    part = np.arange(FINE)[:, None] / FINE
    # Between neighbouring samples the object turns about one axis.
    steps = from_rotvec(part * rotvec(R_PO[1:] @ np.swapaxes(R_PO[:-1], 1, 2))[:, None]) @ R_PO[:-1, None]
    turns = np.concatenate([steps.reshape(-1, 3, 3), R_PO[-1:]])
    return float(nearest(hand, i, fine, turns, between(p_PO)))


@heap
def nearest(hand: Hand, i: int, q: Array, R_WO: Array, p_WO: Array) -> float:
    """Least distance of agent i's tip from the object's surface at the joints q (F, n_a) and the object's poses, m."""
    n_a = q.shape[1]
    R_WL, p_WL, R_OT = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3)), np.empty((3, 3))
    p, foot, n, least = np.empty(3), np.empty(3), np.empty(3), np.inf
    for s in range(len(q)):
        forward(hand.chains, i, q[s], R_WL, p_WL)
        for a in range(3):
            p[a] = p_WL[n_a, a] - p_WO[s, a]
        rotate_back(R_WO[s], p, p)
        multiply_back(R_WO[s], R_WL[n_a], R_OT)
        least = min(least, tip_gap(hand, i, R_OT, p, foot, n))
    return least


def achieved(hand: Hand, i: int, command: Array, R_OT: Array, x_O: Array, n_O: Array) -> Array:
    """The relative motion over the interval, in C: as commanded for six joints, as the joints allowed for fewer."""
    if is_full(hand, i):
        return command
    y_O = np.cross(n_O, x_O)
    skew = R_OT[1:] @ np.swapaxes(R_OT[:-1], 1, 2)
    turn = 0.5 * np.stack([skew[:, a, b] - skew[:, b, a] for a, b in ((2, 1), (0, 2), (1, 0))], axis=1)
    total = command.copy()
    total[0] = np.sum(turn * 0.5 * (x_O[:-1] + x_O[1:]))
    total[1] = np.sum(turn * 0.5 * (y_O[:-1] + y_O[1:]))
    return total
