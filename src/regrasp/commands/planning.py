"""Planning: a plan, or the grasps to begin it with."""

import dataclasses
import time
from pathlib import Path
from typing import Annotated, Any, Optional

from regrasp.commands.line import DONE, REFUSED, Answer, importing, parse, replaced, say, writable
from regrasp.errors import InputError

ITERATIONS, TIME_LIMIT = ("local", "annealing", "iterations"), ("time_limit",)
"""Where in the planner's settings `--iterations` and `--time-limit` belong."""


def plan(arguments: list[str]) -> Answer:
    with importing():
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
                planner = replaced(planner, path, value)
        return scene, output, seed, planner

    def asked(default: Settings) -> tuple[str, Path, int, Settings]:
        request.__defaults__ = (default, 0, None, None)
        return parse(request, "plan", arguments)

    # The scene file's settings are the defaults of the flags, so its name is read first.
    name, output, seed, settings = asked(Settings())
    writable(output)
    scene = load(name)
    if scene.planner:
        _, _, seed, settings = asked(read(Settings, scene.planner))
    started = time.perf_counter()
    with Reporter() as report:
        outcome = plan_scene(scene, seed, settings, report)
    seconds = time.perf_counter() - started
    arcs = [str(arc) for arc in outcome.tried]
    for repair in outcome.repairs:
        say(f"{scene.name}: {repair}")
    if outcome.plan is None:
        failure = outcome.failure
        assert failure is not None
        say(f"{scene.name}: no plan: {failure}")
        for arc in outcome.tried:
            say(f"tried: {arc}")
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
    say(f"{scene.name}: the best plan so far, not feasible, is in {output}: {outcome.failure}")
    return REFUSED, {**answer, "failure": dataclasses.asdict(outcome.failure)}


def grasp(arguments: list[str]) -> Answer:
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

    name, count, seed, output = parse(request, "grasp", arguments)
    if not 1 <= count <= 12:
        raise InputError("--count", f"is {count}", "1 to 12")
    if output is not None:
        if output.suffix.lower() != ".png":
            raise InputError("--output", f"{output} is not a .png file", "pictures are written as PNG")
        writable(output)
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
        say(f"{scene.name}: no grasp: {found}")
        return REFUSED, {"scene": scene.name, "failure": dataclasses.asdict(found)}
    answer: dict[str, Any] = {"scene": scene.name, "grasps": [proposal.to_dict() for proposal in found]}
    if output is not None:
        from regrasp.view.grasps import page

        captions = [f"holds with {100 * proposal.friction:.0f} % of the friction" for proposal in found]
        page([proposal.rest for proposal in found], captions).save(output)
        answer["picture"] = str(output)
    return DONE, answer
