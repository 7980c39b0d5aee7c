"""The Markov chain over V: none of its shortcuts changes it, compiled it is the generic one, and it does not do work twice."""

import dataclasses

import numpy as np
import pytest
from arcs import Arc, made

from regrasp.planner import chain
from regrasp.planner.task import Settings as Planner
from regrasp.planner.terms import Shortcuts
from regrasp.scene.load import load
from regrasp.search import annealing
from regrasp.search.annealing import Settings

SETTINGS = Settings(iterations=300, trials=60)
ALL = Shortcuts()
OFF = {
    "changed": Shortcuts(changed=0),
    "memory": Shortcuts(memory=0),
    "warm": Shortcuts(warm=0),
    "bound": Shortcuts(bound=0),
    "all": Shortcuts(0, 0, 0, 0),
}


SCENES = ("puma4-obstacles", "fig4-relocation", "fig2-planar", "heavy-push")
"""A ball in the air; arms with a closed form that relocate; planar fingers; a table that carries and is slid on. Each of the
other scenes has the kinds of agents, contacts and bodies of one of these."""


@pytest.fixture(scope="module", params=SCENES)
def each(request: pytest.FixtureRequest) -> Arc:
    return made(load(request.param), Planner(intervals=12))


def counted(problem: chain.ContactMotions) -> list[int]:
    """Configurations, force programs, pivots and free motions computed so far."""
    counts = problem.work.counts
    return [int(getattr(counts, field.name)[0]) for field in dataclasses.fields(counts)]


def annealed(a: Arc, shortcuts: Shortcuts, seed: int):
    """The problem after annealing from a random V, and the result."""
    rng = np.random.default_rng(seed)
    problem = a.problem(a.random(rng), shortcuts)
    return problem, chain.anneal(problem, SETTINGS, rng)


def moved_alike(one, other, **tolerance: float) -> None:
    """Two runs accept the same moves with the same energies, and find the same best V."""
    assert len(set(one.energies)) > 5  # the chain moves
    for name in ("energies", "best_energies", "start_temperature"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), err_msg=name, **tolerance)
    np.testing.assert_array_equal(other.best, one.best)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("off", [name for name in OFF if name != "warm"])
def test_what_is_left_out_was_not_needed_to_the_last_bit(each: Arc, off: str, seed: int) -> None:
    """Without warm starts, which move the last bits: any other shortcut, or all of them, on and off."""
    cold = Shortcuts(warm=0)
    without, other = annealed(each, dataclasses.replace(OFF[off], warm=0), seed)
    with_all, result = annealed(each, cold, seed)
    moved_alike(result, other, rtol=0.0, atol=0.0)
    np.testing.assert_array_equal(without.snapshot(), with_all.snapshot())


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("off", OFF)
def test_no_shortcut_changes_the_chain(each: Arc, off: str, seed: int) -> None:
    """With any of them off, and with all, the same moves are accepted, with the same energies, and the same V is best.

    A force program that starts elsewhere ends at the same optimum up to the last bits."""
    with_all, result = annealed(each, ALL, seed)
    without, other = annealed(each, OFF[off], seed)
    moved_alike(result, other, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(without.snapshot(), with_all.snapshot())


def test_warm_starts_leave_every_energy_as_it_is(each: Arc) -> None:
    """Move by move along one chain, to the last bits; supports and agents come and go on the way."""
    rng = np.random.default_rng(2)
    warm, cold = (
        each.problem(each.random(np.random.default_rng(1)), shortcuts) for shortcuts in (ALL, Shortcuts(warm=0))
    )
    finite = 0
    for _ in range(250):
        move = warm.propose(rng)
        values = [problem.evaluate(move, np.inf) for problem in (warm, cold)]
        assert values[0] == pytest.approx(values[1], rel=1e-11)
        finite += values[0] < np.inf
        if values[0] <= warm.energy() + rng.exponential(2.0):
            warm.accept(move)
            cold.accept(move)
    assert finite > 200


def both(a: Arc, settings: Settings, seed: int) -> tuple[list, list]:
    """The results of the compiled and the generic chain, and the problems after them, without warm starts."""
    results, problems = [], []
    for run in (chain.anneal, annealing.anneal):
        rng = np.random.default_rng(seed)
        problems.append(a.problem(a.random(rng), Shortcuts(warm=0)))
        results.append((run(problems[-1], settings, rng), rng.random()))
    return results, problems


def same_chains(results: list, problems: list) -> None:
    """All that two runs came by, and all that is left of them, is the same to the last bit."""
    (ours, drawn), (generic, other) = results
    assert ours.start_temperature == generic.start_temperature > 0.0
    assert ours.best_energy == generic.best_energy == ours.energies.min()
    for name in ("energies", "best_energies", "best"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(generic, name), err_msg=name)
    np.testing.assert_array_equal(problems[0].snapshot(), problems[1].snapshot())
    assert (problems[0].energy(), drawn) == (problems[1].energy(), other)


def test_the_compiled_chain_is_the_generic_one(each: Arc) -> None:
    """The same random numbers give the same trials, temperatures, energies and V's, to the last bit."""
    same_chains(*both(each, SETTINGS, 3))


def test_a_chain_that_runs_out_of_configurations_goes_on() -> None:
    """All are forgotten, and the chain stays the generic one; and what it is with new ones for every evaluation."""
    a = made(load("fig4-relocation"), Planner(intervals=12))
    results, problems = both(a, Settings(iterations=6000, acceptance=0.95, final=1.0), 0)
    full = len(problems[0].found.q)
    assert counted(problems[0])[0] > full > problems[0].found.used[0]
    same_chains(results, problems)
    without, other = annealed(a, OFF["all"], 0)
    assert counted(without)[0] > full
    np.testing.assert_allclose(other.energies, annealed(a, ALL, 0)[1].energies, rtol=1e-9, atol=1e-9)


def test_downhill_never_rises_and_the_best_is_its_end(each: Arc) -> None:
    rng = np.random.default_rng(4)
    problem = each.problem(each.random(rng))
    result = chain.anneal(problem, Settings(iterations=250, acceptance=0.0), rng)
    assert result.start_temperature == 0.0
    assert len(result.energies) == 251
    assert np.all(np.diff(result.energies) <= 0.0)
    np.testing.assert_array_equal(result.best_energies, result.energies)
    problem.reset(result.best)
    assert problem.energy() == pytest.approx(result.best_energy, rel=1e-9)


def test_who_stops_and_what_time_has_passed_is_asked_once_a_block() -> None:
    """A run that is stopped, or out of time, ends with a block; one block is made however little time there is."""
    a = made(load("fig3-puma3"))
    rng = np.random.default_rng(0)
    for stop, elapsed, moves in (
        (lambda state: state.iteration >= 150, lambda: 0.0, 200),
        (lambda _: False, lambda: 1.0, 100),
        (lambda _: True, lambda: 0.0, 0),
    ):
        result = chain.anneal(a.problem(a.random(rng)), Settings(iterations=300, trials=10), rng, stop, elapsed)
        assert len(result.energies) == moves + 1


def test_a_move_that_was_evaluated_costs_nothing_the_second_time(each: Arc) -> None:
    """No configuration, no force program, no free motion."""
    rng = np.random.default_rng(6)
    problem = each.problem(each.random(rng))
    moves = [problem.propose(rng) for _ in range(30)]
    first = [problem.evaluate(move, np.inf) for move in moves]
    counts = counted(problem)
    assert min(counts) > 0
    assert [problem.evaluate(move, np.inf) for move in moves] == first
    assert counted(problem) == counts


def work(a: Arc, shortcuts: Shortcuts) -> np.ndarray:
    """Configurations, force programs, pivots and free motions of three searches, counted."""
    total = np.zeros(4, int)
    for seed in range(3):
        problem, _ = annealed(a, shortcuts, seed)
        total += counted(problem)
    return total


@pytest.mark.parametrize("name", ["fig2-planar", "fig3-puma3", "fig4-relocation", "puma4-obstacles"])
def test_every_shortcut_saves_work(name: str) -> None:
    """Counted, not timed: parts of the work without it, with room above what was measured when these were written.

    For three agents and four: of one or two there is less to leave out.
    """
    each = made(load(name), Planner(intervals=12))
    on = work(each, ALL)
    configurations, programs, _, ways = (on / work(each, Shortcuts(bound=0))).tolist()
    assert configurations < 0.85
    assert programs < 0.85
    assert ways < 0.7
    assert (on / work(each, Shortcuts(changed=0)))[0] < 0.95
    configurations, programs, _, ways = (on / work(each, Shortcuts(memory=0))).tolist()
    assert configurations < 0.95
    assert programs < 0.85
    assert ways < 1.0
    cold = work(each, Shortcuts(warm=0))
    assert cold[1] == pytest.approx(on[1], rel=0.01)  # the last bits of warm starts may turn a move
    assert on[2] < 0.75 * cold[2]
    configurations, programs, pivots, ways = (on / work(each, OFF["all"])).tolist()
    assert configurations < 0.12
    assert programs < 0.35
    assert pivots < 0.2
    assert ways < 0.45
