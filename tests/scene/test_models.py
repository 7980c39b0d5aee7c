"""Robots from files as they come: found, converted, repaired, and told what was done."""

import os
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from regrasp.errors import InputError
from regrasp.scene import models, urdf
from regrasp.scene.load import validate
from regrasp.scene.world import World, build, from_plan

CLAW = Path(__file__).parents[2] / "examples" / "claw" / "claw.urdf"
LINK = """<link name="{name}"><collision><origin xyz="{at}"/><geometry>{shape}</geometry></collision>{more}</link>"""
JOINT = """<joint name="{name}" type="{type}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="{effort}" velocity="{speed}"/></joint>"""
BALL = '<sphere radius="0.02"/>'
BOX = '<box size="0.02 0.02 0.1"/>'
VERTICES = np.array([[x, y, z] for x in (-0.01, 0.01) for y in (-0.02, 0.02) for z in (0.0, 0.08)])


def mesh(uri: str, scale: str = "1 1 1") -> str:
    return f'<mesh filename="{uri}" scale="{scale}"/>'


def robot(shape: str = BOX, more: str = "", joint: str = "revolute", effort: float = 2.0, speed: float = 3.0) -> str:
    """Base, arm and hand in a row; the hand has the shape."""
    return "".join([
        '<robot name="r">', LINK.format(name="base", at="0 0 0", shape='<sphere radius="0.02"/>', more=""),
        LINK.format(name="arm", at="0 0 0.05", shape=BOX, more=""),
        LINK.format(name="hand", at="0 0 0", shape=shape, more=more),
        JOINT.format(name="shoulder", type="revolute", parent="base", child="arm", at="0 0 0.01", effort=2, speed=3),
        JOINT.format(name="elbow", type=joint, parent="arm", child="hand", at="0 0 0.11", effort=effort, speed=speed),
        "</robot>",
    ])  # fmt: skip


def write_obj(path: Path, vertices: np.ndarray = VERTICES) -> None:
    faces = [(1, 2, 4), (1, 4, 3), (5, 7, 8), (5, 8, 6), (1, 5, 6), (1, 6, 2), (3, 4, 8), (3, 8, 7), (1, 3, 7), (1, 7, 5),
             (2, 6, 8), (2, 8, 4)]  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = ["v " + " ".join(map(str, v)) for v in vertices] + ["f " + " ".join(map(str, f)) for f in faces]
    path.write_text("\n".join(lines))


def read(path: Path, text: str, packages: dict[str, str] | None = None) -> models.Robot:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return models.read_file(path, packages or {})


def extents(found: models.Robot, body: str = "hand") -> np.ndarray:
    """Full sizes of the box that holds a body's only colliding geom, in the geom's frame, ascending."""
    model = found.spec.compile()
    (geom,) = [g for g in range(model.ngeom) if model.body(model.geom_bodyid[g]).name == body and model.geom_contype[g]]
    return np.sort(2 * model.geom_aabb[geom, 3:])


def test_a_package_is_found_by_name_above_beside_along_the_path_or_where_it_is_said_to_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    text = robot(mesh("package://arm_description/meshes/hand.obj"))
    file = tmp_path / "ws" / "arm_description" / "urdf" / "r.urdf"
    places = [
        (tmp_path / "ws" / "arm_description", {}, ""),  # the folder that holds the file
        (tmp_path / "arm_description", {}, ""),  # a folder beside one above the file
        (tmp_path / "ros" / "arm_description", {}, str(tmp_path / "ros")),
        (tmp_path / "ros" / "arm_description", {}, f"/nowhere{os.pathsep}{tmp_path / 'ros' / 'arm_description'}"),
        (tmp_path / "else", {"arm_description": str(tmp_path / "else")}, ""),
    ]
    for home, packages, along in places:
        monkeypatch.setenv("ROS_PACKAGE_PATH", along)
        with pytest.raises(
            InputError, match=r"model\.file: collision mesh 'package://arm_d.*' is not found \(package://"
        ):
            read(file, text, packages)
        write_obj(home / "meshes" / "hand.obj")
        np.testing.assert_allclose(extents(read(file, text, packages)), [0.02, 0.04, 0.08], atol=1e-6)
        (home / "meshes" / "hand.obj").unlink()


def test_a_relative_path_a_file_uri_and_mujocos_meshdir_count_too(tmp_path: Path) -> None:
    write_obj(tmp_path / "parts" / "hand.obj")
    for uri in ("parts/hand.obj", f"file://{tmp_path}/parts/hand.obj", f"{tmp_path}/parts/hand.obj"):
        assert extents(read(tmp_path / "r.urdf", robot(mesh(uri))))[2] == pytest.approx(0.08)
    text = robot(mesh("hand.obj")).replace("</robot>", '<mujoco><compiler meshdir="parts"/></mujoco></robot>')
    assert extents(read(tmp_path / "r.urdf", text))[2] == pytest.approx(0.08)


def test_meshes_of_one_name_and_of_several_scales_are_told_apart(tmp_path: Path) -> None:
    write_obj(tmp_path / "a" / "part.obj")
    write_obj(tmp_path / "b" / "part.obj", 2 * VERTICES)
    for uri, scale, size in (
        ("b/part.obj", "1 1 1", 0.16),
        ("a/part.obj", "0.5 0.5 0.5", 0.04),
        ("a/part.obj", "1 1 1", 0.08),
    ):
        seen = "".join(
            f"<visual><geometry>{mesh(*other)}</geometry></visual>"
            for other in (("a/part.obj", "1 1 1"), ("b/part.obj", "1 1 1"), ("a/part.obj", "0.5 0.5 0.5"))
        )
        assert extents(read(tmp_path / "r.urdf", robot(mesh(uri, scale), seen)))[2] == pytest.approx(size)


@pytest.mark.parametrize("suffix", ["glb", "dae", "ply", "stl"])
def test_a_mesh_that_mujoco_does_not_read_is_converted(tmp_path: Path, suffix: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    if suffix == "dae":
        pytest.importorskip("collada")
    shape = trimesh.convex.convex_hull(VERTICES)
    content = shape.export(file_type="stl_ascii" if suffix == "stl" else suffix)
    (tmp_path / f"hand.{suffix}").write_bytes(content.encode() if isinstance(content, str) else content)
    found = read(tmp_path / "r.urdf", robot(mesh(f"hand.{suffix}")))
    np.testing.assert_allclose(extents(found), [0.02, 0.04, 0.08], atol=1e-6)
    said = found.repairs[0]
    assert re.fullmatch(
        rf"mesh 'hand.{suffix}' is a (text|{suffix} file), which MuJoCo does not read: made binary STL", said
    )


def test_a_dae_in_other_units_is_as_large_as_it_says(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("collada")
    content = trimesh.convex.convex_hull(VERTICES * 100).export(file_type="dae")
    text = content.decode() if isinstance(content, bytes) else content
    (tmp_path / "hand.dae").write_text(text.replace("</asset>", '<unit name="centimeter" meter="0.01"/></asset>'))
    np.testing.assert_allclose(
        extents(read(tmp_path / "r.urdf", robot(mesh("hand.dae")))), [0.02, 0.04, 0.08], atol=1e-6
    )


@pytest.mark.parametrize(
    ("inertial", "said"),
    [
        ("", ["link 'hand' has no mass: that of its collision geometry at 1000 kg/m³"]),
        ('<inertial><mass value="0.1"/></inertial>', ["body 'hand' has no inertia: given 1e-06 kg m²"]),
        ('<inertial><mass value="0.1"/><inertia ixx="1" iyy="1" izz="nan"/></inertial>', ["body 'hand' has principal"]),
        ('<inertial><mass value="0.1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>', []),
    ],
)
def test_what_is_missing_of_a_mass_is_made_up_and_told(tmp_path: Path, inertial: str, said: list[str]) -> None:
    found = read(tmp_path / "r.urdf", robot(BALL, inertial))
    of_hand = [each for each in found.repairs if "'hand'" in each]
    assert [each.startswith(start) for each, start in zip(of_hand, said, strict=True)] == [True] * len(said)
    assert found.spec.compile().body("hand").mass[0] == pytest.approx(
        0.1 if inertial else 1000 * 4 / 3 * np.pi * 0.02**3
    )


def test_a_picture_that_is_missing_or_broken_is_left_out_and_a_body_is_not(tmp_path: Path) -> None:
    (tmp_path / "broken.glb").write_bytes(b"no mesh")
    for uri, why in (("package://x/none.stl", "is not found"), ("broken.glb", "cannot be read")):
        found = read(tmp_path / "r.urdf", robot(BOX, f"<visual><geometry>{mesh(uri)}</geometry></visual>"))
        said = found.repairs[0]
        assert said.startswith(f"mesh {uri!r} {why}")
        assert said.endswith("left out, it is for the eye only")
        np.testing.assert_allclose(extents(found), [0.02, 0.02, 0.1])
        with pytest.raises(InputError, match=why):
            read(tmp_path / "r.urdf", robot(mesh(uri)))


def test_the_same_holds_for_the_meshes_of_an_mjcf_file(tmp_path: Path) -> None:
    write_obj(tmp_path / "meshes" / "hand.obj")
    text = """<mujoco><compiler meshdir="meshes"/>
      <asset><mesh name="a" file="hand.obj"/><mesh name="b" file="none.obj"/></asset>
      <worldbody><body name="hand"><joint/><geom type="mesh" mesh="a"/>
      <geom type="mesh" mesh="{}" contype="{}" conaffinity="0"/></body></worldbody></mujoco>"""
    (said,) = read(tmp_path / "r.xml", text.format("b", 0)).repairs
    assert said == "mesh 'none.obj' is not found: left out, it is for the eye only"
    with pytest.raises(InputError, match=r"model\.file: collision mesh 'none\.obj' is not found"):
        read(tmp_path / "r.xml", text.format("b", 1))


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("<robot", "model.file: is not XML"),
        (
            '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>',
            "model.file: has xacro macros (first: xacro r.urdf",
        ),
        ('<robot name="r"><link name="a"/><link name="a"/></robot>', "model.file: MuJoCo cannot read it"),
    ],
)
def test_what_is_no_urdf_is_refused_in_one_line(tmp_path: Path, text: str, line: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path / "r.urdf", text)
    assert str(caught.value).startswith(line)
    assert "\n" not in str(caught.value)


def test_urdf_is_known_by_what_it_says(tmp_path: Path) -> None:
    found = read(tmp_path / "robot.xml", '<?xml version="1.0"?>\n<!-- a comment -->\n' + robot())
    assert found.spec.body("hand") is not None


def world(file: Path, text: str, **agent: object) -> World:
    file.write_text(text)
    scene = {
        "name": "r", "model": {"file": str(file)}, "agents": [{"name": "a", "tip": "hand", **agent}],
        "object": {"shape": "sphere", "size": [0.03], "mass": 0.1},
        "start": {"pose": {"position": [0, 0, 0.3]}}, "goal": {"pose": {"position": [0, 0, 0.3]}},
    }  # fmt: skip
    return build(validate(scene))


def test_speeds_come_from_the_urdf_unless_the_scene_says_them_and_outlive_it(tmp_path: Path) -> None:
    made = world(tmp_path / "r.urdf", robot(BALL, speed=1.25))
    again = from_plan(made.scene.model_dump(mode="json"), made.xml, made.assets)
    for each in (made, again):
        assert each.agents[0].speed.tolist() == [3.0, 1.25]
    assert world(tmp_path / "r.urdf", robot(BALL, speed=0.0)).agents[0].speed.tolist() == [3.0, 2.0]
    assert world(tmp_path / "r.urdf", robot(BALL), speed=0.5).agents[0].speed.tolist() == [0.5, 0.5]


def test_repairs_outlive_the_file(tmp_path: Path) -> None:
    text = robot(BALL, f"<visual><geometry>{mesh('skin &amp; bone.stl')}</geometry></visual>")
    made = world(tmp_path / "r.urdf", text)
    again = from_plan(made.scene.model_dump(mode="json"), made.xml, made.assets)
    assert made.repairs == again.repairs
    assert "mesh 'skin & bone.stl' is not found: left out, it is for the eye only" in made.repairs


def test_neighbours_that_overlap_at_rest_never_collide_and_others_do(tmp_path: Path) -> None:
    """The arm stands in the sphere of the base, the hand is clear of it at rest."""
    made = world(tmp_path / "r.urdf", robot(BALL))
    (said,) = [said for said in made.repairs if "never collide" in said]
    assert re.fullmatch(r"bodies 'base' and 'arm', neighbours, overlap by \d+\.\d mm at rest: never collide", said)
    pairs = {frozenset(made.model.body(made.model.geom_bodyid[g]).name for g in pair) for pair in made.collision_pairs}
    assert frozenset(("robot/base", "robot/arm")) not in pairs
    assert frozenset(("robot/base", "robot/hand")) in pairs


LOOP = """<mujoco><worldbody>
  <body name="arm"><joint name="turn" axis="0 1 0"/><geom name="tip" size="0.01" pos="0.1 0 0"/></body>
  <body name="one" pos="0 0.3 0"><joint name="a"/><geom size="0.01"/>
    <body name="two"><joint name="b"/><geom size="0.01"/></body></body>
  </worldbody><equality>{}</equality></mujoco>"""


@pytest.mark.parametrize(
    ("bond", "binds"),
    [
        ('<joint joint1="a" joint2="b"/>', ""),
        ('<connect body1="one" body2="two" anchor="0 0 0"/>', ""),
        ('<weld body1="two" body2="arm"/>', "'two' and 'arm'"),
    ],
)
def test_a_closed_loop_is_refused_where_it_binds_an_agent(tmp_path: Path, bond: str, binds: str) -> None:
    (tmp_path / "r.xml").write_text(LOOP.format(bond))
    pose = {"pose": {"position": [0, 0, 0.3]}}
    scene = validate({
        "name": "r", "model": {"file": str(tmp_path / "r.xml")}, "agents": [{"name": "a", "tip": "tip"}],
        "object": {"shape": "sphere", "size": [0.03], "mass": 0.1}, "start": pose, "goal": pose,
    })  # fmt: skip
    if not binds:
        assert build(scene).model.neq == 0
        return
    with pytest.raises(InputError, match=f"model: an equality constraint binds {binds}"):
        build(scene)


def test_a_joint_of_no_agent_rests_where_its_range_is_nearest_to_zero(tmp_path: Path) -> None:
    """The frozen world has the geoms where the movable one has them with that joint value."""
    text = """<mujoco><worldbody>
      <body name="arm"><joint name="turn"/><geom name="tip" size="0.01" pos="0.1 0 0"/></body>
      <body name="idle" pos="0 0.3 0.1" euler="20 30 40">
        <joint name="j" type="{}" axis="0.6 0 0.8" pos="0.02 0.03 0.04" range="{}" limited="true"/>
        <geom name="bar" type="box" size="0.01 0.02 0.03" pos="0.05 0 0"/></body></worldbody></mujoco>"""
    for kind, given, value in (
        ("hinge", "30 80", np.radians(30)),
        ("slide", "-0.3 -0.1", -0.1),
        ("hinge", "-5 9", 0.0),
    ):
        (tmp_path / "r.xml").write_text(text.format(kind, given))
        scene = {
            "name": "r", "model": {"file": str(tmp_path / "r.xml")}, "agents": [{"name": "a", "tip": "tip"}],
            "object": {"shape": "sphere", "size": [0.03], "mass": 0.1},
            "start": {"pose": {"position": [0, 0, 0.3]}}, "goal": {"pose": {"position": [0, 0, 0.3]}},
        }  # fmt: skip
        frozen = build(validate(scene)).model
        free = mujoco.MjModel.from_xml_path(str(tmp_path / "r.xml"))
        data, rest = mujoco.MjData(free), mujoco.MjData(frozen)
        data.joint("j").qpos[0] = value
        mujoco.mj_kinematics(free, data)
        mujoco.mj_kinematics(frozen, rest)
        np.testing.assert_allclose(rest.geom("robot/bar").xpos, data.geom("bar").xpos, atol=1e-12)
        np.testing.assert_allclose(rest.geom("robot/bar").xmat, data.geom("bar").xmat, atol=1e-12)


def test_the_claw_is_read_with_all_that_is_wrong_with_it() -> None:
    found = models.read_file(CLAW, {})
    model = found.spec.compile()
    assert model.njnt == 9
    assert set(found.speeds.values()) == {3.0}
    for side in ("left", "right", "front"):
        for words in ("_base' moves and has mass 0", "_base' has no inertia", "_proximal' has principal inertias"):
            assert any(f"body '{side}{words}" in said for said in found.repairs)
    assert sum("shiny_proximal.dae' is not found" in said for said in found.repairs) == 1
    assert np.all(model.body_mass[2:] > 0)  # all that moves
    assert urdf.locate("package://claw/meshes/none.stl", [CLAW.parent], {}) is None
