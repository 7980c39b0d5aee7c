"""Paper §5: downhill searches from random V end in different local minima of Eq. (1), annealing ends lower."""

import math

import numpy as np
import pytest
from scipy.stats import wilcoxon

from regrasp.bench.searches import SingleEntries, job
from regrasp.planner.chain import Change
from regrasp.planner.energy import make_room
from regrasp.planner.local import terms_of
from regrasp.planner.motions import ONTO, RELOCATE
from regrasp.planner.scan import new_scan
from regrasp.search.annealing import Settings, anneal

STARTS, TURN, EVALUATIONS = 48, 0.06, 4000
ANNEALING = Settings(iterations=EVALUATIONS - 200, trials=200)
DOWNHILL = Settings(iterations=EVALUATIONS, acceptance=0.0)


@pytest.fixture(scope="module")
def searches():
    """From each random V: the problem at the end of a downhill search, and annealing's least energy."""
    work = job("fig3-puma3", turn=TURN)  # its whole way in ten intervals
    hand, local = work.task.hand, work.task.settings.local
    terms = terms_of(hand, local)
    scan = new_scan(hand, work.path, local.relocation)  # it only remembers: shared by all searches
    ends = []
    for seed in range(STARTS):
        V = work.random_start(seed)
        cold, warm = (SingleEntries(hand, work.path, scan, terms, work.grasp, V) for _ in range(2))
        anneal(cold, DOWNHILL, np.random.default_rng(seed))
        ends.append((cold, anneal(warm, ANNEALING, np.random.default_rng(seed)).best_energy))
    return ends


def test_downhill_ends_in_different_local_minima(searches):
    minima = {}
    for cold, _ in searches:
        V = cold.snapshot()
        around = []
        scan = cold.model[2]
        for j, i in np.ndindex(*V.shape):
            # All motions but relocations, and all candidates that are known to be free.
            for code in [c for c in range(ONTO) if c != RELOCATE] + list(ONTO + np.flatnonzero(scan.row[i, j + 1] > 0)):
                other = V.copy()
                other[j, i] = code
                make_room(cold.found, cold.work, cold.current)
                around.append(cold.evaluate(Change(other, i, j, j), math.inf))
        if min(around) >= cold.energy() - 1e-9:
            minima[V.tobytes()] = cold.energy()
    assert len(minima) > STARTS // 2, len(minima)
    assert max(minima.values()) > 1.2 * min(minima.values())


def test_annealing_ends_lower(searches):
    downhill = np.array([cold.energy() for cold, _ in searches])
    annealed = np.array([energy for _, energy in searches])
    assert np.median(annealed) < np.median(downhill)
    assert wilcoxon(annealed - downhill, alternative="less").pvalue < 0.01
