"""A Markov chain over the matrices V of an arc (paper §4): what a move proposes, and the Metropolis rule, compiled.

The chain is that of `search.annealing` on `ContactMotions`: the same random numbers give the same V's.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import kernel
from regrasp.planner.configurations import Configurations, Grasp, grasp_of, new_configurations
from regrasp.planner.energy import evaluate, make_room
from regrasp.planner.hand import Hand
from regrasp.planner.motions import MOTION_COUNT, ONTO, RELOCATE, STAY, whole
from regrasp.planner.path import Path
from regrasp.planner.relocation import choose, hopeless
from regrasp.planner.scan import Scan
from regrasp.planner.state import State, copy_intervals, new_state
from regrasp.planner.terms import Shortcuts, Terms, Work, new_work
from regrasp.search.annealing import ROUND, Result, Settings, temperature_of
from regrasp.search.annealing import State as AnnealingState

Array = NDArray[np.float64]
Codes = NDArray[np.int16]

DRAWS = 8  # random numbers of a move, beside those of the candidates that it compares
MOVE = 0.1  # part of the moves that choose a relocation's candidate anew, at most SHIFT intervals earlier or later
SHIFT = 3
CARRY = 0.3  # part of the moves that carry the motion of a neighbouring interval on
RUN = 0.7  # part of the others that reach over a run of intervals
BLOCK = 100  # moves between two looks at the clock


@kernel
def propose(
    hand: Hand, path: Path, scan: Scan, terms: Terms, found: Configurations, work: Work, cur: State, u: Array,
    bound: float, new: State,
) -> tuple[int, int, int]:  # fmt: skip
    """new.V: one agent does another motion over a run of intervals, or a change of motion moves to another time.

    u (DRAWS + sample,): uniform on [0, 1). Returns (agent, first and last interval of the change), or −1 for the agent where
    it should relocate and E would exceed the bound wherever it went.
    """
    n, k = cur.V.shape
    for j in range(n):
        for a in range(k):
            new.V[j, a] = cur.V[j, a]
    if u[2] < MOVE:
        count = 0
        for j in range(n):
            for a in range(k):
                count += cur.V[j, a] >= ONTO
        if count > 0:
            left = whole(u[0] * count)
            for e in range(n * k):
                j, i = e // k, e % k
                if cur.V[j, i] < ONTO:
                    continue
                if left == 0:
                    break
                left -= 1
            to = min(max(whole(j - SHIFT + u[1] * (2 * SHIFT + 1)), 0), n - 1)
            around = cur.V[j - 1 if j > 0 and (u[3] < 0.5 or j == n - 1) else min(j + 1, n - 1), i]
            if hopeless(hand, path, terms, found, work, cur, min(j, to), to, i, bound):
                return whole(-1), to, to
            new.V[j, i] = around if around < ONTO else STAY
            new.V[to, i] = ONTO + choose(hand, path, scan, terms, found, work, cur, to, i, u[DRAWS:])
            return i, min(j, to), max(j, to)
    i, first = whole(u[0] * k), whole(u[1] * n)
    if u[2] < MOVE + CARRY:
        # Moves the time of a change without a new one.
        final = min(n - 1, first + whole(u[4] * 3))
        source = first - 1 if u[3] < 0.5 else final + 1
        if 0 <= source < n and cur.V[source, i] < ONTO:
            new.V[first : final + 1, i] = cur.V[source, i]
            return i, first, final
    code, final = whole(u[5] * MOTION_COUNT), first
    if code == RELOCATE:
        if hopeless(hand, path, terms, found, work, cur, first, first, i, bound):
            return whole(-1), first, first
        code = ONTO + choose(hand, path, scan, terms, found, work, cur, first, i, u[DRAWS:])
    elif u[6] < RUN:
        final = min(n - 1, first + whole(u[7] * n))
    new.V[first : final + 1, i] = code
    return i, first, final


@kernel
def metropolis(
    hand: Hand, path: Path, scan: Scan, terms: Terms, found: Configurations, work: Work, cur: State, new: State,
    u: Array, trial: bool, start: float, cooled: float, first_move: int, moves: int, elapsed: float,
    E: float, best_E: float, best: Codes, energies: Array, offered: Array,
) -> tuple[float, float]:  # fmt: skip
    """len(u) Metropolis moves from cur, whose energy is E: (E, the least E met).

    u (len(u), DRAWS + sample + 1): uniform on [0, 1), the last of each row for the threshold. The moves are first_move … of
    `moves`, at temperatures from `start` down to `cooled` of it (`search.annealing.temperature`). trial: they are made where
    E does not rise, and known where it does; then nothing is drawn for the threshold. best: the V of the least energy, in and
    out; energies: after every move, offered: that it was offered, inf above the threshold, out.
    """
    draws = DRAWS + terms.sample
    for r in range(len(u)):
        make_room(found, work, cur)
        bound = limit = np.inf
        level = E + ROUND * (1.0 + abs(E))
        if not trial:
            done = (first_move + r) / max(moves - 1, 1)
            bound = level - start * math.pow(cooled, max(elapsed, done)) * math.log(1.0 - u[r, draws])
            if work.shortcuts.bound:
                limit = bound
        i, first, final = propose(hand, path, scan, terms, found, work, cur, u[r, :draws], limit, new)
        value, last = np.inf, first
        if i >= 0:
            value, first, last = evaluate(hand, path, scan, terms, found, work, i, first, final, bound, cur, new)
        if value <= (level if trial else bound):
            copy_intervals(new, cur, first, last)
            E = value
            if best_E > E:
                best_E = E
                best[:] = cur.V
        energies[r], offered[r] = E, value
    return E, best_E


@dataclass(frozen=True)
class Change:
    """A proposed V, which differs from the current one in one agent's intervals first … final only."""

    V: Codes
    agent: int
    first: int
    final: int


class ContactMotions:
    """Eq. (1) on one arc as a problem for `search.annealing`: the current V and its State, and the trial beside it."""

    def __init__(
        self,
        hand: Hand,
        path: Path,
        scan: Scan,
        terms: Terms,
        start: Grasp,
        V: Codes,
        shortcuts: Shortcuts | None = None,
    ) -> None:
        n, k = V.shape
        self.current, self.trial = new_state(n, k), new_state(n, k)
        self.work = new_work(hand, path, shortcuts or Shortcuts())
        self.found = new_configurations(hand, path, scan, start)
        self.model = (hand, path, scan, terms, self.found, self.work)
        self.draws = DRAWS + terms.sample
        self.reset(V)

    def reset(self, V: Codes) -> None:
        """Take V as the current state, evaluated from scratch."""
        make_room(self.found, self.work, self.current)
        self.trial.V[:] = V
        self._energy, _, _ = evaluate(*self.model, -1, 0, len(V) - 1, np.inf, self.current, self.trial)
        copy_intervals(self.trial, self.current, 0, len(V))

    def energy(self) -> float:
        """E of the current V."""
        return self._energy

    def unbroken(self) -> int:
        """How many intervals come before the first at whose ends the current V breaks a constraint."""
        broken = (self.current.c > 0.0) | (self.current.e > 0.0)
        return int(np.argmax(broken)) if np.any(broken) else len(broken)

    def breaks_nothing(self) -> bool:
        """Whether the current V breaks no constraint at the ends of its intervals, and its contacts determine the pose."""
        return self.unbroken() == len(self.current.V) and not np.any(self.current.h)

    def propose(self, rng: np.random.Generator) -> Change:
        """A random move (`propose`)."""
        make_room(self.found, self.work, self.current)
        move = propose(*self.model, self.current, rng.random(self.draws), np.inf, self.trial)
        return Change(self.trial.V.copy(), *move)

    def evaluate(self, move: Change, bound: float) -> float:
        """E of the proposed V, or inf as soon as it is known to exceed the bound."""
        make_room(self.found, self.work, self.current)
        self.trial.V[:] = move.V
        self._tried, *self._changed = evaluate(
            *self.model, move.agent, move.first, move.final, bound, self.current, self.trial
        )
        return self._tried

    def accept(self, move: Change) -> None:
        """Make the proposed V the current one."""
        copy_intervals(self.trial, self.current, *self._changed)
        self._energy = self._tried

    def reject(self, move: Change) -> None:
        """Keep the current V: the trial is written anew by the next evaluation."""

    def snapshot(self) -> Codes:
        """The current V."""
        return self.current.V.copy()

    def grasp(self, j: int) -> Grasp:
        """The grasp of configuration j under the current V."""
        return grasp_of(self.model[0], self.model[1], self.found, self.current.at[j], j)

    def trials(self, count: int, rng: np.random.Generator) -> Array:
        """Make those of `count` random moves that don't rise; the rises of the others."""
        energies, offered = np.empty(count), np.empty(count)
        u = rng.random((count, self.draws))
        self._energy, _ = metropolis(
            *self.model, self.current, self.trial, u, True, 0.0, 1.0, 0, count, 0.0, self._energy, -math.inf,
            self.snapshot(), energies, offered,
        )  # fmt: skip
        rises = offered - energies  # 0 where the move was made
        return rises[(rises > 0.0) & (rises < math.inf)]

    def moves(
        self, settings: Settings, start: float, first: int, count: int, elapsed: float,
        best: Codes, best_energy: float, rng: np.random.Generator,
    ) -> tuple[float, Array]:  # fmt: skip
        """Metropolis moves first … first + count − 1 of the schedule: (least energy, energies). best: its V, in and out."""
        energies, offered = np.empty(count), np.empty(count)
        u = rng.random((count, self.draws + 1))
        self._energy, best_energy = metropolis(
            *self.model, self.current, self.trial, u, False, start, settings.final, first, settings.iterations, elapsed,
            self._energy, best_energy, best, energies, offered,
        )  # fmt: skip
        return best_energy, energies


def anneal(
    problem: ContactMotions,
    settings: Settings,
    rng: np.random.Generator,
    stop: Callable[[AnnealingState[Codes]], bool] = lambda _: False,
    elapsed: Callable[[], float] = lambda: 0.0,
) -> Result[Codes]:
    """`search.annealing.anneal` of contact motions, in compiled blocks: `stop` and `elapsed` are asked once a block.

    One block is made however little time there is.
    """
    rises: list[Array] = []
    for done in range(0, settings.trials if settings.acceptance > 0.0 else 0, BLOCK):
        if elapsed() > 0.2:
            break
        rises.append(problem.trials(min(BLOCK, settings.trials - done), rng))
    start = temperature_of(np.concatenate([np.empty(0), *rises]), settings.acceptance)
    best, least = problem.snapshot(), problem.energy()
    history = [np.array([least])]
    done = 0
    while done < settings.iterations and ((passed := elapsed()) < 1.0 or done == 0):
        if stop(AnnealingState(done, start, problem.energy(), least, best)):
            break
        count = min(BLOCK, settings.iterations - done)
        least, energies = problem.moves(settings, start, done, count, passed, best, least, rng)
        history.append(energies)
        done += count
    energies = np.concatenate(history)
    return Result(best, least, start, energies, np.minimum.accumulate(energies))
