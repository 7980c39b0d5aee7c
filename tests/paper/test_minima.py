"""Paper §5: Eq. (1) has many local minima: downhill searches from random V end in many of them, annealing lower."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import wilcoxon

from regrasp.bench import job
from regrasp.planner.local import Change, ContactMotions, random_motions, terms_of
from regrasp.planner.motions import MOTION_COUNT
from regrasp.planner.relocation import new_scan
from regrasp.search.annealing import Settings, anneal

STARTS, INTERVALS = 10, 6
ANNEALING = Settings(iterations=600, trials=100)
DOWNHILL = Settings(iterations=700, acceptance=0.0)


def single_changes(V):
    """Every V that differs in one entry."""
    for j, i in np.ndindex(V.shape):
        for code in range(MOTION_COUNT):
            if code != V[j, i]:
                W = V.copy()
                W[j, i] = code
                yield Change(W, j, j)


def settle(problem):
    """Go down by single entries until none lowers E: a local minimum by exhaustion."""
    lower = True
    while lower:
        lower = False
        for change in single_changes(problem.snapshot()):
            if problem.evaluate(change, problem.energy() - 1e-9) < math.inf:
                problem.accept(change)
                lower = True
                break
            problem.reject(change)


@pytest.fixture(scope="module")
def segment():
    work = job("fig3-puma3")
    n = len(work.path.R_WO)
    # The first intervals of the segment: the claim needs no more.
    path = work.path._replace(
        **{f: getattr(work.path, f)[:INTERVALS] for f in work.path._fields if len(getattr(work.path, f)) == n}
    )
    return dataclasses.replace(work, path=path)


@pytest.fixture(scope="module")
def searches(segment):
    """From each random V: the problem settled at the end of a downhill search, and annealing's least energy."""
    hand, local = segment.task.hand, segment.task.settings.local
    terms = terms_of(hand, local)
    scan = new_scan(hand, segment.path, local.relocation)  # it only remembers: shared by all searches
    ends = []
    for seed in range(STARTS):
        V = random_motions(INTERVALS, len(segment.task.names), np.random.default_rng(seed))
        cold = ContactMotions(hand, segment.path, scan, terms, segment.grasp, V)
        anneal(cold, DOWNHILL, np.random.default_rng(seed))
        settle(cold)
        warm = ContactMotions(hand, segment.path, scan, terms, segment.grasp, V)
        ends.append((cold, anneal(warm, ANNEALING, np.random.default_rng(seed)).best_energy))
    return ends


def test_downhill_ends_in_different_local_minima(searches):
    for cold, _ in searches:
        for change in single_changes(cold.snapshot()):
            assert cold.evaluate(change, math.inf) >= cold.energy() - 1e-9
            cold.reject(change)
    assert len({cold.snapshot().tobytes() for cold, _ in searches}) > STARTS // 2
    assert len({round(cold.energy(), 6) for cold, _ in searches}) > STARTS // 2


def test_annealing_ends_lower(searches):
    # Downhill evaluates as many V's as annealing and is then even led on to the bottom of its valley.
    downhill = np.array([cold.energy() for cold, _ in searches])
    annealed = np.array([energy for _, energy in searches])
    assert np.median(annealed) < np.median(downhill)
    assert wilcoxon(annealed - downhill, alternative="less").pvalue < 0.01
