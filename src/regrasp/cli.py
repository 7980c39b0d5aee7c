"""The command line. Results go to stdout, progress and messages to stderr.

Exit codes: 0 done; 1 ran, but no plan was found, the certificate was refused or a benchmark missed its mark; 2 bad
input, told in one line; 130 interrupted. Heavy libraries are imported by the command that needs them.
"""

import contextlib
import dataclasses
import difflib
import gc
import importlib
import io
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Optional

from regrasp import __version__
from regrasp.errors import InputError, RegraspError
from regrasp.view import answers

DONE, REFUSED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
ITERATIONS, TIME_LIMIT = ("local", "annealing", "iterations"), ("time_limit",)
"""Where in the planner's settings `--iterations` and `--time-limit` belong."""

Answer = tuple[int, dict[str, Any]]


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
        code, answer, show = BAD_INPUT, {"error": line}, _nothing
        _say(line)
        for other in getattr(error, "others", ()):
            _say(str(other))
    except RegraspError as error:
        code, answer, show = REFUSED, {"error": str(error)}, _nothing
        _say(str(error))
    except KeyboardInterrupt:
        code, answer, show = INTERRUPTED, {"error": "interrupted"}, _nothing
        _say("interrupted")
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
        return DONE, {"commands": {key: words for key, (words, _, _) in COMMANDS.items()}}, answers.commands
    if name == "--version":
        return DONE, {"version": __version__}, lambda answer: print(f"regrasp {answer['version']}")
    if name not in COMMANDS:
        near = difflib.get_close_matches(name, COMMANDS, n=1)
        hint = f"{near[0]}?" if near else f"legal: {', '.join(COMMANDS)}"
        raise InputError("regrasp", f"unknown command {name!r}", hint)
    _, run, show = COMMANDS[name]
    code, answer = run(arguments[1:])
    return code, answer, show


def _parse(command: Callable[..., Any], name: str, arguments: list[str]) -> Any:
    """What `command` returns for the arguments; a wrong one raises InputError with tyro's reason in one line."""
    import tyro

    words = f"{COMMANDS[name][0]}\n\n{answers.JSON}"
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
def _importing() -> Iterator[None]:
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


def _plan(arguments: list[str]) -> Answer:
    with _importing():
        import tyro

        from regrasp.planner.method import plan_scene
        from regrasp.planner.task import Settings
        from regrasp.scene.load import load
        from regrasp.settings import read
        from regrasp.view.progress import Reporter

    def request(
        scene: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
        output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="PLAN")],
        planner: Settings,
        seed: int = 0,
        # tyro checks the default of an `int | None`, but not that of an Optional, with a library slow to import.
        iterations: Annotated[
            Optional[int],  # noqa: UP045
            tyro.conf.arg(metavar="N", help_behavior_hint="(default: planner's)"),
        ] = None,
        time_limit: Annotated[
            Optional[float],  # noqa: UP045
            tyro.conf.arg(metavar="S", help_behavior_hint="(default: planner's)"),
        ] = None,
    ) -> tuple[str, Path, int, Settings]:
        """Read the command line.

        Args:
            scene: Name of a built-in scene (see `regrasp scenes`), or path of a scene file.
            output: Plan file to write.
            planner: Settings of the planner; they replace those of the scene file.
            seed: Seed of every random choice: the same seed, settings and iterations give the same plan.
            iterations: Annealing iterations on each arc of the route.
            time_limit: Seconds after which the best plan so far is taken; 0: none.
        """
        for path, value in ((ITERATIONS, iterations), (TIME_LIMIT, time_limit)):
            if value is not None:
                planner = _replaced(planner, path, value)
        return scene, output, seed, planner

    def parse(default: Settings) -> tuple[str, Path, int, Settings]:
        request.__defaults__ = (default, 0, None, None)
        return _parse(request, "plan", arguments)

    # The scene file's settings are the defaults of the flags, so its name is read first.
    name, output, seed, settings = parse(Settings())
    _writable(output)
    scene = load(name)
    if scene.planner:
        _, _, seed, settings = parse(read(Settings, scene.planner))
    started = time.perf_counter()
    with Reporter() as report:
        outcome = plan_scene(scene, seed, settings, report)
    seconds = time.perf_counter() - started
    arcs = [str(arc) for arc in outcome.tried]
    for repair in outcome.repairs:
        _say(f"{scene.name}: {repair}")
    if outcome.plan is None:
        failure = outcome.failure
        assert failure is not None
        _say(f"{scene.name}: no plan: {failure}")
        for arc in outcome.tried:
            _say(f"tried: {arc}")
        return REFUSED, {
            "scene": scene.name,
            "seconds": seconds,
            "failure": dataclasses.asdict(failure),
            "arcs": arcs,
            "repairs": outcome.repairs,
        }
    outcome.plan.save(output)
    answer = {
        "plan": str(output),
        "seconds": seconds,
        **outcome.plan.summary(),
        "arcs": arcs,
        "repairs": outcome.repairs,
    }
    if outcome.failure is None:
        return DONE, answer
    _say(f"{scene.name}: the best plan so far, not feasible, is in {output}: {outcome.failure}")
    return REFUSED, {**answer, "failure": dataclasses.asdict(outcome.failure)}


def _replaced(settings: Any, path: Sequence[str], value: object) -> Any:
    """Nested frozen dataclasses with the field at `path` replaced."""
    first, *rest = path
    inner = _replaced(getattr(settings, first), rest, value) if rest else value
    return dataclasses.replace(settings, **{first: inner})


def _check(arguments: list[str]) -> Answer:
    import tyro

    def request(plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PLAN")]) -> Path:
        """Read the command line.

        Args:
            plan: Plan file, as `regrasp plan` writes it.
        """
        return plan

    path = _parse(request, "check", arguments)
    from regrasp.plan import load
    from regrasp.verify.check import check

    certificate = check(load(path))
    for finding in certificate.refusals:
        _say(f"{path}: refused: {finding}")
    return (DONE if certificate.passed else REFUSED), {"plan": str(path), **certificate.to_dict()}


def _replay(arguments: list[str]) -> Answer:
    import tyro

    from regrasp.control.controller import Control
    from regrasp.plan import load
    from regrasp.verify.replay import control_of, replay
    from regrasp.verify.trials import Perturbation

    def request(
        plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PLAN")],
        control: Control,
        perturbation: Perturbation,
        trials: int = 0,
        seed: int = 0,
        cores: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: all)")] = None,
        output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE")] = None,
    ) -> tuple[Path, Control, Perturbation, int, int, int | None, Path | None]:
        """Read the command line.

        Args:
            plan: Plan file, as `regrasp plan` writes it.
            control: How the robots are controlled; replaces what the scene says.
            perturbation: Ranges of the perturbed trials.
            trials: Perturbed executions in each mode.
            seed: Seed of the trials; the result does not depend on the number of cores.
            cores: Processes that share the trials.
            output: Picture (.png) or clip (.gif) of the execution with object feedback to write.
        """
        return plan, control, perturbation, trials, seed, cores, output

    def parse(control: Control) -> tuple[Path, Control, Perturbation, int, int, int | None, Path | None]:
        request.__defaults__ = (control, Perturbation(), 0, 0, None, None)
        return _parse(request, "replay", arguments)

    # The scene's settings are the defaults of the flags, so the plan is read first.
    path, *_ = parse(Control())
    found = load(path)
    _, control, ranges, trials, seed, cores, output = parse(control_of(found))
    for name, value in (("--trials", trials), ("--cores", 1 if cores is None else cores - 1)):
        if value < 0:
            raise InputError(
                name, f"is {value + (name == '--cores')}", "0 or more" if name == "--trials" else "1 or more"
            )
    if output is not None:
        if output.suffix.lower() not in (".png", ".gif"):
            raise InputError("--output", f"{output} is neither .png nor .gif", "a picture or a clip")
        _writable(output)
    result = replay(found, trials, seed, control, ranges, cores)
    answer = {"plan": str(path), **result.to_dict()}
    if output is not None:
        from regrasp.view.film import clip, prepare, replayed

        shown = result.nominal[-1]
        film = prepare(found, shown.run)
        if output.suffix.lower() == ".gif":
            clip(film, output)
        else:
            replayed(film, shown.tolerance, shown.tube).save(output)
        answer["picture"] = str(output)
    for each in result.nominal:
        if not each.passed:
            _say(f"{path}: {each.mode}: {each.failure or 'reaches the goal, but leaves the tube on its way'}")
    return (DONE if result.passed else REFUSED), answer


def _grasp(arguments: list[str]) -> Answer:
    import tyro

    def request(
        scene: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
        count: int = 4,
        seed: int = 0,
        output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE")] = None,
    ) -> tuple[str, int, int, Path | None]:
        """Read the command line.

        Args:
            scene: Name of a built-in scene (see `regrasp scenes`), or path of a scene file.
            count: Grasps shown, the best first, 1 to 12.
            seed: Seed of the search.
            output: Picture to write, a .png file.
        """
        return scene, count, seed, output

    name, count, seed, output = _parse(request, "grasp", arguments)
    if not 1 <= count <= 12:
        raise InputError("--count", f"is {count}", "1 to 12")
    if output is not None:
        if output.suffix.lower() != ".png":
            raise InputError("--output", f"{output} is not a .png file", "pictures are written as PNG")
        _writable(output)
    from regrasp.planner.outcome import Failure
    from regrasp.planner.proposals import propose
    from regrasp.planner.task import Settings
    from regrasp.scene.load import load
    from regrasp.settings import read
    from regrasp.view.progress import Reporter

    scene = load(name)
    with Reporter() as report:
        found = propose(scene, seed, count, read(Settings, scene.planner), report)
    if isinstance(found, Failure):
        _say(f"{scene.name}: no grasp: {found}")
        return REFUSED, {"scene": scene.name, "failure": dataclasses.asdict(found)}
    answer: dict[str, Any] = {"scene": scene.name, "grasps": [proposal.to_dict() for proposal in found]}
    if output is not None:
        from regrasp.view.grasps import page

        captions = [f"holds with {100 * proposal.friction:.0f} % of the friction" for proposal in found]
        page([proposal.rest for proposal in found], captions).save(output)
        answer["picture"] = str(output)
    return DONE, answer


def _scenes(arguments: list[str]) -> Answer:
    def request() -> None:
        """Read the command line."""

    _parse(request, "scenes", arguments)
    from regrasp.scene.load import builtin

    return DONE, {"scenes": [{"name": name, "description": words} for name, words in builtin().items()]}


def _models(arguments: list[str]) -> Answer:
    def request() -> None:
        """Read the command line."""

    _parse(request, "models", arguments)
    from regrasp.scene import menagerie, models

    return DONE, {"hands": models.hands(), "menagerie": list(menagerie.names()), "root": menagerie.root()}


def _doctor(arguments: list[str]) -> Answer:
    import tyro

    def request(model: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE|MODEL")]) -> str:
        """Read the command line.

        Args:
            model: A scene (built-in name or path), or a robot: path of an MJCF or URDF file, name in the menagerie.
        """
        return model

    name = _parse(request, "doctor", arguments)
    from regrasp.scene.doctor import examine

    diagnosis = examine(name)
    return (DONE if diagnosis.healthy else REFUSED), {"examined": name, **dataclasses.asdict(diagnosis)}


def _render(arguments: list[str]) -> Answer:
    import tyro

    def request(
        plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PLAN")],
        output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FILE")],
        frames: int = 6,
    ) -> tuple[Path, Path, int]:
        """Read the command line.

        Args:
            plan: Plan file, as `regrasp plan` writes it.
            output: Picture to write, a .png file.
            frames: Number of instants shown, 1 to 12.
        """
        return plan, output, frames

    path, output, frames = _parse(request, "render", arguments)
    if output.suffix.lower() != ".png":
        raise InputError("--output", f"{output} is not a .png file", "pictures are written as PNG")
    if not 1 <= frames <= 12:
        raise InputError("--frames", f"is {frames}", "1 to 12")
    _writable(output)
    from regrasp.plan import load
    from regrasp.view.render import render

    picture = render(load(path), frames)
    picture.save(output)
    return DONE, {"picture": str(output), "width": picture.width, "height": picture.height}


BENCHES = {
    "paper": "searches",
    "minima": "searches",
    "scenes": "scenes",
    "replays": "replays",
    "replans": "replans",
    "levers": "levers",
    "goals": "goals",
}
"""Benchmark → the module of `regrasp.bench` that has it."""


def _bench(arguments: list[str]) -> Answer:
    import tyro

    def request(
        name: Annotated[
            Literal["paper", "minima", "scenes", "replays", "replans", "levers", "goals"], tyro.conf.Positional
        ],
        seeds: int = 10,
    ) -> tuple[str, int]:
        """Read the command line.

        Args:
            name: paper: the paper's own job, timed (§5). minima: local minima of the energy (§5).
                scenes: every built-in scene, planned and checked. replays: the same, executed in physics.
                replans: displaced states along plans, planned again.
                levers: what makes them survive it, switched off one by one.
                goals: random goals of objects in three fingertips.
            seeds: How many seeds are run, or goals per object.
        """
        return name, seeds

    name, seeds = _parse(request, "bench", arguments)
    if seeds < 1:
        raise InputError("--seeds", f"is {seeds}", "1 or more")
    module = importlib.import_module(f"regrasp.bench.{BENCHES[name]}")
    answer = getattr(module, name)(seeds=seeds)
    return (DONE if answer.get("passed", True) else REFUSED), {"bench": name, **answer}


def _nothing(answer: dict[str, Any]) -> None:
    """Shows nothing: all was said."""


def _say(line: str) -> None:
    print(line, file=sys.stderr)


def _writable(path: Path) -> None:
    """Raise InputError before the work if its result could not be written."""
    if not path.parent.is_dir():
        raise InputError("--output", f"no directory {path.parent}", "make it first")
    if path.is_dir():
        raise InputError("--output", f"{path} is a directory", "name a file")


COMMANDS: dict[str, tuple[str, Callable[[list[str]], Answer], Callable[[dict[str, Any]], None]]] = {
    "plan": ("Plan a scene: contact motions, joint trajectories and forces, from start to goal.", _plan, answers.plan),
    "check": ("Re-check a plan independently of the planner: the certificate.", _check, answers.certificate),
    "replay": ("Execute a plan in physics, as planned and in perturbed trials.", _replay, answers.replay),
    "grasp": ("Show the best start grasps of a scene, to choose one from.", _grasp, answers.grasps),
    "scenes": ("List the built-in scenes.", _scenes, answers.scenes),
    "models": ("List the robots that a scene can name: built-in hands, MuJoCo Menagerie.", _models, answers.models),
    "doctor": ("Say what will go wrong with a scene or a robot, and what to do about it.", _doctor, answers.diagnosis),
    "render": ("Draw a plan: frames side by side, contact motions marked, forces as arrows.", _render, answers.picture),
    "bench": ("Measure the method: paper, minima, scenes, replays, replans, levers, goals.", _bench, _nothing),
}
"""Name → what it does, what runs it, what shows its answer."""
