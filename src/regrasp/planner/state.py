"""One matrix V as a way through the agents' configurations, and what each of its intervals adds to Eq. (1)."""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import kernel
from regrasp.kernels.records import Record

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.uint8]
Codes = NDArray[np.int16]


class State(Record):
    """n intervals, k agents.

    V (n, k): contact motions; at (n + 1, k): the agents' configurations (`Configurations`); behind (n, k): had to stay behind
    where it should have relocated; way (n, k): how a free motion goes, −1 nowhere; touch (n, k, k): pairs of agents that
    collide at the interval's end, upper triangle; c, e, f, h (n,): the interval's share of Eq. (1).
    """

    V: Codes
    at: Ints
    behind: Flags
    way: NDArray[np.int8]
    touch: Flags
    c: Array
    e: Array
    f: Array
    h: Array


def new_state(n: int, k: int) -> State:
    """A State of n intervals and k agents at the start configurations, to be evaluated."""
    at = np.zeros((n + 1, k), np.int64)
    at[0] = 1 + np.arange(k)
    return State(
        np.zeros((n, k), np.int16), at, np.zeros((n, k), np.uint8), np.zeros((n, k), np.int8),
        np.zeros((n, k, k), np.uint8), *(np.zeros(n) for _ in range(4)),
    )  # fmt: skip


@kernel
def copy_intervals(source: State, target: State, first: int, last: int) -> None:
    """Copy the intervals first … last − 1 and the configurations at their ends."""
    k = source.V.shape[1]
    for j in range(first, last):
        for a in range(k):
            target.V[j, a] = source.V[j, a]
            target.at[j + 1, a] = source.at[j + 1, a]
            target.behind[j, a] = source.behind[j, a]
            target.way[j, a] = source.way[j, a]
            for b in range(a + 1, k):
                target.touch[j, a, b] = source.touch[j, a, b]
        target.c[j], target.e[j], target.f[j], target.h[j] = source.c[j], source.e[j], source.f[j], source.h[j]
