"""The old matrix V as the start of a new search: what of it is still to come, in other intervals of time."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from regrasp.plan import OFF, RELOCATE, STAY, Plan

Codes = NDArray[np.int8]


def coming(plan: Plan, j: int, last: int) -> Codes:
    """The rows of V from interval j to the end of segment `last`, without the hand-overs, in which nothing moves."""
    rows = np.arange(len(plan.V))
    moves = np.any(plan.joints != plan.joints[:, :1], axis=(1, 2))
    moves |= np.any(plan.object_position != plan.object_position[:, :1], axis=(1, 2))
    moves |= np.any(plan.object_quaternion != plan.object_quaternion[:, :1], axis=(1, 2))
    return plan.V[moves & (rows >= j) & (plan.segment <= last)].copy()


def with_touching(V: Codes, touching: NDArray[np.bool_]) -> Codes:
    """V (r, k) for agents of which other ones touch the object now than V thinks.

    Who should bear and has lost the contact relocates, one after the other, in rows put before. Who should be off or on its
    way and touches already does what comes after its relocation.
    """
    r, k = V.shape
    out, lost = V.copy(), []
    for i in range(k):
        if r == 0:
            continue
        if touching[i] and V[0, i] == RELOCATE:
            out[0, i] = V[1, i] if r > 1 and V[1, i] != RELOCATE else STAY
        elif not touching[i] and V[0, i] < RELOCATE:
            lost.append(i)
    before = np.repeat(np.where(out[:1] == RELOCATE, OFF, out[:1]), len(lost), axis=0)
    before[np.arange(len(lost)), lost] = RELOCATE
    return np.concatenate([before, out])


def resampled(V: Codes, n: int) -> Codes:
    """V (r, k), r ≥ 1, in n intervals: every agent's motions in their order, every relocation once.

    A motion gets the part of the intervals that it had; short ones may vanish. Relocations keep their order among all agents
    and stand in intervals of their own, as long as there are n for them; the last ones fall away where there are not.
    """
    r, k = V.shape
    old, agent = np.nonzero(V == RELOCATE)
    count = min(len(old), n)
    V = V.copy()
    V[old[count:], agent[count:]] = STAY
    place = np.floor((old[:count] + 0.5) * n / r).astype(np.int64)
    step = np.arange(count)
    place = np.maximum.accumulate(place - step) + step  # apart, later ones later, …
    place = np.minimum(place, n - count + step)  # … and none behind the end
    out = np.empty((n, k), np.int8)
    source = np.floor((np.arange(n) + 0.5) * r / n).astype(np.int64)
    for i in range(k):
        mine = np.flatnonzero(agent[:count] == i)
        was = [-1, *old[:count][mine], r]
        now = [-1, *place[mine], n]
        for (a, b), (first, end) in zip(pairwise(was), pairwise(now), strict=True):
            # What stands between two relocations stays between them.
            run = V[a + 1 : b, i]
            rows = slice(first + 1, end)
            out[rows, i] = run[np.clip(source[rows] - a - 1, 0, len(run) - 1)] if len(run) else STAY
        out[place[mine], i] = RELOCATE
    return out
