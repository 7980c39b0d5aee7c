"""How far the object gets: against MuJoCo's distances, for bodies that stop it, carry it, or stand too near at the start."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tables import Distances, at, task

from regrasp.kernels.features import TOUCH
from regrasp.planner.arcs import Arc
from regrasp.planner.surroundings import SINK, gap_to, gaps_at, go
from regrasp.planner.task import Task

CLEARANCE = 0.002
STEPS = 60
SHAPES = {"box": 1e-6, "capsule": 1e-6, "sphere": 1e-6, "cylinder": 3e-5}  # MuJoCo's cylinders have rims of capsules
NONE = np.zeros(3)


def scene(shape: str) -> Task:
    """The table and the wall may carry the object, a post and a ball must not touch it."""
    return task(shape, ("table", "wall"), ("post", "ball"))


def went(t: Task, arc: Arc, held: tuple[int, ...] = (), steps: int = STEPS) -> tuple[float, int, tuple[int, ...]]:
    """(part, body that stops it, carriers that it touches all the way)."""
    B = len(t.router.around.kind)
    flags, kept = np.zeros(B, np.uint8), np.zeros(B, np.uint8)
    flags[list(held)] = 1
    u, body = go(t.router.around, *arc.start, arc.w, arc.c, arc.d, steps, CLEARANCE, flags, kept)
    return u, body, tuple(np.flatnonzero(kept).tolist())


def shift(t: Task, start: tuple[float, ...], d: list[float], held: tuple[int, ...] = ()):
    pose = at(*start)
    return went(t, Arc(pose, NONE, pose[1], np.array(d), "straight"), held)


def test_carriers_come_first_and_every_body_that_may_be_met_is_there() -> None:
    t = scene("box")
    names = [t.router.name(b) for b in range(len(t.router.around.kind))]
    assert names[:2] == ["table", "wall"]
    assert {"post", "ball", "finger1/column", "finger2/column"} <= set(names[2:])
    np.testing.assert_array_equal(t.router.around.carries, [1, 1] + [0] * (len(names) - 2))


@pytest.mark.parametrize("shape", SHAPES)
def test_gaps_are_mujocos(shape: str) -> None:
    """Exact up to the limit, anything above it where the bodies are farther."""
    t = scene(shape)
    distances, around, rng = Distances(t), t.router.around, np.random.default_rng(0)
    near = 0
    for R in Rotation.random(60, rng=rng).as_matrix():
        p = rng.uniform([-0.08, -0.05, 0.02], [0.06, 0.06, 0.09])
        true, gaps = distances(R, p), np.empty(len(around.kind))
        gaps_at(around, R, p, 0.03, gaps)
        for b, gap in enumerate(true):
            mine = gap_to(around, b, R, p, 0.03)
            assert mine == gaps[b]
            if 0.0 < gap <= 0.03:
                assert mine == pytest.approx(gap, abs=SHAPES[shape])
                near += 1
            else:
                assert mine > 0.03 if gap > 0.0 else mine < SHAPES[shape]
    assert near > 40


@pytest.mark.parametrize("shape", SHAPES)
def test_the_object_goes_until_it_touches_a_carrier_or_is_the_clearance_from_an_obstacle(shape: str) -> None:
    """Random arcs among all of them: clear at every step on the way, at the end as near as may be to what stops it."""
    t = scene(shape)
    distances, around, rng, slack = Distances(t), t.router.around, np.random.default_rng(1), SHAPES[shape]
    least = np.where(around.carries == 1, 0.0, CLEARANCE)
    stopped = dict.fromkeys(range(-1, 4), 0)
    for _ in range(120):
        R, p = Rotation.random(rng=rng).as_matrix(), rng.uniform([-0.05, -0.04, 0.045], [0.01, 0.02, 0.09])
        if np.any(distances(R, p) < least + 1e-4):
            continue
        w, c, d = rng.normal(size=3), p + 0.02 * rng.normal(size=3), 0.1 * rng.normal(size=3)
        arc = Arc((R, p), w, c, d, "any")
        u, body, kept = went(t, arc)
        assert kept == ()
        for step in np.arange(0.0, u, 1.0 / STEPS):
            assert np.all(distances(*arc.pose(step)) >= least - slack)
        end = distances(*arc.pose(u))
        assert np.all(end >= least - slack)
        if body < 0:
            assert u == 1.0
        elif body < 4:
            assert end[body] == pytest.approx(least[body], abs=slack + SINK)
        if body < 4:
            stopped[body] += 1
    assert min(stopped.values()) > 0, stopped


def test_where_it_stops_does_not_depend_on_the_steps() -> None:
    t, start = scene("box"), at(0, 0, 0.06)
    arc = Arc(start, np.array([0.5, 0.4, 0.2]), start[1], np.array([0.1, 0.0, -0.01]), "any")
    ends = [went(t, arc, steps=steps) for steps in (2, 7, 60, 1000)]
    assert {end[1] for end in ends} == {1}
    np.testing.assert_allclose([end[0] for end in ends], ends[0][0], atol=1e-8)


def test_what_carries_is_touched_all_the_way_or_is_left() -> None:
    t = scene("box")
    lying = (0, 0, 0.025)
    for d, end in (
        ([0.02, 0.0, 0.0], (1.0, -1, (0,))),  # slides
        ([0.0, 0.0, 0.02], (1.0, -1, ())),  # lifted
        ([0.02, 0.0, 0.01], (1.0, -1, ())),
        ([0.06, 0.0, 0.0], (0.5, 1, (0,))),  # slides up to the wall
        ([0.0, -0.1, -0.0], (1.0, -1, (0,))),
    ):
        u, body, kept = shift(t, lying, d, (0,))
        assert (pytest.approx(u, abs=1e-5), body, kept) == end
    u, body, kept = shift(t, (0, 0, 0.025), [0, 0, -0.01], (0,))
    assert (body, kept) == (0, (0,))
    assert u * 0.01 <= 2.0 * SINK
    u, body, kept = shift(t, (0.03, 0, 0.025), [0, 0.02, 0.02], (0, 1))  # up along the wall
    assert (u, body, kept) == (1.0, -1, (1,))
    u, body, kept = shift(t, (0, 0, 0.035), [0, 0, -0.02])  # falls onto the table, which it did not touch before
    assert (pytest.approx(u, abs=1e-5), body, kept) == (0.5, 0, ())


def test_what_slides_off_an_edge_leaves_the_table_with_its_last_corner() -> None:
    """A corner of the rounded box leaves the edge x = 0 as its flat face does: from there it hovers over the edge's line."""
    t = task("box", ("edge",))
    flat = 0.03 - 0.004
    for way, kept in ((0.03 + flat - 1e-4, (0,)), (0.03 + flat + 1e-3, ())):
        assert shift(t, (-0.03, 0, 0.025), [way, 0, 0], (0,)) == (1.0, -1, kept)


def test_an_obstacle_nearer_than_the_clearance_may_be_left_or_passed_but_not_approached() -> None:
    t = scene("sphere")
    y = 0.06 - 0.008 - 0.025 - 0.5 * CLEARANCE  # half of it from the post
    assert shift(t, (0, y, 0.06), [0, -0.03, 0])[:2] == (1.0, -1)
    assert shift(t, (0, y, 0.045), [0, 0, 0.01])[:2] == (1.0, -1)  # along the post
    u, body, _ = shift(t, (0, y, 0.06), [0, 0.01, 0])
    assert (t.router.name(body), pytest.approx(u, abs=2e-5)) == ("post", 0.0)
    assert shift(t, (0, y, 0.06), [0, 0, 0])[:2] == (1.0, -1)


def test_a_body_that_carries_is_no_obstacle_at_the_clearance() -> None:
    t = scene("sphere")
    assert shift(t, (0, 0, 0.025 + 0.5 * CLEARANCE), [0, -0.03, 0])[:2] == (1.0, -1)
    assert shift(t, (0, 0, 0.025 + TOUCH), [0, -0.03, 0], (0,)) == (1.0, -1, (0,))


@pytest.mark.parametrize("held", [(), (0,), (0, 1)])
def test_no_motion_gets_to_its_end_and_keeps_all(held: tuple[int, ...]) -> None:
    t = scene("box")
    x = 0.03 if 1 in held else 0.0
    assert shift(t, (x, 0, 0.025 if held else 0.06), [0, 0, 0], held) == (1.0, -1, held)
