"""Every built-in scene, planned and checked."""

import itertools
import statistics
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from regrasp.bench.kernels import compile_kernels, print_reasons, say
from regrasp.plan import RELOCATE, Plan
from regrasp.planner.hand import hand_of
from regrasp.planner.method import plan_scene
from regrasp.planner.path import distance
from regrasp.planner.task import Settings
from regrasp.planner.turns import from_quaternion
from regrasp.scene.load import load
from regrasp.scene.schema import Object
from regrasp.scene.world import build
from regrasp.settings import read
from regrasp.verify.check import check


def scenes(seeds: int, names: Sequence[str]) -> dict[str, Any]:
    """Built-in scenes with seeds 0 … seeds − 1 and default settings, planned and checked.

    Passed if at least 9 of 10 are certified on each.
    """
    compile_kernels()
    rows = [scene_row(name, seeds) for name in names]
    title = f"built-in scenes, {seeds} seeds, default settings"
    table = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))
    for heading in ("scene", "planned", "certified", "median s", "worst s", *COUNTS):
        table.add_column(heading, justify="left" if heading == "scene" else "right", no_wrap=True)
    for row in rows:
        table.add_row(
            row["scene"], str(row["planned"]), str(row["certified"]), f"{row['seconds']:.2f}",
            f"{row['slowest_seconds']:.2f}", *("-" if row[key] is None else f"{row[key]:.3g}" for key in COUNTS),
        )  # fmt: skip
    console = Console()
    console.print(table)
    print_reasons(console, rows)
    return {"passed": all(10 * row["certified"] >= 9 * seeds for row in rows), "seeds": seeds, "scenes": rows}


COUNTS = ("intervals", "relocations", "way", "force")
"""Medians over the plans found. way: length of the object's path over that of the straight one; force: the largest of
an agent, N."""


def detour(plan: Plan, radius: float) -> float:
    """Length of the object's path, way + radius · angle, over that of the straight path between its ends."""
    p, R = plan.object_position.reshape(-1, 3), from_quaternion(plan.object_quaternion.reshape(-1, 4))
    poses = list(zip(R, p, strict=True))
    way = sum(distance(a, b, radius) for a, b in itertools.pairwise(poses))
    return way / distance(poses[0], poses[-1], radius)


def scene_row(name: str, seeds: int) -> dict[str, Any]:
    """One built-in scene: how many seeds are planned and certified, how fast, and why the others are not."""
    scene = load(name)
    settings = read(Settings, scene.planner)
    seconds, plans, certified, reasons = [], [], 0, []
    for seed in range(seeds):
        started = time.perf_counter()
        outcome = plan_scene(scene, seed, settings)
        seconds.append(time.perf_counter() - started)
        if outcome.plan is None:
            reason = f"no plan: {outcome.failure}"
        else:
            plans.append(outcome.plan)
            refusals = check(outcome.plan).refusals
            reason = "; ".join(f"refused: {finding}" for finding in refusals)
        certified += not reason
        say(f"{name}, seed {seed}: {reason or 'certified'}, {seconds[-1]:.2f} s")
        if reason:
            reasons.append(f"seed {seed}: {reason}")
    thing = scene.object
    radius = max(thing.size) if isinstance(thing, Object) else hand_of(build(scene)).radius
    counts: tuple[list[float], ...] = (
        [len(plan.V) for plan in plans],
        [int(np.sum(plan.V == RELOCATE)) for plan in plans],
        [detour(plan, radius) for plan in plans],
        [plan.summary()["largest_force"] for plan in plans],
    )
    return {
        "scene": name,
        "planned": len(plans),
        "certified": certified,
        "seconds": statistics.median(seconds),
        "slowest_seconds": max(seconds),
        **{key: statistics.median(each) if plans else None for key, each in zip(COUNTS, counts, strict=True)},
        "reasons": reasons,
    }
