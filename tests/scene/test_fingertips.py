from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from regrasp.errors import InputError
from regrasp.scene.load import load, validate
from regrasp.scene.schema import Scene
from regrasp.scene.world import World, build, from_plan

ARM = """<mujoco>
  <worldbody>
    <body name="upper">
      <joint name="turn" axis="0 0 1" range="-90 90"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0.2 0 0" size="0.01"/>
      <body name="hand" pos="0.25 0 0">
        <joint name="bend" axis="0 1 0" range="-90 90"/>
        <geom name="stump" type="capsule" fromto="0 0 0 0.02 0 0" size="0.006"/>
        <geom name="block" type="box" pos="0.05 0 0.01" euler="0 30 0" size="0.01 0.012 0.008" friction="0.4"/>
        <geom name="drum" type="cylinder" pos="0.05 0 0.05" size="0.01 0.008"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""
EGG = {"shape": "ellipsoid", "size": [0.01, 0.012, 0.015]}
PUCK = {"shape": "box", "size": [0.01, 0.012, 0.015], "rounding": 0.004}


def puma(tip: dict[str, Any] | None) -> Scene:
    data = load("fig3-puma3").model_dump(mode="json")
    return validate(data | {"agents": [{"name": "finger1", "tip": tip}, {"name": "finger2"}, {"name": "finger3"}]})


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return path


def own(arm: Path, tip: Any) -> Scene:
    pose = {"position": [1.0, 0.0, 0.0]}
    return validate({
        "name": "own", "model": {"file": str(arm)}, "object": {"shape": "sphere", "size": [0.03], "mass": 0.1},
        "agents": [{"name": "a", "tip": tip}], "start": {"pose": pose}, "goal": {"pose": pose},
    })  # fmt: skip


def at_home(world: World) -> mujoco.MjData:
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.start
    mujoco.mj_kinematics(world.model, data)
    return data


@pytest.mark.parametrize(
    ("tip", "kind", "size"),
    [
        (None, 0, [0.0135, 0.0, 0.0, 0.0]),
        (EGG, 1, [0.01, 0.012, 0.015, 0.0]),
        ({"shape": "capsule", "size": [0.01, 0.006]}, 2, [0.01, 0.006, 0.0, 0.0]),
        (PUCK, 4, [0.01, 0.012, 0.015, 0.004]),
    ],
)
def test_a_built_in_tip_takes_the_shape_it_is_given_and_its_place(tip: Any, kind: int, size: list[float]) -> None:
    world, plain = build(puma(tip)), build(puma(None))
    agent, before = world.agents[0], plain.agents[0]
    assert agent.tip_kind == kind
    np.testing.assert_allclose(agent.tip_size, size, atol=1e-15)
    assert world.model.geom(agent.tip_geom).name == "finger1/tip"
    np.testing.assert_allclose(
        at_home(world).geom_xpos[agent.tip_geom], at_home(plain).geom_xpos[before.tip_geom], atol=1e-12
    )
    np.testing.assert_allclose(
        at_home(world).geom_xmat[agent.tip_geom], at_home(plain).geom_xmat[before.tip_geom], atol=1e-12
    )
    stored = from_plan(world.scene.model_dump(mode="json"), world.xml, world.assets).agents[0]
    np.testing.assert_array_equal(stored.tip_geoms, agent.tip_geoms)
    np.testing.assert_array_equal(stored.tip_size, agent.tip_size)
    assert set(agent.tip_geoms) <= set(agent.geoms)
    touching = {frozenset(pair) for pair in world.collision_pairs.tolist()}
    assert not any(frozenset((int(g), int(o))) in touching for g in agent.tip_geoms for o in world.object_geoms)
    np.testing.assert_array_equal(world.model.geom_friction[agent.tip_geoms, 0], agent.friction)


def test_a_tip_stands_where_its_pose_says_in_the_frame_of_the_tip_before() -> None:
    pose = {"position": [0.001, 0.002, 0.003], "euler": [0.3, -0.2, 0.5]}
    scene = puma(PUCK | {"pose": pose})
    world, plain = build(scene), build(puma(None))
    before, now = at_home(plain), at_home(world)
    at, to = plain.agents[0].tip_geom, world.agents[0].tip_geom
    R, placed = before.geom_xmat[at].reshape(3, 3), scene.agents[0].tip.pose
    np.testing.assert_allclose(now.geom_xpos[to], before.geom_xpos[at] + R @ placed.p, atol=1e-12)
    np.testing.assert_allclose(now.geom_xmat[to].reshape(3, 3), R @ placed.R, atol=1e-12)


def test_the_pieces_of_a_rounded_box_are_its_union() -> None:
    """A point is in one of the geoms if and only if it is within the rounding of the box shrunk by it."""
    world = build(puma(PUCK | {"pose": {"position": [0, 0, 0], "euler": [0.3, -0.2, 0.5]}}))
    data, agent = at_home(world), world.agents[0]
    R, p = data.geom_xmat[agent.tip_geom].reshape(3, 3), data.geom_xpos[agent.tip_geom]
    core = np.array(PUCK["size"]) - PUCK["rounding"]
    for point in np.random.default_rng(0).uniform(-1.2, 1.2, size=(400, 3)) * PUCK["size"]:
        depth = np.linalg.norm(np.maximum(np.abs(point) - core, 0.0)) - PUCK["rounding"]
        found = False
        for g in agent.tip_geoms:
            local = data.geom_xmat[g].reshape(3, 3).T @ (R @ point + p - data.geom_xpos[g])
            size = world.model.geom_size[g]
            if world.model.geom_type[g] == mujoco.mjtGeom.mjGEOM_BOX:
                found |= bool(np.all(np.abs(local) <= size))
            else:
                found |= bool(np.linalg.norm(local - [0, 0, np.clip(local[2], -size[1], size[1])]) <= size[0])
        assert found == (depth <= 0.0) or abs(depth) < 1e-9


def test_a_body_of_ones_own_model_gets_a_tip(arm: Path) -> None:
    world = build(own(arm, EGG | {"body": "hand", "pose": {"position": [0.08, 0, 0], "euler": [0, 0.4, 0]}}))
    agent, data = world.agents[0], at_home(world)
    assert world.model.geom(agent.tip_geom).name == "robot/a/tip"
    np.testing.assert_allclose(data.geom_xpos[agent.tip_geom], [0.33, 0.0, 0.0], atol=1e-12)
    assert (agent.tip_kind, len(agent.joints)) == (1, 2)
    assert any("scene gives body 'hand'" in said for said in world.repairs)


def test_a_box_of_ones_own_model_gets_round_edges_where_it_is(arm: Path) -> None:
    source = mujoco.MjModel.from_xml_path(str(arm))
    before = mujoco.MjData(source)
    mujoco.mj_kinematics(source, before)
    world = build(own(arm, {"geom": "block", "rounding": 0.003}))
    agent, data = world.agents[0], at_home(world)
    np.testing.assert_allclose(agent.tip_size, [0.01, 0.012, 0.008, 0.003], atol=1e-15)
    np.testing.assert_allclose(data.geom_xpos[agent.tip_geom], before.geom("block").xpos, atol=1e-12)
    np.testing.assert_allclose(data.geom_xmat[agent.tip_geom], before.geom("block").xmat, atol=1e-12)
    assert len(agent.tip_geoms) == 15


def test_a_box_with_sharp_edges_gets_round_ones_and_that_is_told(arm: Path) -> None:
    world = build(own(arm, "block"))
    np.testing.assert_allclose(world.agents[0].tip_size, [0.01, 0.012, 0.008, 0.002], atol=1e-15)
    assert any("'block' has its edges rounded by 2 mm" in said for said in world.repairs)
    again = from_plan(world.scene.model_dump(mode="json"), world.xml, world.assets)
    np.testing.assert_array_equal(again.agents[0].tip_geoms, world.agents[0].tip_geoms)


@pytest.mark.parametrize(
    ("tip", "line"),
    [
        ("drum", "agents.0.tip: is a cylinder (legal: sphere, ellipsoid"),
        (EGG | {"body": "claw"}, "agents.0.tip.body: no body 'claw' in the model (legal: upper, hand)"),
        ({"geom": "rod", "rounding": 0.001}, "agents.0.tip.geom: 'rod' is not a box"),
        ({"geom": "block", "rounding": 0.008}, "agents.0.tip.rounding: 0.008 m is too large for 'block' (legal: < 0.008 m)"),
        (EGG, "agents.0.tip.body: missing"),
        ({"geom": "block"}, "agents.0.tip: rounding is missing"),
        ({"geom": "block", "rounding": 0.001, "size": [0.1]}, "agents.0.tip: a geom of the model has its place and size"),
        ({"body": "hand"}, "agents.0.tip: needs geom or shape, not both"),
        ({"shape": "ellipsoid", "size": [0.01], "body": "hand"}, "agents.0.tip: size has 1 numbers for a ellipsoid"),
        ({"shape": "box", "size": [0.01] * 3, "body": "hand"}, "agents.0.tip: rounding 0 of the box's edges must lie between"),
        ({"shape": "torus", "size": [0.01], "body": "hand"}, "agents.0.tip.shape: 'torus' is not legal"),
    ],
)  # fmt: skip
def test_a_tip_that_cannot_be_is_refused(arm: Path, tip: Any, line: str) -> None:
    with pytest.raises(InputError) as caught:
        build(own(arm, tip))
    assert str(caught.value).startswith(line)


@pytest.mark.parametrize("tip", ["t", {"geom": "finger1/tip", "rounding": 0.001}, EGG | {"body": "finger1/link6"}])
def test_the_tip_of_a_built_in_hand_is_no_other_geom(tip: Any) -> None:
    with pytest.raises(InputError, match=r"agents\.0\.tip: the tips of a built-in hand are fixed"):
        puma(tip)
