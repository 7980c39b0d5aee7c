"""Scenes without a solution: each ends with the reason, in time, with exit code 1."""

import json
from pathlib import Path

import pytest

from regrasp.cli import main

HERE = Path(__file__).parent / "impossible"
REASONS = {
    "goal-in-wall": ("collision", ("goal.pose", "wall")),
    "passage-too-narrow": ("route", ("wall", "table")),
    "too-weak": ("equilibrium", ("table", "max_force")),
}


def test_every_scene_here_has_its_reason() -> None:
    assert {file.stem for file in HERE.glob("*.yaml")} == set(REASONS)


@pytest.mark.parametrize("name", REASONS)
def test_it_ends_with_the_reason(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    constraint, words = REASONS[name]
    out = tmp_path / "plan.npz"
    assert main(["plan", str(HERE / f"{name}.yaml"), "-o", str(out), "--json"]) == 1
    said = capsys.readouterr()
    failure = json.loads(said.out)["failure"]
    assert failure["constraint"] == constraint
    for word in words:
        assert word in " ".join(failure.values())
    assert not out.exists()
    assert "Traceback" not in said.err
