"""Start grasps: found ones balance with room to spare and are clear, given ones are what was given."""

import numpy as np
import pytest
from arcs import SMALL, Arc, Oracle, arc, changed, height, made
from scipy.optimize import linprog

from regrasp.planner.arcs import straight
from regrasp.planner.grasp import given_grasp
from regrasp.planner.legs import pieces_of
from regrasp.planner.outcome import Failure
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
    path = pieces_of(task, straight(task.router.start_pose, task.router.goal_pose))[0]
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
    """Off by less than a millimetre it is settled onto the surface; further off it is refused, with the distance."""
    auto = arc("fig3-puma3")
    q = [auto.grasp.q[auto.joints(i)] for i in range(3)]
    _, grasp = given([{"agent": n, "joints": row.tolist()} for n, row in zip(auto.task.names, q, strict=True)])
    assert not isinstance(grasp, Failure)
    np.testing.assert_allclose(grasp.q, auto.grasp.q, atol=1e-5)
    np.testing.assert_allclose(grasp.p_OC, auto.grasp.p_OC, atol=1e-6)
    q[1] = q[1] + [0, 0.1, 0, 0, 0, 0]
    _, refused = given([{"agent": n, "joints": row.tolist()} for n, row in zip(auto.task.names, q, strict=True)])
    assert isinstance(refused, Failure)
    assert (refused.constraint, refused.agent) == ("grasp", auto.task.names[1])
    assert "mm" in refused.reason


def test_an_unreachable_point_names_its_agent() -> None:
    names = arc("fig3-puma3").task.names
    points = [[0.045, 0, 0], [-0.02, 0.03, 0], [-0.02, -0.03, 0]]
    _, failure = given([{"agent": n, "point": p} for n, p in zip(names, points, strict=True)], [0.3, 0.0, 0.4])
    assert isinstance(failure, Failure)
    assert failure.constraint == "reach"
    assert failure.agent == names[1]  # the object stands over finger1, which reaches its own point
    assert "start.grasp" in failure.where
    assert "\n" not in str(failure)
