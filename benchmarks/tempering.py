"""Parallel tempering against several starts, which is what is built in (`LocalPlanner.attempts`), at equal cost."""

import dataclasses
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.jobs import problem_of, start_of
from benchmarks.measure import Row, compared
from regrasp.bench.searches import Job
from regrasp.planner.chain import ContactMotions
from regrasp.planner.motion import detail
from regrasp.planner.terms import Shortcuts
from regrasp.search.annealing import Settings as Annealing
from regrasp.search.annealing import temperature_of

STARTS = 3
"""Annealing runs one after the other: the planner's default."""
REPLICAS = 6
COLDEST = 1e-2
"""Of the hottest replica's temperature. Annealing ends at 1e-3 of it, where nothing moves; no replica must freeze."""
BLOCK = 50
"""Moves between two looks at a chain, and between two swaps."""


@dataclass(frozen=True)
class Search:
    """One search: times and least energies after every block, s to the first V without violations (inf: none), the motion's."""

    times: list[float]
    energies: list[float]
    first: float
    feasible: bool

    def energy_at(self, seconds: float) -> float:
        """The least energy found by then, or at the first look."""
        return min(
            (E for t, E in zip(self.times, self.energies, strict=True) if t <= seconds), default=self.energies[0]
        )


def measured_temperature(problem: ContactMotions, annealing: Annealing, rng: np.random.Generator) -> float:
    """The start temperature of annealing, by its trial moves."""
    return temperature_of(problem.trials(annealing.trials, rng), annealing.acceptance)


def starts(work: Job, annealing: Annealing, seed: int) -> Iterator[tuple[ContactMotions, np.ndarray, float]]:
    """STARTS annealing runs: (the chain, its best V, the least energy) after every block."""
    for run, rng in enumerate(np.random.default_rng(seed).spawn(STARTS)):
        problem = problem_of(work, start_of(work, STARTS * seed + run), Shortcuts())
        hot = measured_temperature(problem, annealing, rng)
        best, least = problem.snapshot(), problem.energy()
        for done in range(0, annealing.iterations, BLOCK):
            least, _ = problem.moves(annealing, hot, done, BLOCK, 0.0, best, least, rng)
            yield problem, best, least


def tempered(work: Job, annealing: Annealing, seed: int) -> Iterator[tuple[ContactMotions, np.ndarray, float]]:
    """REPLICAS chains with as many moves in all, neighbours in temperature swapped by the rule of Swendsen and Wang (1986)."""
    rng = np.random.default_rng(seed)
    first = REPLICAS * seed
    problems = [problem_of(work, start_of(work, first + r), Shortcuts()) for r in range(REPLICAS)]
    share = dataclasses.replace(annealing, trials=STARTS * annealing.trials // REPLICAS)
    hot = float(np.median([measured_temperature(problem, share, rng) for problem in problems]))
    T = hot * COLDEST ** (np.arange(REPLICAS) / (REPLICAS - 1))
    best = [problem.snapshot() for problem in problems]
    least = [problem.energy() for problem in problems]
    even = dataclasses.replace(annealing, final=1.0)
    at = list(range(REPLICAS))  # which chain each temperature has
    for round_ in range(STARTS * annealing.iterations // (REPLICAS * BLOCK)):
        for level, r in enumerate(at):
            least[r], _ = problems[r].moves(even, T[level], 0, BLOCK, 0.0, best[r], least[r], rng)
            yield problems[r], best[r], least[r]
        for level in range(round_ % 2, REPLICAS - 1, 2):
            a, b = at[level], at[level + 1]
            rise = (1.0 / T[level] - 1.0 / T[level + 1]) * (problems[b].energy() - problems[a].energy())
            if rise <= 0.0 or rng.random() < math.exp(-rise):
                at[level], at[level + 1] = b, a


def searched(work: Job, annealing: Annealing, seed: int, tempering: bool) -> Search:
    """Run one of both to its end."""
    times, energies, first = [], [], math.inf
    champion: tuple[float, np.ndarray, ContactMotions] | None = None
    started = time.perf_counter()
    for problem, best, least in (tempered if tempering else starts)(work, annealing, seed):
        state = problem.current
        if first == math.inf and not np.any(state.c) and not np.any(state.e):
            first = time.perf_counter() - started
        if champion is None or least < champion[0]:
            champion = least, best.copy(), problem
        times.append(time.perf_counter() - started)
        energies.append(champion[0])
    assert champion is not None
    _, V, problem = champion
    problem.reset(V)
    hand, path, _, terms, found, chain = problem.model
    motion = detail(hand, path, terms, found, problem.current, chain, work.task.names)
    return Search(times, energies, first, not motion.violations)


def rows(jobs: dict[str, Job], seeds: int, iterations: int) -> list[Row]:
    """Both on the first arcs of scenes; the reference is several starts."""
    annealing = Annealing(iterations=iterations)
    found = []
    for name, work in jobs.items():
        group = "parallel tempering, reference: several starts"
        pairs = [tuple(searched(work, annealing, seed, kind) for kind in (True, False)) for seed in range(seeds)]
        ours, plain = [a for a, _ in pairs], [b for _, b in pairs]
        equal = [min(a.times[-1], b.times[-1]) for a, b in pairs]
        half = STARTS * iterations // 2
        firsts = [np.median([each.first for each in side]) for side in (ours, plain)]
        good = [sum(each.feasible for each in side) for side in (ours, plain)]
        missed = [sum(each.first == math.inf for each in side) for side in (ours, plain)]
        at_end, early = (
            ([a.energy_at(part * t) for a, t in zip(ours, equal, strict=True)],
             [b.energy_at(part * t) for b, t in zip(plain, equal, strict=True)])
            for part in (1.0, 0.5)
        )  # fmt: skip
        found += [
            Row(group, f"{name}: time to the first feasible V", float(firsts[0]), "s", 0.0, seeds, float(firsts[1]),
                float(firsts[1] / firsts[0]), note=f"never in {missed[0]} and {missed[1]} of {seeds}"),
            compared(group, f"{name}: energy at equal time", *at_end, unit="",
                     note=f"feasible motions {good[0]} and {good[1]} of {seeds}"),
            compared(group, f"{name}: energy at half of it", *early, unit="", note=f"about {half} moves"),
            compared(group, f"{name}: time for the same moves", [a.times[-1] for a in ours], [b.times[-1] for b in plain]),
        ]  # fmt: skip
    return found
