"""Plans of every built-in scene, executed in physics: as planned, and in perturbed trials with object feedback."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from regrasp.bench.kernels import compile_kernels, print_reasons, say
from regrasp.planner.method import plan_scene
from regrasp.planner.task import Settings
from regrasp.scene.load import load
from regrasp.settings import read
from regrasp.verify.replay import MODES, RATE, Nominal, Trial, replay
from regrasp.verify.trials import wilson

TRIALS = 100
"""Perturbed executions of a scene, shared out evenly over its plans."""
OPEN_RATE = 0.95
"""Part of the plans that must reach the goal open loop; with feedback all must."""
GUIDED_TRIALS = 20
"""The same as TRIALS where supports carry the object."""
NEAR, NEAR_RATE = (0.01, np.radians(10.0)), 0.8
"""m and rad within which such plans end near the goal, and the part of them that must with feedback."""


def replays(seeds: int, names: Sequence[str]) -> dict[str, Any]:
    """Built-in scenes with seeds 0 … seeds − 1 and default settings: planned, executed, tried TRIALS times.

    A seed without a plan counts as a failure. Passed if open loop reaches the goal in 95 %, feedback in all, and 95 % of
    the perturbed trials with feedback; where supports carry the object, if 80 % end near the goal with feedback.
    """
    compile_kernels()
    rows = [scene_row(name, seeds, -(-(GUIDED_TRIALS if load(name).carriers else TRIALS) // seeds)) for name in names]
    table = Table(title=f"replay, {seeds} seeds per scene", title_justify="left", box=None, padding=(0, 1, 0, 0))
    for heading in ("scene", "mode", "at goal", "near", "worst", "on the way", "corr.", "speed"):
        table.add_column(heading, justify="left" if heading in ("scene", "mode") else "right", no_wrap=True)
    for row in rows:
        for mode in MODES:
            each = row[mode]
            table.add_row(
                row["scene"], mode, f"{each['passed']}/{seeds}", str(each["near"]), _off(each["worst"]), _off(each["tube"]),
                "-" if each["correlation"] is None else f"{each['correlation']:.3f}", _number(each["speed"]),
            )  # fmt: skip
    tried = Table(title="perturbed trials with feedback", title_justify="left", box=None, padding=(0, 1, 0, 0))
    for heading in ("scene", "at goal", "95 % interval", "median", "drops", "slip mm", "force N"):
        tried.add_column(heading, justify="left" if heading == "scene" else "right", no_wrap=True)
    for row in rows:
        each = row["trials"]
        low, high = each["wilson"]
        tried.add_row(
            row["scene"], f"{each['successes']}/{each['trials']}", f"{low:.3f} to {high:.3f}", _off(each["median"]),
            str(each["drops"]), _number(each["largest_slip_mm"]), _number(each["largest_force"]),
        )  # fmt: skip
    console = Console()
    console.print(table)
    console.print(tried)
    print_reasons(console, rows)
    return {"passed": all(row["passed"] for row in rows), "seeds": seeds, "scenes": rows}


FIGURES = ("worst", "tube", "correlation", "speed")


def scene_row(name: str, seeds: int, share: int) -> dict[str, Any]:
    """One built-in scene: its plans as planned in both modes, and `share` perturbed trials of each."""
    scene = load(name)
    settings = read(Settings, scene.planner)
    runs: dict[str, list[Nominal]] = {mode: [] for mode in MODES}
    trials: list[Trial] = []
    reasons, lost = [], 0
    for seed in range(seeds):
        outcome = plan_scene(scene, seed, settings)
        if outcome.plan is None:
            reasons.append(f"seed {seed}: no plan: {outcome.failure}")
            lost += share
            continue
        found = replay(outcome.plan, trials=share, seed=seed, trial_modes=("feedback",))
        for each in found.nominal:
            runs[each.mode].append(each)
            if not each.passed:
                reasons.append(f"seed {seed}, {each.mode}: {each.failure or 'leaves the tube'}")
        done = found.trials[0].trials
        trials += done
        reasons += [f"seed {seed}, trial {n}: {trial.failure}" for n, trial in enumerate(done) if trial.failure]
        good = " ".join(f"{each.mode} {'reached' if each.passed else 'MISSED'}" for each in found.nominal)
        say(f"{name}, seed {seed}: {good}, {found.trials[0].successes} of {share} trials")
    successes, count = sum(trial.failure is None for trial in trials), len(trials) + lost
    tried = {"trials": count, "successes": successes, "wilson": wilson(successes, count), **_trial_figures(trials)}
    modes = {mode: _figures(runs[mode]) for mode in MODES}
    passed = (
        modes["feedback"]["near"] >= NEAR_RATE * seeds
        if scene.carriers
        else (
            modes["open"]["passed"] >= OPEN_RATE * seeds
            and modes["feedback"]["passed"] == seeds
            and successes >= RATE * count
        )
    )
    return {"scene": name, "passed": passed, **modes, "trials": tried, "reasons": reasons}


def _figures(runs: list[Nominal]) -> dict[str, Any]:
    if not runs:
        return {"passed": 0, "near": 0, **dict.fromkeys(FIGURES)}
    final, tube = np.array([each.final for each in runs]), np.array([each.largest for each in runs])
    return {
        "passed": sum(each.passed for each in runs),
        "near": int(np.sum(np.all(final <= NEAR, axis=1))),
        "worst": final.max(axis=0).tolist(),
        "tube": tube.max(axis=0).tolist(),
        "correlation": min((each.correlation for each in runs if each.correlation is not None), default=None),
        "speed": float(np.median([each.speed for each in runs])),
    }


def _trial_figures(trials: list[Trial]) -> dict[str, Any]:
    if not trials:
        return dict.fromkeys(("median", "largest_slip_mm", "largest_force")) | {"drops": 0}
    final = np.median([trial.final for trial in trials], axis=0)
    return {
        "median": final.tolist(),
        "drops": sum(trial.dropped for trial in trials),
        "largest_slip_mm": 1e3 * max(trial.slip for trial in trials),
        "largest_force": max(trial.force for trial in trials),
    }


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _off(error: list[float] | None) -> str:
    """m and rad in mm and degrees."""
    return "-" if error is None else f"{1e3 * error[0]:.2f} mm {np.degrees(error[1]):.2f}°"
