"""Relocation (paper §3): of a sample of the scan's candidates the one from which the least forces hold the object.

The paper scans all candidates whenever it evaluates a relocation. Deviation: the scan is made when a relocation is proposed,
over a random part of the candidates, and V says which one was taken. So an agent's way depends on its own motions only, the
scan costs as much as it is worth, and annealing weighs the choice by what it does to the rest of the arc.
"""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import kernel
from regrasp.planner.configurations import Configurations, standing
from regrasp.planner.hand import Hand
from regrasp.planner.motions import RELOCATE, STAY, whole
from regrasp.planner.path import Path
from regrasp.planner.scan import Scan, outlook_of
from regrasp.planner.state import State
from regrasp.planner.terms import Terms, Work, interval_energy, least_energy, loose, sum_of_forces

Array = NDArray[np.float64]

SAME = 1e-9  # weights by which objectives differ that are equal but for their last bits: a point stands twice
NEIGHBOURS = 4  # candidates after one that is barred that are asked in its stead


@kernel
def with_indispensable(
    hand: Hand, path: Path, terms: Terms, found: Configurations, work: Work, j: int, value: float, bound: float
) -> float:
    """A value, and `outlook` times the part of the agents that bear without any one of which the others don't hold the
    object at the end of interval j; inf as soon as it is known not to be below the bound.

    Who bears and how is in `work`, as for `sum_of_forces`.
    """
    count, lost, total = 0, 0, value
    for a in range(len(work.bears)):
        count += work.bears[a]
    for a in range(len(work.bears)):
        if work.bears[a]:
            work.bears[a] = 0
            lost += sum_of_forces(hand, path, terms, found, work, j, whole(1)) == np.inf
            work.bears[a] = 1
            total = value + terms.outlook * (lost / count)
            if total >= bound:
                return np.inf
    return total


@kernel
def others_bear(found: Configurations, work: Work, state: State, j: int, i: int) -> None:
    """Tell `sum_of_forces` that all agents but i do in interval j what the state says, and i bears no force."""
    for a in range(len(work.bears)):
        work.codes[a] = state.V[j, a]
        work.here[a], work.there[a] = state.at[j, a], state.at[j + 1, a]
        work.bears[a] = 1 if a != i and state.V[j, a] < RELOCATE and found.holds[state.at[j, a]] else 0


@kernel
def hopeless(
    hand: Hand, path: Path, terms: Terms, found: Configurations, work: Work, state: State, first: int, j: int, i: int,
    bound: float,
) -> bool:  # fmt: skip
    """Whether E exceeds the bound wherever agent i goes in interval j: what the others can't hold alone is known before.

    first: the first interval that the relocation changes.
    """
    if bound == np.inf:
        return False
    limit, least = bound + 1e-9 * (1.0 + abs(bound)), 0.0
    for other in range(len(state.V)):
        least += interval_energy(terms, state, other) if other < first else least_energy(terms, work, other)
    least += terms.stability * loose(hand, path, found, state, j, i)
    if least > limit:
        return True
    others_bear(found, work, state, j, i)
    for end in range(2):
        if sum_of_forces(hand, path, terms, found, work, j, whole(end)) == np.inf:
            return bool(least + terms.equilibrium - least_energy(terms, work, j) > limit)
    return False


@kernel
def objective(
    hand: Hand, path: Path, scan: Scan, terms: Terms, found: Configurations, work: Work, state: State, j: int, i: int,
    candidate: int, there: int, bound: float,
) -> float:  # fmt: skip
    """The paper's objective of a candidate, on which agent i stands in configuration `there` at the end of interval j.

    It is the sum of the contact forces as if the agent stood there, the others as they are; inf where the object isn't held,
    or as soon as it is known not to be below the bound.
    Deviation: to it are added, times `outlook`, the part of the coming way on which the contact can't be kept, and the part of
    the agents that could not be relocated from there; a contact that is about to leave the agent's reach would have to be
    relocated again at once, and others wait for their turn.
    """
    kept = scan.kept[scan.row[i, j + 1, candidate]]
    if kept >= 0.0 and work.floor[j] + terms.outlook * (1.0 - kept) >= bound:
        return np.inf
    others_bear(found, work, state, j, i)
    work.codes[i], work.there[i], work.bears[i] = STAY, there, 1
    value = sum_of_forces(hand, path, terms, found, work, j, whole(1))
    if value >= bound:
        return np.inf
    value += terms.outlook * (
        1.0 - outlook_of(hand, path, scan, found.R_WB, found.p_WB, j + 1, i, candidate, terms.clearance, terms.commands)
    )
    if value >= bound:
        return np.inf
    return with_indispensable(hand, path, terms, found, work, j, value, bound)


@kernel
def choose(
    hand: Hand, path: Path, scan: Scan, terms: Terms, found: Configurations, work: Work, state: State, j: int, i: int,
    u: Array,
) -> int:  # fmt: skip
    """The best of len(u) random candidates for agent i at the end of interval j. u: uniform on [0, 1).

    Where the object isn't held from any of them, the first on which the agent can stand, or any.
    """
    count = len(scan.p_O)
    best, least = whole(u[0] * count), np.inf
    stands = False
    for s in range(len(u)):
        c = whole(u[s] * count)
        there = whole(0)
        for _ in range(NEIGHBOURS):
            there = standing(hand, path, scan, found, j + 1, i, c, terms.clearance)
            if there > 0:
                break
            c = c + 1 if c + 1 < count else whole(0)
        if there == 0:
            continue
        if not stands:
            best, stands = c, True
        value = objective(hand, path, scan, terms, found, work, state, j, i, c, there, least)
        if value < least - SAME:
            best, least = c, value
    return best
