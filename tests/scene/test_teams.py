"""Teams: the published arm, the platform's and the flying tip's kinematics, and robots that take no part."""

import math
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp.errors import InputError
from regrasp.scene import mobile, ur5e
from regrasp.scene.load import validate
from regrasp.scene.world import World, build

POSES = {"start": {"pose": {"position": [0, 0, 0.5]}}, "goal": {"pose": {"position": [0, 0, 0.5]}}}
BALL = {"shape": "sphere", "size": [0.05], "mass": 0.1}
FLYING = {
    "hand": "flying",
    "bases": [[0.2, 0.1, 0.5], [-0.2, 0.0, 0.6]],
    "workspaces": [{"position": [0.0, 0.1, 0.5], "size": [0.4, 0.3, 0.2]}],
}
MOBILE = {
    "hand": "mobile",
    "bases": [{"position": [1.0, 0.5], "angle": 2.0}, {"position": [-1.0, 0.0], "home": [0.3, 0.4, -0.5]}],
    "room": {"size": [2, 2]},
}
ARMS = {
    "hand": "ur5e",
    "bases": [{"position": [0.8, 0, 0.1], "euler": [0, 0, 3]}, {"position": [-0.8, 0, 0], "euler": [0.2, 0, 0]}],
}
TEAMS = [pytest.param(FLYING, id="flying"), pytest.param(MOBILE, id="mobile"), pytest.param(ARMS, id="ur5e")]


def world_of(model: dict[str, Any], **more: Any) -> World:
    return build(validate({"name": "team", "model": model, "object": BALL, **POSES, **more}))


def tip_pose(world: World, geom: str, joints: np.ndarray | None = None) -> np.ndarray:
    """(4, 4), the first agent at `joints`, the others at rest."""
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.start
    if joints is not None:
        data.qpos[world.agents[0].qpos] = joints
    mujoco.mj_kinematics(world.model, data)
    X, g = np.eye(4), world.model.geom(geom).id
    X[:3, :3], X[:3, 3] = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g]
    return X


@pytest.mark.parametrize("model", TEAMS)
def test_six_joints_move_the_tip_in_any_way_from_rest(model: dict[str, Any]) -> None:
    world = world_of(model)
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.start
    mujoco.mj_forward(world.model, data)
    for agent in world.agents:
        J = np.empty((6, world.model.nv))
        mujoco.mj_jac(world.model, data, J[:3], J[3:], data.geom_xpos[agent.tip_geom], agent.tip_body)
        assert len(agent.joints) == 6
        assert np.linalg.cond(J[:, agent.dofs]) < 30


@pytest.mark.parametrize("model", TEAMS)
def test_who_takes_no_part_stands_in_its_rest_posture(model: dict[str, Any]) -> None:
    everybody = world_of(model)
    first, second = (agent.name for agent in everybody.agents)
    alone = world_of(model, agents=[{"name": first}])
    for name in (first, second):
        np.testing.assert_allclose(tip_pose(alone, f"{name}/tip"), tip_pose(everybody, f"{name}/tip"), atol=1e-12)
    assert alone.model.geom(f"{second}/tip").id in alone.static_geoms


@pytest.mark.parametrize("model", TEAMS)
def test_at_rest_nobody_touches_itself_or_others(model: dict[str, Any]) -> None:
    world = world_of(model)
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.start
    mujoco.mj_forward(world.model, data)
    assert data.ncon == 0


def test_a_flying_tip_reaches_the_corners_of_its_workspace_and_turns_about_its_centre() -> None:
    world = world_of(FLYING)
    agent = world.agents[0]
    for joints, corner in ((agent.lower, [-0.4, -0.2, 0.3]), (agent.upper, [0.4, 0.4, 0.7])):
        q = np.where(np.isfinite(joints), joints, 0.0)
        np.testing.assert_allclose(tip_pose(world, "tip1/tip", q)[:3, 3], corner, atol=1e-12)
    turned = tip_pose(world, "tip1/tip", np.array([0, 0, 0, 0.3, -0.4, 2.0]))
    np.testing.assert_allclose(turned[:3, 3], FLYING["bases"][0], atol=1e-12)
    np.testing.assert_allclose(turned[:3, :3], Rotation.from_euler("ZYX", [0.3, -0.4, 2.0]).as_matrix(), atol=1e-12)


def test_a_mobile_robots_tip_is_where_platform_shoulder_roll_and_bend_put_it() -> None:
    world = world_of(MOBILE)
    rng = np.random.default_rng(4)
    for _ in range(20):
        x, y, yaw, shoulder, roll, bend = q = np.array(
            [*rng.uniform(-2, 2, 3), *rng.uniform(mobile.LOWER, mobile.UPPER)]
        )
        arm = Rotation.from_euler("ZY", [yaw, -shoulder])
        tool = arm * Rotation.from_euler("XY", [roll, -bend])
        wrist = np.array([x, y, 0.55]) + arm.apply([mobile.ARM + mobile.FOREARM, 0, 0])
        X = tip_pose(world, "robot1/tip", q)
        np.testing.assert_allclose(X[:3, 3], wrist + tool.apply([0.2, 0, 0]), atol=1e-12)
        np.testing.assert_allclose(X[:3, :3], tool.as_matrix(), atol=1e-12)


def test_the_ur5e_is_the_denavit_hartenberg_product() -> None:
    world = world_of({**ARMS, "bases": [{"position": [0, 0, 0], "euler": [0, 0, math.pi]}]})
    rng = np.random.default_rng(5)
    for q in [np.zeros(6), *rng.uniform(-ur5e.RANGE, ur5e.RANGE, (20, 6))]:
        T = np.eye(4)
        for theta, d, a, alpha in zip(q, ur5e.D, ur5e.A, ur5e.ALPHA, strict=True):
            c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
            T = T @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        T[:3, 3] += 0.2 * T[:3, 2]
        np.testing.assert_allclose(tip_pose(world, "arm1/tip", q), T, atol=1e-9)


def test_the_ur5e_weighs_what_is_published_where_it_is_published() -> None:
    world = world_of({**ARMS, "bases": [{"position": [0, 0, 0], "euler": [0, 0, math.pi]}]})
    model, data = world.model, mujoco.MjData(world.model)
    links = [model.body(f"arm1/link{i + 1}").id for i in range(6)]
    np.testing.assert_allclose(model.body_mass[links], [3.761, 8.058, 2.846, 1.37, 1.3, 0.365], rtol=1e-5)
    mujoco.mj_kinematics(model, data)
    # By hand, all angles zero: the upper arm lies along −x at the shoulder's height, its tube beside it by 0.11336 m.
    np.testing.assert_allclose(data.xipos[links[1]], [-0.425 + 0.2125, -0.11336, 0.1625], atol=1e-6)


@pytest.mark.parametrize(
    ("model", "field", "reason"),
    [
        ({**FLYING, "bases": [[0.5, 0, 0.5]]}, "model", "base 1 is outside its workspace"),
        ({**FLYING, "workspaces": FLYING["workspaces"] * 3}, "model", "3 workspaces for 2 tips"),
        ({**MOBILE, "bases": [{"position": [0, 0]}, {"position": [0, 2]}]}, "model", "base 2 is outside the room"),
        ({**MOBILE, "shoulder": 0.2}, "model.shoulder", "greater than or equal to 0.45"),
        ({**ARMS, "fingers": 3}, "model.fingers", "unknown key"),
        ({"hand": "ur10"}, "model", "neither a built-in hand nor a model of your own"),
    ],
)
def test_what_cannot_stand_there_is_said(model: dict[str, Any], field: str, reason: str) -> None:
    with pytest.raises(InputError) as found:
        validate({"name": "team", "model": model, "object": BALL, **POSES})
    assert found.value.field == field
    assert reason in found.value.reason
