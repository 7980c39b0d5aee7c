"""The Allegro hand has the published joint frames, on both sides."""

import os
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from regrasp.scene import allegro
from regrasp.scene.load import validate
from regrasp.scene.pose import Pose
from regrasp.scene.world import World, build

PUBLISHED = Path(os.environ.get("MENAGERIE_ROOT", "")) / "wonik_allegro"
PREFIX = {"index": "ff", "middle": "mf", "ring": "rf", "thumb": "th"}
LINKS = ("base", "proximal", "medial", "distal")
AWAY = {"pose": {"position": [0.08, 0, 0.4]}}


def world_of(**hand: Any) -> World:
    model = {"hand": "allegro", **hand}
    ball = {"shape": "sphere", "size": [0.03], "mass": 0.1}
    return build(validate({"name": "hand", "model": model, "object": ball, "start": AWAY, "goal": AWAY}))


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="MENAGERIE_ROOT names no directory with wonik_allegro")
@pytest.mark.parametrize("side", ["right", "left"])
def test_every_link_moves_as_the_published_hand(side: str) -> None:
    world = world_of(side=side)
    ours, theirs = world.model, mujoco.MjModel.from_xml_path(str(PUBLISHED / f"{side}_hand.xml"))
    data, other = mujoco.MjData(ours), mujoco.MjData(theirs)
    palm = ours.body("palm").id
    rng = np.random.default_rng(5)
    for _ in range(20):
        for agent in world.agents:
            theirs_joints = [theirs.joint(f"{PREFIX[agent.name]}j{i}") for i in range(4)]
            np.testing.assert_allclose([agent.lower, agent.upper], np.array([j.range for j in theirs_joints]).T)
            data.qpos[agent.qpos] = rng.uniform(agent.lower, agent.upper)
            other.qpos[[j.qposadr[0] for j in theirs_joints]] = data.qpos[agent.qpos]
        other.qpos[:7] = [*data.xpos[palm], *ours.body_quat[palm]]
        mujoco.mj_kinematics(ours, data)
        other.qpos[:3] = data.xpos[palm]
        mujoco.mj_kinematics(theirs, other)
        for agent in world.agents:
            for i, link in enumerate(LINKS):
                mine = ours.body(f"{agent.name}/link{i + 1}").id
                published = theirs.body(f"{PREFIX[agent.name]}_{link}").id
                # The published numbers have six digits.
                np.testing.assert_allclose(data.xpos[mine], other.xpos[published], atol=2e-6)
                np.testing.assert_allclose(data.xmat[mine], other.xmat[published], atol=1e-5)


def test_the_left_hand_is_the_right_one_in_a_mirror() -> None:
    right, left = world_of(side="right"), world_of(side="left")
    data, mirrored = mujoco.MjData(right.model), mujoco.MjData(left.model)
    rng = np.random.default_rng(6)
    for a, b in zip(right.agents, left.agents, strict=True):
        data.qpos[a.qpos] = mirrored.qpos[b.qpos] = rng.uniform(a.lower, a.upper)
        if a.name != "thumb":
            mirrored.qpos[b.qpos[0]] *= -1.0  # both sides spread their fingers about the same axis
    mujoco.mj_kinematics(right.model, data)
    mujoco.mj_kinematics(left.model, mirrored)
    tips = [agent.tip_geom for agent in right.agents]
    np.testing.assert_allclose(data.geom_xpos[tips] * [1, -1, 1], mirrored.geom_xpos[tips], atol=1e-12)


def test_the_palm_s_face_is_where_the_scene_puts_it() -> None:
    """A pose turned over looks down; the palm's box ends in the plane z = 0 of that pose and is around its origin."""
    pose = Pose(position=(0.1, -0.2, 0.5), euler=(np.pi, 0.0, 0.3))
    world = world_of(pose=pose.model_dump(exclude_defaults=True))
    data = mujoco.MjData(world.model)
    mujoco.mj_kinematics(world.model, data)
    geom = world.model.geom("palm").id
    centre = pose.R.T @ (data.geom_xpos[geom] - pose.p)
    np.testing.assert_allclose(centre, [0, 0, -allegro.PALM_SIZE[0]], atol=1e-12)


def test_no_links_overlap_in_the_rest_posture() -> None:
    world = world_of()
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.start
    mujoco.mj_kinematics(world.model, data)
    gaps = [mujoco.mj_geomDistance(world.model, data, a, b, 0.1, None) for a, b in world.collision_pairs]
    assert min(gaps) > 0.002


def test_unlisted_fingers_are_obstacles_and_the_palm_can_carry() -> None:
    scene = validate({
        "name": "three", "model": {"hand": "allegro", "home": {"ring": [0, 0, 0, 0]}}, "supports": ["palm"],
        "object": {"shape": "sphere", "size": [0.03], "mass": 0.1}, "start": AWAY, "goal": AWAY,
        "agents": [{"name": "thumb"}, {"name": "index"}],
    })  # fmt: skip
    world = build(scene)
    assert [agent.name for agent in world.agents] == ["thumb", "index"]
    assert world.model.njnt == 9
    assert world.model.geom("ring/tip").id in world.static_geoms
    assert world.support_geoms.tolist() == [world.model.geom("palm").id]
