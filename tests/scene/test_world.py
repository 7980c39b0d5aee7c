"""The world of a scene: what is in it, and what may touch what."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from regrasp.errors import InputError
from regrasp.scene.load import builtin, load, validate
from regrasp.scene.pose import Pose
from regrasp.scene.world import World, build, from_plan

POSES = {"start": {"pose": {"position": [0.3, 0, 0.5]}}, "goal": {"pose": {"position": [0.3, 0, 0.5]}}}
BALL = {"shape": "sphere", "size": [0.03], "mass": 0.1}
ARM = """
<mujoco>
  <compiler angle="degree" meshdir="meshes"/>
  <asset><mesh name="lump" file="lump.obj"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="base" pos="0 0 0.2"> <geom name="stand" type="box" size=".02 .02 .02"/>
      <body name="link1"> <joint name="turn" axis="0 0 1" range="-90 90"/>
        <geom name="upper" type="capsule" fromto="0 0 0 .1 0 0" size=".01"/>
        <geom name="look" type="mesh" mesh="lump" contype="0" conaffinity="0"/>
        <body name="link2" pos=".1 0 0"> <joint name="push" type="slide" axis="1 0 0" range="0 .1"/>
          <geom type="sphere" size=".015"/>
        </body>
      </body>
      <body name="spare"> <joint name="idle" axis="0 1 0"/>
        <geom name="rod" type="capsule" size=".01 .05" pos="0 0 .1"/>
        <body name="link3" pos="0 0 .2"> <joint name="roll" type="ball"/> <geom name="knob" size=".01"/> </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="turn"/></actuator>
  <keyframe><key qpos="0 0 0 1 0 0 0"/></keyframe>
</mujoco>
"""
LUMP = "v 0 0 0\nv .01 0 0\nv 0 .01 0\nv 0 0 .01\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture(scope="module", params=sorted(builtin()))
def world(request: pytest.FixtureRequest) -> World:
    return build(load(request.param))


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "lump.obj").write_text(LUMP)
    (tmp_path / "arm.xml").write_text(ARM)
    return tmp_path / "arm.xml"


def arm_scene(file: Path, agents: list[dict[str, Any]], **more: Any) -> Any:
    return validate({"name": "arm", "model": {"file": str(file)}, "object": BALL, "agents": agents, **POSES, **more})


def names(world: World) -> set[frozenset[str]]:
    return {frozenset((world.model.geom(g).name, world.model.geom(h).name)) for g, h in world.collision_pairs}


def test_built_in_scene_steps_without_warnings(world: World) -> None:
    model, data = world.model, mujoco.MjData(world.model)
    data.qpos[:] = world.start
    for _ in range(200):
        mujoco.mj_step(model, data)
    assert all(warning.number == 0 for warning in data.warning)
    assert np.all(np.isfinite(data.qpos))


def test_agents_are_separate_chains_at_home_inside_their_limits(world: World) -> None:
    joints = np.concatenate([limb.joints for limb in world.limbs])
    geoms = np.concatenate([limb.geoms for limb in world.limbs])
    assert len(set(joints)) == len(joints) == world.model.njnt - 1
    assert len(set(geoms)) == len(geoms)
    for agent in world.agents:
        assert np.all((agent.lower < agent.home) & (agent.home < agent.upper))
        assert agent.tip_geom in agent.geoms
        assert len(agent.joints) == len(agent.qpos) == len(agent.dofs) == len(agent.speed)
        assert agent.friction == world.scene.friction
        assert agent.max_force == (world.scene.max_force or 10.0)


def test_nothing_that_must_not_touch_touches_at_the_start(world: World) -> None:
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.start
    mujoco.mj_kinematics(world.model, data)
    for g, h in world.collision_pairs:
        assert mujoco.mj_geomDistance(world.model, data, int(g), int(h), 1.0, np.zeros(6)) > 1e-3


def test_object_stands_at_the_start_pose_with_its_mass(world: World) -> None:
    model, data, scene = world.model, mujoco.MjData(world.model), world.scene
    data.qpos[:] = world.start
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.xpos[world.object_body], scene.start.pose.p, atol=1e-12)
    np.testing.assert_allclose(data.xmat[world.object_body].reshape(3, 3), scene.start.pose.R, atol=1e-12)
    assert model.body_mass[world.object_body] == pytest.approx(scene.object.mass, rel=1e-12)
    assert np.all(model.geom_bodyid[world.object_geoms] == world.object_body)
    np.testing.assert_array_equal(world.object_size[: len(scene.object.size)], scene.object.size)


def test_collision_pairs_are_what_mujoco_collides_but_for_the_wanted_contacts(world: World) -> None:
    """Everything is heaped up at random; MuJoCo's own contacts are the oracle."""
    model, data = world.model, mujoco.MjData(world.model)
    listed = {(int(g), int(h)) for g, h in world.collision_pairs}
    tips = {agent.tip_geom for agent in world.agents}
    wanted = {
        (min(g, o), max(g, o)) for g in tips | set(world.support_geoms.tolist()) for o in world.object_geoms.tolist()
    }
    assert all(g < h for g, h in listed)
    assert len(listed) == len(world.collision_pairs)
    assert not listed & wanted
    model.geom_margin[:] = 10.0  # so that every pair that may touch is reported as a contact
    model.body_margin[:] = 10.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    found = set()
    rng = np.random.default_rng(1)
    for _ in range(3):
        data.qpos[:] = world.start
        for agent in world.agents:
            lower, upper = np.maximum(agent.lower, -np.pi), np.minimum(agent.upper, np.pi)
            data.qpos[agent.qpos] = rng.uniform(lower, upper)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        found |= {(int(min(c)), int(max(c))) for c in data.contact.geom}
    boxes = set(np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX).tolist())
    far = {pair for pair in listed if boxes.issuperset(pair)}  # of which MuJoCo misses some at such a margin
    assert listed <= found | wanted | far
    assert found <= listed | wanted


def test_no_agent_collides_with_its_own_neighbouring_links() -> None:
    pairs = names(build(load("fig3-puma3")))
    for near in (
        ("finger1/link1", "finger1/link2"),
        ("finger1/link2", "finger1/link3"),
        ("finger1/link3", "finger1/tool"),
        ("finger1/column", "finger1/link1"),
        ("finger1/tip", "object/0"),
        ("palm", "finger1/column"),
    ):
        assert frozenset(near) not in pairs
    for far in (
        ("finger1/link1", "finger1/link3"),
        ("finger1/link2", "finger1/tip"),
        ("finger1/link3", "finger2/link3"),
        ("finger1/tip", "finger2/tip"),
        ("finger1/tool", "object/0"),
        ("finger2/column", "finger1/link2"),
        ("palm", "finger1/tip"),
        ("palm", "object/0"),
    ):
        assert frozenset(far) in pairs


def test_obstacles_meet_everything_and_supports_spare_the_object() -> None:
    world = build(load("puma4-obstacles"))
    moving = [world.model.geom(g).name for agent in world.agents for g in agent.geoms] + ["object/0"]
    assert {frozenset(("post", name)) for name in moving} <= names(world)
    planar = build(load("fig2-planar"))
    assert planar.support_geoms.tolist() == [planar.model.geom("table").id]
    np.testing.assert_array_equal(planar.support_friction, [0.4])
    assert frozenset(("table", "object/0")) not in names(planar)
    assert frozenset(("table", "finger1/tip")) in names(planar)


def test_stored_world_is_the_same_world(world: World) -> None:
    again = from_plan(world.scene.model_dump(mode="json"), world.xml, world.assets)
    assert again.scene == world.scene
    np.testing.assert_array_equal(again.collision_pairs, world.collision_pairs)
    for field in ("body_pos", "body_quat", "geom_pos", "geom_size", "jnt_range", "body_inertia", "qpos0"):
        np.testing.assert_array_equal(getattr(again.model, field), getattr(world.model, field))


def test_contact_friction_is_that_of_tip_and_support() -> None:
    scene = load("fig2-planar")
    data = scene.model_dump(mode="json") | {"agents": [{"name": "finger1", "friction": 0.25, "max_force": 3}]}
    world = build(validate(data))
    model, state = world.model, mujoco.MjData(world.model)
    agent = world.agents[0]
    assert (agent.name, agent.friction, agent.max_force, len(world.agents)) == ("finger1", 0.25, 3.0, 1)
    model.geom_margin[:] = model.body_margin[:] = 1.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    state.qpos[:] = world.start
    state.qpos[world.object_qpos + 2] -= 1e-4
    mujoco.mj_forward(model, state)
    friction = {frozenset(c.geom.tolist()): c.friction[0] for c in state.contact}
    assert friction[frozenset((agent.tip_geom, int(world.object_geoms[0])))] == 0.25
    assert friction[frozenset((int(world.support_geoms[0]), int(world.object_geoms[0])))] == 0.4


@pytest.mark.parametrize("name", ["fig3-puma3", "fig2-planar"])
def test_fingers_that_are_not_listed_stand_still_at_home_as_obstacles(name: str) -> None:
    whole = build(load(name))
    data = whole.scene.model_dump(mode="json") | {"agents": [{"name": "finger3"}, {"name": "finger1"}]}
    world = build(validate(data))
    for some in (world, from_plan(world.scene.model_dump(mode="json"), world.xml, world.assets)):
        assert [agent.name for agent in some.agents] == ["finger3", "finger1"]
        assert some.model.njnt == sum(len(agent.joints) for agent in some.agents) + 1
        poses = []
        for each in (whole, some):
            state = mujoco.MjData(each.model)
            state.qpos[:] = each.start
            mujoco.mj_kinematics(each.model, state)
            poses.append(
                [(state.geom(i).name, *state.geom_xpos[i], *state.geom_xmat[i]) for i in range(each.model.ngeom)]
            )
        for (geom, *X), (same, *Y) in zip(*poses, strict=True):
            assert geom == same
            np.testing.assert_allclose(X, Y, atol=1e-12)
        idle = {g for g in range(some.model.ngeom) if some.model.geom(g).name.startswith("finger2/")}
        assert idle <= set(some.static_geoms.tolist())
        assert {frozenset(("finger2/tip", other)) for other in ("finger1/tip", "object/0")} <= names(some)


def test_planar_fingers_stay_in_their_plane() -> None:
    world = build(load("fig2-planar"))
    data = mujoco.MjData(world.model)
    rng = np.random.default_rng(0)
    for _ in range(20):
        for agent in world.agents:
            lower, upper = np.maximum(agent.lower, -np.pi), np.minimum(agent.upper, np.pi)
            data.qpos[agent.qpos] = rng.uniform(lower, upper)
        mujoco.mj_kinematics(world.model, data)
        for agent, base in zip(world.agents, world.scene.model.bases, strict=True):  # type: ignore[union-attr]
            tip, angles = data.geom_xpos[agent.tip_geom], base.angle + np.cumsum(data.qpos[agent.qpos])
            reach = (0.09, 0.07, 0.05) @ np.stack([np.cos(angles), np.sin(angles)], axis=1)
            np.testing.assert_allclose(tip[[0, 2]], base.position + reach, atol=1e-12)
            assert abs(tip[1]) < 1e-12


def test_pumas_stand_evenly_and_face_the_axis() -> None:
    """Their homes are one posture turned about the hand's axis, tools level and pointing at it, at any size."""
    for scale, ring in ((0.3, 0.33), (1.0, 1.1)):
        data = {"name": "ring", "model": {"hand": "puma", "fingers": 5, "scale": scale, "ring": ring}, "object": BALL}
        world = build(validate(data | POSES))
        state = mujoco.MjData(world.model)
        state.qpos[:] = world.start
        mujoco.mj_kinematics(world.model, state)
        tips = np.array([state.geom_xpos[agent.tip_geom] for agent in world.agents])
        tools = np.array([state.geom_xmat[agent.tip_geom].reshape(3, 3)[:, 2] for agent in world.agents])
        angles = np.unwrap(np.arctan2(tips[:, 1], tips[:, 0]))
        np.testing.assert_allclose(np.diff(angles), 2 * np.pi / 5, atol=1e-9)
        np.testing.assert_allclose(np.cross(tips, tools)[:, 2], 0.0, atol=1e-9)
        assert np.all((tips * tools)[:, :2].sum(axis=1) < 0)
        np.testing.assert_allclose(tools[:, 2], 0.0, atol=1e-9)


def test_own_model_keeps_its_kinematics_and_outlives_its_files(arm: Path) -> None:
    placed = Pose(position=(0.5, 0, 0), euler=(0, 0, 1.0))
    scene = arm_scene(arm, [{"name": "a", "tip": "link2"}])
    scene = validate(scene.model_dump(mode="json") | {"model": {"file": str(arm), "pose": placed}})
    world = build(scene)
    stored = from_plan(scene.model_dump(mode="json"), world.xml, dict(world.assets))
    agent = stored.agents[0]
    source = mujoco.MjModel.from_xml_path(str(arm))
    data, mine = mujoco.MjData(source), mujoco.MjData(stored.model)
    for turn, push in ((0.0, 0.0), (0.7, 0.03), (-1.5, 0.1)):
        data.joint("turn").qpos[:], data.joint("push").qpos[:] = turn, push
        mine.qpos[agent.qpos] = turn, push
        mujoco.mj_kinematics(source, data)
        mujoco.mj_kinematics(stored.model, mine)
        expected = placed.R @ data.body("link2").xpos + placed.p
        np.testing.assert_allclose(mine.geom_xpos[agent.tip_geom], expected, atol=1e-12)
    np.testing.assert_allclose(agent.lower, [-np.pi / 2, 0], atol=1e-12)
    assert [stored.model.actuator(a).trnid[0] for a in range(stored.model.nu)] == [
        agent.joints[0]
    ]  # its own drive stays
    # Joints of no agent are frozen, visual geoms ignored, the file's own floor is an obstacle.
    assert stored.model.njnt == 3
    assert "robot/look" not in {name for pair in names(stored) for name in pair}
    assert {"robot/floor", "robot/rod", "robot/knob"} <= {stored.model.geom(g).name for g in stored.static_geoms}
    assert frozenset(("robot/rod", "robot/link2")) in names(stored)


@pytest.mark.parametrize(
    ("agents", "line"),
    [
        ([{"name": "a", "tip": "finger"}], "agents.0.tip: no geom or body 'finger' in the model (legal: floor, stand"),
        ([{"name": "a", "tip": "stand"}], "agents.0.tip: no joint moves 'stand'"),
        ([{"name": "a", "tip": "knob"}], "agents.0.tip: joint 'roll' before it is a ball"),
        ([{"name": "a", "tip": "look"}], "agents.0.tip: the geom does not collide"),
        ([{"name": "a", "tip": "link2"}, {"name": "b", "tip": "upper"}], "agents.1.tip: no joint moves 'upper' alone"),
        ([{"name": "a", "tip": "link2", "home": [0.1]}], "agents.0.home: 1 values for 2 joints"),
        ([{"name": "a", "tip": "link2", "home": [0.1, 0.2]}], "agents.0.home: value 2 is 0.2, outside"),
    ],
)
def test_agent_that_the_model_has_not_is_refused(arm: Path, agents: list[dict[str, Any]], line: str) -> None:
    with pytest.raises(InputError) as caught:
        build(arm_scene(arm, agents))
    assert str(caught.value).startswith(line)


def test_model_file_that_is_missing_or_broken_is_refused(tmp_path: Path) -> None:
    agents = [{"name": "a", "tip": "t"}]
    with pytest.raises(InputError, match=r"model\.file: no file"):
        build(arm_scene(tmp_path / "none.xml", agents))
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody><geom/></mujoco>")
    with pytest.raises(InputError, match=r"model\.file: MuJoCo cannot read it: ") as caught:
        build(arm_scene(tmp_path / "broken.xml", agents))
    assert "\n" not in str(caught.value)


def test_bases_stand_where_they_are_put_and_make_the_ring_where_they_are_put_on_it() -> None:
    data = load("fig3-puma3").model_dump(mode="json")
    data["model"] |= {"palm": False, "pose": {"position": [0.1, -0.2, 0.3], "euler": [0.4, -0.5, 0.6]}}
    ring = build(validate(data)).model
    angles = [2 * np.pi * i / 3 for i in range(3)]
    data["model"]["bases"] = [
        {"position": [0.33 * np.cos(a), 0.33 * np.sin(a), 0], "euler": [0, 0, a - np.pi]} for a in angles
    ]
    scene = validate(data)
    placed = build(scene)
    np.testing.assert_allclose(placed.model.body_pos, ring.body_pos, atol=1e-15)
    turns = np.sum(placed.model.body_quat * ring.body_quat, axis=1)  # of either sign
    np.testing.assert_allclose(np.abs(turns), 1.0, atol=1e-15)
    assert scene.support_names == ()
    # At rest a finger stretches along the x axis of its base, which the base's own pose may tilt.
    data["model"]["bases"][0] = {"position": [0, 0, 0], "euler": [1.0, 0.7, -0.3]}
    tilted = validate(data)
    world = build(tilted)
    start = mujoco.MjData(world.model)
    start.qpos[:] = world.start
    mujoco.mj_kinematics(world.model, start)
    tool = start.geom_xmat[world.agents[0].tip_geom].reshape(3, 3)[:, 2]
    np.testing.assert_allclose(tool, tilted.model.pose.R @ tilted.model.bases[0].R @ [1.0, 0.0, 0.0], atol=1e-12)


def test_home_outside_the_limits_of_a_built_in_hand_is_refused() -> None:
    data = load("fig3-puma3").model_dump(mode="json")
    data["model"]["home"] = [0, 0, 3, 0, 0, 0]
    with pytest.raises(InputError, match=r"model\.home: value 3 is 3, outside the joint's range"):
        build(validate(data))
