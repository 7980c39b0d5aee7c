"""Wrists: the joints that a hand's fingers share, found in the model, moving or fixed."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from regrasp.errors import InputError
from regrasp.scene.load import load, validate
from regrasp.scene.world import World, build, from_plan

EXAMPLES = Path(__file__).parents[2] / "examples"
SHARED = ["robot/x", "robot/y", "robot/z", "robot/yaw"]


def crane(**model: Any) -> dict[str, Any]:
    scene = yaml.safe_load((EXAMPLES / "crane.yaml").read_text(encoding="utf-8"))
    scene["model"] |= {"file": str(EXAMPLES / "crane.xml"), **model}
    return dict(scene)


def names(world: World, joints: np.ndarray) -> list[str]:
    return [world.model.joint(int(j)).name for j in joints]


def test_what_all_fingers_share_is_an_arm_and_no_agents() -> None:
    world = build(validate(crane()))
    (arm,) = world.arms
    assert names(world, arm.joints) == SHARED
    np.testing.assert_array_equal(arm.home, [-0.1, 0.0, -0.12, 0.0])
    assert [len(agent.joints) for agent in world.agents] == [3, 3, 3]
    assert all(agent.arm == 0 for agent in world.agents)
    everything = np.concatenate([*(limb.geoms for limb in world.limbs), world.static_geoms, world.object_geoms])
    assert len(set(everything.tolist())) == len(everything) == world.model.ngeom
    assert names(world, world.joints)[-4:] == SHARED
    again = from_plan(world.scene.model_dump(mode="json"), world.xml, world.assets)
    np.testing.assert_array_equal(again.start, world.start)


def test_a_fixed_wrist_stands_where_the_moving_one_rests() -> None:
    moving, fixed = build(validate(crane())), build(validate(crane(wrist="fixed")))
    assert fixed.arms == ()
    assert fixed.model.njnt == 10
    data, other = mujoco.MjData(moving.model), mujoco.MjData(fixed.model)
    data.qpos[:], other.qpos[:] = moving.start, fixed.start
    mujoco.mj_kinematics(moving.model, data)
    mujoco.mj_kinematics(fixed.model, other)
    for agent in fixed.agents:
        name = fixed.model.geom(agent.tip_geom).name
        np.testing.assert_allclose(other.geom(name).xpos, data.geom(name).xpos, atol=1e-12)
    assert "robot/palm" in {fixed.model.geom(g).name for g in fixed.static_geoms}


def test_the_built_in_arm_brings_the_palm_where_the_scene_has_it() -> None:
    scene = load("arm-hand-carry")
    carried = build(scene)
    alone = {**scene.model_dump(mode="json", exclude_none=True), "supports": []}
    alone["model"].pop("arm")
    hand = build(validate(alone))
    data, other = mujoco.MjData(carried.model), mujoco.MjData(hand.model)
    data.qpos[:], other.qpos[:] = carried.start, hand.start
    mujoco.mj_kinematics(carried.model, data)
    mujoco.mj_kinematics(hand.model, other)
    for agent in hand.agents:
        name = hand.model.geom(agent.tip_geom).name
        np.testing.assert_allclose(data.geom(name).xpos, other.geom(name).xpos, atol=1e-5)
    assert scene.support_names == ("floor",)  # a palm that moves bears nothing by itself
    far = {**scene.model_dump(mode="json", exclude_none=True)}
    far["model"]["pose"]["position"] = [2.0, 0.0, 0.4]
    with pytest.raises(InputError, match=r"model\.arm: cannot bring the palm to model\.pose"):
        build(validate(far))


def test_a_built_in_arm_may_stand_still() -> None:
    scene = load("arm-hand-carry").model_dump(mode="json", exclude_none=True)
    scene["model"]["arm"]["wrist"] = "fixed"
    scene["goal"] = scene["start"] = {"pose": scene["start"]["pose"]}
    world = build(validate(scene))
    assert world.arms == ()
    assert "arm/link5" in {world.model.geom(g).name for g in world.static_geoms}


@pytest.mark.parametrize(
    ("posture", "field", "reason"),
    [
        ({"w": 0.1}, "w", "no such joint"),
        ({"left_root": 0.1}, "left_root", "is an agent's own joint"),
        ({"yaw": 0.6}, "yaw", "0.6 is out of its range"),
    ],
)
def test_a_posture_is_of_shared_and_idle_joints_within_their_ranges(
    posture: dict[str, float], field: str, reason: str
) -> None:
    with pytest.raises(InputError, match=f"model.posture.{field}: {reason}") as error:
        build(validate(crane(posture=posture)))
    assert error.value.hint


def test_an_idle_finger_rests_in_its_posture() -> None:
    """Left out of the agents it goes with the palm."""
    scene = crane(posture={"front_root": -0.7, "x": -0.1, "z": -0.12})
    scene["agents"] = scene["agents"][:2]
    world = build(validate(scene))
    assert world.model.geom("robot/front_tip").id in world.arms[0].geoms
    free = mujoco.MjModel.from_xml_path(str(EXAMPLES / "crane.xml"))
    data, mine = mujoco.MjData(free), mujoco.MjData(world.model)
    data.joint("front_root").qpos, data.joint("x").qpos, data.joint("z").qpos = -0.7, -0.1, -0.12
    mine.qpos[:] = world.start
    mujoco.mj_kinematics(free, data)
    mujoco.mj_kinematics(world.model, mine)
    np.testing.assert_allclose(mine.geom("robot/front_tip").xpos, data.geom("front_tip").xpos, atol=1e-12)


def test_fingers_that_share_more_than_their_arm_are_refused(tmp_path: Path) -> None:
    (tmp_path / "r.xml").write_text("""<mujoco><worldbody><body name="arm"><joint name="lift" type="slide"/>
    <geom size="0.01"/><body name="one"><joint name="a"/><geom name="t1" size="0.01" pos="0.1 0 0"/></body>
    <body name="fork"><joint name="both"/><geom size="0.01"/>
    <body name="two"><joint name="b"/><geom name="t2" size="0.01" pos="0 0.1 0"/></body>
    <body name="three"><joint name="c"/><geom name="t3" size="0.01" pos="0 -0.1 0"/></body></body></body>
    </worldbody></mujoco>""")
    pose = {"pose": {"position": [0, 0, 0.3]}}
    scene = {
        "name": "r", "model": {"file": str(tmp_path / "r.xml")},
        "agents": [{"name": t, "tip": t} for t in ("t1", "t2", "t3")],
        "object": {"shape": "sphere", "size": [0.03], "mass": 0.1}, "start": pose, "goal": pose,
    }  # fmt: skip
    with pytest.raises(InputError, match="joint 'robot/both' moves some of an arm's fingers only"):
        build(validate(scene))
