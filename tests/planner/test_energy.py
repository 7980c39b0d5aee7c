"""Eq. (1): what the shortcuts leave as it is, and what its counts count."""

import dataclasses
import itertools

import numpy as np
import pytest
from arcs import NAMES, Arc, arc, changed, made

from regrasp.planner.chain import ContactMotions
from regrasp.planner.configurations import UNKNOWN, Grasp
from regrasp.planner.energy import make_room
from regrasp.planner.hand import plane_of
from regrasp.planner.local import random_motions
from regrasp.planner.motions import OFF, ONTO, ROLL_X, SLIDE_MINUS_Y, SLIDE_X, STAY
from regrasp.planner.supports import SLIDE, STICK
from regrasp.planner.terms import Shortcuts, changes, loose
from regrasp.scene.load import builtin, load

PLACES = ("q", "holds", "R_WG", "p_WG", "lost", "own")
CONTACTS = ("p_OC", "p_TC", "R_OT", "n_O")


@pytest.fixture(scope="module", params=NAMES)
def each(request: pytest.FixtureRequest) -> Arc:
    return arc(request.param)


def at_ends(problem: ContactMotions, name: str) -> np.ndarray:
    """A field of `Configurations` for the configurations that the current V leads through, (n + 1, k, …)."""
    return getattr(problem.found, name)[problem.current.at]


def lost(problem: ContactMotions) -> np.ndarray:
    """Who leaves its workspace in contact, or has to stay behind, (n, k)."""
    in_contact = problem.current.V < OFF - 1
    return (problem.current.behind == 1) | (in_contact & (at_ends(problem, "lost")[1:] == 1))


def same_states(a: ContactMotions, b: ContactMotions) -> None:
    """Everything that the two problems' current states mean is equal to the last bit."""
    for name in ("V", "behind", "way", "c", "e", "f", "h"):
        np.testing.assert_array_equal(getattr(a.current, name), getattr(b.current, name), err_msg=name)
    k = a.current.V.shape[1]
    np.testing.assert_array_equal(*(np.triu(p.current.touch, 1)[..., :k, :k] for p in (a, b)))
    held = at_ends(a, "holds") == 1
    assert np.all(at_ends(a, "own")[1:] != UNKNOWN)
    for name in PLACES:
        rows = slice(1, None) if name == "own" else slice(None)
        np.testing.assert_array_equal(at_ends(a, name)[rows], at_ends(b, name)[rows], err_msg=name)
    for name in CONTACTS:
        np.testing.assert_array_equal(at_ends(a, name)[held], at_ends(b, name)[held], err_msg=name)


@pytest.mark.parametrize("seed", range(3))
def test_incremental_evaluation_is_evaluation_from_scratch(each: Arc, seed: int) -> None:
    """Along a chain of accepted, rejected and cut-off proposals the energy and the whole state are those from scratch;
    the bound turns energies above it into inf and leaves all others alone. To the last bit without warm starts."""
    rng = np.random.default_rng(seed)
    n = len(each.path.R_WO)
    chain = each.problem(each.random(rng), Shortcuts(warm=0))
    oracle = each.problem(chain.snapshot(), Shortcuts(0, 0, 0, 0))
    cut = kept = accepted = 0
    for _ in range(80):
        move = chain.propose(rng)
        others = np.ones_like(move.V, bool)
        others[move.first : move.final + 1, move.agent] = False
        assert np.array_equal(move.V[others], chain.snapshot()[others])
        assert n > move.final >= move.first >= 0
        oracle.reset(move.V)
        true = oracle.energy()
        bound = rng.choice([np.inf, true, np.nextafter(true, -np.inf), chain.energy() + rng.exponential(3.0)])
        offered = chain.evaluate(move, bound)
        if true > bound:
            assert offered == np.inf
            cut += 1
        else:
            assert offered == true
            kept += 1
        if offered < np.inf and rng.random() < 0.6:
            chain.accept(move)
            same_states(chain, oracle)
            accepted += 1
        else:
            chain.reject(move)
    assert min(cut, kept, accepted) > 5
    same_states(chain, each.problem(chain.snapshot(), Shortcuts(warm=0)))  # nothing remembered


def test_changes_count_as_documented() -> None:
    """A change of an agent's motion counts once; a relocation is a motion of its own even after another."""
    R = ONTO + 3
    assert changes(np.array([[0, 1], [0, 1], [0, 1]], np.int16)) == 0
    assert changes(np.array([[0], [1], [1], [0]], np.int16)) == 2
    assert changes(np.array([[R], [R], [R]], np.int16)) == 2
    assert changes(np.array([[0], [R], [0]], np.int16)) == 2
    V = random_motions(200, 5, 2, np.random.default_rng(0))
    pairs = [(a, b) for row in V.T for a, b in itertools.pairwise(row)]
    again = sum(a == b >= ONTO for a, b in pairs)
    assert again > 0
    assert changes(V) == sum(a != b for a, b in pairs) + again


def loose_at(a: Arc, codes: tuple[int, ...], holds: tuple[int, ...]) -> int:
    """h of the first interval where the agents do these motions, and hold the object or not."""
    problem = a.problem(np.zeros((len(a.path.R_WO), len(codes)), np.int16))
    problem.current.V[0] = codes
    problem.found.holds[problem.current.at[0]] = holds
    return loose(a.hand, a.path, problem.found, problem.current, 0, -1)


def test_stability_counts_the_contacts_that_stick() -> None:
    """Three in space: rolling and resting agents count, sliding ones and those that don't bear do not."""
    a = arc("fig4-relocation")
    rows = {
        (STAY, STAY, ROLL_X, ROLL_X): 0,
        (STAY, STAY, ROLL_X, SLIDE_X): 0,
        (STAY, ONTO, ROLL_X, ROLL_X): 0,
        (STAY, ONTO + 5, ROLL_X, SLIDE_X): 1,
        (STAY, SLIDE_X, SLIDE_MINUS_Y, SLIDE_X): 2,
        (SLIDE_X, OFF, SLIDE_MINUS_Y, SLIDE_X): 3,
    }
    for codes, missing in rows.items():
        assert loose_at(a, codes, (1, 1, 1, 1)) == missing
    assert loose_at(a, (STAY,) * 4, (1, 0, 0, 1)) == 1


def test_a_support_counts_where_the_object_sticks_to_it() -> None:
    """Two in a plane: the ball that slides on the table needs two fingers, the one that sticks there needs one."""
    a = arc("fig2-planar")
    for mode, missing in ((SLIDE, 1), (STICK, 0)):
        path = dataclasses.replace(a.path, support_mode=np.full_like(a.path.support_mode, mode))
        assert loose_at(dataclasses.replace(a, path=path), (STAY, SLIDE_X, SLIDE_X), (1, 1, 1)) == missing


@pytest.mark.parametrize("name", builtin())
def test_no_forces_are_less_than_the_floor(name: str) -> None:
    """Of what holds the object, whoever slides, goes or is off; the floor is nothing where a support bears."""
    a, rng = arc(name), np.random.default_rng(0)
    problem = a.problem(np.full((len(a.path.R_WO), len(a.task.names)), STAY, np.int16))
    floor, held = problem.work.floor, 0
    borne = np.any((a.path.support_mode == STICK) | (a.path.support_mode == SLIDE), axis=1)
    np.testing.assert_array_equal(floor > 0.5, ~borne)
    assert np.all(floor[borne] == 0.0)
    for _ in range(40):
        V = np.where(rng.random(problem.current.V.shape) < 0.3, a.random(rng), STAY).astype(np.int16)
        problem.reset(V)
        holds = problem.current.e == 0.0
        held += np.sum(holds)
        assert np.all(problem.current.f[holds] >= floor[holds])
    assert held > 10


@pytest.mark.parametrize(
    ("freedoms", "plane"),
    [
        (("x", "z", "ry"), {"x", "z", "ry"}),
        (("ry", "x"), {"x", "z", "ry"}),
        (("rz",), {"x", "y", "rz"}),
        (("rx", "y"), {"y", "z", "rx"}),
        (("x", "y", "z", "rx", "ry", "rz"), None),
        (("x", "y", "z"), None),
        (("x", "rx"), None),
        (("x", "y", "ry"), None),
        (("ry", "rz"), None),
    ],
)
def test_freedoms_of_a_plane_are_known(freedoms: tuple[str, ...], plane: set[str] | None) -> None:
    assert plane_of(freedoms) == plane


def test_a_plane_needs_two_contacts_and_has_three_axes_of_disturbance() -> None:
    """In space three contacts determine a pose and a disturbance has all six."""
    plane, space = arc("fig2-planar").hand, arc("fig4-relocation").hand
    assert (plane.needed, space.needed) == (2, 3)
    np.testing.assert_array_equal([plane.shifts, plane.turns], [[1, 0, 1], [0, 1, 0]])
    np.testing.assert_array_equal([space.shifts, space.turns], np.ones((2, 3)))


def test_the_energy_is_the_weighted_sum_of_its_terms(each: Arc) -> None:
    """E = K_c Σ c + K_e Σ e + K_f Σ f + K_g Σ g + K_h Σ h with every lost agent, every colliding block, every free motion
    without a way and all but one at a time counted in c, and in h what there are too few of agents that stick and supports
    that do."""
    for seed in range(4):
        problem = each.problem(each.random(np.random.default_rng(seed)))
        s, K = problem.current, each.task.settings.local.energy
        holds = at_ends(problem, "holds")
        free = ((s.V >= ONTO) & (s.behind == 0)) | ((s.V == OFF) & (holds[:-1] == 1))
        hits = at_ends(problem, "own")[1:].sum(1) + np.triu(s.touch, 1).sum((1, 2))
        barred = (free & (s.way < 0)).sum(1)
        np.testing.assert_array_equal(s.c, lost(problem).sum(1) + hits + barred + np.maximum(free.sum(1) - 1, 0))
        assert set(s.e) <= {0.0, 1.0}
        assert np.all(s.f[s.e == 1.0] == 0.0)
        stick = ((s.V < SLIDE_X) & (holds[:-1] == 1)).sum(1) + (each.path.support_mode == STICK).sum(1)
        np.testing.assert_array_equal(s.h, np.maximum(0, each.hand.needed - stick))
        expected = K.collision * s.c.sum() + K.equilibrium * s.e.sum() + K.force * s.f.sum() + K.change * changes(s.V)
        expected += K.stability * s.h.sum()
        assert problem.energy() == pytest.approx(expected, rel=1e-12)


def test_an_agents_way_depends_on_its_own_motions_only(each: Arc) -> None:
    """Its configurations are the same beside any motions of the others."""
    rng = np.random.default_rng(5)
    k = len(each.task.names)
    V, other = each.random(rng), each.random(rng)
    for i in range(k):
        other[:, i] = V[:, i]
        a, b = each.problem(V), each.problem(other)
        for name in ("q", "holds", "R_WG", "p_WG"):
            np.testing.assert_array_equal(at_ends(a, name)[:, i], at_ends(b, name)[:, i], err_msg=name)
        np.testing.assert_array_equal(a.current.behind[:, i], b.current.behind[:, i])
        other = each.random(rng)


@pytest.mark.parametrize("seed", range(2))
def test_energies_are_the_same_after_all_has_been_forgotten(each: Arc, seed: int) -> None:
    """When configurations run out only the current V's are found anew, in new places; all energies are as before."""
    rng = np.random.default_rng(seed)
    problem = each.problem(each.random(rng), Shortcuts(warm=0))
    for _ in range(5):
        move = problem.propose(rng)
        problem.evaluate(move, np.inf)
        problem.accept(move)
    moves = [problem.propose(rng) for _ in range(15)]
    before = [problem.evaluate(move, np.inf) for move in moves]
    same = each.problem(problem.snapshot(), Shortcuts(warm=0))
    place = problem.current.at.copy()
    used, full = int(problem.found.used[0]), len(problem.found.q)
    problem.found.used[0] = full - 65
    make_room(problem.found, problem.work, problem.current)
    n, k = problem.current.V.shape
    assert problem.found.used[0] <= 1 + k + n * k < used
    assert not problem.work.pairs.taken.any()
    assert not problem.work.sums.taken.any()
    assert not np.array_equal(place, problem.current.at)
    same_states(problem, same)
    assert [problem.evaluate(move, np.inf) for move in moves] == before
    used = int(problem.found.used[0])
    make_room(problem.found, problem.work, problem.current)
    assert problem.found.used[0] == used  # while there is room nothing is forgotten


def test_the_order_of_the_agents_does_not_count() -> None:
    """With the agents listed in another order the same motions have the same collisions and the same least forces."""
    ours = arc("fig3-puma3")
    order = [2, 0, 1]
    scene = changed(load("fig3-puma3"), agents=[{"name": ours.task.names[i]} for i in order])
    other = made(scene)
    assert other.task.names == tuple(ours.task.names[i] for i in order)
    g = ours.grasp
    q = np.concatenate([g.q[ours.joints(i)] for i in order])
    other = Arc(other.task, other.path, Grasp(q, g.holds[order], g.p_OC[order], g.p_TC[order], g.R_OT[order]))
    collided = 0.0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        V = rng.integers(0, SLIDE_MINUS_Y + 1, (len(ours.path.R_WO), 3)).astype(np.int16)
        V[:, rng.integers(3)] = rng.choice([SLIDE_MINUS_Y, OFF])
        a, b = ours.problem(V).current, other.problem(V[:, order]).current
        np.testing.assert_array_equal(a.c, b.c)
        np.testing.assert_array_equal(a.e, b.e)
        np.testing.assert_allclose(a.f, b.f, atol=1e-9)
        collided += a.c.sum()
    assert collided > 0
