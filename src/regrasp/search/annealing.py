"""Simulated annealing (Metropolis 1953, Kirkpatrick 1983) of any problem that can propose and evaluate moves.

`init` measures the start temperature, `step` makes one Metropolis move, `anneal` runs both to the end. At zero
temperature the same code is the downhill search that the paper compares with (§5).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROUND = 1e-9
"""Energies closer than this, relative to 1 + |E|, are equal: sums in another order differ in their last bits."""
Move = TypeVar("Move")
Snapshot = TypeVar("Snapshot")
SnapshotOut = TypeVar("SnapshotOut", covariant=True)


class Problem(Protocol[Move, SnapshotOut]):
    """What is annealed: it holds the current state, and at most one move at a time is under trial."""

    def energy(self) -> float:
        """Energy of the current state."""

    def propose(self, rng: np.random.Generator) -> Move:
        """A random move from the current state, as likely as its reverse."""

    def evaluate(self, move: Move, bound: float) -> float:
        """Energy after the move; it may stop early and return inf once that is known to exceed `bound`."""

    def accept(self, move: Move) -> None:
        """Make the move that was evaluated last."""

    def reject(self, move: Move) -> None:
        """Forget the move that was evaluated last."""

    def snapshot(self) -> SnapshotOut:
        """A copy of the current state that later moves leave alone."""


@dataclass(frozen=True)
class Settings:
    """The schedule: geometric cooling from a measured start temperature.

    `acceptance` is the part of the uphill trial moves that the start temperature accepts (0: downhill search), `final`
    the last temperature over the first (1: constant temperature).
    """

    iterations: int = 4000
    trials: int = 50
    acceptance: float = 0.3
    final: float = 1e-3

    def __post_init__(self) -> None:
        for field, legal, condition in (
            ("iterations", "a whole number ≥ 0", self.iterations >= 0),
            ("trials", "a whole number ≥ 1", self.trials >= 1),
            ("acceptance", "0 ≤ acceptance < 1", 0.0 <= self.acceptance < 1.0),
            ("final", "0 < final ≤ 1", 0.0 < self.final <= 1.0),
        ):
            if not condition:
                raise ValueError(f"{field} is {getattr(self, field)}, legal: {legal}")


@dataclass(frozen=True, slots=True)
class State(Generic[Snapshot]):
    """Where a run stands: `best` is the snapshot of the state of the least energy met so far."""

    iteration: int
    start_temperature: float
    energy: float
    best_energy: float
    best: Snapshot


@dataclass(frozen=True, slots=True)
class Info:
    """What one step did: the Metropolis threshold it drew and the energy it was offered (inf above the threshold)."""

    temperature: float
    bound: float
    proposed: float
    accepted: bool


@dataclass(frozen=True)
class Result(Generic[Snapshot]):
    """The best state, and current and best energy after every iteration (entry 0: before the first)."""

    best: Snapshot
    best_energy: float
    start_temperature: float
    energies: Array
    best_energies: Array


def temperature_of(uphill: Array, acceptance: float) -> float:
    """T with mean(exp(-Δ/T)) = acceptance over the energy rises Δ > 0 of trial moves (Ben-Ameur 2004); 0 without any.

    White 1984 takes the scale of T from the spread of Δ; solving for the ratio itself also holds for skewed rises.
    """
    if uphill.size == 0 or acceptance == 0.0:
        return 0.0
    # In log T: below the lower end even the least rise is accepted too seldom, above the upper one Jensen's inequality
    # says that the mean is accepted too often.
    low = math.log(float(uphill.min()) / -math.log(acceptance))
    high = math.log(float(uphill.mean()) / -math.log(acceptance))
    for _ in range(60):
        middle = 0.5 * (low + high)
        if np.exp(-uphill / math.exp(middle)).mean() < acceptance:
            low = middle
        else:
            high = middle
    return math.exp(high)


def level(energy: float) -> float:
    """What counts as not above this energy."""
    return energy + ROUND * (1.0 + abs(energy))


def init(
    problem: Problem[Move, Snapshot],
    settings: Settings,
    rng: np.random.Generator,
    elapsed: Callable[[], float] = lambda: 0.0,
) -> State[Snapshot]:
    """Measure the start temperature by trial moves.

    The trials are a downhill search: rises are measured and undone, so a good start is kept and a bad one is left
    before its surroundings count. A downhill search measures nothing and starts from where it is. Of a limited time,
    whose passed part `elapsed` tells, the trials take a fifth at most.
    """
    energy = problem.energy()
    uphill: list[float] = []
    for _ in range(settings.trials if settings.acceptance > 0.0 else 0):
        if elapsed() > 0.2:
            break
        move = problem.propose(rng)
        proposed = problem.evaluate(move, math.inf)
        if proposed <= level(energy):
            problem.accept(move)
            energy = proposed
        else:
            problem.reject(move)
            if proposed < math.inf:
                uphill.append(proposed - energy)
    start = temperature_of(np.array(uphill), settings.acceptance)
    return State(0, start, energy, energy, problem.snapshot())


def temperature(settings: Settings, start: float, iteration: int, elapsed: float = 0.0) -> float:
    """T = start · final^(iteration / (iterations - 1)): the last iteration is at final · start.

    Where the part `elapsed` of a limited time is ahead of the iterations, it takes their place: a run that is cut short
    by the clock is cold at its end.
    """
    return start * math.pow(settings.final, max(elapsed, iteration / max(settings.iterations - 1, 1)))


def step(
    problem: Problem[Move, Snapshot],
    state: State[Snapshot],
    settings: Settings,
    rng: np.random.Generator,
    elapsed: float = 0.0,
) -> tuple[State[Snapshot], Info]:
    """One Metropolis move: accepted with probability min(1, exp(-ΔE / T)).

    The threshold is drawn first, as E - T ln u (E up to ROUND): a move is accepted when its energy does not exceed it, so its
    evaluation may stop as soon as it does, and the chain is the same.
    """
    T = temperature(settings, state.start_temperature, state.iteration, elapsed)
    move = problem.propose(rng)
    bound = level(state.energy) - T * math.log(1.0 - rng.random())
    proposed = problem.evaluate(move, bound)
    accepted = proposed <= bound
    energy, best_energy, best = state.energy, state.best_energy, state.best
    if accepted:
        problem.accept(move)
        energy = proposed
        if energy < best_energy:
            best_energy, best = energy, problem.snapshot()
    else:
        problem.reject(move)
    after = State(state.iteration + 1, state.start_temperature, energy, best_energy, best)
    return after, Info(T, bound, proposed, accepted)


def anneal(
    problem: Problem[Move, Snapshot],
    settings: Settings,
    rng: np.random.Generator,
    stop: Callable[[State[Snapshot]], bool] = lambda _: False,
    elapsed: Callable[[], float] = lambda: 0.0,
) -> Result[Snapshot]:
    """Anneal for `settings.iterations` iterations, or until `stop`, asked before each, says so.

    `elapsed` tells which part of a time limit has passed: the run cools by it where it is ahead of the iterations, and
    ends at 1.
    """
    state = init(problem, settings, rng, elapsed)
    energies, best_energies = [state.energy], [state.best_energy]
    while state.iteration < settings.iterations and not stop(state) and (passed := elapsed()) < 1.0:
        state, _ = step(problem, state, settings, rng, passed)
        energies.append(state.energy)
        best_energies.append(state.best_energy)
    return Result(state.best, state.best_energy, state.start_temperature, np.array(energies), np.array(best_energies))
