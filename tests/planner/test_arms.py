"""Arms that carry hands: MuJoCo's kinematics and distances as oracles, and what it means to go with the object."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from regrasp.planner.arms import SHARES, SPURT, arms_hit, carried, poses_of, ways
from regrasp.planner.hand import RANGE_MARGIN, Hand, geom_index, hand_of
from regrasp.planner.path import interpolate, nominal_path
from regrasp.planner.turns import from_rotvec, rotvec
from regrasp.scene.load import load
from regrasp.scene.world import World, build

Array = np.ndarray
CRANE = str(Path(__file__).parents[2] / "examples" / "crane.yaml")
SCENES = ["arm-hand-carry", CRANE]


def made(scene: str) -> tuple[World, Hand]:
    world = build(load(scene))
    return world, hand_of(world)


def route(world: World, n: int = 40) -> tuple[Array, Array]:
    """The object's poses straight from start to goal."""
    start, goal = world.scene.start.pose, world.scene.goal.pose
    return interpolate((start.R, start.p), (goal.R, goal.p), np.linspace(0.0, 1.0, 12 * n + 1))


def random_joints(world: World, rng: np.random.Generator, count: int) -> Array:
    arm = world.arms[0]
    return rng.uniform(np.maximum(arm.lower, -3.0), np.minimum(arm.upper, 3.0), (count, len(arm.joints)))


@pytest.mark.parametrize("scene", SCENES)
def test_palms_and_bodies_are_where_mujoco_has_them(scene: str) -> None:
    world, hand = made(scene)
    data, index, q = mujoco.MjData(world.model), geom_index(world), random_joints(world, np.random.default_rng(0), 10)
    R_WP, p_WP, R_WG, p_WG = poses_of(hand, q)
    for s, joints in enumerate(q):
        data.qpos[:] = world.start
        data.qpos[world.arms[0].qpos] = joints
        mujoco.mj_kinematics(world.model, data)
        np.testing.assert_allclose(R_WP[1, s], data.xmat[world.arms[0].body].reshape(3, 3), atol=1e-12)
        np.testing.assert_allclose(p_WP[1, s], data.xpos[world.arms[0].body], atol=1e-12)
        for g in world.arms[0].geoms:
            (row,) = index[int(g)]
            np.testing.assert_allclose(R_WG[s, row - hand.arm_geom], data.geom_xmat[g].reshape(3, 3), atol=1e-12)
            np.testing.assert_allclose(p_WG[s, row - hand.arm_geom], data.geom_xpos[g], atol=1e-12)


@pytest.mark.parametrize("scene", SCENES)
def test_arms_hit_what_mujoco_says_they_hit(scene: str) -> None:
    world, hand = made(scene)
    rng, model, data = np.random.default_rng(1), world.model, mujoco.MjData(world.model)
    carried = {int(g) for g in world.arms[0].geoms}
    fingers = {int(g) for agent in world.agents for g in agent.geoms}
    pairs = [p for p in world.collision_pairs if set(map(int, p)) & carried and not set(map(int, p)) & fingers]
    q = random_joints(world, rng, 150)
    _, _, R_WG, p_WG = poses_of(hand, q)
    (R_WO, p_WO), hits, near = route(world, 1), 0, 1e-3
    for s, joints in enumerate(q):
        data.qpos[:] = world.start
        data.qpos[world.arms[0].qpos] = joints
        mujoco.mj_kinematics(model, data)
        least = min(mujoco.mj_geomDistance(model, data, int(a), int(b), 1.0, None) for a, b in pairs)
        if abs(least) > near:
            hit = arms_hit(hand, R_WG[s : s + 1], p_WG[s : s + 1], R_WO[:1], p_WO[:1], 0.0) == 0
            assert hit == (least < 0.0)
            hits += hit
    assert 0 < hits < 150


@pytest.mark.parametrize("scene", SCENES)
def test_the_palm_goes_with_the_object_and_takes_its_share_of_the_turn(scene: str) -> None:
    world, hand = made(scene)
    R, p = route(world)
    found = ways(hand, R, p, hand.arm_home, 0.003)
    assert len(found) == len(SHARES) + 1
    for share, q in zip(SHARES, found, strict=False):
        R_WP, p_WP, _, _ = poses_of(hand, q)
        turns = from_rotvec(share * rotvec(R @ R[0].T))
        np.testing.assert_allclose(R_WP[1], turns @ R_WP[1, 0], atol=1e-6)
        np.testing.assert_allclose(p_WP[1], p + turns @ (p_WP[1, 0] - p[0]), atol=1e-6)
        assert np.all((q >= hand.arms.lower) & (q <= hand.arms.upper))
        assert np.abs(np.diff(q, axis=0)).max() <= SPURT
    np.testing.assert_array_equal(found[-1], np.tile(hand.arm_home, (len(R), 1)))


def test_an_arm_takes_the_share_of_a_turn_that_its_joints_allow() -> None:
    """The crane turns by 0.5 rad at most: of 0.9 rad half, of 0.4 rad about another axis nothing."""
    _, hand = made(CRANE)
    p = np.zeros((241, 3)) + [-0.1, 0.0, 0.08]
    u = np.linspace(0.0, 1.0, 241)[:, None]
    yaw, tilt = from_rotvec(u * [0.0, 0.0, 0.9]), from_rotvec(u * [0.4, 0.0, 0.0])
    turned = ways(hand, yaw, p, hand.arm_home, 0.003)
    assert abs(turned[0][-1, 3]) == pytest.approx(0.45, abs=1e-6)
    assert abs(turned[0][-1, 3]) < 0.5 - RANGE_MARGIN
    still = np.tile(hand.arm_home, (241, 1))
    for q in ways(hand, tilt, p, hand.arm_home, 0.003):
        np.testing.assert_allclose(q, still, atol=1e-7)


def test_an_arm_that_something_stops_does_not_go() -> None:
    """The joints would take the palm into the floor, 0.4 m beneath it."""
    world, hand = made("arm-hand-carry")
    R, p = route(world)
    down = p[0] - np.linspace(0.0, 0.42, len(p))[:, None] * [0.0, 0.0, 1.0]
    still = np.tile(np.eye(3), (len(R), 1, 1))
    assert carried(hand, still, down, hand.arm_home) is not None
    (only,) = ways(hand, still, down, hand.arm_home, 0.003)
    assert np.ptp(only, axis=0).max() == 0.0


def test_a_path_has_the_object_in_the_palm() -> None:
    """X_WP X_PO = X_WO at every sample, and nothing but the world where no arm is."""
    world, hand = made(CRANE)
    R, p = route(world, 4)
    path = nominal_path(R, p, 4, 12, np.array(world.scene.gravity), hand, (), ways(hand, R, p, hand.arm_home, 0.003)[0])
    np.testing.assert_allclose(path.R_WP[1] @ path.R_PO[1], path.R_WO, atol=1e-12)
    there = (path.R_WP[1] @ path.p_PO[1][..., None])[..., 0] + path.p_WP[1]
    np.testing.assert_allclose(there, path.p_WO, atol=1e-12)
    np.testing.assert_allclose(path.p_PO[1], np.broadcast_to(path.p_PO[1, 0, 0], path.p_PO[1].shape), atol=1e-9)
    _, fixed = made("allegro-cube")
    assert nominal_path(R, p, 4, 12, np.zeros(3), fixed, ()).R_PO.shape[0] == 1
