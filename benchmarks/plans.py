"""Time to the first certified plan of every built-in scene, from the scene in memory, kernels in memory too.

A plan counts when `check` certifies it. Its own time is not counted: who plans needs the motion, who doubts it the check; it
stands in a column of its own.
"""

import dataclasses
import statistics
from typing import Any

from benchmarks.measure import Row, row, seconds_of
from regrasp.planner.method import plan_scene
from regrasp.planner.outcome import Outcome
from regrasp.planner.task import Settings
from regrasp.scene.load import builtin, load
from regrasp.scene.schema import Scene
from regrasp.settings import read
from regrasp.verify.check import check

LIMITS = (0.1, 0.2, 0.3, 0.5, 1.0, 2.0)
"""s: values of --time-limit."""
GROUP = "the first certified plan"


def rows(seeds: int, limits: tuple[float, ...] = LIMITS) -> list[Row]:
    """Every built-in scene, without a limit and with growing ones."""
    return [each for name in builtin() for each in scene(name, seeds, limits)]


def scene(name: str, seeds: int, limits: tuple[float, ...]) -> list[Row]:
    """One scene: s without a limit; the part of the seeds certified under each limit, up to that at which half are."""
    settings = read(Settings, load(name).planner)
    free = [planned(load(name), seed, settings) for seed in range(seeds)]
    checking = statistics.median(each["check"] for each in free)
    good = sum(each["certified"] for each in free)
    found = [
        row(GROUP, f"{name}, no limit", [each["seconds"] for each in free], "s",
            note=f"{good} of {seeds} certified; check {checking:.2f} s")
    ]  # fmt: skip
    least = None
    for limit in limits:
        limited = dataclasses.replace(settings, time_limit=limit)
        runs = [planned(load(name), seed, limited) for seed in range(seeds)]
        part = sum(each["certified"] for each in runs) / seeds
        took = statistics.median(each["seconds"] for each in runs)
        found.append(Row(
            GROUP, f"{name}, limit {limit:g} s", part, "certified", 0.0, seeds, x=limit, note=f"took {took:.2f} s",
        ))  # fmt: skip
        if part >= 0.5:
            least = limit
            break
    value = float("nan") if least is None else least
    return [
        *found,
        Row(GROUP, f"{name}, least limit for half", value, "s", 0.0, seeds, note=f"of {', '.join(map(str, limits))} s"),
    ]


def planned(scene: Scene, seed: int, settings: Settings) -> dict[str, Any]:
    """Plan and check: whether certified, s of both."""
    outcomes: list[Outcome] = []
    seconds = seconds_of(lambda: outcomes.append(plan_scene(scene, seed, settings)))
    plan = outcomes[0].plan if outcomes[0].failure is None else None
    refused = [True]
    checking = seconds_of(lambda: refused.append(bool(check(plan).refusals))) if plan is not None else float("nan")
    return {"seconds": seconds, "certified": not refused[-1], "check": checking}
