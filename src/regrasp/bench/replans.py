"""Displaced states along the plans of built-in scenes, planned again: how many, in how many calls, in what time."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from regrasp.bench.kernels import compile_kernels, print_reasons, say
from regrasp.kernels.chains import forward
from regrasp.kernels.inverse import inverse
from regrasp.plan import RELOCATE, Plan
from regrasp.planner.along import interval_at, joints_at, pose_at
from regrasp.planner.hand import Hand, hand_of
from regrasp.planner.method import plan_scene
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Pose
from regrasp.planner.replan import Answer, Replanner
from regrasp.planner.task import Settings
from regrasp.scene.load import load
from regrasp.scene.world import from_plan
from regrasp.settings import read

Array = NDArray[np.float64]

SCENES = ("fig4-relocation", "puma4-obstacles")
FAR, TURNED = 0.02, np.radians(15.0)
"""m and rad: the largest displacement."""
DRAWS = 10
"""Displaced states of a plan."""
CALLS = 10
"""Calls of `step` before a state counts as not planned."""
LIMIT = 0.1
"""s: what the median call has at most."""
REACHED = 1e-6
"""m and rad: how exactly the fingers follow the object to a displaced state."""


@dataclass(frozen=True)
class Displaced:
    """A state off a plan's path at time t, s: the object's pose, the joints (nq,)."""

    t: float
    X_WO: Pose
    q: Array


def moved(plan: Plan, hand: Hand, t: float, shift: Array, turn: Array) -> Displaced | None:
    """The object displaced from its place at time t, and the joints with which the fingers that hold it went along.

    None where one of them cannot.
    """
    (R, p), q = pose_at(plan, t), joints_at(plan, t)
    D = Rotation.from_rotvec(turn).as_matrix()
    for i in np.flatnonzero(plan.V[interval_at(plan, t)] < RELOCATE).tolist():
        mine = slice(hand.chains.start[i], hand.chains.start[i + 1])
        joints = q[mine].copy()
        R_WL, p_WL = np.empty((len(joints) + 1, 3, 3)), np.empty((len(joints) + 1, 3))
        forward(hand.chains, i, joints, R_WL, p_WL)
        residual, _ = inverse(hand.chains, i, D @ R_WL[-1], p + shift + D @ (p_WL[-1] - p), joints, R_WL, p_WL)
        if residual > REACHED:
            return None
        q[mine] = joints
    return Displaced(t, (D @ R, p + shift), q)


def draws(plan: Plan, hand: Hand, rng: np.random.Generator) -> Iterator[Displaced | None]:
    """States at times and with displacements drawn at random; None for those that the fingers cannot reach."""
    while True:
        t = float(rng.uniform(0.1, 0.9) * plan.time[-1, -1])
        d, a = rng.standard_normal(3), rng.standard_normal(3)
        shift, turn = (x * rng.uniform(0.4, 1.0) / np.linalg.norm(x) for x in (d, a))
        yield moved(plan, hand, t, FAR * shift, TURNED * turn)


def replans(seeds: int) -> dict[str, Any]:
    """DRAWS displaced states along the plan of each of SCENES with seeds 0 … seeds − 1, each planned again.

    Passed if the median call takes LIMIT at most.
    """
    compile_kernels()
    rows = [scene_row(name, seeds) for name in SCENES]
    table = Table(title=f"planned again, {seeds} seeds per scene", title_justify="left", box=None, padding=(0, 1, 0, 0))
    for heading in ("scene", "planned", "1st call", "calls", "impossible", "ms", "90 %", "state", "search", "forces"):
        table.add_column(heading, justify="left" if heading == "scene" else "right", no_wrap=True)
    for row in rows:
        table.add_row(
            row["scene"], f"{row['planned']}/{row['states']}", str(row["at_once"]), f"{row['calls']:.1f}",
            str(row["impossible"]), *(f"{row[key]:.0f}" for key in ("median_ms", "ninety_ms", *PHASES)),
        )  # fmt: skip
    console = Console()
    console.print(table)
    print_reasons(console, rows)
    return {"passed": all(row["median_ms"] <= 1e3 * LIMIT for row in rows), "seeds": seeds, "scenes": rows}


PHASES = ("state", "search", "forces")


def scene_row(name: str, seeds: int) -> dict[str, Any]:
    """One scene. calls: mean of the states that were planned; ms: of all calls that searched.

    impossible: draws that the fingers cannot reach, or with the object or one of them inside something.
    """
    scene = load(name)
    settings = read(Settings, scene.planner)
    steps: list[Answer] = []
    calls: list[int] = []
    reasons, lost, states = [], 0, 0
    for seed in range(seeds):
        outcome = plan_scene(scene, seed, settings)
        if outcome.plan is None:
            reasons.append(f"seed {seed}: no plan: {outcome.failure}")
            continue
        plan, done = outcome.plan, 0
        hand = hand_of(from_plan(plan.scene, plan.xml, plan.assets))
        source = draws(plan, hand, np.random.default_rng(seed))
        while done < DRAWS:
            state = next(source)
            if state is None:
                lost += 1
                continue
            answers = asked(Replanner(plan, seed=done), state)
            if inside(answers[0].failure):
                lost += 1
                continue
            done += 1
            steps += [answer for answer in answers if answer.spent.search > 0.0]
            if answers[-1].new:
                calls.append(len(answers))
            else:
                reasons.append(f"seed {seed}, state {done}: {answers[-1].failure}")
        states += DRAWS
        say(f"{name}, seed {seed}: {len(calls)} of {states} states planned again")
    seconds = np.array([answer.seconds for answer in steps])
    return {
        "scene": name,
        "states": states,
        "planned": len(calls),
        "at_once": calls.count(1),
        "calls": float(np.mean(calls)) if calls else float("nan"),
        "impossible": lost,
        "median_ms": 1e3 * float(np.median(seconds)),
        "ninety_ms": 1e3 * float(np.quantile(seconds, 0.9)),
        **{
            key: 1e3 * float(np.median([getattr(answer.spent, key) for answer in steps if answer.new]))
            for key in PHASES
        },
        "reasons": reasons,
    }


def inside(failure: Failure | None) -> bool:
    """Whether the draw has put the object or a finger into something."""
    return failure is not None and (failure.constraint, failure.where) == ("collision", "start")


def asked(replanner: Replanner, state: Displaced) -> list[Answer]:
    """Steps from one state until there is a plan, or CALLS of them."""
    answers: list[Answer] = []
    while not answers or (not answers[-1].new and len(answers) < CALLS):
        answers.append(replanner.step(state.t, state.X_WO, state.q))
    return answers
