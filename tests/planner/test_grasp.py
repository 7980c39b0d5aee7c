"""Start grasps: found ones balance with room to spare and are clear, given ones are what was given."""

import dataclasses
import functools

import numpy as np
import pytest
from arcs import SMALL, Arc, Oracle, arc, changed, height, made
from scipy.optimize import linprog

from regrasp.kernels.chains import forward
from regrasp.planner.ahead import OUT, look_over, nothing_ahead
from regrasp.planner.arcs import straight
from regrasp.planner.chain import ContactMotions
from regrasp.planner.choices import drawn, grasp_cost, improve, new_weighing
from regrasp.planner.collision import place_agent
from regrasp.planner.configurations import bodies_along
from regrasp.planner.grasp import continued, given_grasp, nothing
from regrasp.planner.motions import OFF, ONTO, STAY
from regrasp.planner.outcome import Failure
from regrasp.planner.pieces import first_piece
from regrasp.planner.stances import find_grasp
from regrasp.planner.task import prepare
from regrasp.scene.load import load

NAMES = ("fig3-puma3", "fig4-relocation", "fig2-planar", "puma4-obstacles")
EDGES = 64  # the polygon around the circle is 0.1 % wider


def balances(a: Arc, use: float) -> bool:
    """Whether forces in cones of `use` times μ hold the object at the start (HiGHS)."""
    columns, caps = [], []
    spots = [(a.grasp.p_OC[i], -normal(a, i), use * a.hand.mu[i], a.hand.cap[i]) for i in np.flatnonzero(a.grasp.holds)]
    for slot in np.flatnonzero(a.path.support_mode[0] == 1):
        p, n = a.path.support_p_O[0, 0, slot], a.path.support_n_O[0, 0, slot]
        spots.append((p, n, use * a.path.support_mu[slot], 1e6))
    for number, (p, n, mu, _) in enumerate(spots):
        x = np.linalg.svd(n[None])[2][1]
        for angle in np.arange(EDGES) * 2 * np.pi / EDGES:
            f = n + mu / np.cos(np.pi / EDGES) * (np.cos(angle) * x + np.sin(angle) * np.cross(n, x))
            columns.append([*f, *np.cross(p - a.hand.p_OM_O, f) / a.hand.radius])
            caps.append(number)
    rows = np.equal.outer(np.arange(len(spots)), caps).astype(float)
    result = linprog(
        np.zeros(len(columns)), A_ub=rows, b_ub=[spot[3] for spot in spots], A_eq=np.array(columns).T,
        b_eq=[*a.path.up_O[0, 0], 0.0, 0.0, 0.0], method="highs",
    )  # fmt: skip
    return bool(result.success)


def normal(a: Arc, i: int) -> np.ndarray:
    """Outward normal at agent i's contact: from there to the tip's centre."""
    g = a.grasp
    return -(g.R_OT[i] @ g.p_TC[i]) / a.hand.size_T[i, 0]


@pytest.mark.parametrize("name", NAMES)
def test_a_found_grasp_touches_balances_and_is_clear(name: str) -> None:
    """60 % of μ suffices; tips touch to 1e-6 m; everything else keeps the clearance by MuJoCo's distances."""
    a = arc(name)
    assert np.all(a.grasp.holds == 1)
    assert balances(a, a.task.settings.grasp.friction_use)
    oracle = Oracle(a.task)
    R, p = a.path.R_WO[0, 0], a.path.p_WO[0, 0]
    oracle.put(R, p, a.grasp.q)
    assert oracle.clear() >= a.terms.clearance - 1e-6
    assert oracle.folded() >= -1e-6
    for i in range(len(a.task.names)):
        R_WT, p_WT = oracle.tip(i)
        centre = R.T @ (p_WT - p)
        assert height(a, centre) == pytest.approx(a.hand.size_T[i, 0], abs=1e-6)
        np.testing.assert_allclose(R.T @ R_WT, a.grasp.R_OT[i], atol=1e-9)
        np.testing.assert_allclose(a.grasp.p_OC[i] - a.grasp.R_OT[i] @ a.grasp.p_TC[i], centre, atol=1e-6)


def test_an_agent_that_is_off_rests_and_the_others_hold() -> None:
    scene = load("fig4-relocation")
    pose = scene.start.pose.model_dump(mode="json", exclude_defaults=True)
    a = made(changed(scene, start={"pose": pose, "off": ["finger2"]}))
    assert a.grasp.holds.tolist() == [1, 0, 1, 1]
    np.testing.assert_array_equal(a.grasp.q[a.joints(1)], a.hand.home[a.joints(1)])
    assert balances(a, a.task.settings.grasp.friction_use)
    oracle = Oracle(a.task)
    oracle.put(a.path.R_WO[0, 0], a.path.p_WO[0, 0], a.grasp.q)
    assert oracle.clear() >= -1e-6


def given(contacts: list[dict], position: list[float] | None = None, off: tuple[str, ...] = ()):
    scene = load("fig3-puma3")
    pose = scene.start.pose.model_dump(mode="json", exclude_defaults=True)
    if position:
        pose["position"] = position
    task = prepare(changed(scene, start={"pose": pose, "grasp": contacts, "off": off}), SMALL)
    path = first_piece(task, straight(task.router.start_pose, task.router.goal_pose), None)
    return Arc(task, path, None), given_grasp(task.hand, path, task.world.scene.start.grasp, task.names)


def test_a_grasp_given_by_points_touches_there() -> None:
    auto = arc("fig3-puma3")
    points = auto.grasp.p_OC
    a, grasp = given([{"agent": n, "point": p.tolist()} for n, p in zip(auto.task.names, points, strict=True)])
    assert not isinstance(grasp, Failure)
    np.testing.assert_allclose(grasp.p_OC, points, atol=1e-9)
    oracle = Oracle(a.task)
    R, p = a.path.R_WO[0, 0], a.path.p_WO[0, 0]
    oracle.put(R, p, grasp.q)
    for i in range(3):
        centre = R.T @ (oracle.tip(i)[1] - p)
        assert height(a, centre) == pytest.approx(a.hand.size_T[i, 0], abs=1e-6)
        assert np.linalg.norm(centre - points[i]) == pytest.approx(a.hand.size_T[i, 0], abs=1e-6)


def test_a_given_point_within_reach_is_touched_however_the_tool_has_to_point() -> None:
    """The finger stands under the object and reaches the point with its tool far off the normal only."""
    a, grasp = given([{"agent": "finger1", "point": [0.045, 0, 0]}], [0.4, 0.0, 0.4], ("finger2", "finger3"))
    assert not isinstance(grasp, Failure), str(grasp)
    oracle = Oracle(a.task)
    R, p = a.path.R_WO[0, 0], a.path.p_WO[0, 0]
    oracle.put(R, p, grasp.q)
    R_WT, p_WT = oracle.tip(0)
    np.testing.assert_allclose(R.T @ (p_WT - p), [0.045 + a.hand.size_T[0, 0], 0.0, 0.0], atol=1e-6)
    assert -(R.T @ R_WT @ a.hand.axis_T[0])[0] < np.cos(0.5)  # no solution is nearer to the normal than 31°


def test_points_off_the_surface_are_taken_to_it() -> None:
    auto = arc("fig3-puma3")
    points = auto.grasp.p_OC * 1.1
    a, grasp = given([{"agent": n, "point": p.tolist()} for n, p in zip(auto.task.names, points, strict=True)])
    assert not isinstance(grasp, Failure)
    for p in grasp.p_OC:
        assert np.sum((p / a.hand.size_O[:3]) ** 2) == pytest.approx(1.0, abs=1e-9)


def test_a_grasp_given_by_joints_has_these_joints() -> None:
    """Too far from the object it is refused, with the distance."""
    auto = arc("fig3-puma3")
    q = [auto.grasp.q[auto.joints(i)] for i in range(3)]
    _, grasp = given([{"agent": n, "joints": row.tolist()} for n, row in zip(auto.task.names, q, strict=True)])
    assert not isinstance(grasp, Failure)
    np.testing.assert_allclose(grasp.q, auto.grasp.q, atol=1e-5)
    np.testing.assert_allclose(grasp.p_OC, auto.grasp.p_OC, atol=1e-6)
    q[1] = q[1] + [0, 0.6, 0, 0, 0, 0]
    _, refused = given([{"agent": n, "joints": row.tolist()} for n, row in zip(auto.task.names, q, strict=True)])
    assert isinstance(refused, Failure)
    assert (refused.constraint, refused.agent) == ("grasp", auto.task.names[1])
    assert "mm" in refused.reason


def test_joints_that_bring_a_tip_near_are_completed_to_a_contact() -> None:
    """At the nearest point of the ellipsoid to the tip's centre, pointing as the joints have it."""
    auto = arc("fig3-puma3")
    q = [auto.grasp.q[auto.joints(i)].copy() for i in range(3)]
    q[1] -= [0, 0.05, 0, 0, 0, 0]
    a, grasp = given([{"agent": n, "joints": row.tolist()} for n, row in zip(auto.task.names, q, strict=True)])
    assert not isinstance(grasp, Failure)
    R, p = a.path.R_WO[0, 0], a.path.p_WO[0, 0]
    R_WL, p_WL = np.empty((7, 3, 3)), np.empty((7, 3))
    forward(a.hand.chains, 1, q[1], R_WL, p_WL)
    away = R.T @ (p_WL[6] - p) - grasp.p_OC[1]
    assert np.linalg.norm(away) - a.hand.size_T[1, 0] > 5e-3
    gradient = grasp.p_OC[1] / a.hand.size_O[:3] ** 2
    np.testing.assert_allclose(np.cross(away, gradient) / np.linalg.norm(gradient), 0.0, atol=1e-7)
    pointed = R_WL[6] @ a.hand.axis_T[1]
    forward(a.hand.chains, 1, grasp.q[a.joints(1)], R_WL, p_WL)
    np.testing.assert_allclose(R_WL[6] @ a.hand.axis_T[1], pointed, atol=1e-6)


def test_an_unreachable_point_names_its_agent() -> None:
    names = arc("fig3-puma3").task.names
    points = [[0.045, 0, 0], [-0.02, 0.03, 0], [-0.02, -0.03, 0]]
    _, failure = given([{"agent": n, "point": p} for n, p in zip(names, points, strict=True)], [0.3, 0.0, 0.4])
    assert isinstance(failure, Failure)
    assert failure.constraint == "reach"
    assert failure.agent == names[1]  # the object stands over finger1, which reaches its own point
    assert "start.grasp" in failure.where
    assert "\n" not in str(failure)


@functools.cache
def light() -> Arc:
    """The box of heavy-push, not so heavy: one finger pushes it."""
    scene = load("heavy-push")
    body = scene.object.model_dump(mode="json", exclude_defaults=True)
    return made(changed(scene, object={**body, "mass": 0.2}))


def drawing(a: Arc):
    """The arguments of `drawn` for an arc, all candidates looked over, and the legal ones."""
    hand, path, scan, terms = a.hand, a.path, a.scan(), a.terms
    k, count, geoms = len(hand.tip_geom), len(scan.p_O), int(np.max(np.diff(hand.geom_start)))
    carried = path.support_mode.shape[1] > 0
    R_WB, p_WB = bodies_along(hand, path)
    ahead = nothing_ahead(k, count, geoms)
    rest_R, rest_p = np.zeros((k, geoms, 3, 3)), np.zeros((k, geoms, 3))
    for i in range(k):
        look_over(hand, path, scan, R_WB, p_WB, i, terms, i, ahead, 1)
        q = hand.home[a.joints(i)]
        R_WL, p_WL = np.empty((len(q) + 1, 3, 3)), np.empty((len(q) + 1, 3))
        forward(hand.chains, i, q, R_WL, p_WL)
        place_agent(hand, i, np.eye(3), np.zeros(3), R_WL, p_WL, rest_R[i], rest_p[i])
    legal = [np.append(np.flatnonzero(row >= 0.0), [OUT] * carried).astype(np.int64) for row in ahead.kept]
    counts, table = np.array([len(row) for row in legal]), np.full((k, max(map(len, legal))), OUT)
    for row, free in zip(table, legal, strict=True):
        row[: len(free)] = free
    fixed = (hand, path, terms, np.arange(k), rest_R, rest_p)
    return fixed, (terms.margins, ahead), new_weighing(hand, path), (table, counts), legal


@pytest.mark.parametrize("name", ["fig3-puma3", "fig2-planar", "heavy-push"])
def test_random_choices_are_drawn_until_one_holds(name: str) -> None:
    """Row by row of the numbers: those passed over hold nothing, the one returned costs what it says; all choices legal."""
    fixed, seen, w, (table, counts), legal = drawing(arc(name))
    k = len(counts)
    u, choice, at, found = np.random.default_rng(0).random((400, k)), np.zeros(k, np.int64), 0, 0
    while True:
        before = at
        at, cost = drawn(*fixed, choice, *seen, w, table, counts, u, at)
        rows = [[legal[a][int(u[row, a] * counts[a])] for a in range(k)] for row in range(before, at)]
        costs = [grasp_cost(*fixed, np.array(row), *seen, np.inf, w) for row in rows]
        if cost == np.inf:
            assert at == len(u)
            assert np.all(np.isinf(costs))
            break
        assert np.all(np.isinf(costs[:-1]))
        assert costs[-1] == pytest.approx(cost, rel=1e-9)
        np.testing.assert_array_equal(choice, rows[-1])
        found += 1
    assert found > 1
    assert drawn(*fixed, choice, *seen, w, table, counts, u, len(u)) == (len(u), np.inf)


@pytest.mark.parametrize("name", ["fig3-puma3", "fig2-planar", "heavy-push"])
def test_an_improved_choice_costs_least_among_all_that_differ_in_one_agent(name: str) -> None:
    """Looked at again one by one, with force programs that begin from nothing."""
    fixed, seen, w, (table, counts), legal = drawing(arc(name))
    k, at = len(counts), 0
    u, choice = np.random.default_rng(1).random((400, k)), np.zeros(k, np.int64)
    for _ in range(2):
        at, before = drawn(*fixed, choice, *seen, w, table, counts, u, at)
        cost = improve(*fixed, choice, *seen, before, w)
        assert cost <= before
        assert grasp_cost(*fixed, choice, *seen, np.inf, new_weighing(*fixed[:2])) == pytest.approx(cost, rel=1e-9)
        for a, c in [(a, c) for a, row in enumerate(legal) for c in row]:
            other = choice.copy()
            other[a] = c
            fresh = new_weighing(*fixed[:2])
            assert grasp_cost(*fixed, other, *seen, np.inf, fresh) >= cost - 1e-8
            assert grasp_cost(*fixed, other, *seen, cost - 1e-6, fresh) == np.inf


def test_nobody_has_to_touch_what_a_table_holds_but_somebody_does() -> None:
    """All agents off is no grasp; one alone may be. In the air nobody may be left out."""
    fixed, seen, w, _, legal = drawing(light())
    none = np.full(len(legal), OUT)
    assert grasp_cost(*fixed, none, *seen, np.inf, w) == np.inf
    alone = []
    for i, c in [(i, c) for i, row in enumerate(legal) for c in row if c != OUT]:
        choice = none.copy()
        choice[i] = c
        alone.append(grasp_cost(*fixed, choice, *seen, np.inf, w))
    assert min(alone) < np.inf
    assert all(OUT in row for row in legal)
    assert not any(OUT in row for row in drawing(arc("fig3-puma3"))[-1])


@pytest.mark.parametrize(
    ("name", "off"), [("heavy-push", ()), ("fig3-puma3", ()), ("fig2-planar", (0,)), ("fig2-planar", (2,))]
)
def test_a_stance_says_on_which_candidates_its_agents_stand(name: str, off: tuple[int, ...]) -> None:
    """OUT for those that are off, who rest; the others' contacts are the candidates' points."""
    a = arc(name)
    for seed in range(3):
        scan = a.scan()
        found = find_grasp(
            a.hand, a.path, scan, a.terms, off, a.task.names, a.task.settings.grasp, np.random.default_rng(seed)
        )
        assert not isinstance(found, Failure)
        stance = found[0]
        np.testing.assert_array_equal(stance.candidates != OUT, stance.grasp.holds == 1)
        assert np.all(stance.candidates[list(off)] == OUT)
        for i, c in enumerate(stance.candidates):
            q = stance.grasp.q[a.joints(i)]
            if c == OUT:
                np.testing.assert_array_equal(q, a.hand.home[a.joints(i)])
            else:
                np.testing.assert_array_equal(stance.grasp.p_OC[i], scan.p[scan.row[i, 0, c]])
                np.testing.assert_array_equal(q, scan.q[scan.row[i, 0, c], : len(q)])


@pytest.mark.parametrize("name", ["fig3-puma3", "fig4-relocation", "heavy-push"])
def test_more_restarts_find_no_worse_grasp(name: str) -> None:
    """With the same random numbers, of which the first are the same."""
    a = arc(name)
    fixed, (margins, *seen), w, _, _ = drawing(a)
    use = 1.0 - a.task.settings.grasp.friction_use
    margins = dataclasses.replace(margins, friction=max(margins.friction, use))
    for seed in range(3):
        costs = []
        for restarts in (1, 2, 3, 6):
            settings = dataclasses.replace(a.task.settings.grasp, restarts=restarts)
            found = find_grasp(
                a.hand, a.path, a.scan(), a.terms, (), a.task.names, settings, np.random.default_rng(seed)
            )
            assert not isinstance(found, Failure)
            each = [grasp_cost(*fixed, stance.candidates, margins, *seen, np.inf, w) for stance in found]
            assert each[1:] == sorted(each[1:])  # before them the cheapest that lasts
            costs.append(min(each))
        assert np.all(np.diff(costs) <= 1e-9)


def test_a_V_that_goes_on_begins_with_what_was_looked_at_ahead_and_then_stays() -> None:
    """Agents that are off stay off, as those do that are told to."""
    onward = np.array([[OFF, 3], [ONTO + 5, 2]], np.int16)
    for n in (1, 2, 5):
        V = continued(onward, n)
        assert V.shape == (n, 2)
        np.testing.assert_array_equal(V[:2], onward[:n])
        assert np.all(V[2:] == STAY)
    a = arc("fig4-relocation")
    n = len(a.path.R_WO)
    some = dataclasses.replace(a.grasp, holds=np.array([1, 1, 0, 1], np.uint8))
    now, goes_on = (
        ContactMotions(a.hand, a.path, a.scan(), a.terms, some, V)
        for V in (np.tile(np.where(some.holds == 1, STAY, OFF).astype(np.int16), (n, 1)), continued(nothing(some), n))
    )
    assert goes_on.energy() == pytest.approx(now.energy(), rel=1e-12)
    np.testing.assert_array_equal(goes_on.grasp(n).holds, some.holds)
