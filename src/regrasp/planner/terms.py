"""The terms of Eq. (1), their weights, and what one chain of evaluations remembers of them.

Four exact shortcuts leave every value as it is (`Shortcuts`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.basis import Program, program
from regrasp.kernels.forces import EDGES
from regrasp.kernels.native import kernel
from regrasp.kernels.records import Record
from regrasp.kernels.stack import stack
from regrasp.planner.balance import balance
from regrasp.planner.collision import hits
from regrasp.planner.configurations import Configurations
from regrasp.planner.hand import Hand
from regrasp.planner.memory import Memory, new_memory, remember, slot_of
from regrasp.planner.motions import OFF, ONTO, RELOCATE, is_sliding, whole
from regrasp.planner.passage import free_motion
from regrasp.planner.path import Path
from regrasp.planner.reserve import Margins
from regrasp.planner.state import State
from regrasp.planner.supports import SLIDE, STICK

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.uint8]
Codes = NDArray[np.int16]

SCATTER = 6364136223846793005  # of a signature's digits, so that many columns, too, give different numbers
BASES = 128  # kept: more than the ways in which four agents can bear, slide or do neither


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
    sample: int
    high: float
    commands: Array


class Shortcuts(Record):
    """The exact shortcuts of an evaluation (DESIGN: they leave the Markov chain unchanged), each 1 (on) or 0.

    changed: only the intervals that the change of V reaches are evaluated anew, and there only the agent that it moves.
    memory: configurations, collisions, force programs and free motions are looked up where they have been computed before.
    warm: a force program starts from the basis of the one before. bound: an evaluation ends as soon as the partial sum
    exceeds the threshold that the Metropolis rule has drawn.
    """

    changed: int = 1
    memory: int = 1
    warm: int = 1
    bound: int = 1


class Counts(Record):
    """What evaluations did, counted: (1,) each."""

    configurations: Ints
    programs: Ints
    pivots: Ints
    ways: Ints


class Work(Record):
    """What one chain of evaluations needs beside its states: what it remembers, scratch, counts.

    joined (n,): the force program at the start of the interval is that at the end of the one before, where nothing slides.
    signatures (BASES,): which columns a force program had; bases (BASES, 6 + k): the basis at which the last such one ended.
    floor (n,): the least sum of normal forces that can hold the object in the interval, whatever the agents do, in weights.
    """

    shortcuts: Shortcuts
    counts: Counts
    lp: Program
    joined: Flags
    signatures: Ints
    bases: Ints
    floor: Array
    pairs: Memory
    sums: Memory
    ways: Memory
    key_pair: Ints
    key_sum: Ints
    key_way: Ints
    bears: Flags
    codes: Codes
    here: Ints
    there: Ints
    p: Array
    n: Array
    t: Array


def new_work(hand: Hand, path: Path, shortcuts: Shortcuts) -> Work:
    """Nothing remembered, nothing counted."""
    n, k, slots = len(path.R_WO), len(hand.tip_geom), path.support_mode.shape[1]
    lp = program(EDGES * (k + slots), k)
    joined = np.zeros(n, np.uint8)
    same = np.all(path.support_mode[1:] == path.support_mode[:-1], axis=1)
    joined[1:] = same & ~np.any(path.support_mode[1:] == SLIDE, axis=1)
    rows = [np.zeros((k, 3)) for _ in range(3)]
    counts = Counts(*(np.zeros(1, np.int64) for _ in range(4)))
    return Work(
        shortcuts, counts, lp, joined, np.full(BASES, -1), np.zeros((BASES, len(lp.basis)), np.int64), floor_of(hand, path),
        new_memory(12, 1), new_memory(12, 1 + k), new_memory(12, 3), np.zeros(1, np.int64), np.zeros(1 + k, np.int64),
        np.zeros(3, np.int64), np.zeros(k, np.uint8), np.zeros(k, np.int16), np.zeros(k, np.int64),
        np.zeros(k, np.int64), *rows,
    )  # fmt: skip


def floor_of(hand: Hand, path: Path) -> Array:
    """`Work.floor`: a force of the length √(1 + μ²) is the most that a normal force of 1 makes, and supports cost nothing."""
    alone = ~np.any((path.support_mode == STICK) | (path.support_mode == SLIDE), axis=1)
    load = np.linalg.norm(path.up_O, axis=2).min(axis=1)
    # Less a millionth: more than the round-off of a force program.
    return np.asarray(alone * load * (1.0 - 1e-6) / np.sqrt(1.0 + np.max(hand.mu) ** 2), np.float64)


@kernel
def changes(V: Codes) -> int:
    """Σ_i g_i: how often agents change their contact motion; each relocation is a motion of its own."""
    count = 0
    for j in range(1, V.shape[0]):
        for i in range(V.shape[1]):
            if V[j, i] != V[j - 1, i] or V[j, i] >= ONTO:
                count += 1
    return count


@kernel
def loose(hand: Hand, path: Path, found: Configurations, state: State, j: int, but: int) -> int:
    """h_j: how many sticking contacts interval j has too few to determine the object's pose, agent `but` (−1: none) left out.

    Agents that bear without sliding and supports on which the object sticks; a contact that slides follows the object.
    """
    stick = 0
    for i in range(state.V.shape[1]):
        code = state.V[j, i]
        if i != but and code < RELOCATE and found.holds[state.at[j, i]] and not is_sliding(whole(code)):
            stick += 1
    for column in range(path.support_mode.shape[1]):
        if path.support_mode[j, column] == STICK:
            stick += 1
    return max(0, hand.needed - stick)


@kernel
def moves_freely(code: int, holds: int) -> bool:
    """Whether an agent leaves or comes to the object in this interval."""
    return code >= ONTO or (code == OFF and holds == 1)


@kernel
def collide(hand: Hand, terms: Terms, found: Configurations, work: Work, a: int, b: int, x: int, y: int) -> bool:
    """Whether agents a < b in their configurations x and y come closer than the clearance."""
    key, slot = work.key_pair, 0
    if work.shortcuts.memory:
        key[0] = x << 32 | y
        slot = slot_of(work.pairs, key)
        if work.pairs.taken[slot]:
            return work.pairs.values[slot] > 0.0
    hit = hits(hand, a, b, found.R_WG[x], found.p_WG[x], found.R_WG[y], found.p_WG[y], terms.clearance)
    if work.shortcuts.memory:
        remember(work.pairs, slot, key, 1.0 if hit else 0.0)
    return hit


@kernel
def sum_of_forces(hand: Hand, path: Path, terms: Terms, found: Configurations, work: Work, j: int, end: int) -> float:
    """Σ of the normal contact forces at the start (end = 0) or end (1) of interval j; inf without equilibrium.

    work.bears, codes, here, there (k,): which agents bear, their contact motions, their configurations at its two ends.
    """
    k = len(work.bears)
    key, slot = work.key_sum, 0
    key[0] = 2 * j - 1 if end == 0 and work.joined[j] else 2 * j + end
    for i in range(k):
        if not work.bears[i]:
            key[1 + i] = -1
        elif is_sliding(whole(work.codes[i])):
            key[1 + i] = -2 - work.there[i]
        else:
            key[1 + i] = work.there[i] if end else work.here[i]
    if work.shortcuts.memory:
        slot = slot_of(work.sums, key)
        if work.sums.taken[slot]:
            return work.sums.values[slot]
    signature = 0
    for column in range(path.support_mode.shape[1]):
        signature = SCATTER * signature + path.support_mode[j, column]
    for i in range(k):
        signature *= SCATTER
        if work.bears[i]:
            signature += 1 if is_sliding(whole(work.codes[i])) else 2
            c = work.there[i] if end else work.here[i]
            for a in range(3):
                work.p[i, a], work.n[i, a] = found.p_OC[c, a], found.n_O[c, a]
                work.t[i, a] = found.t_O[work.there[i], end, a]
    # Another program's basis is of no use, and the last with the same columns may have been long ago.
    basis = work.bases[signature % BASES]
    warm = work.shortcuts.warm == 1 and work.signatures[signature % BASES] == signature
    if warm:
        work.lp.basis[:] = basis
    s = path.R_WO.shape[1] - 1 if end else 0
    held, value, pivots = balance(
        hand, path, j, s, work.bears, work.codes, work.p, work.n, work.t, terms.margins, warm, work.lp
    )
    work.signatures[signature % BASES] = signature
    basis[:] = work.lp.basis
    work.counts.programs[0] += 1
    work.counts.pivots[0] += pivots
    if not held:
        value = np.inf
    if work.shortcuts.memory:
        remember(work.sums, slot, key, value)
    return value


@kernel
def force_terms(hand: Hand, path: Path, terms: Terms, found: Configurations, work: Work, new: State, j: int) -> None:
    """e_j and Σ_i |f_ij| of interval j. The force program stands at both ends of it with its contact motions."""
    for i in range(len(work.bears)):
        work.codes[i] = new.V[j, i]
        work.here[i], work.there[i] = new.at[j, i], new.at[j + 1, i]
        work.bears[i] = 1 if new.V[j, i] < RELOCATE and found.holds[new.at[j, i]] else 0
    new.e[j], new.f[j] = 1.0, 0.0
    start = sum_of_forces(hand, path, terms, found, work, j, whole(0))
    if start < np.inf:
        end = sum_of_forces(hand, path, terms, found, work, j, whole(1))
        if end < np.inf:
            new.e[j], new.f[j] = 0.0, 0.5 * (start + end)


@kernel
def way_of(hand: Hand, path: Path, terms: Terms, found: Configurations, work: Work, new: State, j: int, i: int) -> int:
    """The way of agent i's free motion through interval j, −1 for none."""
    n_a = hand.chains.start[i + 1] - hand.chains.start[i]
    way, known = free_motion(
        hand, path, found, work.ways, work.key_way, work.shortcuts.memory == 1, j, i, new.at[j], new.at[j + 1],
        terms.high, terms.clearance, stack((path.R_WO.shape[1], n_a)),
    )  # fmt: skip
    work.counts.ways[0] += not known
    return way


@kernel
def least_energy(terms: Terms, work: Work, j: int) -> float:
    """What e_j and f_j add to Eq. (1) at least: the forces that hold the object, or the want of them."""
    return min(terms.equilibrium, terms.force * work.floor[j])


@kernel
def interval_energy(terms: Terms, state: State, j: int) -> float:
    """The share of interval j in Eq. (1), without the changes g."""
    violations = terms.collision * state.c[j] + terms.equilibrium * state.e[j]
    return violations + terms.force * state.f[j] + terms.stability * state.h[j]
