"""Measuring the method."""

import importlib
from typing import Annotated, Literal

from regrasp.commands.line import DONE, REFUSED, Answer, parse
from regrasp.errors import InputError

BENCHES = {
    "paper": "searches",
    "minima": "searches",
    "scenes": "scenes",
    "replays": "replays",
    "replans": "replans",
    "levers": "levers",
    "goals": "goals",
    "scans": "scans",
    "view": "views",
}
"""Benchmark → the module of `regrasp.bench` that has it."""

BY_SCENE = ("scenes", "replays")


def bench(arguments: list[str]) -> Answer:
    import tyro

    from regrasp.scene.load import builtin

    def request(
        name: Annotated[
            Literal["paper", "minima", "scenes", "replays", "replans", "levers", "goals", "scans", "view"],
            tyro.conf.Positional,
        ],
        seeds: int = 10,
        scenes: tuple[str, ...] = (),
    ) -> tuple[str, int, tuple[str, ...]]:
        """Read the command line.

        Args:
            name: paper: the paper's own job, timed (§5). minima: local minima of the energy (§5).
                scenes: every built-in scene, planned and checked. replays: the same, executed in physics.
                replans: displaced states along plans, planned again.
                levers: what makes them survive it, switched off one by one.
                goals: random goals of objects in three fingertips. scans: the same with scanned objects (`regrasp[ycb]`).
                view: size of pages, time until they are served, frames made per second.
            seeds: How many seeds are run, goals per object, or times a page is served.
            scenes: Built-in scenes that `scenes` and `replays` take; all where none is named.
        """
        return name, seeds, scenes

    name, seeds, scenes = parse(request, "bench", arguments)
    if seeds < 1:
        raise InputError("--seeds", f"is {seeds}", "1 or more")
    if scenes and name not in BY_SCENE:
        raise InputError("--scenes", f"is given for {name}", f"only {' and '.join(BY_SCENE)} go scene by scene")
    for scene in scenes:
        if scene not in builtin():
            raise InputError("--scenes", f"is {scene!r}", f"built-in scenes: {', '.join(builtin())}")
    module = importlib.import_module(f"regrasp.bench.{BENCHES[name]}")
    answer = getattr(module, name)(seeds=seeds, **({"names": scenes or builtin()} if name in BY_SCENE else {}))
    return (DONE if answer.get("passed", True) else REFUSED), {"bench": name, **answer}
