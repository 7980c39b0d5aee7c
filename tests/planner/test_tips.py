"""Tips of any shape: MuJoCo's distances see them stand, roll and slide on the object as planned."""

import dataclasses
import functools

import mujoco
import numpy as np
import pytest
from arcs import Arc, Oracle, arc, changed, made
from scipy.spatial.transform import Rotation

from regrasp.kernels.sampling import sample
from regrasp.kernels.surfaces import BOX, CAPSULE, ELLIPSOID, SPHERE
from regrasp.planner.method import plan_scene
from regrasp.planner.motions import SLIDE_MINUS_Y
from regrasp.planner.task import Settings
from regrasp.planner.tips import over, sharpest, tip_gap, touches_in_a_point, under
from regrasp.scene.load import load
from regrasp.scene.schema import Scene
from regrasp.scene.world import World
from regrasp.verify.check import check

EGG = {"shape": "ellipsoid", "size": [0.011, 0.014, 0.017]}
PILL = {"shape": "capsule", "size": [0.012, 0.008]}
PUCK = {"shape": "box", "size": [0.012, 0.012, 0.014], "rounding": 0.006}
LYING = {"position": [0, 0, 0], "euler": [0, 1.5707963267948966, 0]}
TIPS = {
    "fig3-puma3": (EGG, PILL, PUCK),
    "fig2-planar": (EGG, {**EGG, "pose": LYING}, {**PILL, "size": [0.012, 0.006], "pose": LYING}),
}


def shaped(name: str) -> Scene:
    """A built-in scene with other tips."""
    return changed(load(name), agents=[{"name": f"finger{i + 1}", "tip": tip} for i, tip in enumerate(TIPS[name])])


@functools.cache
def mixed(name: str) -> Arc:
    return made(shaped(name))


def apart(world: World, data: mujoco.MjData, i: int) -> float:
    """Distance of agent i's tip from the object."""
    return min(
        mujoco.mj_geomDistance(world.model, data, int(g), int(o), 0.05, None)
        for g in world.agents[i].tip_geoms
        for o in world.object_geoms
    )


def test_a_tip_stands_over_the_surface_as_high_as_asked() -> None:
    a = mixed("fig3-puma3")
    hand, rng = a.hand, np.random.default_rng(0)
    R_WO, p_WO = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
    points, normals = sample(hand.kind_O, hand.size_O, hand.grids, 20)
    for i in range(3):
        for p_O, n_O in zip(points, normals, strict=True):
            R_WT, height = Rotation.random(random_state=rng).as_matrix(), float(rng.uniform(0.0, 0.004))
            p_WT, p, n, p_TC = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
            over(hand, i, R_WO, p_WO, p_O, n_O, height, R_WT, p_WT)
            R_OT = np.ascontiguousarray(R_WO.T @ R_WT)
            assert tip_gap(hand, i, R_OT, R_WO.T @ (p_WT - p_WO), p, n) == pytest.approx(height, abs=1e-9)
            np.testing.assert_allclose(p, p_O, atol=1e-7)
            under(hand, i, R_OT, n_O, p_TC)
            np.testing.assert_allclose(R_WT @ p_TC + p_WT, R_WO @ (p_O + height * n_O) + p_WO, atol=1e-12)


@pytest.mark.parametrize("name", TIPS)
def test_tips_touch_where_the_start_grasp_says(name: str) -> None:
    a = mixed(name)
    oracle = Oracle(a.task)
    oracle.put(a.path.R_WO[0, 0], a.path.p_WO[0, 0], a.grasp.q)
    for i in np.flatnonzero(a.grasp.holds):
        R, p = oracle.tip(i)
        assert apart(a.task.world, oracle.data, i) == pytest.approx(0.0, abs=2e-6)
        contact = a.path.R_WO[0, 0] @ a.grasp.p_OC[i] + a.path.p_WO[0, 0]
        np.testing.assert_allclose(R @ a.grasp.p_TC[i] + p, contact, atol=1e-6)


@pytest.mark.parametrize("name", TIPS)
def test_the_contact_stays_closed_while_tips_of_any_shape_roll_and_slide(name: str) -> None:
    a = mixed(name)
    n, k = len(a.path.R_WO), len(a.task.names)
    V = np.random.default_rng(0).integers(0, SLIDE_MINUS_Y + 1, (n, k)).astype(np.int16)
    problem = a.problem(V)
    motion = a.motion(problem)
    lost = np.logical_or.accumulate(problem.found.lost[problem.current.at[1:]] == 1, axis=0)
    assert not lost.all()
    oracle, worst = Oracle(a.task), 0.0
    for j in range(n):
        for s in range(a.path.R_WO.shape[1]):
            oracle.put(a.path.R_WO[j, s], a.path.p_WO[j, s], motion.joints[j, s])
            for i in np.flatnonzero(~lost[j]):
                worst = max(worst, abs(apart(a.task.world, oracle.data, i)))
    assert worst <= 5e-6  # MuJoCo's own distances are no finer


@pytest.mark.parametrize("name", TIPS)
def test_a_plan_with_tips_of_any_shape_is_certified(name: str) -> None:
    outcome = plan_scene(shaped(name), 0, Settings())
    assert outcome.plan is not None, str(outcome.failure)
    certificate = check(outcome.plan)
    assert certificate.passed, [str(finding) for finding in certificate.refusals]


def test_a_face_on_a_face_is_no_contact_that_can_move() -> None:
    a = mixed("fig3-puma3")
    hand = dataclasses.replace(a.hand, kind_O=BOX, size_O=np.array([0.03, 0.03, 0.03, 0.004]))
    p_OC, p_TC = np.array([0.03, 0.002, 0.001]), np.empty(3)
    for tilt, fine in ((0.0, False), (0.2, True)):
        R_OT = Rotation.from_rotvec([0.0, tilt, 0.5 * tilt]).as_matrix()
        under(hand, 2, R_OT, np.array([1.0, 0.0, 0.0]), p_TC)
        assert touches_in_a_point(hand, 2, p_OC, p_TC, R_OT) == fine


def test_the_sharpest_ball_touches_within_every_tip() -> None:
    for kind, size in ((SPHERE, [0.01, 0, 0, 0]), (ELLIPSOID, [0.01, 0.02, 0.015, 0]), (CAPSULE, [0.01, 0.02, 0, 0]),
                       (BOX, [0.01, 0.02, 0.015, 0.003])):  # fmt: skip
        size = np.array(size)
        r = sharpest(kind, size)
        points, normals = sample(kind, size, arc("fig3-puma3").hand.grids, 100)
        for p, n in zip(points, normals, strict=True):
            centre = p - r * n
            assert np.all(np.linalg.norm(points - centre, axis=1) >= r - 1e-12)
