"""The motion of one arc in full: every sample's joints, contacts and forces from V, and every constraint looked at again."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from regrasp.kernels.chains import forward
from regrasp.kernels.contact import advance
from regrasp.kernels.forces import contact_forces
from regrasp.kernels.surfaces import project, tangents
from regrasp.planner.balance import balance, is_sliding, slide_direction
from regrasp.planner.collision import block_hit, place, tip_hit
from regrasp.planner.energy import Terms, Work, bearing, moves_freely
from regrasp.planner.follow import is_full, reach_tip, short_step
from regrasp.planner.hand import RANGE_MARGIN, Hand
from regrasp.planner.motions import OFF, RELOCATE, whole
from regrasp.planner.path import Path
from regrasp.planner.relocation import Scan, free_motion
from regrasp.planner.splines import dense
from regrasp.planner.state import State
from regrasp.planner.supports import SLIDE, STICK

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
    force_W: Array
    support_force_W: Array
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
    hits: NDArray[np.uint8], static_R: Array, static_p: Array,
) -> None:  # fmt: skip
    """Blocks that collide at any sample of interval j: hits (k, k + 2). q (m + 1, nq) joints of all agents.

    holds (k,): in contact all through; ends (k,): in contact at the start (1), the end (2) or both (3) of a free motion,
    near which its tip may be close to the object.
    """
    m, k = q.shape[0] - 1, len(holds)
    R_WG, p_WG = static_R.copy(), static_p.copy()
    obj = np.zeros((1, 3, 3))
    obj_p = np.zeros((1, 3))
    rise = m // 4
    joints = np.max(np.diff(hand.chains.start))
    R_WL, p_WL = np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3))
    for s in range(m + 1):
        obj[0], obj_p[0] = path.R_WO[j, s], path.p_WO[j, s]
        place(hand, hand.object_geom, hand.object_geom + 1, obj, obj_p, R_WG, p_WG)
        for i in range(k):
            forward(hand.chains, i, q[s, hand.chains.start[i] : hand.chains.start[i + 1]], R_WL, p_WL)
            place(hand, hand.geom_start[i], hand.geom_start[i + 1], R_WL, p_WL, R_WG, p_WG)
        for a in range(k):
            near = (ends[a] & 1 and s <= rise) or (ends[a] & 2 and s >= m - rise)
            for c in range(a, k + 2):
                if block_hit(hand, a, c, R_WG, p_WG, clearance):
                    hits[a, c] = 1
            if holds[a] == 0 and not near and tip_hit(hand, a, R_WG, p_WG, clearance):
                hits[a, k + 1] = 1


def detail(
    hand: Hand,
    path: Path,
    scan: Scan,
    terms: Terms,
    state: State,
    V: NDArray[np.int8],
    work: Work,
    names: tuple[str, ...],
) -> Motion:
    """The Motion of V, whose interval ends stand in the state as `evaluate` left them."""
    n, k = V.shape
    m = path.R_WO.shape[1] - 1
    slots = path.support_mode.shape[1]
    joints = np.zeros((n, m + 1, len(hand.home)))
    p_OC, n_O, x_O = (np.full((n, m + 1, k, 3), np.nan) for _ in range(3))
    force, support_force = np.zeros((n, m + 1, k, 3)), np.zeros((n, m + 1, slots, 3))
    twist = np.zeros((n, k, 4))
    found: list[Violation] = []
    bears = np.zeros(k, np.uint8)
    # Any contact motion of an agent that is not in contact means that it stays off.
    said = (V == RELOCATE) | (state.holds[:n] == 1)
    for j in range(n):
        bearing(state, j, bears)
        ends = np.zeros(k, np.uint8)
        for i in range(k):
            first, last = hand.chains.start[i], hand.chains.start[i + 1]
            q = np.zeros((m + 1, last - first))
            q[0] = state.q[j, first:last]
            if bears[i]:
                p, p_T, x, nn = (np.zeros((m + 1, 3)) for _ in range(4))
                R = np.zeros((m + 1, 3, 3))
                p[0], p_T[0], R[0] = state.p_OC[j, i], state.p_TC[j, i], state.R_OT[j, i]
                traced = trace_contact(hand, path, terms.commands[V[j, i]], j, i, p, p_T, R, x, q, nn)
                if state.lost[j, i] or not traced or np.max(np.abs(q[m] - state.q[j + 1, first:last])) > SAME:
                    found.append(Violation("reach", j, names[i], "leaves its workspace while in contact"))
                q[m] = state.q[j + 1, first:last]
                p_OC[j, :, i], n_O[j, :, i], x_O[j, :, i] = p, nn, x
                twist[j, i] = achieved(hand, i, terms.commands[V[j, i]], R, x, nn)
            elif moves_freely(V[j, i], state.holds[j, i]) and not state.lost[j, i]:
                c = state.chosen[j, i]
                lands = c >= 0
                goal_q = scan.q[i, j + 1, c, : last - first] if lands else hand.home[first:last]
                p_c, n_c = (scan.p[i, j + 1, c], scan.n[i, j + 1, c]) if lands else (np.zeros(3), np.zeros(3))
                clear = free_motion(
                    hand, path, state, j, i, bool(state.holds[j, i]), lands, p_c, n_c, goal_q, state.way[j, i],
                    terms.high, terms.clearance, q,
                )  # fmt: skip
                ends[i] = int(state.holds[j, i]) + 2 * int(lands)
                if not clear:
                    found.append(Violation("collision", j, names[i], "has no free way between contacts"))
                if least_gap(hand, path, j, i, q) < -GRAZE:
                    found.append(
                        Violation("collision", j, names[i], "grazes the object as it lifts off or touches down")
                    )
            else:
                q[:] = q[0]
                if state.lost[j, i]:
                    found.append(Violation("reach", j, names[i], "finds no free way to or from a contact"))
            joints[j, :, first:last] = q
            fine = between(q)
            if bears[i] and np.max(np.abs(np.diff(q, 2, axis=0))) > UNEVEN:
                found.append(Violation("reach", j, names[i], "comes too near to a singularity while in contact"))
            if np.any(fine < hand.chains.lower[first:last] - LIMIT) or np.any(
                fine > hand.chains.upper[first:last] + LIMIT
            ):
                found.append(Violation("reach", j, names[i], "passes a joint limit between two samples"))
        hits = np.zeros((k, k + 2), np.uint8)
        sample_hits(hand, path, j, joints[j], bears, ends, 0.5 * terms.clearance, hits, state.R_WG[j], state.p_WG[j])
        for a, c in zip(*np.nonzero(hits), strict=True):
            other = names[c] if c < k else ("a static body", "the object")[c - k]
            found.append(Violation("collision", j, names[a], f"touches {other if c != a else 'itself'}"))
        if not forces(hand, path, terms, j, bears, V[j], p_OC[j], n_O[j], x_O[j], work, force[j], support_force[j]):
            found.append(Violation("equilibrium", j, "", "no contact forces hold the object"))
    V = np.where(said, V, OFF).astype(np.int8)
    return Motion(path, V, joints, twist, p_OC, n_O, x_O, force, support_force, tuple(found))


def between(q: Array) -> Array:
    """Joints on the spline that a plan follows, denser than the samples q (m + 1, n_a)."""
    return dense(len(q) - 1)[0] @ q


def least_gap(hand: Hand, path: Path, j: int, i: int, q: Array) -> float:
    """Least distance of agent i's tip from the object's surface in interval j, between the samples too, m."""
    fine, m = between(q), len(q) - 1
    n_a = q.shape[1]
    R_WL, p_WL = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3))
    foot, n, least = np.empty(3), np.empty(3), np.inf
    turns = Slerp(np.arange(m + 1), Rotation.from_matrix(path.R_WO[j]))(np.linspace(0.0, m, len(fine))).as_matrix()
    places = between(path.p_WO[j])
    for row, R_WO, p_WO in zip(fine, turns, places, strict=True):
        forward(hand.chains, i, row, R_WL, p_WL)
        centre = np.ascontiguousarray(R_WO.T @ (p_WL[n_a] - p_WO))
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


def forces(
    hand: Hand, path: Path, terms: Terms, j: int, bears: NDArray[np.uint8], codes: NDArray[np.int8],
    p_OC: Array, n_O: Array, x_O: Array, work: Work, force: Array, support_force: Array,
) -> bool:  # fmt: skip
    """Contact forces (W, N) at every sample of interval j from the force LP; whether there are any everywhere."""
    m, k = len(p_OC) - 1, len(bears)
    t = np.zeros((k, 3))
    y_O = np.cross(n_O, x_O)
    count = k + path.support_mode.shape[1]
    fine = True
    for s in range(m + 1):
        for i in range(k):
            if bears[i] and is_sliding(codes[i]):
                slide_direction(codes[i], x_O[s, i], y_O[s, i], t[i])
        held, _, columns = balance(hand, path, j, s, bears, codes, p_OC[s], n_O[s], t, terms.margins, work.lp)
        if not held:
            fine = False
            continue
        starts, at = np.zeros(count + 1, np.int64), 0
        for c in range(count):
            starts[c] = at
            if c < k:
                at += (1 if is_sliding(codes[c]) else 8) if bears[c] else 0
            else:
                at += {STICK: 8, SLIDE: 1}.get(int(path.support_mode[j, c - k]), 0)
        starts[count] = columns
        f_O = np.zeros((count, 3))
        contact_forces(work.lp.A, work.lp.solution, starts, hand.weight, f_O)
        f_W = f_O @ path.R_WO[j, s].T
        force[s], support_force[s] = f_W[:k], f_W[k:]
    return fine
