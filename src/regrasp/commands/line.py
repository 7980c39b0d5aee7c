"""What all commands share: exit codes, the reading of arguments, messages."""

import contextlib
import dataclasses
import gc
import io
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from regrasp.errors import InputError
from regrasp.view import answers

DONE, REFUSED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

Answer = tuple[int, dict[str, Any]]

WORDS = {
    "plan": "Plan a scene: contact motions, joint trajectories and forces, from start to goal.",
    "check": "Re-check a plan independently of the planner: the certificate.",
    "replay": "Execute a plan in physics, as planned and in perturbed trials.",
    "grasp": "Show the best start grasps of a scene, to choose one from.",
    "scenes": "List the built-in scenes.",
    "models": "List the robots that a scene can name: built-in hands, MuJoCo Menagerie.",
    "doctor": "Say what will go wrong with a scene or a robot, and what to do about it.",
    "view": "Look at a plan, or at the search for one, in a browser: play, scrub, forces, contact motions, findings.",
    "render": "Draw a plan: frames side by side or a clip, contact motions marked, forces as arrows.",
    "plot": "Draw figures of a plan for print: V, energy, forces, joints, clearances.",
    "bench": "Measure the method: paper, minima, scenes, replays, replans, levers, goals, scans, view.",
}
"""Command → what it does."""


def parse(command: Callable[..., Any], name: str, arguments: list[str]) -> Any:
    """What `command` returns for the arguments; a wrong one raises InputError with tyro's reason in one line."""
    import tyro

    words = f"{WORDS[name]}\n\n{answers.JSON}"
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(command, prog=f"regrasp {name}", description=words, args=arguments)
    except ValueError as error:  # a value of the right type that the settings refuse
        raise InputError(f"regrasp {name}", str(error), f"see regrasp {name} --help") from None
    except SystemExit as end:
        if not end.code:
            raise
    raise InputError(f"regrasp {name}", *_complaint(complaint.getvalue(), name)) from None


@contextlib.contextmanager
def importing() -> Iterator[None]:
    """A context for imports: garbage is not looked for among them, then or later, as modules hold none."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def _complaint(text: str, name: str) -> tuple[str, str]:
    """Reason and hint from tyro's box of text."""
    lines = [line.strip("│╭╮╰╯ ") for line in text.splitlines()]
    sections: list[list[str]] = [[]]
    for line in lines[1:]:
        if line and not line.strip("─"):
            sections.append([])
        elif line:
            sections[-1].append(line)
    reason = " ".join(sections[0]).replace(f"Missing from regrasp {name}:", "missing:")
    near = next((s[1] for s in sections if len(s) > 1 and s[0].startswith("Perhaps you meant")), "")
    return reason, f"{near}?" if near else f"see regrasp {name} --help"


def replaced(settings: Any, path: Sequence[str], value: object) -> Any:
    """Nested frozen dataclasses with the field at `path` replaced."""
    first, *rest = path
    inner = replaced(getattr(settings, first), rest, value) if rest else value
    return dataclasses.replace(settings, **{first: inner})


def say(line: str) -> None:
    print(line, file=sys.stderr)


def writable(path: Path, flag: str = "--output") -> None:
    """Raise InputError before the work if its result, which the flag names, could not be written."""
    if not path.parent.is_dir():
        raise InputError(flag, f"no directory {path.parent}", "make it first")
    if path.is_dir():
        raise InputError(flag, f"{path} is a directory", "name a file")


def drawable(path: Path) -> None:
    """Raise InputError before the work if no picture or clip could be written there."""
    if path.suffix.lower() not in (".png", ".gif", ".mp4"):
        raise InputError("--output", f"{path} is no .png, .gif or .mp4 file", "a picture or a clip")
    writable(path)
