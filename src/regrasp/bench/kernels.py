"""Compiling ahead, so that no measurement holds a compilation; telling how far the work is."""

import dataclasses
import sys
import time
from typing import Any

from rich.console import Console

from regrasp.planner.method import plan_scene
from regrasp.planner.outcome import Report
from regrasp.planner.task import Settings
from regrasp.planner.warm import COMPILING
from regrasp.scene.load import builtin, load
from regrasp.search.annealing import Settings as Annealing
from regrasp.settings import read
from regrasp.view.progress import Reporter


def compile_kernels() -> float:
    """Plan every built-in scene with next to no iterations, so that nothing is left to compile; s it took."""
    say("compiling the kernels (minutes the first time, then they are kept beside the sources)")
    started = time.perf_counter()
    with Reporter() as report:
        for name in builtin():
            scene = load(name)
            settings = read(Settings, scene.planner)
            local = dataclasses.replace(settings.local, attempts=1, annealing=Annealing(iterations=20, trials=20))
            plan_scene(scene, 0, dataclasses.replace(settings, arcs=1, local=local), only_compilation(report))
    seconds = time.perf_counter() - started
    say(f"compiled or loaded in {seconds:.1f} s")
    return seconds


def only_compilation(report: Report) -> Report:
    """A report that is told of compilation only."""
    return lambda step: report(step) if step.stage == COMPILING else None


def print_reasons(console: Console, rows: list[dict[str, Any]]) -> None:
    """Why scenes' runs failed, below their table: each row's `reasons`."""
    for row in rows:
        for reason in row["reasons"]:
            console.print(f"{row['scene']}, {reason}", markup=False, soft_wrap=True)


def say(line: str) -> None:
    """Tell how far the work is, on stderr."""
    print(line, file=sys.stderr, flush=True)
