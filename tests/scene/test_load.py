"""Scene files: what is legal loads and comes back, what is not gives one clear line."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from regrasp.errors import InputError
from regrasp.scene.load import builtin, dump, load, parse, validate
from regrasp.scene.pose import Pose
from regrasp.scene.schema import Scene

BASE: dict[str, Any] = {
    "name": "test",
    "model": {"hand": "puma", "fingers": 3},
    "object": {"shape": "box", "size": [0.03, 0.03, 0.04], "rounding": 0.004, "mass": 0.2},
    "environment": [{"name": "table", "shape": "plane"}],
    "supports": ["table"],
    "start": {"pose": {"position": [0, 0, 0.1]}},
    "goal": {"pose": {"position": [0, 0.01, 0.1], "euler": [0, 0, 0.5]}},
}
GRASP = [{"agent": f"finger{i}", "point": [0.03, 0, 0]} for i in (1, 2, 3)]

BAD = [
    ("object.mas", 1, "object.mas: unknown key (mass?)"),
    ("colour", "red", "colour: unknown key (legal: name, description, model"),
    ("model.finger", 3, "model.finger: unknown key (fingers?)"),
    ("goal.pose.rpy", [0, 0, 0], "goal.pose.rpy: unknown key (legal: position, quaternion, euler)"),
    ("environment.0.sise", 3, "environment.0.sise: unknown key (size?)"),
    ("object.mass", None, "object.mass: None is not a finite number"),
    ("object.mass", 0, "object.mass: 0 is too small (legal: > 0"),
    ("object.mass", -1, "object.mass: -1 is too small"),
    ("object.mass", 1500, "object.mass: 1500 is too large (kilograms, not grams?"),
    ("object.mass", "heavy", "object.mass: 'heavy' is not a finite number"),
    ("object.mass", True, "object.mass: True is not a finite number"),
    ("object.mass", float("nan"), "object.mass: nan is not a finite number"),
    ("object.size", [30, 30, 40], "object.size.0: 30 is too large (metres, not millimetres?"),
    ("object.size", [0.03], "object: size has 1 numbers for a box (legal: half extents x, y, z)"),
    ("object.rounding", 0, "object: rounding 0 of the box's edges must lie between 0 and 0.03 m"),
    ("object.rounding", 0.03, "object: rounding 0.03 of the box's edges"),
    ("object", {"shape": "sphere", "size": [0.03], "rounding": 0.01, "mass": 1}, "object: a sphere has no edges"),
    ("object.shape", "cone", "object.shape: 'cone' is not legal (legal: 'sphere', 'ellipsoid'"),
    ("object", None, "object: "),
    ("friction", 0, "friction: 0 is too small (legal: > 0 and ≤ 3)"),
    ("friction", 4, "friction: 4 is too large"),
    ("environment.0.friction", -0.5, "environment.0.friction: -0.5 is too small"),
    ("max_force", -1, "max_force: -1 is too small"),
    ("start.pose.euler", [0, 0, 90], "start.pose.euler.2: 90 is too large (radians, not degrees?"),
    ("start.pose.position", [0, 0, 150], "start.pose.position.2: 150 is too large (metres, not millimetres?"),
    ("start.pose.quaternion", [1, 1, 0, 0], "start.pose.quaternion: the quaternion has length 1.41421, not 1"),
    ("start.pose.quaternion", [0, 0, 0, 0], "start.pose.quaternion: the quaternion has length 0, not 1"),
    ("goal.pose.quaternion", [1, 0, 0, 0], "goal.pose: quaternion and euler are both given"),
    ("goal.pose.position", [0, 0], "goal.pose.position"),
    ("goal.tolerance", {"rotation": 5}, "goal.tolerance.rotation: 5 is too large (radians, not degrees?"),
    ("supports", ["shelf"], "supports.0: no surface 'shelf' (legal: table, palm)"),
    ("supports", ["table", "table"], "supports.1: 'table' appears twice"),
    ("start.off", ["finger4"], "start.off.0: no agent 'finger4' (legal: finger1, finger2, finger3)"),
    ("start.grasp", "manual", "start.grasp: 'manual' is not legal (legal: 'auto')"),
    (
        "start.grasp",
        [{"agent": "thumb", "point": [0, 0, 0]}, *GRASP],
        "start.grasp.0.agent: no agent 'thumb' (legal: fin",
    ),
    ("start.grasp", [*GRASP, GRASP[0]], "start.grasp.3.agent: 'finger1' appears twice"),
    ("start.grasp", GRASP[:2], "start.grasp: says nothing of finger3"),
    ("start.grasp", [{"agent": "finger1"}], "start.grasp.0: needs point or joints, not both"),
    ("start.grasp", [{"agent": "finger1", "points": [0, 0, 0]}], "start.grasp.0.points: unknown key (point?)"),
    ("agents", [{"name": "finger9"}], "agents.0.name: no finger 'finger9'"),
    ("agents", [{"name": "finger1", "tip": "t"}], "agents.0.tip: the tips of a built-in hand are fixed"),
    ("agents", [{"name": "finger1", "home": [90, 0]}], "agents.0.home.0: 90 is too large (radians, not degrees?"),
    ("environment.0.name", "object", "environment.0.name: 'object' is reserved"),
    ("environment.0.name", "the table", "environment.0.name: 'the table' is not a name"),
    ("environment.0.shape", "mesh", "environment.0.shape: 'mesh' is not legal"),
    ("environment.0.size", [1, 1], "environment.0: size has 2 numbers for a plane (legal: no size)"),
    ("freedoms", ["x", "roll"], "freedoms.1: 'roll' is not legal (legal: 'x', 'y'"),
    ("freedoms", [], "freedoms: "),
    ("freedoms", ["x", "z", "ry"], "goal.pose: differs from the start in y, rz (freedoms: x, z, ry)"),
    ("model", {"hand": "barrett"}, "model: neither a built-in hand nor a file"),
    ("model", {"hand": "puma", "fingers": 0}, "model.fingers: "),
    ("model", {"hand": "puma", "scale": 300}, "model.scale: 300 is too large"),
    ("model", {"hand": "planar"}, "model.bases: missing"),
    ("model", {"file": "robot.xml"}, "agents: missing"),
    ("start", {"grasp": "auto"}, "start.pose: missing"),
    ("start", "here", "start: 'here' is not a mapping"),
    ("supports", "table", "supports: 'table' is not a list"),
    ("name", 3, "name: 3 is not a text"),
    ("model.fingers", "many", "model.fingers: 'many' is not a whole number"),
    ("model.bases", [BASE["start"]["pose"]] * 2, "model: 2 bases for 3 fingers (one pose for each finger)"),
    ("model.bases", [BASE["start"]["pose"]] * 3, "model: bases leave no ring for a palm to close (palm: false)"),
    ("model.palm", "perhaps", "model.palm: 'perhaps' is neither true nor false"),
]


def changed(path: str, value: Any) -> dict[str, Any]:
    data = copy.deepcopy(BASE)
    *way, last = path.split(".")
    part: Any = data
    for key in way:
        part = part[int(key)] if isinstance(part, list) else part[key]
    part[last] = value
    return data


@pytest.mark.parametrize(("path", "value", "line"), BAD, ids=[f"{path}-{i}" for i, (path, _, _) in enumerate(BAD)])
def test_bad_value_gives_one_clear_line(path: str, value: Any, line: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(yaml.safe_dump(changed(path, value)), "my.yaml")
    message = str(caught.value)
    assert message.startswith(f"my.yaml: {line}")
    assert "\n" not in message


def test_every_fault_is_reported_at_once() -> None:
    data = changed("object.mass", -1)
    data["friction"] = 9
    data["goal"]["pose"]["position"][2] = 500
    with pytest.raises(InputError) as caught:
        validate(data, "my.yaml")
    faults = [caught.value, *caught.value.others]
    assert [fault.field for fault in faults] == ["object.mass", "friction", "goal.pose.position.2"]
    assert str(caught.value).endswith("and 2 more")


def test_yaml_error_names_the_line(tmp_path: Path) -> None:
    file = tmp_path / "broken.yaml"
    file.write_text("name: a\nmodel: {hand: puma\nobject: 3\n")
    with pytest.raises(InputError, match=r"broken\.yaml: line 3: "):
        load(file)


def test_key_written_twice_is_an_error() -> None:
    with pytest.raises(InputError, match=r"my\.yaml: line 2: 'name' is written twice"):
        parse("name: a\nname: b\n", "my.yaml")


def test_off_is_a_key_and_true_and_false_are_booleans() -> None:
    text = yaml.safe_dump(changed("model.palm", False)).replace("start:\n", "start:\n  off: [finger2]\n")
    scene = parse(text.replace("- table", "").replace("supports:", "supports: []"))
    assert scene.start.off == ("finger2",)
    assert scene.support_names == ("table",)


@pytest.mark.parametrize("text", ["", "- a\n", "just text", "name: !!python/object:os.system {}", "a: \x00"])
def test_what_is_no_scene_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        parse(text, "my.yaml")


def test_file_that_is_not_there_or_not_text(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        load(tmp_path / "none.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8"):
        load(tmp_path / "binary.yaml")


def test_typing_error_in_a_built_in_name_suggests_the_nearest() -> None:
    with pytest.raises(InputError, match=r"no built-in scene 'fig3-pumma' \(fig3-puma3\? legal: allegro-cube"):
        load("fig3-pumma")


def test_model_file_counts_from_the_scene_file(tmp_path: Path) -> None:
    data = changed("model", {"file": "arm.xml"})
    data["agents"] = [{"name": "arm", "tip": "tip"}]
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(data))
    assert load(tmp_path / "s.yaml").model.file == str(tmp_path / "arm.xml")  # type: ignore[union-attr]


@pytest.mark.parametrize("name", sorted(builtin()))
def test_built_in_scene_survives_yaml_and_plain_data(name: str) -> None:
    scene = load(name)
    assert scene.name == name
    assert builtin()[name] == scene.description
    assert parse(dump(scene)) == scene
    assert Scene.model_validate(scene.model_dump(mode="json")) == scene


def test_example_in_the_documentation_is_a_scene() -> None:
    text = Path(__file__).parents[2].joinpath("docs", "scenes.md").read_text(encoding="utf-8")
    scene = parse(text.split("```yaml\n")[1].split("```")[0], "docs/scenes.md")
    assert scene.agent_names == ("finger1", "finger2", "finger3", "finger4")


def test_documentation_names_every_key() -> None:
    text = Path(__file__).parents[2].joinpath("docs", "scenes.md").read_text(encoding="utf-8")
    schema = Scene.model_json_schema()
    keys = {key for part in (schema, *schema["$defs"].values()) for key in part.get("properties", {})}
    assert [key for key in sorted(keys) if f"`{key}`" not in text] == []


def test_exponents_without_a_point_are_numbers() -> None:
    """YAML 1.1 takes 1e-3 for a text."""
    assert parse(dump(validate(BASE)) + "friction: 5e-1\n").friction == 0.5


def test_json_schema_tells_keys_and_ranges() -> None:
    schema = Scene.model_json_schema()
    assert schema["additionalProperties"] is False
    mass = schema["$defs"]["Object"]["properties"]["mass"]
    assert mass["exclusiveMinimum"] == 0.0
    assert "kg" in mass["description"]


def test_euler_angles_are_about_fixed_x_y_z() -> None:
    """R = Rz(yaw) Ry(pitch) Rx(roll), written out as matrices."""
    roll, pitch, yaw = 0.3, -0.7, 1.9
    c, s = np.cos, np.sin
    Rx = np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
    Ry = np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
    Rz = np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
    pose = Pose(position=(0, 0, 0), euler=(roll, pitch, yaw))
    np.testing.assert_allclose(pose.R, Rz @ Ry @ Rx, atol=1e-15)
    again = Pose(position=(0, 0, 0), quaternion=tuple(pose.wxyz))
    np.testing.assert_allclose(again.R, pose.R, atol=1e-15)


def test_scenes_cannot_be_changed() -> None:
    scene = load("fig3-puma3")
    with pytest.raises(ValueError, match="frozen"):
        scene.friction = 0.1  # type: ignore[misc]


def test_supports_auto_is_every_body_that_may_be_named() -> None:
    scene = parse(yaml.safe_dump(changed("supports", "auto")))
    assert scene.carriers == scene.support_names
    assert parse(dump(scene)) == scene
    assert scene.carriers != parse(yaml.safe_dump(changed("supports", ["table"]))).carriers == ("table",)
