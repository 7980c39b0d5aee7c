"""Eq. (1): E(V) = K_c Σ_j c_j + K_e Σ_j e_j + K_f Σ_ij |f_ij| + K_g Σ_i g_i + K_h Σ_j h_j, evaluated term by term.

The paper's, and with K_h what the contacts that stick leave of the object's pose undetermined.

Every term only adds, so the cheapest come first: changes, contacts that stick, the agents' ways through their
configurations, the force programs, collisions, the free motions.
"""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import kernel
from regrasp.planner.configurations import Configurations, keep_only, onward, own_hits
from regrasp.planner.hand import Hand
from regrasp.planner.memory import forget
from regrasp.planner.motions import RELOCATE, whole
from regrasp.planner.path import Path
from regrasp.planner.scan import Scan
from regrasp.planner.state import State
from regrasp.planner.terms import (
    Terms,
    Work,
    changes,
    collide,
    force_terms,
    interval_energy,
    least_energy,
    loose,
    moves_freely,
    way_of,
)

Array = NDArray[np.float64]

ROOM = 64  # configurations that one proposal looks at, at most


@kernel
def walk(
    hand: Hand, path: Path, scan: Scan, terms: Terms, found: Configurations, work: Work, i: int, first: int, final: int,
    merge: bool, cur: State, new: State, room: float,
) -> tuple[int, float]:  # fmt: skip
    """Agent i's configurations under new.V from interval `first` on: (interval after the last that differs, least increase).

    With `merge`, where the others are where they were, the walk ends where it meets the current one after interval `final`,
    and what is known by then is added up: agents that are lost and, up to `final`, contacts that don't stick. It also ends
    where that exceeds `room`.
    """
    n, k = new.V.shape
    least = 0.0
    known = work.shortcuts.memory == 1
    here = new.at[first, i]
    for j in range(first, n):
        if merge:
            for a in range(k):
                if a != i:
                    new.V[j, a], new.at[j, a] = cur.V[j, a], cur.at[j, a]
            least += terms.stability * loose(hand, path, found, new, j, whole(-1))
            if least > room:
                return j, least
        used = found.used[0]
        here, behind = onward(
            hand, path, scan, terms.commands, terms.clearance, found, j, i, here, whole(new.V[j, i]), known
        )
        work.counts.configurations[0] += found.used[0] - used
        new.at[j + 1, i] = here
        new.behind[j, i] = behind
        if behind or (new.V[j, i] < RELOCATE and found.lost[here]):
            least += terms.collision
            if least > room:
                return j + 1, least
        if merge and j >= final and here == cur.at[j + 1, i]:
            return j + 1, least
    return n, least


@kernel
def evaluate(
    hand: Hand, path: Path, scan: Scan, terms: Terms, found: Configurations, work: Work, i: int, first: int, final: int,
    bound: float, cur: State, new: State,
) -> tuple[float, int, int]:  # fmt: skip
    """E(new.V), which differs from cur.V in agent i's intervals first … final only; i = −1: cur holds nothing.

    Returns (E, first, last): E is inf if it exceeds the bound; intervals first … last − 1 of `new` differ from `cur`, and only
    they are written.
    """
    n, k = new.V.shape
    if work.shortcuts.changed == 0:
        i = whole(-1)
    if i < 0:
        first, final = whole(0), n - 1
    else:
        while first <= final and new.V[first, i] == cur.V[first, i]:
            first += 1
        while first < final and new.V[final, i] == cur.V[final, i]:
            final -= 1
    limit = np.inf
    if work.shortcuts.bound:
        limit = bound + 1e-9 * (1.0 + abs(bound))  # partial sums are added up in another order
    least = terms.change * changes(new.V)
    for j in range(n):
        least += interval_energy(terms, cur, j) if j < first else least_energy(terms, work, j)
    if least > limit:
        return np.inf, first, first
    last = first
    if first <= final:
        for a in range(k):
            new.at[first, a] = cur.at[first, a]
        for a in range(k):
            if i < 0 or a == i:
                end, more = walk(hand, path, scan, terms, found, work, a, first, final, i >= 0, cur, new, limit - least)
                last = max(last, end)
                least += more
                if least > limit:
                    return np.inf, first, last
    for j in range(last, n):
        least += interval_energy(terms, cur, j) - least_energy(terms, work, j)
    for j in range(first, last):
        movers, own = 0, 0
        for a in range(k):
            if i >= 0 and a != i:
                new.V[j, a] = cur.V[j, a]
                new.at[j + 1, a] = cur.at[j + 1, a]
                new.behind[j, a] = cur.behind[j, a]
                if new.behind[j, a] or (new.V[j, a] < RELOCATE and found.lost[new.at[j + 1, a]]):
                    own += 1
                own += found.own[new.at[j + 1, a]]
                for b in range(a + 1, k):
                    if b != i:
                        new.touch[j, a, b] = cur.touch[j, a, b]
                        own += new.touch[j, a, b]
            if moves_freely(new.V[j, a], found.holds[new.at[j, a]]) and not new.behind[j, a]:
                movers += 1
        new.h[j] = loose(hand, path, found, new, j, whole(-1))
        new.c[j] = max(0, movers - 1)  # one free motion at a time
        if i < 0:
            least += terms.stability * new.h[j]
        least += terms.collision * (new.c[j] + own)
    if least > limit:
        return np.inf, first, last
    for j in range(first, last):
        force_terms(hand, path, terms, found, work, new, j)
        least += terms.equilibrium * new.e[j] + terms.force * new.f[j] - least_energy(terms, work, j)
        if least > limit:
            return np.inf, first, last
    for j in range(first, last):
        for a in range(k):
            if i < 0 or a == i:
                least += terms.collision * own_hits(hand, path, found, j + 1, a, new.at[j + 1, a], terms.clearance)
                if least > limit:
                    return np.inf, first, last
    for j in range(first, last):
        for a in range(k):
            for b in range(a + 1, k):
                if i < 0 or a == i or b == i:
                    x, y = new.at[j + 1, a], new.at[j + 1, b]
                    new.touch[j, a, b] = 1 if collide(hand, terms, found, work, a, b, x, y) else 0
                    least += terms.collision * new.touch[j, a, b]
        if least > limit:
            return np.inf, first, last
    for j in range(first, last):
        for a in range(k):
            new.way[j, a] = 0
            if moves_freely(new.V[j, a], found.holds[new.at[j, a]]) and not new.behind[j, a]:
                if i >= 0 and a != i and new.at[j, i] == cur.at[j, i] and new.at[j + 1, i] == cur.at[j + 1, i]:
                    new.way[j, a] = cur.way[j, a]
                else:
                    new.way[j, a] = way_of(hand, path, terms, found, work, new, j, a)
                if new.way[j, a] < 0:
                    least += terms.collision
                    if least > limit:
                        return np.inf, first, last
    for j in range(first, last):
        for a in range(k):
            here = new.at[j + 1, a]
            if new.behind[j, a] or (new.V[j, a] < RELOCATE and found.lost[here]):
                new.c[j] += 1
            new.c[j] += found.own[here]
            if new.way[j, a] < 0:
                new.c[j] += 1
            for b in range(a + 1, k):
                new.c[j] += new.touch[j, a, b]
    E = terms.change * changes(new.V)
    for j in range(n):
        E += interval_energy(terms, new if first <= j < last else cur, j)
    return (E, first, last) if bound >= E else (np.inf, first, last)


@kernel
def make_room(found: Configurations, work: Work, cur: State) -> None:
    """Before an evaluation that could run out of configurations: forget all but those of the current state."""
    n, k = cur.V.shape
    if found.used[0] + (k + 1) * (n + 1) + ROOM < len(found.q):
        return
    keep_only(found, cur.at)
    forget(work.pairs)
    forget(work.sums)
    forget(work.ways)
