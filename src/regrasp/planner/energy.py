"""Eq. (1): E(V) = K_c Σ_j c_j + K_e Σ_j e_j + K_f Σ_ij |f_ij| + K_g Σ_i g_i + K_h Σ_j h_j, evaluated interval by interval.

The paper's, and with K_h what the contacts that stick leave of the object's pose undetermined.

Object pose → contact kinematics per agent → joint angles → collisions → force LP. Two exact shortcuts leave every value as
it is: what a change of V does not reach is taken over from the current state, and the evaluation ends as soon as the
partial sum, to which every further term only adds, exceeds the bound that the Metropolis rule has drawn.
"""

from dataclasses import dataclass
from typing import cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from regrasp.kernels.basis import Program, program
from regrasp.kernels.chains import forward
from regrasp.kernels.forces import EDGES
from regrasp.kernels.records import Record
from regrasp.kernels.surfaces import project, tangents
from regrasp.planner.balance import balance, is_sliding, slide_direction
from regrasp.planner.collision import block_hit, place, tip_hit
from regrasp.planner.follow import follow
from regrasp.planner.hand import Hand
from regrasp.planner.motions import OFF, RELOCATE, STAY, whole
from regrasp.planner.path import Path
from regrasp.planner.relocation import Scan, free_motion, relocate, stand_on
from regrasp.planner.reserve import Margins
from regrasp.planner.state import State, copy_agent, copy_motion, copy_terms, same_agent
from regrasp.planner.supports import SLIDE, STICK

Array = NDArray[np.float64]
Codes = NDArray[np.int8]

# Typed, as numba would compile every kernel below a literal a second time.
NOBODY, STAND = cast(int, np.int64(-1)), cast(int, np.int64(STAY))


@dataclass(frozen=True)
class Energy:
    """Weights of Eq. (1), K_c ≈ K_e ≫ K_f, K_g, and the margins of its constraints.

    collision K_c, equilibrium K_e: per interval and violation. force K_f: per weight of contact force and interval.
    change K_g: per change of an agent's contact motion. stability K_h: per interval and contact that sticks too few.
    clearance: m, kept between bodies that may not touch. friction_margin: part of μ that rolling and resting contacts
    leave unused. grip: normal force, in weights, that every agent in contact has to spare. disturbance δ: standard deviation
    of each component of a wrench that comes unplanned, in weights and weights times the object's radius; agents that rest or
    roll have to spare what their share in it asks of them beside the grip (`planner.reserve`). slide_force: largest normal
    force of an agent that slides, in weights: its friction is never known well, and the others bear the error.
    """

    collision: float = 10.0
    equilibrium: float = 10.0
    force: float = 0.15
    change: float = 0.1
    stability: float = 5.0
    clearance: float = 0.0015
    friction_margin: float = 0.3
    grip: float = 0.05
    disturbance: float = 0.1
    slide_force: float = 0.5

    def __post_init__(self) -> None:
        if not 0.0 <= self.friction_margin < 1.0:
            raise ValueError(f"friction_margin is {self.friction_margin}, legal: 0 ≤ friction_margin < 1")
        if not self.grip >= 0.0:
            raise ValueError(f"grip is {self.grip}, legal: 0 or more weights")
        if not self.disturbance >= 0.0:
            raise ValueError(f"disturbance is {self.disturbance}, legal: 0 or more weights")
        if not self.slide_force >= self.grip:
            raise ValueError(f"slide_force is {self.slide_force}, legal: the grip, {self.grip}, or more weights")

    @property
    def margins(self) -> Margins:
        """What the force programs leave unused."""
        return Margins(self.friction_margin, self.grip, self.disturbance, self.slide_force)


class Terms(Record):
    """The settings of Energy and Relocation as the kernels take them; high: lift height, m."""

    collision: float
    equilibrium: float
    force: float
    change: float
    stability: float
    clearance: float
    margins: Margins
    outlook: float
    tries: int
    high: float
    commands: Array


class Work(Record):
    """Scratch of one evaluation."""

    lp: Program
    score: Array
    touched: NDArray[np.uint8]
    dirty: NDArray[np.uint8]
    bears: NDArray[np.uint8]


def new_work(hand: Hand, path: Path, scan: Scan) -> Work:
    """Scratch arrays for evaluations on this path."""
    k, slots = len(hand.tip_geom), path.support_mode.shape[1]
    lp = program(EDGES * (k + slots), k)
    flags = [np.zeros(k, np.uint8) for _ in range(3)]
    return Work(lp, np.zeros(len(scan.p_O)), *flags)


@njit(cache=True, nogil=True)
def changes(V: Codes) -> int:
    """Σ_i g_i: how often agents change their contact motion; each relocation is a motion of its own."""
    count = 0
    for j in range(1, V.shape[0]):
        for i in range(V.shape[1]):
            if V[j, i] != V[j - 1, i] or V[j, i] == RELOCATE:
                count += 1
    return count


@njit(cache=True, nogil=True)
def loose(hand: Hand, path: Path, j: int, bears: NDArray[np.uint8], codes: Codes) -> int:
    """h_j: how many sticking contacts interval j has too few to determine the object's pose.

    Agents that bear without sliding and supports on which the object sticks; a contact that slides follows the object.
    """
    stick = 0
    for i in range(len(bears)):
        if bears[i] == 1 and not is_sliding(whole(codes[i])):
            stick += 1
    for column in range(path.support_mode.shape[1]):
        if path.support_mode[j, column] == STICK:
            stick += 1
    return max(0, hand.needed - stick)


@njit(cache=True, nogil=True)
def moves_freely(code: int, holds: int) -> bool:
    """Whether an agent leaves or comes to the object in this interval."""
    return code == RELOCATE or (code == OFF and holds == 1)


@njit(cache=True, nogil=True)
def follow_contact(hand: Hand, path: Path, terms: Terms, state: State, j: int, i: int, code: int) -> None:
    """Agent i in contact through interval j: contact motion, joint angles, bodies, normals (writes configuration j + 1)."""
    first, last = hand.chains.start[i], hand.chains.start[i + 1]
    x, y, n, foot = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    R_WL, p_WL = np.empty((last - first + 1, 3, 3)), np.empty((last - first + 1, 3))
    state.holds[j + 1, i] = 1
    state.q[j + 1, first:last] = state.q[j, first:last]
    state.p_OC[j + 1, i] = state.p_OC[j, i]
    state.p_TC[j + 1, i] = state.p_TC[j, i]
    state.R_OT[j + 1, i] = state.R_OT[j, i]
    project(hand.kind_O, hand.size_O, state.p_OC[j, i], foot, n)
    tangents(n, x, y)
    state.n_O[j, 0, i] = n
    if is_sliding(code):
        slide_direction(code, x, y, state.t_O[j, 0, i])
    fine = follow(
        hand, path, terms.commands[code], j, i, state.p_OC[j + 1, i], state.p_TC[j + 1, i], state.R_OT[j + 1, i], x,
        state.q[j + 1, first:last], R_WL, p_WL,
    )  # fmt: skip
    if not fine:
        state.lost[j, i] = 1
    place(hand, hand.geom_start[i], hand.geom_start[i + 1], R_WL, p_WL, state.R_WG[j + 1], state.p_WG[j + 1])
    project(hand.kind_O, hand.size_O, state.p_OC[j + 1, i], foot, n)
    state.n_O[j, 1, i] = n
    if is_sliding(code):
        for a in range(3):
            y[a] = n[(a + 1) % 3] * x[(a + 2) % 3] - n[(a + 2) % 3] * x[(a + 1) % 3]
        slide_direction(code, x, y, state.t_O[j, 1, i])


@njit(cache=True, nogil=True)
def rest(hand: Hand, state: State, j: int, i: int) -> None:
    """Agent i stays away from the object through interval j."""
    for a in range(hand.chains.start[i], hand.chains.start[i + 1]):
        state.q[j + 1, a] = state.q[j, a]
    state.holds[j + 1, i] = 0
    for g in range(hand.geom_start[i], hand.geom_start[i + 1]):
        state.R_WG[j + 1, g] = state.R_WG[j, g]
        state.p_WG[j + 1, g] = state.p_WG[j, g]


@njit(cache=True, nogil=True)
def move_freely(hand: Hand, path: Path, scan: Scan, terms: Terms, state: State, j: int, i: int, work: Work) -> None:
    """Agent i relocates or retires in interval j; where it can't, it is lost and keeps to where it is."""
    first, last = hand.chains.start[i], hand.chains.start[i + 1]
    n_a = last - first
    q = np.empty((path.R_WO.shape[1], n_a))
    if state.V[j, i] == RELOCATE:
        c, way = relocate(
            hand, path, scan, state, j, i, work.bears, terms.clearance, terms.margins, terms.outlook,
            terms.tries, terms.high, work.lp, work.score, q,
        )  # fmt: skip
        state.chosen[j, i] = c
        state.way[j, i] = way
        if c >= 0:
            stand_on(hand, path, scan, state, j + 1, i, c)
            return
    else:
        goal = np.zeros(3)
        lifts = state.holds[j, i] == 1
        home = hand.home[first:last]
        if free_motion(
            hand, path, state, j, i, lifts, not lifts, goal, goal, home, whole(0), terms.high, terms.clearance, q
        ):
            R_WL, p_WL = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3))
            state.q[j + 1, first:last] = home
            forward(hand.chains, i, home, R_WL, p_WL)
            place(hand, hand.geom_start[i], hand.geom_start[i + 1], R_WL, p_WL, state.R_WG[j + 1], state.p_WG[j + 1])
            state.holds[j + 1, i] = 0
            return
    stay_behind(hand, path, terms, state, j, i)


@njit(cache=True, nogil=True)
def stay_behind(hand: Hand, path: Path, terms: Terms, state: State, j: int, i: int) -> None:
    """Agent i could not move freely in interval j: the workspace condition is broken, it keeps to where it is."""
    if state.holds[j, i] == 1:
        follow_contact(hand, path, terms, state, j, i, STAND)
    else:
        rest(hand, state, j, i)
    state.chosen[j, i] = -1
    state.lost[j, i] = 1


@njit(cache=True, nogil=True)
def collisions(hand: Hand, terms: Terms, cur: State, new: State, j: int, work: Work, fresh: bool) -> None:
    """Which blocks of bodies collide at the end of interval j; blocks of agents that did not change are taken over."""
    k = len(work.dirty)
    R_WG, p_WG = new.R_WG[j + 1], new.p_WG[j + 1]
    for a in range(k):
        for c in range(a, k + 2):
            changed = fresh or work.dirty[a] == 1 or (c < k and work.dirty[c] == 1)
            if not changed:
                new.hits[j, a, c] = cur.hits[j, a, c]
                continue
            hit = block_hit(hand, a, c, R_WG, p_WG, terms.clearance)
            if c == k + 1 and not hit and new.holds[j + 1, a] == 0:
                hit = tip_hit(hand, a, R_WG, p_WG, terms.clearance)
            new.hits[j, a, c] = 1 if hit else 0


@njit(cache=True, nogil=True)
def same_program(path: Path, state: State, j: int) -> bool:
    """Whether the force LP at the start of interval j is that at the end of interval j − 1: same contacts, none sliding."""
    if j == 0:
        return False
    for i in range(state.V.shape[1]):
        code = state.V[j, i]
        if code != state.V[j - 1, i] or code == RELOCATE or is_sliding(whole(code)):
            return False
        if state.holds[j - 1, i] != state.holds[j, i]:
            return False
    for column in range(path.support_mode.shape[1]):
        mode = path.support_mode[j, column]
        if mode != path.support_mode[j - 1, column] or mode == SLIDE:
            return False
    return True


@njit(cache=True, nogil=True)
def score_interval(hand: Hand, path: Path, terms: Terms, new: State, j: int, work: Work) -> None:
    """c_j, e_j, Σ_i |f_ij| and h_j of interval j. The force LP stands at both ends of the interval with its contact motions."""
    k, m = len(work.dirty), path.R_WO.shape[1] - 1
    count = 0
    for a in range(k):
        count += new.lost[j, a]
        for c in range(a, k + 2):
            count += new.hits[j, a, c]
    new.c[j] = count
    start = np.inf
    if same_program(path, new, j):
        start = new.end[j - 1]
    else:
        held, value, _ = balance(
            hand, path, j, whole(0), work.bears, new.V[j], new.p_OC[j], new.n_O[j, 0], new.t_O[j, 0], terms.margins,
            work.lp,
        )  # fmt: skip
        if held:
            start = value
    held, value, _ = balance(
        hand, path, j, m, work.bears, new.V[j], new.p_OC[j + 1], new.n_O[j, 1], new.t_O[j, 1], terms.margins,
        work.lp,
    )  # fmt: skip
    new.end[j] = value if held else np.inf
    fine = start < np.inf and held
    new.e[j] = 0.0 if fine else 1.0
    new.f[j] = 0.5 * (start + value) if fine else 0.0
    new.h[j] = loose(hand, path, j, work.bears, new.V[j])


@njit(cache=True, nogil=True)
def interval_energy(terms: Terms, state: State, j: int) -> float:
    """The share of interval j in Eq. (1), without the changes g."""
    violations = terms.collision * state.c[j] + terms.equilibrium * state.e[j]
    return violations + terms.force * state.f[j] + terms.stability * state.h[j]


@njit(cache=True, nogil=True)
def bearing(state: State, j: int, bears: NDArray[np.uint8]) -> None:
    """Which agents bear force in interval j: those in contact that neither relocate nor retire."""
    for i in range(len(bears)):
        contact = state.V[j, i] != RELOCATE and state.V[j, i] != OFF
        bears[i] = 1 if contact and state.holds[j, i] == 1 else 0


@njit(cache=True, nogil=True)
def evaluate(
    hand: Hand, path: Path, scan: Scan, terms: Terms, V: Codes, first: int, final: int, bound: float, fresh: bool,
    cur: State, new: State, work: Work,
) -> tuple[float, int]:  # fmt: skip
    """E(V) where V differs from cur.V in intervals first … final only; written to `new` from configuration `first` on.

    Returns (E, stop): E is inf if it exceeds the bound; rows up to configuration `stop` of `new` differ from `cur`.
    fresh: take nothing over, `cur` holds only the start.
    """
    n, k = V.shape
    E = terms.change * changes(V)
    for j in range(first):
        E += interval_energy(terms, cur, j)
    if bound < E:
        return np.inf, first
    for i in range(k):
        copy_agent(hand, cur, new, first, i)
        work.dirty[i] = 0
        if first > 0:
            new.V[first - 1, i], new.holds[first - 1, i] = cur.V[first - 1, i], cur.holds[first - 1, i]
    if first > 0:
        new.end[first - 1] = cur.end[first - 1]
    for j in range(first, n):
        touched = 0
        for i in range(k):
            work.touched[i] = 1 if fresh or work.dirty[i] == 1 or V[j, i] != cur.V[j, i] else 0
            touched += work.touched[i]
            new.V[j, i] = V[j, i]
        if touched == 0 and j > final:
            for rest_j in range(j, n):
                E += interval_energy(terms, cur, rest_j)
            return (E, j) if bound >= E else (np.inf, j)
        mover = NOBODY
        for i in range(k):
            if mover < 0 and moves_freely(V[j, i], new.holds[j, i]):
                mover = i
        if touched > 0:
            for i in range(k):
                if moves_freely(V[j, i], new.holds[j, i]):
                    work.touched[i] = 1  # who may move, its scan and its way depend on all the others
        for i in range(k):
            if work.touched[i] == 0:
                copy_motion(cur, new, j, i)
                copy_agent(hand, cur, new, j + 1, i)
                continue
            new.chosen[j, i] = -1
            new.way[j, i] = 0
            new.lost[j, i] = 0
            if i == mover:
                continue
            if moves_freely(V[j, i], new.holds[j, i]):
                stay_behind(hand, path, terms, new, j, i)  # one free motion at a time
            elif new.holds[j, i] == 1:
                follow_contact(hand, path, terms, new, j, i, whole(V[j, i]))
            else:
                rest(hand, new, j, i)
        bearing(new, j, work.bears)
        if mover >= 0 and work.touched[mover] == 1:
            move_freely(hand, path, scan, terms, new, j, mover, work)
        for i in range(k):
            work.dirty[i] = 1 if work.touched[i] == 1 and not same_agent(hand, new, cur, j + 1, i) else 0
            if fresh:
                work.dirty[i] = 1
        if touched == 0:
            for a in range(k):
                new.hits[j, a] = cur.hits[j, a]
            copy_terms(cur, new, j)
        else:
            collisions(hand, terms, cur, new, j, work, fresh)
            score_interval(hand, path, terms, new, j, work)
        E += interval_energy(terms, new, j)
        if bound < E:
            return np.inf, j + 1
    return E, n


@njit(cache=True, nogil=True)
def adopt(hand: Hand, new: State, cur: State, first: int, stop: int) -> None:
    """Take the trial state over into the current one, configurations first + 1 … stop."""
    k = cur.V.shape[1]
    for j in range(first, stop):
        for i in range(k):
            copy_agent(hand, new, cur, j + 1, i)
            copy_motion(new, cur, j, i)
        cur.hits[j] = new.hits[j]
        copy_terms(new, cur, j)
