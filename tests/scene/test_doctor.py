"""What is wrong with a scene or a robot is told before planning, with a remedy, and nothing else is."""

from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh
import yaml

from regrasp.errors import InputError
from regrasp.scene.doctor import Symptom, examine
from regrasp.scene.load import builtin, dump, load
from regrasp.scene.world import build

CLAW = Path(__file__).parents[2] / "examples" / "claw.yaml"
HAND = """<mujoco><compiler angle="radian"/><option cone="elliptic" impratio="10" noslip_iterations="10"/>
<default><joint damping="0.1" range="-1 1"/></default><asset><mesh name="m" vertex="0 0 0 {m} 0 0 0 {m} 0 0 0 {m}"/></asset>
<worldbody><body name="palm"> {free} <geom name="palm" type="box" size="0.05 0.05 0.01"/>
  <body name="left" pos="-0.04 0 0.02"><joint name="l1" axis="0 1 0" {l1}/>
    <geom type="capsule" size="0.005" fromto="0 0 0 0 0 0.05"/>
    <body name="ltip" pos="0 0 0.06"><joint name="l2" axis="1 0 0" {l2}/>
      <geom type="{kind}" size="0.01 0.01" {mesh}/></body></body>
  <body name="right" pos="0.04 0 0.02"><joint name="r1" axis="0 1 0"/>
    <geom type="capsule" size="0.005" fromto="0 0 0 0 0 0.05"/>
    <body name="rtip" pos="0 0 0.06"><joint name="r2" axis="1 0 0"/> <geom size="0.01"/></body></body>
</body></worldbody>{more}</mujoco>"""  # fmt: skip
WORDS = {"m": "0.01", "free": "", "l1": "", "l2": "", "kind": "sphere", "mesh": "", "more": ""}
SCENE = {
    "name": "hand", "model": {"file": "hand.xml"}, "agents": [{"name": "l", "tip": "ltip"}, {"name": "r", "tip": "rtip"}],
    "object": {"shape": "sphere", "size": [0.027], "mass": 0.1},
    "start": {"pose": {"position": [0, 0, 0.075]}}, "goal": {"pose": {"position": [0, 0, 0.076]}},
}  # fmt: skip

Make = Callable[..., str]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Writes the hand with some of its words changed, and the scene with some of its keys changed; the scene's path."""

    def write(words: dict[str, str] | None = None, **changes: object) -> str:
        (tmp_path / "hand.xml").write_text(HAND.format(**(WORDS | (words or {}))))
        (tmp_path / "hand.yaml").write_text(yaml.safe_dump(SCENE | changes))
        return str(tmp_path / "hand.yaml")

    return write


def of(symptoms: tuple[Symptom, ...], severity: str) -> list[str]:
    return [str(symptom) for symptom in symptoms if symptom.severity == severity]


@pytest.mark.parametrize("name", sorted(builtin()))
def test_built_in_scenes_have_no_error_and_no_warning(name: str) -> None:
    found = examine(name)
    assert found.healthy
    assert of(found.symptoms, "warning") == []


def test_a_sound_hand_has_nothing_and_its_chains_end_in_its_tips(make: Make, tmp_path: Path) -> None:
    assert examine(make()).symptoms == ()
    found = examine(str(tmp_path / "hand.xml"))
    assert found.symptoms == ()
    assert found.tips == ("ltip", "rtip")


@pytest.mark.parametrize(
    ("words", "severity", "line"),
    [
        ({"free": "<freejoint/>"}, "note", "body 'palm': floats: held where the file puts it (model.pose places it)"),
        ({"l1": 'limited="false"'}, "warning", "joint 'l1': has no limits"),
        ({"l1": 'damping="0"', "l2": 'damping="0"'}, "warning", "joints l1, l2: has neither damping nor armature"),
        ({"more": '<option cone="pyramidal"/>'}, "note", "model.option: with cone=pyramidal a grasp creeps"),
        (
            {"more": '<option impratio="1" noslip_iterations="0"/>'},
            "note",
            "with impratio=1, noslip_iterations=0 a grasp",
        ),
        (
            {"more": '<equality><joint joint1="l1" joint2="l2" polycoef="0 1 2 0 0"/></equality>'},
            "warning",
            "'l1' and 'l2': bound by an equality",
        ),
        (
            {"more": '<tendon><fixed><joint joint="l1" coef="1"/></fixed></tendon>'},
            "warning",
            "model: 1 tendons are ignored",
        ),
        ({"kind": "mesh", "mesh": 'mesh="m"', "m": "10"}, "error", "body 'ltip': a geom is"),
    ],
)
def test_each_fault_of_a_robot_has_its_symptom(
    make: Make, tmp_path: Path, words: dict[str, str], severity: str, line: str
) -> None:
    make(words)
    found = examine(str(tmp_path / "hand.xml"))
    assert len(found.symptoms) == 1
    assert line in of(found.symptoms, severity)[0]
    assert found.symptoms[0].remedy
    assert found.healthy == (severity != "error")


@pytest.mark.parametrize(
    ("changes", "severity", "line"),
    [
        ({"start": {"pose": {"position": [0, 0, 0.3]}}, "goal": {"pose": {"position": [0, 0, 0.3]}}}, "error",
         "agent 'l': its tip comes no nearer than"),
        ({"goal": {"pose": {"position": [0, 0, 0.2]}}}, "note", "its tip does not reach the object at the goal"),
        ({"object": {"shape": "sphere", "size": [0.027], "mass": 5.0}}, "error", "together they bear 24.4 N at most"),
        ({"agents": [{"name": "l", "tip": "ltip", "home": [0.7, 0]}, {"name": "r", "tip": "rtip", "home": [-0.7, 0]}]},
         "error", "body 'robot/ltip' and body 'robot/rtip': overlap by"),
        ({"agents": [{"name": "l", "tip": "none"}]}, "error", "agents.0.tip: no geom or body 'none' in the model"),
        ({"model": {"file": "none.xml"}}, "error", "model.file: no file"),
    ],
)  # fmt: skip
def test_each_fault_of_a_scene_has_its_symptom(
    make: Make, changes: dict[str, object], severity: str, line: str
) -> None:
    found = examine(make(**changes))
    assert any(line in said for said in of(found.symptoms, severity)), [str(symptom) for symptom in found.symptoms]
    assert found.healthy == (severity != "error")


def test_the_worst_comes_first(make: Make) -> None:
    found = examine(make({"free": "<freejoint/>", "l1": 'limited="false"'}, model={"file": "hand.xml"}, object={
        "shape": "sphere", "size": [0.027], "mass": 5.0}))  # fmt: skip
    assert [symptom.severity for symptom in found.symptoms] == ["error", "warning", "note"]


def test_what_was_repaired_is_a_note_once() -> None:
    found = examine(str(CLAW))
    assert found.healthy
    notes = of(found.symptoms, "note")
    assert len(set(notes)) == len(notes)
    for said in build(load(str(CLAW))).repairs:
        assert f"note: model: {said}" in notes


def test_a_file_that_is_no_scene_and_one_that_is_not_there_are_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        examine(str(tmp_path / "none.urdf"))
    with pytest.raises(InputError, match="no built-in scene"):
        examine("alegro")
    (tmp_path / "bad.yaml").write_text(dump(load("fig3-puma3")) + "what: 1\n")
    with pytest.raises(InputError, match="unknown key"):
        examine(str(tmp_path / "bad.yaml"))


def test_how_well_a_grid_describes_the_objects_mesh_is_told(
    make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    trimesh.creation.box((0.04, 0.04, 0.04)).export(tmp_path / "box.stl")
    shape = {"shape": "mesh", "file": "box.stl", "mass": 0.1, "rounding": 0.004, "resolution": 0.002}
    (note,) = [line for line in of(examine(make(object=shape)).symptoms, "note") if "object" in line and "grid" in line]
    assert "a grid of 2 mm" in note
    assert "rounded by 4 mm" in note
    assert "filled by 0.08 mm at most" in note
