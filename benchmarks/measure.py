"""Times as medians of repeats with their spread, and the rows that a run is made of."""

import dataclasses
import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

SHORTEST = 2e-2
"""s: one repeat of a kernel lasts at least as long, so that the clock and a switch of threads don't count."""


@dataclass(frozen=True)
class Row:
    """One line of the table: `value` in `unit`, median of `repeats`, beside the reference's for the same work.

    ratio: how many times better than the reference, measured pair by pair within the run; None without a reference. spread:
    half the interquartile range over the median, of the ratio where there is one, else of the value. x: where on its axis a
    row of a scaling stands. note: what else is to be known.
    """

    group: str
    name: str
    value: float
    unit: str
    spread: float
    repeats: int
    reference: float | None = None
    ratio: float | None = None
    x: float | None = None
    note: str = ""

    def as_dict(self) -> dict[str, Any]:
        """As it is saved."""
        return dataclasses.asdict(self)


def spread_of(values: Sequence[float]) -> float:
    """Half the interquartile range over the median; 0 for fewer than three values."""
    if len(values) < 3:
        return 0.0
    low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
    return 0.5 * (high - low) / abs(middle) if middle else 0.0


def seconds_of(work: Callable[[], Any]) -> float:
    """s that one call takes."""
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def row(group: str, name: str, values: Sequence[float], unit: str, **more: Any) -> Row:
    """A row without a reference."""
    return Row(group, name, statistics.median(values), unit, spread_of(values), len(values), **more)


def compared(
    group: str, name: str, ours: Sequence[float], reference: Sequence[float], unit: str = "s", **more: Any
) -> Row:  # fmt: skip
    """A row from times of the two sides of the same work, pair by pair; more per second is better where the unit is a rate."""
    ratios = [a / b if unit == "1/s" else b / a for a, b in zip(ours, reference, strict=True)]
    return Row(
        group, name, statistics.median(ours), unit, spread_of(ratios), len(ours), statistics.median(reference),
        statistics.median(ratios), **more,
    )  # fmt: skip


def counted(loop: Callable[[int], Any]) -> Callable[[], float]:
    """s per pass of `loop(count)`, which makes `count` passes: called once to warm up, then as often as SHORTEST asks for."""
    loop(1)
    count = 1
    while (seconds := seconds_of(partial(loop, count))) < SHORTEST:
        count = min(8 * count, math.ceil(1.5 * count * SHORTEST / max(seconds, 1e-9)))
    return lambda: seconds_of(partial(loop, count)) / count


def versus(
    group: str, name: str, ours: Callable[[int], Any], reference: Callable[[int], Any], repeats: int, note: str = ""
) -> Row:  # fmt: skip
    """A kernel against its reference, per call, turn and turn about: what slows one pair slows both."""
    first, second = counted(ours), counted(reference)
    pairs = [(first(), second()) for _ in range(repeats)]
    return compared(group, name, [a for a, _ in pairs], [b for _, b in pairs], note=note)


def exponent(x: Sequence[float], y: Sequence[float]) -> float:
    """Slope of the least-squares line through (log x, log y): 1 where y grows linearly with x."""
    u, v = [math.log(each) for each in x], [math.log(each) for each in y]
    return statistics.linear_regression(u, v).slope
