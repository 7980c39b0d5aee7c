"""Eq. (1): what the shortcuts leave as it is, to the last bit, and what its counts count."""

import dataclasses
import itertools

import numpy as np
import pytest
from arcs import NAMES, Arc, arc, changed, made

from regrasp.planner.energy import changes, loose
from regrasp.planner.grasp import Grasp
from regrasp.planner.hand import plane_of
from regrasp.planner.local import ContactMotions, random_motions
from regrasp.planner.motions import OFF, RELOCATE, ROLL_X, SLIDE_MINUS_Y, SLIDE_X, STAY
from regrasp.planner.supports import SLIDE, STICK
from regrasp.scene.load import load

ROWS = ("V", "lost", "hits", "c", "e", "f", "h", "chosen")


@pytest.fixture(scope="module", params=NAMES)
def each(request: pytest.FixtureRequest) -> Arc:
    return arc(request.param)


def travelling(problem: ContactMotions) -> np.ndarray:
    """Where an agent's way is read: it relocates or retires and is not lost."""
    s = problem.current
    return ((s.V == RELOCATE) | ((s.V == OFF) & (s.holds[:-1] == 1))) & (s.lost == 0)


def same_states(a: ContactMotions, b: ContactMotions) -> None:
    """Everything that the two problems' current states mean is equal to the last bit."""
    for name in ROWS:
        np.testing.assert_array_equal(getattr(a.current, name), getattr(b.current, name), err_msg=name)
    np.testing.assert_array_equal(a.current.way[travelling(a)], b.current.way[travelling(b)])
    np.testing.assert_array_equal(a.current.q, b.current.q)
    np.testing.assert_array_equal(a.current.holds, b.current.holds)
    held = a.current.holds == 1
    for name in ("p_OC", "p_TC", "R_OT"):
        np.testing.assert_array_equal(getattr(a.current, name)[held], getattr(b.current, name)[held], err_msg=name)
    np.testing.assert_array_equal(a.current.R_WG, b.current.R_WG)
    np.testing.assert_array_equal(a.current.p_WG, b.current.p_WG)


@pytest.mark.parametrize("seed", range(3))
def test_incremental_evaluation_is_evaluation_from_scratch(each: Arc, seed: int) -> None:
    """Along a chain of accepted, rejected and cut-off proposals the energy and the whole state are those from scratch;
    the bound turns energies above it into inf and leaves all others alone."""
    rng = np.random.default_rng(seed)
    n, k = len(each.path.R_WO), len(each.task.names)
    chain = each.problem(random_motions(n, k, rng))
    oracle = each.problem(chain.snapshot())
    cut = kept = accepted = 0
    for _ in range(80):
        move = chain.propose(rng)
        outside = np.ones(n, bool)
        outside[move.first : move.final + 1] = False
        assert np.array_equal(move.V[outside], chain.snapshot()[outside])
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
    same_states(chain, each.problem(chain.snapshot()))  # a scan without memories


def test_changes_count_as_documented() -> None:
    """A change of an agent's motion counts once; a relocation is a motion of its own even after another."""
    R = RELOCATE
    assert changes(np.array([[0, 1], [0, 1], [0, 1]], np.int8)) == 0
    assert changes(np.array([[0], [1], [1], [0]], np.int8)) == 2
    assert changes(np.array([[R], [R], [R]], np.int8)) == 2
    assert changes(np.array([[0], [R], [0]], np.int8)) == 2
    V = random_motions(40, 5, np.random.default_rng(0))
    pairs = [(a, b) for row in V.T for a, b in itertools.pairwise(row)]
    assert changes(V) == sum(a != b for a, b in pairs) + sum(a == b == R for a, b in pairs)


def test_stability_counts_the_contacts_that_stick() -> None:
    """Three in space: rolling and resting agents count, sliding ones and those that don't bear do not."""
    a = arc("fig4-relocation")
    rows = {
        (STAY, STAY, ROLL_X, ROLL_X): 0,
        (STAY, STAY, ROLL_X, SLIDE_X): 0,
        (STAY, RELOCATE, ROLL_X, ROLL_X): 0,
        (STAY, RELOCATE, ROLL_X, SLIDE_X): 1,
        (STAY, SLIDE_X, SLIDE_MINUS_Y, SLIDE_X): 2,
        (SLIDE_X, OFF, SLIDE_MINUS_Y, SLIDE_X): 3,
    }
    for codes, missing in rows.items():
        bears = np.array([code not in (RELOCATE, OFF) for code in codes], np.uint8)
        assert loose(a.hand, a.path, np.int64(0), bears, np.array(codes, np.int8)) == missing
    assert loose(a.hand, a.path, np.int64(0), np.array([1, 0, 0, 1], np.uint8), np.zeros(4, np.int8)) == 1


def test_a_support_counts_where_the_object_sticks_to_it() -> None:
    """Two in a plane: the ball that slides on the table needs two fingers, the one that sticks there needs one."""
    a = arc("fig2-planar")
    codes, bears = np.array([STAY, SLIDE_X, SLIDE_X], np.int8), np.ones(3, np.uint8)
    for mode, missing in ((SLIDE, 1), (STICK, 0)):
        path = dataclasses.replace(a.path, support_mode=np.full_like(a.path.support_mode, mode))
        assert loose(a.hand, path, np.int64(0), bears, codes) == missing


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
    """E = K_c Σ c + K_e Σ e + K_f Σ f + K_g Σ g + K_h Σ h with every lost agent and every colliding block counted in c,
    and in h what there are too few of agents that stick and supports that do."""
    n, k = len(each.path.R_WO), len(each.task.names)
    for seed in range(4):
        problem = each.problem(random_motions(n, k, np.random.default_rng(seed)))
        s, K = problem.current, each.task.settings.local.energy
        blocks = np.triu(np.ones((k, k + 2)))
        np.testing.assert_array_equal(s.c, s.lost.sum(1) + (s.hits * blocks).sum((1, 2)))
        assert set(s.e) <= {0.0, 1.0}
        assert np.all(s.f[s.e == 1.0] == 0.0)
        stick = ((s.V < SLIDE_X) & (s.holds[:-1] == 1)).sum(1) + (each.path.support_mode == STICK).sum(1)
        np.testing.assert_array_equal(s.h, np.maximum(0, each.hand.needed - stick))
        expected = K.collision * s.c.sum() + K.equilibrium * s.e.sum() + K.force * s.f.sum() + K.change * changes(s.V)
        expected += K.stability * s.h.sum()
        assert problem.energy() == pytest.approx(expected, rel=1e-12)


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
        V = rng.integers(0, SLIDE_MINUS_Y + 1, (len(ours.path.R_WO), 3)).astype(np.int8)
        V[:, rng.integers(3)] = rng.choice([SLIDE_MINUS_Y, OFF])
        a, b = ours.problem(V).current, other.problem(V[:, order]).current
        np.testing.assert_array_equal(a.c, b.c)
        np.testing.assert_array_equal(a.e, b.e)
        np.testing.assert_allclose(a.f, b.f, atol=1e-9)
        collided += a.c.sum()
    assert collided > 0
