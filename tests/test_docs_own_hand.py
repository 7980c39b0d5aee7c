"""docs/own-hand.md is true: its commands run, they print what it shows, its scene is the example's."""

import re
import shutil
from pathlib import Path

import pytest

from regrasp.cli import main

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "own-hand.md").read_text(encoding="utf-8")


def commands() -> list[tuple[list[str], list[str]]]:
    """Arguments of every command of the page, and the lines shown below it; `…` stands for lines left out."""
    found: list[tuple[list[str], list[str]]] = []
    for block in re.findall(r"```console\n(.*?)```", TEXT, re.DOTALL):
        for line in block.splitlines():
            if line.startswith("$ regrasp "):
                found.append((line.removeprefix("$ regrasp ").split(), []))
            elif line != "…":
                found[-1][1].append(line)
    return found


def test_the_scene_of_the_page_is_the_example_and_short() -> None:
    shown = TEXT.split("```yaml\n")[1].split("```")[0]
    assert shown == (ROOT / "examples" / "claw.yaml").read_text(encoding="utf-8")
    assert len(shown.splitlines()) <= 30


def test_the_commands_of_the_page_run_and_print_what_it_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    names = []
    for arguments, shown in commands():
        assert main(arguments) == 0, arguments
        printed = capsys.readouterr()
        lines = (printed.out + printed.err).splitlines()
        for line in shown:
            assert line in lines
        names.append(arguments[0])
    assert names == ["doctor", "doctor", "grasp", "plan", "check", "replay", "render"]
    assert (tmp_path / "claw.png").stat().st_size > 10_000
