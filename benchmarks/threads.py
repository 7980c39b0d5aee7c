"""What a second thread gives: two chains side by side, against the same two one after the other."""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from numba import njit

from benchmarks.jobs import problem_of, start_of
from benchmarks.measure import Row, compared, seconds_of
from regrasp.bench.searches import Job
from regrasp.planner.terms import Shortcuts
from regrasp.search.annealing import Settings as Annealing

SINES = 5_000_000


@njit(nogil=True)
def sines(count: int) -> float:
    """Arithmetic alone, without memory: how many processors there are to be had."""
    x = 0.0
    for i in range(count):
        x += math.sin(x + i)
    return x


def both(pool: ThreadPoolExecutor, work: Callable[[int], None]) -> None:
    """Pieces 0 and 1 of the work side by side."""
    list(pool.map(work, (0, 1)))


def rows(work: Job, moves: int, repeats: int) -> list[Row]:
    """Moves per second, and sines, which share nothing, measured in turn with them."""
    even = Annealing(iterations=moves, final=1.0)
    V = [start_of(work, seed) for seed in range(2)]
    problems = [problem_of(work, each, Shortcuts()) for each in V]

    def chain(c: int) -> None:
        problems[c].reset(V[c])
        problems[c].moves(even, 0.5, 0, moves, 0.0, V[c].copy(), problems[c].energy(), np.random.default_rng(0))

    def spin(_: int) -> None:
        sines(SINES)

    kinds: dict[str, tuple[Callable[[int], None], int, str]] = {
        "moves, two threads": (chain, moves, ""),
        "sines, which share nothing, two threads": (spin, SINES, "what the machine gives at the time"),
    }
    rates: dict[str, list[tuple[float, float]]] = {name: [] for name in kinds}
    with ThreadPoolExecutor(2) as pool:
        for repeat in range(repeats + 1):
            for name, (each, count, _) in kinds.items():
                two = seconds_of(partial(both, pool, each))
                one = seconds_of(partial(each, 0)) + seconds_of(partial(each, 1))
                if repeat:  # the first fills the memories
                    rates[name].append((2 * count / two, 2 * count / one))
    found = []
    for name, (_, _, note) in kinds.items():
        two_threads, one_thread = zip(*rates[name], strict=True)
        found.append(compared("threads, reference: one thread", name, two_threads, one_thread, "1/s", note=note))
    return found
