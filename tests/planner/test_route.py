"""The global planner: routes clear by MuJoCo's distances, round obstacles, straight where nothing is in the way."""

import itertools

import numpy as np
import pytest
from arcs import changed
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from tables import Distances, at, task

from regrasp.planner.method import plan_scene
from regrasp.planner.outcome import Failure, Progress
from regrasp.planner.path import distance
from regrasp.planner.poses import GOAL, START
from regrasp.planner.route import GlobalPlanner, Leg, Router
from regrasp.planner.task import Settings, Task, prepare
from regrasp.scene.load import load
from regrasp.search import astar

FLAT = ("x", "y", "rz")
UPRIGHT = ("x", "z", "ry")


def routed(router: Router, start: int = START) -> list[Leg] | Failure:
    return router.route(start, lambda: False, lambda _: None)


def found(router: Router) -> list[Leg]:
    route = routed(router)
    assert not isinstance(route, Failure), str(route)
    return route


@pytest.fixture(scope="module", params=["puma4-obstacles", "heavy-push", "passage-carry", "card-edge", "step-tumble"])
def each(request: pytest.FixtureRequest) -> tuple[Task, list[Leg]]:
    task = prepare(load(request.param), Settings())
    return task, found(task.router)


def test_a_route_leads_from_the_start_to_the_goal_without_a_gap(each: tuple[Task, list[Leg]]) -> None:
    task, route = each
    ends = [(task.router.start_pose, route[0].arc.start), (task.router.goal_pose, route[-1].arc.goal)]
    ends += [(one.arc.goal, two.arc.start) for one, two in itertools.pairwise(route)]
    for one, other in ends:
        assert distance(one, other, task.hand.radius) < 1e-4
    assert route[0].nodes[0] == START
    assert route[-1].nodes[-1] == GOAL
    assert all(one.nodes[-1] == two.nodes[0] for one, two in itertools.pairwise(route))


def test_every_pose_of_a_route_is_clear(each: tuple[Task, list[Leg]]) -> None:
    """Of obstacles by the clearance, or where the start is nearer by that; of supports where it does not touch them, and
    on those that its arc touches all along it."""
    task, route = each
    distances, carriers = Distances(task), len(task.supports)
    # Routes are looked at every 2 % of the radius, at least every 2 mm: between two looks they come nearer by half of that.
    slack = 0.5 * max(0.002, 0.02 * task.hand.radius)
    for leg in route:
        for u in np.linspace(0.0, 1.0, 40):
            gaps = distances(*leg.arc.pose(u))
            assert np.all(gaps[carriers:] >= task.settings.route.clearance - slack)
            assert np.all(gaps[:carriers] >= -slack)
            np.testing.assert_allclose(gaps[list(leg.arc.on)], 0.0, atol=2.5e-5)
        for u in (0.0, 1.0):
            assert distances(*leg.arc.pose(u))[:carriers].min(initial=1.0) > -2e-6


def test_every_leg_is_held(each: tuple[Task, list[Leg]]) -> None:
    task, route = each
    for leg in route:
        assert np.isfinite(task.router.cost_of(leg.arc))
        assert task.router.cost_of(leg.arc) >= leg.arc.length(task.hand.radius)


@pytest.fixture(scope="module")
def post() -> tuple[Task, list[Leg]]:
    task = prepare(load("puma4-obstacles"), Settings())
    return task, found(task.router)


def test_the_route_goes_round_the_post(post: tuple[Task, list[Leg]]) -> None:
    """The straight way is barred; where the route passes the post's plane x = 0 it is beside or above it."""
    task, route = post
    assert task.router.way(task.router.start_pose, task.router.goal_pose) is None
    assert len(route) > 1
    p = np.concatenate([leg.arc.poses(np.linspace(0.0, 1.0, 100))[1] for leg in route])
    crossing = p[np.argmin(np.abs(p[:, 0]))]
    beside, above = np.hypot(*crossing[:2]), crossing[2] - 0.096
    assert beside >= 0.035 + 0.006 or above >= 0.035 + 0.006 - 1e-3


def test_the_route_is_hardly_longer_than_the_shortest_way_round(post: tuple[Task, list[Leg]]) -> None:
    """The taut string round a ball of the post's top and the object's radius, over the top: less than 1.5 times it."""
    task, route = post
    along = sum(leg.arc.length(task.hand.radius) for leg in route)
    assert 0.09 <= along < 1.5 * 0.12


@pytest.mark.parametrize("name", ["fig3-puma3", "fig4-relocation", "fig2-planar"])
def test_where_nothing_is_in_the_way_the_route_is_the_straight_arc(name: str) -> None:
    router = prepare(load(name), Settings()).router
    (leg,) = found(router)
    assert leg.nodes == (START, GOAL)
    assert leg.arc.length(router.hand.radius) == pytest.approx(
        distance(router.start_pose, router.goal_pose, router.hand.radius), abs=1e-12
    )


def test_a_subgoal_is_left_out_where_the_object_may_as_well_go_straight(each: tuple[Task, list[Leg]]) -> None:
    """A straight way over a leg's end would cost more than the arcs that it would replace."""
    task, route = each
    router = task.router
    for one, two in itertools.pairwise(route):
        way = router.shortcut(one.nodes[0], two.nodes[-1])
        arcs = itertools.pairwise((*one.nodes, *two.nodes[1:]))
        assert way is None or router.cost_of(way) > sum(router.cost(a, b) for a, b in arcs)


@pytest.mark.parametrize("weight", [1.0, 1.5, 3.0])
@pytest.mark.parametrize("name", ["puma4-obstacles", "heavy-push"])
def test_the_route_costs_at_most_the_weight_times_the_least_of_the_graph(name: str, weight: float) -> None:
    """Dijkstra's on all arcs that were found, at their costs; straightened it costs no more."""
    router = prepare(load(name), Settings(route=GlobalPlanner(weight=weight))).router
    outcome = astar.find(router, START, GOAL, weight=weight)
    assert isinstance(outcome, astar.Path)
    pairs = list(router.graph.arcs)
    costs = np.array([router.cost(a, b) for a, b in pairs])
    n = len(router.graph.poses)
    a, b = np.array(pairs)[np.isfinite(costs)].T
    least = dijkstra(csr_array((costs[np.isfinite(costs)], (a, b)), shape=(n, n)), indices=START)[GOAL]
    assert least * (1.0 - 1e-12) <= outcome.cost <= weight * least * (1.0 + 1e-12)
    assert sum(router.cost_of(leg.arc) for leg in found(router)) <= outcome.cost * (1.0 + 1e-9)


def test_the_estimate_is_a_lower_bound_of_every_arc(each: tuple[Task, list[Leg]]) -> None:
    """h(a) ≤ bound(a, b) + h(b), so h never overestimates; costs are no less than bounds."""
    router = each[0].router
    for a, b in router.graph.arcs:
        # What is taken for a node may be off by what `poses.SAME` and `THERE` allow.
        assert router.heuristic(a) <= router.bound(a, b) + router.heuristic(b) + 1e-4
    for (a, b), cost in router._cost.items():
        assert cost >= router.bound(a, b)


def test_costs_are_asked_for_a_small_part_of_the_arcs(each: tuple[Task, list[Leg]]) -> None:
    router = each[0].router
    assert len(router._cost) < 0.5 * len(router.graph.arcs)


def test_a_leg_that_failed_is_avoided() -> None:
    """Its cost is raised, so a route that is dearer than the straight one but cheaper than the raised one is taken."""
    router = prepare(load("fig3-puma3"), Settings()).router
    (first,) = found(router)
    before = router.raised(START, GOAL)
    router.failed(first)
    assert router.raised(START, GOAL) == pytest.approx(before * router.settings.penalty)
    route = found(router)
    assert len(route) > 1
    costs = [sum(router.raised(a, b) for a, b in itertools.pairwise(leg.nodes)) for leg in route]
    assert before <= sum(costs) * (1.0 + 1e-9)
    assert sum(costs) <= router.settings.weight * router.raised(START, GOAL)
    router.failed(route[0])
    assert [leg.nodes for leg in found(router)] != [leg.nodes for leg in route]


def test_all_arcs_of_a_kind_are_dearer_once_one_has_failed() -> None:
    """In a scene with supports: slides on the table by the lesson, others not at all."""
    router = prepare(load("heavy-push"), Settings()).router
    router.graph.neighbours(START)
    arcs = [arc for (a, _), arc in router.graph.arcs.items() if a == START]
    failed = next(arc for arc in arcs if arc.kind == "slide" and arc.on)
    router.failed(Leg(failed, (START, GOAL)))
    for arc in arcs:
        alike = (arc.kind, arc.on) == (failed.kind, failed.on)
        assert router.learnt(arc) == (router.settings.lesson if alike else 1.0)
    assert len({router.learnt(arc) for arc in arcs}) == 2


def test_a_subgoal_on_which_the_object_does_not_rest_costs_more() -> None:
    """By `unrest` radii, whatever arc begins there, as nobody can take hold anew; where it rests or hangs free, nothing."""
    t = task("box", ("edge",), (), UPRIGHT, start=(0.01, 0.0, 0.025), goal=(0.02, 0.0, 0.06))
    router = Router(
        t.hand, UPRIGHT, t.supports, at(0.01, 0, 0.025), at(0.02, 0, 0.06), t.router.gravity, t.router.margins,
        t.router.points.clearance, GlobalPlanner(), t.router.names,
    )  # fmt: skip
    assert not router.graph.resting(START)
    more = 0
    for b in router.graph.neighbours(START):
        cost = router.cost_of(router.graph.arcs[START, b])
        if np.isfinite(cost):
            assert router.cost(START, b) == pytest.approx(cost + router.settings.unrest * t.hand.radius)
            more += 1
    assert more > 3


def test_a_cube_is_tumbled_over_a_step() -> None:
    """One pivot over the step's edge, on which it stays, and a way on top of it."""
    route = found(prepare(load("step-tumble"), Settings()).router)
    assert route[0].arc.kind == "pivot"
    assert route[0].arc.angle == pytest.approx(np.pi / 2, abs=1e-3)
    assert all(leg.arc.on == (1,) for leg in route)


def test_a_wall_stops_a_slide_and_the_route_goes_on_from_both_surfaces() -> None:
    """Into the corner of table and wall: the last leg's end touches both, and so does the goal."""
    t = task("box", ("table", "wall"), (), ("x", "y"), start=(0.0, 0.0, 0.025), goal=(0.03, 0.04, 0.025))
    route = found(t.router)
    assert set(t.router.graph.touched(route[-1].arc.goal)) == {0, 1}
    assert all(0 in leg.arc.on for leg in route)
    assert t.router.graph.held[GOAL] == (0, 1)


def test_a_heavy_box_is_pushed_where_it_cannot_be_lifted() -> None:
    """With 4 N for 10 N of weight, in the freedoms that would let it be carried."""
    scene = changed(load("heavy-push"), freedoms=["x", "y", "z", "rz"])
    route = found(prepare(scene, Settings()).router)
    assert all(leg.arc.on == (0,) for leg in route)


def narrow(half: float, levels: int) -> Router:
    """Two chambers for a box 40 mm wide, and between them a gap: `half` from y = 0 to either side."""
    wide = 0.5 * (0.085 - half)
    sizes = {
        "wall0": (0.005, wide, 0.0, -half - wide), "wall1": (0.005, wide, 0.0, half + wide),
        "side0": (0.13, 0.005, 0.0, -0.09), "side1": (0.13, 0.005, 0.0, 0.09),
        "end0": (0.005, 0.085, -0.125, 0.0), "end1": (0.005, 0.085, 0.125, 0.0),
    }  # fmt: skip
    bodies = [
        {"name": name, "shape": "box", "size": [x, y, 0.05], "pose": {"position": [*at, 0.05]}}
        for name, (x, y, *at) in sizes.items()
    ]
    table = {"name": "table", "shape": "box", "size": [0.15, 0.15, 0.01], "pose": {"position": [0, 0, -0.01]}}
    t = task(
        "box", ("table",), (), ("x", "y"), start=(-0.06, 0.012, 0.025), goal=(0.06, 0.012, 0.025),
        route=GlobalPlanner(levels=levels), environment=[table, *bodies],
    )  # fmt: skip
    return Router(
        t.hand, ("x", "y"), t.supports, t.router.start_pose, t.router.goal_pose, t.router.gravity, t.router.margins,
        t.router.points.clearance, t.settings.route, t.router.names,
    )  # fmt: skip


def test_a_gap_too_fine_for_the_first_level_is_found_at_the_next() -> None:
    coarse, fine = narrow(0.0225, 1), narrow(0.0225, 2)
    assert isinstance(routed(coarse), Failure)
    route = found(fine)
    assert fine.level == 1
    assert fine.graph.resolution.step == 0.5 * coarse.graph.resolution.step
    assert fine.graph.resolution.angle == 0.5 * coarse.graph.resolution.angle
    assert route[-1].nodes[-1] == GOAL


def test_without_a_way_the_failure_names_the_bodies_that_leave_no_room() -> None:
    failure = routed(narrow(0.018, 1))
    assert isinstance(failure, Failure)
    assert failure.constraint == "route"
    assert "wall0 and wall1" in failure.reason
    assert "planner.route" in failure.remedy


def test_without_enough_force_the_failure_names_the_move() -> None:
    scene = changed(load("heavy-push"), max_force=0.05)
    failure = routed(prepare(scene, Settings(route=GlobalPlanner(levels=1))).router)
    assert isinstance(failure, Failure)
    assert failure.constraint == "equilibrium"
    assert "table" in failure.reason
    assert "max_force" in failure.remedy


def test_a_card_that_lies_flat_and_may_not_slide_is_not_picked_up() -> None:
    failure = routed(task("card", ("table",), (), ("z",), start=(0, 0, 0.0025), goal=(0, 0, 0.05)).router)
    assert isinstance(failure, Failure)
    assert failure.constraint == "equilibrium"
    assert "through the air" in failure.reason


@pytest.mark.parametrize("budget", [{"nodes": 5}, {"poses": 20}])
def test_budgets_end_the_search(budget: dict[str, int]) -> None:
    router = prepare(load("puma4-obstacles"), Settings(route=GlobalPlanner(**budget))).router
    failure = routed(router)
    assert isinstance(failure, Failure)
    assert failure.constraint == "route"
    assert next(iter(budget)) in failure.remedy
    assert len(router.graph.poses) < 100


def test_the_search_ends_when_it_is_told_to_and_tells_how_far_it_is() -> None:
    router = narrow(0.018, 1)
    told: list[Progress] = []
    failure = router.route(START, lambda: len(told) > 0, told.append)
    assert isinstance(failure, Failure)
    assert len(told) == 1
    assert (told[0].stage, told[0].done, told[0].total) == ("route", 20, router.settings.nodes)


def test_a_search_goes_on_from_where_the_object_is_and_begins_again_at_the_start() -> None:
    """From a node in the middle of a route its rest is found; at a finer level the graph starts there."""
    router = narrow(0.0225, 2)
    found(router)
    assert router.level == 1
    again = found(router)
    assert again[0].nodes[0] == START
    middle = again[0].nodes[-1]
    rest = routed(router, middle)
    assert not isinstance(rest, Failure)
    assert rest[0].nodes[0] == middle
    assert router.restarted() == START
    assert router.graph.start is router.start_pose


@pytest.mark.parametrize(("end", "where"), [("start", "start.pose"), ("goal", "goal.pose")])
def test_an_end_inside_an_obstacle_is_named(end: str, where: str) -> None:
    scene = load("puma4-obstacles")
    old = getattr(scene, end).model_dump(mode="json", exclude_defaults=True)
    outcome = plan_scene(changed(scene, **{end: {**old, "pose": {"position": [0.0, 0.0, 0.11]}}}), 0, Settings())
    assert outcome.plan is None
    assert outcome.failure is not None
    assert (outcome.failure.constraint, outcome.failure.where) == ("collision", where)
    assert "post" in outcome.failure.reason
    assert where in outcome.failure.remedy


def test_an_object_below_its_support_is_named() -> None:
    scene = load("fig2-planar")
    outcome = plan_scene(changed(scene, start={"pose": {"position": [0, 0, 0.044]}}), 0, Settings())
    assert outcome.failure is not None
    assert "start.pose" in str(outcome.failure)
    assert "table" in outcome.failure.reason


def test_what_no_agent_could_touch_is_not_passed() -> None:
    """Farther from every base than the stretched finger and the object's radius."""
    t = task("sphere", ("table",), ("post",), ("x", "y"), start=(0.0, 0.0, 0.025), goal=(0.0, 0.12, 0.025))
    assert t.router.in_reach(t.router.start_pose)
    base, limit = t.hand.chains.p_WB[0], t.hand.reach[0] + t.hand.radius
    away = base - t.hand.chains.p_WB[1]
    away /= np.linalg.norm(away)
    for far, reached in ((limit - 1e-6, True), (limit + 1e-6, False)):
        assert t.router.in_reach((np.eye(3), base + far * away)) is reached


def test_a_way_between_two_poses_stays_on_what_carries_it_at_both() -> None:
    router = task("box", ("table", "wall"), (), start=(0.0, 0.0, 0.025)).router
    lying, corner, high = at(0.0, 0.0, 0.025), at(0.03, 0.05, 0.025), at(0.0, 0.0, 0.05)
    slide, lift = router.way(lying, corner), router.way(lying, high)
    assert slide is not None
    assert lift is not None
    assert (slide.kind, slide.on, lift.kind, lift.on) == ("slide", (0,), "straight", ())
    assert router.way(lying, at(0.05, 0.0, 0.025)) is None  # into the wall
    assert router.way(at(0.03, 0.0, 0.025), at(0.03, 0.0, 0.025, np.pi / 2, 0, 0)) is None  # turned through the table
    assert router.blocked(at(0.05, 0.0, 0.025), 0.0) == "wall"
    assert router.blocked(lying, 0.0) == ""
