"""Links that are meshes: the planner's shapes hold what physics collides, and are made once."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from regrasp.scene import cache, collisions, fits, links
from regrasp.scene.load import load, validate
from regrasp.scene.world import World, build

CLAW = Path(__file__).parents[2] / "examples" / "claw.yaml"


@pytest.fixture(autouse=True)
def cache_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


@pytest.fixture
def claw() -> World:
    return build(load(str(CLAW)))


def test_the_shapes_hold_the_hulls_that_physics_collides(claw: World) -> None:
    """MuJoCo's own distances: from a small ball far or near, a shape is never farther than the hull it stands for."""
    model, rng = claw.model, np.random.default_rng(0)
    assert claw.links.shapes
    for geom, shapes in claw.links.shapes.items():
        vertices = collisions.vertices(model, geom)
        spec = mujoco.MjSpec()
        mesh = spec.add_mesh(name="hull", uservert=vertices.ravel())
        spec.worldbody.add_geom(name="hull", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name)
        for i, shape in enumerate(shapes):
            quaternion = np.empty(4)
            mujoco.mju_mat2Quat(quaternion, shape.R.ravel())
            kind = getattr(mujoco.mjtGeom, f"mjGEOM_{shape.kind.upper()}")
            spec.worldbody.add_geom(name=str(i), type=kind, size=shape.size, pos=shape.p, quat=quaternion)
        ball = spec.worldbody.add_body(name="ball", mocap=True)
        ball.add_geom(name="ball", size=[0.001, 0, 0])
        alone = spec.compile()
        data = mujoco.MjData(alone)
        for _ in range(200):
            data.mocap_pos[0] = vertices.mean(axis=0) + rng.normal(size=3) * 0.05
            mujoco.mj_kinematics(alone, data)
            hull = mujoco.mj_geomDistance(alone, data, alone.geom("hull").id, alone.geom("ball").id, 1.0, None)
            near = [
                mujoco.mj_geomDistance(alone, data, alone.geom(str(i)).id, alone.geom("ball").id, 1.0, None)
                for i in range(len(shapes))
            ]
            if hull > 1e-4:
                assert min(near) <= hull + 1e-5


def test_shapes_are_made_once_and_kept(cache_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    vertices = np.random.default_rng(0).normal(size=(30, 3))
    first = links.enclosing(vertices)
    assert any(cache_home.rglob("*"))
    monkeypatch.setattr(fits, "enclosing", lambda _: pytest.fail("made again"))
    again = links.enclosing(vertices)
    for a, b in zip(first, again, strict=True):
        assert a.kind == b.kind
        for field in ("size", "R", "p"):
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
    assert cache.folder().is_relative_to(cache_home)


def test_without_meshes_nothing_is_made() -> None:
    found = build(load("fig3-puma3")).links
    assert (found.shapes, found.spared, found.said, found.crowded) == ({}, frozenset(), (), ())


# Two links whose hulls, pyramids, stand point to point: the shapes about them meet, the pyramids do not.
PYRAMID = "0.02 0 0  0 0.02 0  -0.02 0 0  0 -0.02 0  0 0 0.06"
ROW = f"""<mujoco><asset><mesh name="p" vertex="{PYRAMID}"/></asset><worldbody>
<body name="a"><joint name="ja" axis="0 1 0"/><geom type="mesh" mesh="p"/>
  <body name="b"><joint name="jb" axis="0 1 0"/>
    <body name="c"><joint name="jc" axis="0 1 0"/><geom type="mesh" mesh="p" pos="0 0 0.121" euler="180 0 0"/>
      <geom name="tip" size="0.01" pos="0 0 0.3"/></body></body></body>
<body name="other" pos="0.042 0 0.12">{{joint}}<geom type="mesh" mesh="p" euler="180 0 0"/>
  <geom name="knob" size="0.01" pos="0 0 0.3"/></body>
</worldbody></mujoco>"""


def row(tmp_path: Path) -> World:
    file = tmp_path / "row.xml"
    file.write_text(ROW.format(joint='<joint name="k" axis="0 1 0"/>'))
    pose = {"pose": {"position": [1, 0, 0.3]}}
    scene: dict[str, Any] = {
        "name": "row", "model": {"file": str(file)}, "object": {"shape": "sphere", "size": [0.03], "mass": 0.1},
        "agents": [{"name": "one", "tip": "tip"}, {"name": "two", "tip": "knob"}], "start": pose, "goal": pose,
    }  # fmt: skip
    return build(validate(scene))


def test_shapes_of_neighbours_that_meet_at_rest_are_spared_those_of_others_kept_apart_and_both_are_told(
    tmp_path: Path,
) -> None:
    world = row(tmp_path)
    model, found = world.model, world.links
    mine = {name: int(np.flatnonzero((model.geom_bodyid == model.body(f"robot/{name}").id) & (model.geom_dataid >= 0))[0])
            for name in ("a", "c", "other")}  # fmt: skip
    spared = {frozenset((g, h)) for (g, _), (h, _) in found.spared}
    assert spared <= {frozenset((mine["a"], mine["c"]))}
    (said,) = found.said
    assert "'robot/a' and 'robot/c'" in said
    (crowded,) = found.crowded
    assert "'robot/c' and 'robot/other'" in crowded or "'robot/a' and 'robot/other'" in crowded
    # The hulls themselves stay in what `check` keeps apart.
    pairs = {frozenset((int(g), int(h))) for g, h in world.collision_pairs}
    assert {frozenset((mine["a"], mine["c"])), frozenset((mine["c"], mine["other"]))} <= pairs
