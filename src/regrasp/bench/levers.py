"""What makes plans survive physics: each measure of the planner switched off by itself, the plans executed."""

import dataclasses
import statistics
import time
from collections.abc import Callable
from typing import Any

from rich.console import Console
from rich.table import Table

from regrasp.bench.kernels import compile_kernels, say
from regrasp.planner.method import plan_scene
from regrasp.planner.task import Settings
from regrasp.scene.load import load
from regrasp.settings import read
from regrasp.verify.replay import replay

SCENES = ("puma4-obstacles", "fig4-relocation")
TRIALS = 10
"""Perturbed executions of each plan."""


def _energy(**changes: float) -> Callable[[Settings], Settings]:
    def changed(settings: Settings) -> Settings:
        energy = dataclasses.replace(settings.local.energy, **changes)
        return dataclasses.replace(settings, local=dataclasses.replace(settings.local, energy=energy))

    return changed


def _timing(**changes: float) -> Callable[[Settings], Settings]:
    return lambda settings: dataclasses.replace(settings, timing=dataclasses.replace(settings.timing, **changes))


LEVERS: dict[str, Callable[[Settings], Settings]] = {
    "as shipped": lambda settings: settings,
    "no reserve": _energy(disturbance=0.0),
    "10 % of friction unused": _energy(friction_margin=0.1),
    "slides as hard as any contact": _energy(stability=0.0, slide_force=1e3),
    "hand-overs at once": _timing(settle=0.01, force_rate=1e3),
    "fast: half the joint speeds": _timing(speed=0.5, object_speed=0.2, shortest=0.05),
}
"""What is switched off or loosened → the settings without it."""


def levers(seeds: int) -> dict[str, Any]:
    """Plans with each of LEVERS, with seeds 0 … seeds − 1, executed as planned and in perturbed trials with feedback."""
    compile_kernels()
    rows = []
    for name in SCENES:
        for words, change in LEVERS.items():
            rows.append({"scene": name, "planner": words, **lever_row(name, change, seeds)})
            say(f"{name}, {words}: {rows[-1]['trials']} of {seeds * TRIALS} trials")
    table = Table(title=f"{seeds} seeds, {TRIALS} trials each", title_justify="left", box=None, padding=(0, 2, 0, 0))
    for heading in ("scene", "planner", "planned", "open", "feedback", "trials", "plan s", "motion s"):
        table.add_column(heading, justify="left" if heading in ("scene", "planner") else "right", no_wrap=True)
    for row in rows:
        table.add_row(
            row["scene"], row["planner"], f"{row['planned']}/{seeds}", f"{row['open']}/{seeds}",
            f"{row['feedback']}/{seeds}", f"{row['trials']}/{seeds * TRIALS}", f"{row['seconds']:.1f}",
            "-" if row["duration"] is None else f"{row['duration']:.1f}",
        )  # fmt: skip
    Console().print(table)
    return {"passed": True, "seeds": seeds, "levers": rows}


def lever_row(name: str, change: Callable[[Settings], Settings], seeds: int) -> dict[str, Any]:
    """One scene planned with changed settings: how many plans reach the goal, and how many trials."""
    scene = load(name)
    settings = change(read(Settings, scene.planner))
    seconds, durations = [], []
    row = {"planned": 0, "open": 0, "feedback": 0, "trials": 0}
    for seed in range(seeds):
        started = time.perf_counter()
        plan = plan_scene(scene, seed, settings).plan
        seconds.append(time.perf_counter() - started)
        if plan is None:
            continue
        row["planned"] += 1
        durations.append(float(plan.time[-1, -1]))
        found = replay(plan, trials=TRIALS, seed=seed, trial_modes=("feedback",))
        for each in found.nominal:
            row[each.mode] += each.passed
        row["trials"] += found.trials[0].successes
    return row | {
        "seconds": statistics.median(seconds),
        "duration": statistics.median(durations) if durations else None,
    }
