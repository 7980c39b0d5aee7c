"""What a second thread gives: two chains side by side, against the same two one after the other.

Both make the same moves from the same V. A processor that somebody else is using may take twice as long for them, and which
one that is changes within seconds: side by side each thread is timed by itself, and what both do in a second is added up.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from numba import njit

from benchmarks.jobs import problem_of, start_of
from benchmarks.measure import Row, compared, seconds_of
from regrasp.bench.searches import Job
from regrasp.planner.chain import ContactMotions
from regrasp.planner.terms import Shortcuts
from regrasp.search.annealing import Settings as Annealing

SINES, SUMS = 5_000_000, 50_000_000


@njit(nogil=True)
def sines(count: int) -> float:
    """Arithmetic alone, each step waiting for the one before: how many processors there are to be had."""
    x = 0.0
    for i in range(count):
        x += math.sin(x + i)
    return x


@njit(nogil=True)
def sums(count: int) -> float:
    """Four sums that don't wait for each other: how much of a processor's units there is to be had.

    Two virtual processors may be one core's two threads, or share a core with somebody else's.
    """
    a, b, c, d = 1.0, 1.1, 1.2, 1.3
    for _ in range(count):
        a, b, c, d = a * 0.999 + 0.1, b * 0.998 + 0.2, c * 0.997 + 0.3, d * 0.996 + 0.4
    return a + b + c + d


def both(pool: ThreadPoolExecutor, work: Callable[[int], None], count: int) -> tuple[float, float]:
    """Pieces 0 and 1 of the work, of `count` steps each: steps per second (side by side, one after the other)."""

    def timed(piece: int) -> float:
        return seconds_of(partial(work, piece))

    together = list(pool.map(timed, (0, 1)))
    alone = [pool.submit(timed, piece).result() for piece in (0, 1)]
    return sum(count / seconds for seconds in together), 2 * count / sum(alone)


def rows(work: Job, moves: int, repeats: int) -> list[Row]:
    """Moves per second, and sines and sums, which share nothing, measured in turn with them."""
    even = Annealing(iterations=moves, final=1.0)
    V = start_of(work, 0)
    problems: list[ContactMotions] = []

    def chain(c: int) -> None:
        problems[c].reset(V)
        problems[c].moves(even, 0.5, 0, moves, 0.0, V.copy(), problems[c].energy(), np.random.default_rng(0))

    def waiting(_: int) -> None:
        sines(SINES)

    def busy(_: int) -> None:
        sums(SUMS)

    kinds: dict[str, tuple[Callable[[int], None], int, str]] = {
        "moves, two threads": (chain, moves, ""),
        "sines, which share nothing, two threads": (waiting, SINES, "what the machine gives at the time"),
        "sums, which share nothing, two threads": (busy, SUMS, "of its units, too"),
    }
    rates: dict[str, list[tuple[float, float]]] = {name: [] for name in kinds}
    with ThreadPoolExecutor(2) as pool:
        # Each makes its own, as in planning: small arrays of one thread come from the same lines of memory.
        problems += pool.map(lambda _: problem_of(work, V, Shortcuts()), range(2))
        for repeat in range(repeats + 1):
            for name, (each, count, _) in kinds.items():
                rate = both(pool, each, count)
                if repeat:  # the first fills the memories
                    rates[name].append(rate)
    found = []
    for name, (_, _, note) in kinds.items():
        two_threads, one_thread = zip(*rates[name], strict=True)
        found.append(compared("threads, reference: one thread", name, two_threads, one_thread, "1/s", note=note))
    return found
