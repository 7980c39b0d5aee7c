"""The global planner: routes clear by MuJoCo's distances, round obstacles, straight where nothing is in the way."""

import itertools

import numpy as np
import pytest
from arcs import Oracle, changed

from regrasp.planner.method import plan_scene
from regrasp.planner.outcome import Failure
from regrasp.planner.poses import Node
from regrasp.planner.route import GlobalPlanner
from regrasp.planner.task import Settings, Task, prepare
from regrasp.scene.load import load


@pytest.fixture(scope="module")
def post() -> tuple[Task, list[Node]]:
    task = prepare(load("puma4-obstacles"), Settings())
    route = task.router.route(task.router.grid.start, lambda: False)
    assert not isinstance(route, Failure)
    return task, route


def test_every_pose_of_the_route_is_clear_of_the_post(post: tuple[Task, list[Node]]) -> None:
    task, route = post
    oracle = Oracle(task)
    home = task.hand.home
    obstacles = [task.world.model.geom("post").id]
    clearance, r = task.settings.route.clearance, task.hand.radius
    for a, b in itertools.pairwise(route):
        for R, p in zip(*task.router.grid.arc(a, b, 60), strict=True):
            oracle.put(R, p, home)
            apart = min(oracle.apart(o, g) for o in obstacles for g in task.world.object_geoms)
            # The route is looked at every 0.08 r: between two looks it may come nearer by half of that.
            assert apart >= clearance - 0.04 * r
            assert apart > 0.0


def test_the_route_goes_round_the_post(post: tuple[Task, list[Node]]) -> None:
    """The straight way is barred; where the route passes the post's plane x = 0 it is beside or above it."""
    task, route = post
    grid = task.router.grid
    assert not task.router.free(grid.start, grid.goal)
    assert (route[0], route[-1]) == (grid.start, grid.goal)
    assert len(route) > 2
    p = np.concatenate([grid.arc(a, b, 100)[1] for a, b in itertools.pairwise(route)])
    crossing = p[np.argmin(np.abs(p[:, 0]))]
    beside, above = np.hypot(*crossing[:2]), crossing[2] - 0.096
    assert beside >= 0.035 + 0.006 or above >= 0.035 + 0.006 - 1e-3


def test_the_route_is_hardly_longer_than_the_shortest_way_round(post: tuple[Task, list[Node]]) -> None:
    """The taut string round a ball of the post's top and the object's radius, over the top: less than 1.5 times it."""
    task, route = post
    along = sum(task.router.grid.length(a, b, task.hand.radius) for a, b in itertools.pairwise(route))
    assert 0.09 <= along < 1.5 * 0.12


@pytest.mark.parametrize("name", ["fig3-puma3", "fig4-relocation", "fig2-planar"])
def test_where_nothing_is_in_the_way_the_route_is_the_straight_arc(name: str) -> None:
    router = prepare(load(name), Settings()).router
    assert router.route(router.grid.start, lambda: False) == [router.grid.start, router.grid.goal]


def test_an_arc_that_failed_is_avoided() -> None:
    """Its cost is raised, so a route that is dearer than the straight one but cheaper than the raised one is taken."""
    router = prepare(load("fig3-puma3"), Settings()).router
    start, goal = router.grid.start, router.grid.goal
    before = router.raised(start, goal)
    router.failed(start, goal)
    assert router.raised(start, goal) == pytest.approx(before * router.settings.penalty)
    route = router.route(start, lambda: False)
    assert not isinstance(route, Failure)
    assert len(route) > 2
    arcs = list(itertools.pairwise(route))
    assert sum(router.raised(a, b) for a, b in arcs) < router.raised(start, goal)
    assert before <= sum(router.cost(a, b) for a, b in arcs)
    router.failed(*arcs[0])
    other = router.route(start, lambda: False)
    assert not isinstance(other, Failure)
    assert other != route


@pytest.mark.parametrize(("end", "where"), [("start", "start.pose"), ("goal", "goal.pose")])
def test_an_end_inside_an_obstacle_is_named(end: str, where: str) -> None:
    scene = load("puma4-obstacles")
    old = getattr(scene, end).model_dump(mode="json", exclude_defaults=True)
    outcome = plan_scene(changed(scene, **{end: {**old, "pose": {"position": [0.0, 0.0, 0.11]}}}), 0, Settings())
    assert outcome.plan is None
    assert outcome.failure is not None
    assert (outcome.failure.constraint, outcome.failure.where) == ("collision", where)
    assert "obstacle" in outcome.failure.reason
    assert where in outcome.failure.remedy


def test_an_object_below_its_support_is_named() -> None:
    scene = load("fig2-planar")
    outcome = plan_scene(changed(scene, start={"pose": {"position": [0, 0, 0.044]}}), 0, Settings())
    assert outcome.failure is not None
    assert "start.pose" in str(outcome.failure)
    assert "table" in outcome.failure.reason


def test_without_a_way_the_failure_says_so() -> None:
    """The goal is free but inside a box of walls."""
    walls = [
        {"name": f"wall{a}{s}", "shape": "box", "size": [0.005 if b == a else 0.11 for b in range(3)],
         "pose": {"position": [0.1 * s if b == a else (0.35 if b == 2 else 0.0) for b in range(3)]}}
        for a in range(3) for s in (-1, 1)
    ]  # fmt: skip
    for wall in walls:
        axis = int(wall["name"][4])
        if axis == 2:
            wall["pose"]["position"][2] = 0.35 + 0.1 * int(wall["name"][5:])
    scene = changed(
        load("fig3-puma3"), environment=walls, freedoms=["x", "y", "z"],
        goal={"pose": {"position": [0, 0, 0.35]}},
    )  # fmt: skip
    task = prepare(scene, Settings(route=GlobalPlanner(nodes=100)))
    result = task.router.route(task.router.grid.start, lambda: False)
    assert isinstance(result, Failure)
    assert result.constraint == "route"
