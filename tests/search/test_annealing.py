"""Annealing: Boltzmann's distribution, the early stop, the start temperature, ground states that downhill misses."""

import dataclasses
import math

import numpy as np
import pytest

from regrasp.search import annealing
from regrasp.search.annealing import Settings, State


class Ring:
    """States 0 … n-1 on a ring with the energies given; a move goes one or two places to either side."""

    def __init__(self, energies, start=0, early=False):
        self.energies = np.asarray(energies, float)
        self.at = start
        self.early = early
        self.visited = [start]
        self.stopped = 0

    def energy(self):
        return float(self.energies[self.at])

    def propose(self, rng):
        return (self.at + int(rng.choice((-2, -1, 1, 2)))) % self.energies.size

    def evaluate(self, move, bound):
        energy = float(self.energies[move])
        if self.early and energy > bound:
            self.stopped += 1
            return math.inf
        return energy

    def accept(self, move):
        self.at = move
        self.visited.append(move)

    def reject(self, move):
        self.visited.append(self.at)

    def snapshot(self):
        return self.at


def rugged(n=400):
    """A wide valley with its bottom at 3 n / 4 under ripples that no step of two places crosses downhill."""
    x = np.arange(n)
    return 30.0 * (x / n - 0.75) ** 2 + np.where(x % 5 == 0, 0.0, 0.6) + 0.01 * np.sin(x)


@pytest.mark.parametrize("T", [0.5, 1.0, 3.0])
def test_stationary_distribution_is_boltzmanns(T):
    energies = np.array([0.0, 1.3, 0.4, 2.0, 0.1, 0.9, 1.7])
    problem = Ring(energies)
    settings = Settings(iterations=60_000, final=1.0)
    rng = np.random.default_rng(1)
    state = State(0, T, problem.energy(), problem.energy(), 0)
    for _ in range(settings.iterations):
        state, _ = annealing.step(problem, state, settings, rng)
    measured = np.bincount(problem.visited, minlength=energies.size) / len(problem.visited)
    expected = np.exp(-energies / T) / np.exp(-energies / T).sum()
    np.testing.assert_allclose(measured, expected, atol=0.015)


def test_stopping_at_the_threshold_leaves_the_chain_as_it_is():
    full, early = Ring(rugged()), Ring(rugged(), early=True)
    settings = Settings(iterations=3000)
    results = [annealing.anneal(p, settings, np.random.default_rng(5)) for p in (full, early)]
    assert full.visited == early.visited
    np.testing.assert_array_equal(results[0].energies, results[1].energies)
    assert results[0].best == results[1].best
    assert early.stopped > 500


@pytest.mark.parametrize("acceptance", [0.1, 0.3, 0.8])
def test_start_temperature_accepts_the_stated_part_of_the_rises(acceptance):
    rng = np.random.default_rng(2)
    rises = rng.lognormal(0.0, 2.0, 500)
    T = annealing.temperature_of(rises, acceptance)
    assert np.exp(-rises / T).mean() == pytest.approx(acceptance, rel=1e-9)
    assert annealing.temperature_of(1e6 * rises, acceptance) == pytest.approx(1e6 * T, rel=1e-9)
    assert annealing.temperature_of(np.full(3, 2.0), acceptance) == pytest.approx(-2.0 / math.log(acceptance))


@pytest.mark.parametrize("acceptance", [0.2, 0.5])
def test_chain_accepts_that_part_of_the_rises_it_meets(acceptance):
    # Every state but 0 is uphill of 0, by skewed amounts; only moves out of 0 count.
    energies = np.array([0.0, 0.2, 5.0, 7.0, 1.0])
    settings = Settings(trials=2000, acceptance=acceptance, final=1.0)
    problem = Ring(energies)
    rng = np.random.default_rng(3)
    state = annealing.init(problem, settings, rng)
    assert state.energy == 0.0
    trials = 4000
    hits = 0
    for _ in range(trials):
        problem.at = 0
        _, info = annealing.step(problem, dataclasses.replace(state, energy=0.0), settings, rng)
        hits += info.accepted
    assert hits / trials == pytest.approx(acceptance, abs=5 * math.sqrt(acceptance * (1 - acceptance) / 2000))


def test_downhill_never_goes_up_and_ends_in_a_local_minimum():
    for seed in range(20):
        problem = Ring(rugged(), start=int(np.random.default_rng(seed).integers(400)))
        result = annealing.anneal(problem, Settings(iterations=500, acceptance=0.0), np.random.default_rng(seed))
        assert result.start_temperature == 0.0
        assert np.all(np.diff(result.energies) <= 0.0)
        near = [problem.energies[(result.best + s) % 400] for s in (-2, -1, 1, 2)]
        assert problem.energies[result.best] <= min(near)


def test_annealing_reaches_the_ground_state_that_downhill_misses():
    energies = rugged(100)
    ground = int(energies.argmin())
    cold, warm = 0, 0
    for seed in range(10):
        for acceptance in (0.0, 0.5):
            settings = Settings(iterations=8000, acceptance=acceptance, final=0.02)
            best = annealing.anneal(Ring(energies, start=40), settings, np.random.default_rng(seed)).best
            cold += acceptance == 0.0 and best == ground
            warm += acceptance > 0.0 and best == ground
    assert cold == 0
    assert warm >= 8


def test_history_and_best_belong_together():
    problem = Ring(rugged(), start=10)
    result = annealing.anneal(problem, Settings(iterations=1000), np.random.default_rng(4))
    assert result.energies.shape == result.best_energies.shape == (1001,)
    np.testing.assert_array_equal(result.best_energies, np.minimum.accumulate(result.energies))
    assert problem.energies[result.best] == result.best_energy == result.best_energies[-1]


def test_same_seed_same_run():
    runs = [annealing.anneal(Ring(rugged()), Settings(iterations=500), np.random.default_rng(6)) for _ in range(2)]
    np.testing.assert_array_equal(runs[0].energies, runs[1].energies)


def test_cooling_is_geometric_from_start_to_final():
    settings = Settings(iterations=101, final=1e-2)
    T = np.array([annealing.temperature(settings, 5.0, i) for i in range(101)])
    assert T[0] == 5.0
    assert T[-1] == pytest.approx(0.05)
    np.testing.assert_allclose(T[1:] / T[:-1], 1e-2**0.01)


def test_stop_ends_the_run_with_what_it_has():
    result = annealing.anneal(
        Ring(rugged()), Settings(iterations=1000), np.random.default_rng(7), stop=lambda state: state.iteration == 37
    )
    assert result.energies.size == 38
    nothing = annealing.anneal(
        Ring(rugged(), start=9), Settings(acceptance=0.0), np.random.default_rng(7), lambda _: True
    )
    assert nothing.best == 9


def test_impossible_moves_are_never_made():
    energies = np.array([0.0, math.inf, 1.0, math.inf, 2.0, math.inf])
    problem = Ring(energies)
    result = annealing.anneal(problem, Settings(iterations=2000, acceptance=0.9), np.random.default_rng(8))
    assert np.all(np.isfinite(result.energies))
    assert {0, 2, 4} == set(problem.visited)


@pytest.mark.parametrize(
    ("field", "value"),
    [("iterations", -1), ("trials", 0), ("acceptance", 1.0), ("acceptance", -0.1), ("final", 0.0), ("final", 1.1)],
)
def test_settings_out_of_range_are_refused_by_name(field, value):
    with pytest.raises(ValueError, match=f"{field} is {value}"):
        Settings(**{field: value})


def test_a_run_cut_short_by_the_clock_is_cold_at_its_end():
    # 300 of 100 000 iterations fit into the time: without cooling by the clock they would all be hot.
    settings = Settings(iterations=100_000, acceptance=0.5, trials=50)
    passed = iter(np.clip(np.arange(10_000) / 350, 0.0, 1.0))
    problem = Ring(rugged(), start=10)
    result = annealing.anneal(problem, settings, np.random.default_rng(7), elapsed=lambda: float(next(passed)))
    assert result.energies.size == 301
    assert np.any(np.diff(result.energies[:100]) > 0.0)
    assert np.all(np.diff(result.energies[-50:]) <= 0.0)
    assert annealing.temperature(settings, 5.0, 300, 0.8) == 5.0 * settings.final**0.8
    assert annealing.temperature(settings, 5.0, 99_999, 0.8) == pytest.approx(5.0 * settings.final)


def test_measuring_the_start_temperature_takes_a_fifth_of_the_time_at_most():
    asked = iter(np.arange(10_000) / 100)
    problem = Ring(rugged())
    annealing.init(problem, Settings(trials=1000), np.random.default_rng(8), lambda: float(next(asked)))
    assert next(asked) == pytest.approx(0.22)
