"""The least force along an arc: nobody does with less, where nothing can hold it is infinite, and what rests needs none."""

import dataclasses
import itertools

import numpy as np
import pytest
from arcs import arc
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation
from tables import TILT, Distances, at, graph, task

from regrasp.kernels.basis import program
from regrasp.kernels.forces import EDGES
from regrasp.planner.arcs import Arc, straight
from regrasp.planner.balance import balance
from regrasp.planner.holding import POINTS, arc_force, at_rest, has_room, least_force, touchable
from regrasp.planner.motions import STAY
from regrasp.planner.path import Pose
from regrasp.planner.poses import START
from regrasp.planner.supports import moved_onto, touching
from regrasp.planner.task import Settings, Task, prepare
from regrasp.scene.load import load

MANY = 32  # edges of a pyramid in the oracle's programs
INSCRIBED = np.cos(np.pi / EDGES)  # a cone so much narrower lies within the planner's pyramid of EDGES


def cone(p: np.ndarray, n: np.ndarray, mu: float, t: Task) -> np.ndarray:
    """Wrench columns (6, MANY) in O of a contact at p with inward normal n: edges on the cone."""
    x = np.linalg.svd(n[None])[2][1]
    turn = np.arange(MANY) * 2.0 * np.pi / MANY
    f = n + mu * (np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * np.cross(n, x))
    return np.vstack([f.T, np.cross(p - t.hand.p_OM_O, f).T / t.hand.radius])


def carried(t: Task, pose: Pose, use: float) -> list[np.ndarray]:
    """The columns of the supports at a pose, with `use` of their friction."""
    R = pose[0]
    return [cone(p, R.T @ n, use * s.mu, t) for s in t.supports for p, n in touching(t.hand, s, *pose)]


def least(t: Task, pose: Pose, agents: list[np.ndarray], supports: list[np.ndarray]) -> float:
    """Σ of the agents' normal forces, in weights, at least, by HiGHS; inf without equilibrium."""
    if not agents + supports:
        return np.inf
    cost = [0.0] * MANY * len(supports) + [1.0] * MANY * len(agents)
    b = [*pose[0].T @ [0.0, 0.0, 1.0], 0.0, 0.0, 0.0]
    cap = [float(c) for c in cost]
    result = linprog(
        cost, A_eq=np.hstack(supports + agents), b_eq=b, A_ub=[cap], b_ub=[float(np.sum(t.hand.cap))], method="highs"
    )
    return float(result.fun) if result.status == 0 else np.inf


def force(t: Task, a: Arc) -> float:
    r = t.router
    return arc_force(t.hand, t.supports, a, r.points, r.margins, r.gravity)


def still(t: Task, pose: Pose) -> float:
    return force(t, straight(pose, pose))


@pytest.mark.parametrize("shape", ["box", "sphere", "cylinder", "capsule", "ellipsoid"])
@pytest.mark.parametrize("support", ["table", "edge", "slope"])
def test_what_rests_is_what_the_supports_can_hold(shape: str, support: str) -> None:
    """Flat, over the edge and tilted: forces within a cone inside the planner's pyramids are enough for it to rest; where
    there are none in a cone around them, it does not (HiGHS)."""
    t = task(shape, (support,))
    rng, verdicts = np.random.default_rng(0), []
    turns = [R.as_matrix() for R in (*Rotation.create_group("O")[:8], *Rotation.random(4, rng=rng))]
    if support == "slope":
        turns += [Rotation.from_euler("y", TILT).as_matrix() @ R for R in turns]
    for R, x in itertools.product(turns, (-0.05, -0.011, 0.013)):
        p = t.router.graph.start[1] + [x, 0.0, 0.1]
        pose = R, moved_onto(t.hand, t.supports[0], R, p)
        use = 1.0 - t.router.margins.friction
        rests = t.router.rests(pose)
        verdicts.append(rests)
        if least(t, pose, [], carried(t, pose, use * INSCRIBED)) == 0.0:
            assert rests
        if least(t, pose, [], carried(t, pose, use * 1.001)) == np.inf:
            assert not rests
    if not (support == "slope" or shape in ("sphere", "ellipsoid")):
        assert {True, False} == set(verdicts)


def test_a_box_rests_until_its_centre_is_over_the_edge() -> None:
    t = task("box", ("edge",))
    assert [t.router.rests(at(x, 0.02, 0.025)) for x in (-0.05, -0.001, 0.001, 0.02)] == [True, True, False, False]
    assert [t.router.rests(at(x, 0.02, 0.03, 0, np.pi / 2, 0)) for x in (-0.001, 0.001)] == [True, False]
    assert not t.router.rests(at(-0.05, 0.02, 0.026))  # in the air


def test_a_ball_rests_on_the_level_and_a_box_on_a_slope_up_to_its_friction() -> None:
    """tan 0.4 = 0.42 lies between 0.5 and the 0.35 that a margin of 30 % leaves of it."""
    t = task("sphere", ("table",))
    assert t.router.rests(at(0.03, 0.01, 0.025, 1.0, 2.0, 3.0))
    ball, box = task("sphere", ("slope",)), task("box", ("slope",))
    n = np.array([np.sin(TILT), 0.0, np.cos(TILT)])
    R = Rotation.from_euler("y", TILT).as_matrix()
    for margin, rests in ((0.3, False), (0.0, True)):
        margins = dataclasses.replace(box.router.margins, friction=margin)
        for tried, holds in ((ball, False), (box, rests)):
            pose = R, 0.025 * n - [0.0, 0.0, 0.02]
            assert at_rest(tried.hand, tried.supports, pose, margins, tried.router.gravity) is holds


@pytest.mark.parametrize("support", [(), ("table",), ("edge",)])
def test_no_choice_of_points_with_room_holds_the_object_with_less(support: tuple[str, ...]) -> None:
    """Any few of them, by HiGHS with cones inside the planner's pyramids; all of them need hardly more than it says."""
    t = task("box", support)
    r, use = t.router, (1.0 - t.router.margins.friction) * INSCRIBED
    pose = at(0.02, 0.0, 0.025 if support else 0.1)
    mine = still(t, pose)
    room = [c for c in range(POINTS) if has_room(t.hand, r.points, c, *pose)]
    agents = [cone(r.points.p_O[c], -r.points.n_O[c], use * np.min(t.hand.mu), t) for c in room]
    supports = carried(t, pose, use)
    rng, found = np.random.default_rng(0), 0
    for count in (2, 3, 4, 8) * 10:
        some = least(t, pose, [agents[a] for a in rng.choice(len(agents), count, replace=False)], supports)
        assert mine <= some + 1e-7
        found += some < np.inf
    assert found > 5
    assert mine - 1e-7 <= least(t, pose, agents, supports) <= 1.2 * mine + 1e-7


@pytest.mark.parametrize("name", ["fig3-puma3", "fig4-relocation", "fig2-planar", "heavy-push", "card-edge"])
def test_found_grasps_need_no_less(name: str) -> None:
    """At the start of the arc, with the supports as the object moves over them."""
    a = arc(name)
    t, path, k = a.task, a.path, len(a.task.names)
    lp = program(EDGES * (POINTS + path.support_mode.shape[1]), 1)
    strength = float(np.sum(t.hand.cap))
    mine = least_force(t.hand, path, 0, t.router.points, t.router.margins, strength, lp)
    normals = np.array([a.grasp.R_OT[i] @ a.grasp.p_TC[i] for i in range(k)]) / -t.hand.size_T[:, :1]
    lp = program(EDGES * (k + path.support_mode.shape[1]), k)
    held, value, _ = balance(
        t.hand, path, 0, 0, a.grasp.holds, np.full(k, STAY, np.int16), a.grasp.p_OC, normals, np.zeros((k, 3)),
        t.router.margins, False, lp,
    )  # fmt: skip
    assert held
    assert mine <= value + 1e-9


def test_a_card_is_lifted_only_where_a_finger_gets_beneath_it() -> None:
    """Flat on the table it can be slid; the further it reaches over the edge, the less lifts it."""
    t = prepare(load("card-edge"), Settings())
    lifts, slides = [], []
    for x in (-0.05, -0.03, -0.015, -0.005, 0.005, 0.02):
        pose = at(x, 0, 0.0035)
        lifts.append(force(t, straight(pose, at(x, 0, 0.02))))
        slides.append(force(t, straight(pose, at(x + 0.005, 0, 0.0035))))
    assert lifts[:2] == [np.inf, np.inf]
    assert np.all(np.diff(lifts[2:]) < 0.0)
    assert np.all(np.isfinite(slides))


def test_in_the_air_no_less_than_the_cones_demand_is_needed() -> None:
    """Fingers with friction μ that lift a weight from the sides press with 1/μ weights together, and with 0 from below."""
    t = task("sphere")
    mu = (1.0 - t.router.margins.friction) * t.hand.mu[0]
    value = still(t, at(0, 0, 0.1))
    assert 1.0 / np.sqrt(1.0 + mu**2) - 1e-9 <= value <= 1.0 / mu


def test_what_rests_needs_no_force_and_what_weighs_nothing_neither() -> None:
    lying = task("box", ("table",))
    assert still(lying, at(0, 0, 0.025)) == 0.0
    assert still(lying, at(0, 0, 0.05)) > 0.0
    assert still(task("box", gravity=(0.0, 0.0, 0.0)), at(0, 0, 0.1)) == 0.0


def test_a_strength_that_does_not_suffice_holds_nothing() -> None:
    """All fingers together are as strong as is needed, or by 1 % less."""
    t = task("box")
    pose = at(0.0, 0.0, 0.1)
    needed = still(t, pose)
    for part, holds in ((1.01, True), (0.99, False)):
        hand = dataclasses.replace(t.hand, cap=np.full(2, 0.5 * part * needed))
        r = t.router
        found = arc_force(hand, t.supports, straight(pose, pose), r.points, r.margins, r.gravity)
        assert np.isfinite(found) is np.bool_(holds)


def test_a_single_agent_holds_at_one_point() -> None:
    """It pushes a box along a table and tips it over an edge, but lifts nothing, even where two would at the same points."""
    one = task("box", ("table",), agents=({"name": "finger1"},))
    two = task("box", ("table",))
    pose = at(0, 0, 0.025)
    up, push = straight(pose, at(0, 0, 0.05)), straight(pose, at(0.01, 0, 0.025))
    assert force(one, up) == np.inf > force(two, up)
    assert np.inf > force(one, push) >= force(two, push) > 0.0
    g = graph(task("box", ("table",), start=(0.0, 0.0, 0.025)))
    ways = [g.arcs[START, b] for b in g.neighbours(START)]
    pivots = [way for way in ways if way.kind == "pivot"]
    assert any(np.isfinite(force(one, way)) for way in pivots)


def test_the_force_is_the_mean_of_three_moments() -> None:
    """A box that is lifted off its table costs nothing while it still lies there, and from then on what it does in the air."""
    t = task("box", ("table",))
    high = still(t, at(0, 0, 0.08))
    assert force(t, straight(at(0, 0, 0.08), at(0.01, 0, 0.08))) == pytest.approx(high, rel=1e-6)
    lift = force(t, straight(at(0, 0, 0.025), at(0, 0, 0.15)))
    assert lift > 0.0
    assert lift >= high * (1.0 - 1e-6)  # as it begins a finger has no room beneath


@pytest.mark.parametrize("bodies", [("table", "wall"), ("edge", "post")])
def test_room_is_where_a_tip_is_clear_of_all_bodies(bodies: tuple[str, ...]) -> None:
    """A ball of the tip's size at every point, by MuJoCo's distances."""
    t = task("box", bodies)
    points = touchable(t.hand, 0.0015)
    ball = task("sphere", bodies, object={"shape": "sphere", "size": [points.tip], "mass": 0.1})
    distances, verdicts = Distances(ball), []
    for pose in (at(0.03, 0, 0.025), at(0, 0, 0.03, 0.2, 0.3, 0.4), at(-0.01, 0.02, 0.06, 1.0, 0.5, 0.2)):
        for c in range(POINTS):
            gap = distances(np.eye(3), pose[0] @ (points.p_O[c] + points.tip * points.n_O[c]) + pose[1]).min()
            if abs(gap - 0.0015) < 2e-6:
                continue
            verdicts.append(has_room(t.hand, points, c, *pose))
            assert verdicts[-1] == (gap > 0.0015)
    assert 20 < sum(verdicts) < len(verdicts) - 20


def test_out_of_reach_of_all_agents_is_no_room() -> None:
    """The tip's centre as far from a base as the stretched finger is the limit."""
    t = task("sphere")
    points, base = touchable(t.hand, 0.0015), t.hand.chains.p_WB
    away = base[0] - base[1]
    away /= np.linalg.norm(away)
    c = int(np.argmax(points.n_O @ away))
    centre = points.p_O[c] + points.tip * points.n_O[c]
    for far, room in ((0.999, True), (1.001, False)):
        assert has_room(t.hand, points, c, np.eye(3), base[0] + far * t.hand.reach[0] * away - centre) is room
