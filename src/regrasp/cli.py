"""The command line. Results go to stdout, progress and messages to stderr.

Exit codes: 0 done; 1 ran, but no plan was found, the certificate was refused or a benchmark missed its mark; 2 bad
input, told in one line; 130 interrupted.
"""

import contextlib
import difflib
import json
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

from regrasp import __version__
from regrasp.commands import judging, measuring, planning, showing, viewing
from regrasp.commands.line import BAD_INPUT, DONE, INTERRUPTED, REFUSED, WORDS, Answer, say
from regrasp.errors import InputError, RegraspError
from regrasp.view import answers


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the value is the exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    # Nothing here is drawn with OpenGL, which MuJoCo would otherwise look for as long as it takes to load MuJoCo.
    os.environ.setdefault("MUJOCO_GL", "disable")
    as_json = "--json" in arguments
    arguments = [a for a in arguments if a != "--json"]
    try:
        # What a library prints must not come between a program and the one object it reads.
        with contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext():
            code, answer, show = _run(arguments)
    except (InputError, OSError) as error:
        line = str(error)
        if isinstance(error, OSError):
            line = f"{error.filename or 'file'}: {error.strerror or error}"
        code, answer, show = BAD_INPUT, {"error": line}, nothing
        say(line)
        for other in getattr(error, "others", ()):
            say(str(other))
    except RegraspError as error:
        code, answer, show = REFUSED, {"error": str(error)}, nothing
        say(str(error))
    except KeyboardInterrupt:
        code, answer, show = INTERRUPTED, {"error": "interrupted"}, nothing
        say("interrupted")
    try:
        if as_json:
            print(json.dumps({"exit": code, **answer}, allow_nan=False))
        else:
            show(answer)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader has left; python must not complain about it once more at its own exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


def _run(arguments: list[str]) -> tuple[int, dict[str, Any], Callable[[dict[str, Any]], None]]:
    """Exit code, answer, and how the answer is shown to people."""
    name = arguments[0] if arguments else "--help"
    if name in ("-h", "--help"):
        return DONE, {"commands": WORDS}, answers.commands
    if name == "--version":
        return DONE, {"version": __version__}, lambda answer: print(f"regrasp {answer['version']}")
    if name not in COMMANDS:
        near = difflib.get_close_matches(name, COMMANDS, n=1)
        hint = f"{near[0]}?" if near else f"legal: {', '.join(COMMANDS)}"
        raise InputError("regrasp", f"unknown command {name!r}", hint)
    run, show = COMMANDS[name]
    code, answer = run(arguments[1:])
    return code, answer, show


def nothing(answer: dict[str, Any]) -> None:
    """Shows nothing: all was said."""


COMMANDS: dict[str, tuple[Callable[[list[str]], Answer], Callable[[dict[str, Any]], None]]] = {
    "plan": (planning.plan, answers.plan),
    "check": (judging.check, answers.certificate),
    "replay": (judging.replay, answers.replay),
    "grasp": (planning.grasp, answers.grasps),
    "scenes": (showing.scenes, answers.scenes),
    "models": (showing.models, answers.models),
    "doctor": (showing.doctor, answers.diagnosis),
    "view": (viewing.view, answers.page),
    "render": (showing.render, answers.picture),
    "plot": (showing.plot, answers.figure),
    "bench": (measuring.bench, nothing),
}
"""Name → what runs it, what shows its answer."""
