"""Models of MuJoCo Menagerie: by name, without a network."""

import os
from pathlib import Path

import pytest

from regrasp.errors import InputError
from regrasp.scene import menagerie
from regrasp.scene.load import validate
from regrasp.scene.world import build

ARM = '<mujoco><worldbody><body name="arm"><joint name="j"/><geom name="tip" size="0.1"/></body></worldbody></mujoco>'


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("maker_arm/arm.xml", "maker_arm/scene.xml", "maker_hand/left.xml", "maker_hand/right.xml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(ARM)
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
    return tmp_path


def test_names_are_those_of_the_models_and_not_of_their_scenes(root: Path) -> None:
    assert menagerie.names() == ("maker_arm/arm", "maker_hand/left", "maker_hand/right")
    assert menagerie.path("maker_hand/left") == root / "maker_hand" / "left.xml"
    assert menagerie.path("maker_arm") == root / "maker_arm" / "arm.xml"


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("maker_hand", "'maker_hand' holds 2 models (legal: maker_hand/left, maker_hand/right)"),
        ("maker_hand/rigth", "(maker_hand/right? see regrasp models)"),
        ("other", "(see regrasp models)"),
    ],
)
def test_a_name_that_is_none_is_refused_with_the_nearest(root: Path, name: str, line: str) -> None:
    with pytest.raises(InputError) as caught:
        menagerie.path(name)
    assert caught.value.field == "model.menagerie"
    assert str(caught.value).endswith(line)


def test_without_a_copy_the_remedy_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
    assert menagerie.names() == ()
    with pytest.raises(InputError, match=r"MENAGERIE_ROOT is not set \(git clone https://.*mujoco_menagerie, and set"):
        menagerie.path("maker_arm")
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
    with pytest.raises(InputError, match="no model under MENAGERIE_ROOT"):
        menagerie.path("maker_arm")


def scene(name: str, agents: list[dict[str, object]]) -> object:
    pose = {"pose": {"position": [0, 0, 0.3]}}
    ball = {"shape": "sphere", "size": [0.03], "mass": 0.1}
    return validate(
        {"name": "m", "model": {"menagerie": name}, "object": ball, "agents": agents, "start": pose, "goal": pose}
    )


def test_a_scene_names_it(root: Path) -> None:
    world = build(scene("maker_arm", [{"name": "a", "tip": "tip"}]))
    assert world.model.joint("robot/j").id in world.agents[0].joints


@pytest.mark.skipif("MENAGERIE_ROOT" not in os.environ, reason="needs a copy of MuJoCo Menagerie")
def test_the_allegro_hand_is_four_agents_on_a_palm_that_is_held() -> None:
    tips = ("ff_tip", "mf_tip", "rf_tip", "th_tip")
    world = build(scene("wonik_allegro/right_hand", [{"name": tip, "tip": tip} for tip in tips]))
    assert world.model.njnt == 17
    assert [len(agent.joints) for agent in world.agents] == [4, 4, 4, 4]
    assert world.agents[3].lower[0] == pytest.approx(0.263)
    assert world.repairs == ()
    assert world.model.nu == 16
