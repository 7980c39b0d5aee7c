"""Tips of any shape: MuJoCo's distances see them stand, roll and slide on the object as planned."""

import dataclasses
import functools
from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from arcs import Arc, Oracle, arc, changed, made
from scipy.spatial.transform import Rotation

from regrasp.kernels.grids import Grids, grids_of
from regrasp.kernels.sampling import sample
from regrasp.kernels.surfaces import BOX, CAPSULE, ELLIPSOID, MESH, SPHERE, project
from regrasp.planner.method import plan_scene
from regrasp.planner.motions import SLIDE_MINUS_Y
from regrasp.planner.task import Settings
from regrasp.planner.tips import fits, over, sharpest, tip_gap, touches_in_a_point, under
from regrasp.planner.trace import trace_contact
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


def grid_of(distance: Callable[[np.ndarray], np.ndarray], half: float, h: float) -> Grids:
    axis = np.arange(-half, half + 0.5 * h, h)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    return grids_of([(points[0, 0, 0], h, distance(points))])


def test_a_mesh_is_followed_like_the_body_that_it_is_of() -> None:
    a = arc("fig3-puma3")
    lengths, foot, n = a.hand.size_O, np.empty(3), np.empty(3)

    def distance(points: np.ndarray) -> np.ndarray:
        flat = points.reshape(-1, 3)
        values = [project(ELLIPSOID, lengths, a.hand.grids, point, foot, n) for point in flat]
        return np.reshape(values, points.shape[:-1])

    hands = a.hand, dataclasses.replace(
        a.hand, kind_O=MESH, size_O=np.zeros(4), grids=grid_of(distance, 0.06, 2e-3)
    )  # fmt: skip
    m, n_a = a.path.R_WO.shape[1] - 1, a.hand.chains.start[1]
    for command in a.terms.commands[: SLIDE_MINUS_Y + 1]:
        ends = []
        for hand in hands:
            p, p_T, x, n_O = (np.zeros((m + 1, 3)) for _ in range(4))
            R, q = np.zeros((m + 1, 3, 3)), np.zeros((m + 1, n_a))
            p[0], p_T[0], R[0], q[0] = a.grasp.p_OC[0], a.grasp.p_TC[0], a.grasp.R_OT[0], a.grasp.q[:n_a]
            assert trace_contact(hand, a.path, command, np.int64(0), np.int64(0), p, p_T, R, x, q, n_O)
            ends.append((p, q))
        np.testing.assert_allclose(ends[0][0], ends[1][0], atol=1e-5)
        np.testing.assert_allclose(ends[0][1], ends[1][1], atol=1e-4)


@pytest.mark.parametrize("name", TIPS)
def test_the_contact_frame_stays_one(name: str) -> None:
    """Fingers of few joints settle after each step, which moves the contact a little: its tangent goes along."""
    a = mixed(name)
    m, starts = a.path.R_WO.shape[1] - 1, a.hand.chains.start
    for i in np.flatnonzero(a.grasp.holds):
        joints = slice(starts[i], starts[i + 1])
        for command in a.terms.commands[: SLIDE_MINUS_Y + 1]:
            p, p_T, x, n_O = (np.zeros((m + 1, 3)) for _ in range(4))
            R, q = np.zeros((m + 1, 3, 3)), np.zeros((m + 1, joints.stop - joints.start))
            p[0], p_T[0], R[0], q[0] = a.grasp.p_OC[i], a.grasp.p_TC[i], a.grasp.R_OT[i], a.grasp.q[joints]
            trace_contact(a.hand, a.path, command, np.int64(0), np.int64(i), p, p_T, R, x, q, n_O)
            np.testing.assert_allclose(np.sum(x * n_O, axis=1), 0.0, atol=1e-9)
            np.testing.assert_allclose(np.linalg.norm(x, axis=1), 1.0, atol=1e-12)


def test_a_ball_that_touches_two_sides_of_a_waist_does_not_fit() -> None:
    r, apart, tip = 0.02, 0.015, 0.01

    def two_balls(points: np.ndarray) -> np.ndarray:
        return np.minimum(*(np.linalg.norm(points - [s * apart, 0.0, 0.0], axis=-1) - r for s in (-1.0, 1.0)))

    a = arc("fig3-puma3")
    size_T = np.zeros_like(a.hand.size_T)
    size_T[:, 0] = tip
    hand = dataclasses.replace(
        a.hand, kind_O=MESH, size_O=np.zeros(4), size_T=size_T, grids=grid_of(two_balls, 0.045, 1e-3)
    )
    told = []
    for turn in np.linspace(0.0, 2.0, 41):
        n = np.array([np.cos(turn), np.sin(turn), 0.0])
        p = n * r - [apart, 0.0, 0.0]
        beside = np.linalg.norm(p + tip * n - [apart, 0.0, 0.0]) - r - tip
        if abs(beside) > 1e-4 and p[0] < -1e-3:
            told.append(fits(hand, 0, p, -tip * n, np.eye(3)))
            assert told[-1] == (beside > 0.0)
    assert True in told
    assert False in told
