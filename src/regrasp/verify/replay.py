"""replay: a plan executed in physics, as planned and in worlds that differ from it; docs/replay.md explains the report.

Two modes: `open`, the plan alone, and `feedback`, with the measured pose of the object.
"""

import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regrasp.control.controller import Control
from regrasp.control.impedance import gains
from regrasp.control.reference import reference
from regrasp.plan import Plan
from regrasp.processors import available
from regrasp.scene.world import World, from_plan
from regrasp.settings import read
from regrasp.verify.diagnosis import Failure, diagnose, succeeded
from regrasp.verify.execution import Execution, execute
from regrasp.verify.physics import PERIOD, Reality, nominal
from regrasp.verify.trials import Perturbation, draw, wilson

Array = NDArray[np.float64]

MODES = ("open", "feedback")
TOLERANCE = {"open": (3e-3, math.radians(3.0)), "feedback": (2e-3, math.radians(2.0))}
"""m, rad: at the goal, in the world as planned."""
TRIAL_TOLERANCE = (5e-3, math.radians(5.0))
LARGE = 0.02
"""Objects of more than a decimetre: this part of their size, where it is more than the tolerance in m."""
TUBE = (5e-3, math.radians(5.0))
"""m, rad: about the planned path, in the world as planned."""
RATE = 0.95
"""Of successes among perturbed trials."""


@dataclass(frozen=True)
class Nominal:
    """One execution in the world as planned: the figures, and the Execution itself.

    tolerance, tube: m and rad allowed at the goal and on the way; final, largest: found there. force: N, the largest of
    an agent. slip: m, the largest of an agent where it should not slide. correlation, gain: of the measured with the
    planned force components, and the share of the planned ones that is there; None where the plan has none. speed:
    simulated over real time.
    """

    mode: str
    passed: bool
    failure: Failure | None
    tolerance: tuple[float, float]
    tube: tuple[float, float]
    final: tuple[float, float]
    largest: tuple[float, float]
    slip: float
    force: float
    correlation: float | None
    gain: float | None
    speed: float
    run: Execution


@dataclass(frozen=True)
class Trial:
    """One perturbed execution: final error in m and rad, largest slip in m and force in N, whether the object was dropped."""

    final: tuple[float, float]
    slip: float
    force: float
    dropped: bool
    failure: Failure | None


@dataclass(frozen=True)
class Trials:
    """All perturbed executions of one mode; tolerance: m and rad."""

    mode: str
    tolerance: tuple[float, float]
    trials: tuple[Trial, ...]

    @property
    def successes(self) -> int:
        """How many ended at the goal."""
        return sum(trial.failure is None for trial in self.trials)

    @property
    def rate(self) -> float:
        """Part of the trials that ended at the goal."""
        return self.successes / len(self.trials)

    @property
    def passed(self) -> bool:
        """Whether enough of them did."""
        return self.rate >= RATE

    def to_dict(self) -> dict[str, Any]:
        """The figures as JSON."""
        final = np.array([trial.final for trial in self.trials])
        return {
            "mode": self.mode,
            "passed": self.passed,
            "trials": len(self.trials),
            "successes": self.successes,
            "rate": self.rate,
            "wilson": wilson(self.successes, len(self.trials)),
            "tolerance": self.tolerance,
            "median_error": [_finite(x) for x in np.median(final, axis=0)],
            "worst_error": [_finite(x) for x in final.max(axis=0)],
            "drops": sum(trial.dropped for trial in self.trials),
            "largest_slip": max(trial.slip for trial in self.trials),
            "largest_force": max(trial.force for trial in self.trials),
            "failures": [asdict(trial.failure) | {"trial": n} for n, trial in enumerate(self.trials) if trial.failure],
        }


@dataclass(frozen=True)
class Replay:
    """What `replay` found."""

    scene: str
    nominal: tuple[Nominal, ...]
    trials: tuple[Trials, ...]

    @property
    def passed(self) -> bool:
        """Whether every mode reached the goal within its tolerance, and enough of the trials with feedback did."""
        return all(each.passed for each in self.nominal) and all(
            each.passed for each in self.trials if each.mode == "feedback"
        )

    def to_dict(self) -> dict[str, Any]:
        """The figures as JSON; m, rad, N, s."""
        runs = []
        for each in self.nominal:
            row = {key: value for key, value in vars(each).items() if key not in ("run", "failure")}
            row |= {key: [_finite(x) for x in row[key]] for key in ("final", "largest")}
            runs.append(row | {"failure": asdict(each.failure) if each.failure else None})
        return {
            "scene": self.scene,
            "passed": self.passed,
            "nominal": runs,
            "trials": [each.to_dict() for each in self.trials],
        }


def replay(
    plan: Plan, trials: int = 0, seed: int = 0, control: Control | None = None, ranges: Perturbation | None = None,
    cores: int | None = None, trial_modes: tuple[str, ...] = MODES,
) -> Replay:  # fmt: skip
    """Execute a plan in both modes, and `trials` times in each of `trial_modes` in worlds drawn with `seed` from `ranges`.

    control: by default what the plan's scene says. Raises InputError if the stored model cannot be built or driven.
    """
    bench = Bench(plan, control_of(plan) if control is None else control)
    ranges = Perturbation() if ranges is None else ranges
    runs = tuple(bench.nominal(mode) for mode in MODES)
    all_trials = []
    for mode in trial_modes if trials else ():
        done = _pooled(plan, bench.control, ranges, mode, seed, trials, cores or available())
        all_trials.append(Trials(mode, bench.tolerance(TRIAL_TOLERANCE), done))
    return Replay(str(plan.scene.get("name", "")), runs, tuple(all_trials))


def control_of(plan: Plan) -> Control:
    """The control settings that the plan's scene states."""
    return read(Control, plan.scene.get("control") or {}, "control")


class Bench:
    """A plan set up for execution."""

    def __init__(self, plan: Plan, control: Control) -> None:
        self.plan, self.control = plan, control
        self.world: World = from_plan(plan.scene, plan.xml, plan.assets)
        self.reference = reference(plan, self.world, PERIOD, control.phases)
        self.gains = gains(self.world, plan.joints[0, 0], control.impedance, PERIOD)
        self.size = 2.0 * float(np.max(self.world.model.geom_rbound[self.world.object_geoms]))

    def tolerance(self, plain: tuple[float, float]) -> tuple[float, float]:
        """A tolerance for an object of this size."""
        return max(plain[0], LARGE * self.size), plain[1]

    def run(self, mode: str, reality: Reality, rng: np.random.Generator) -> Execution:
        """One execution."""
        return execute(self.world, self.reference, self.gains, reality, self.control, mode == "feedback", rng)

    def nominal(self, mode: str) -> Nominal:
        """The execution in the world as planned, judged."""
        run = self.run(mode, nominal(self.world), np.random.default_rng(0))
        tolerance = self.tolerance(TOLERANCE[mode])
        tube = self.tolerance(TUBE)
        final, largest = _errors(run)
        failure = diagnose(run, self.plan.agent_names, tolerance)
        passed = succeeded(run, tolerance) and largest[0] <= tube[0] and largest[1] <= tube[1]
        return Nominal(
            mode, passed, failure, tolerance, tube, final, largest, float(run.slip.max(initial=0.0)), largest_force(run),
            *agreement(run), run.seconds / run.wall, run,
        )  # fmt: skip

    def trial(self, mode: str, ranges: Perturbation, seed: int, number: int) -> Trial:
        """Trial `number` of a series: the same seed and number give the same world, whatever the mode."""
        rng = np.random.default_rng([seed, number])
        run = self.run(mode, draw(self.plan, self.world, ranges, rng), rng)
        final, _ = _errors(run)
        failure = diagnose(run, self.plan.agent_names, self.tolerance(TRIAL_TOLERANCE))
        return Trial(final, float(run.slip.max(initial=0.0)), largest_force(run), run.trouble is not None, failure)


def largest_force(run: Execution) -> float:
    """The largest force of an agent on the object, N."""
    return float(np.linalg.norm(run.force_W, axis=2).max(initial=0.0))


def agreement(run: Execution) -> tuple[float | None, float | None]:
    """Pearson's correlation of measured and planned force components over all agents and records in contact, and the
    slope of the measured over the planned ones (least squares): 1 where all of the planned force is there."""
    measured, planned = run.force_W[run.bears].ravel(), run.planned_W[run.bears].ravel()
    if len(planned) < 2 or np.ptp(planned) == 0.0:
        return None, None
    (spread, common), (_, variance) = np.cov(planned, measured)
    if variance == 0.0:
        return None, 0.0
    return float(common / math.sqrt(spread * variance)), float(common / spread)


def _errors(run: Execution) -> tuple[tuple[float, float], tuple[float, float]]:
    if not len(run.time):
        return (math.inf, math.inf), (math.inf, math.inf)
    off = run.off
    final, largest = off[-1], off.max(axis=0)
    return (float(final[0]), float(final[1])), (float(largest[0]), float(largest[1]))


def _pooled(
    plan: Plan, control: Control, ranges: Perturbation, mode: str, seed: int, trials: int, cores: int
) -> tuple[Trial, ...]:
    """All trials of a mode, shared out over the cores; the result does not depend on how many there are."""
    shares = [range(first, trials, min(cores, trials)) for first in range(min(cores, trials))]
    if len(shares) == 1:
        return tuple(_share(plan, control, ranges, mode, seed, shares[0]))
    with ProcessPoolExecutor(len(shares)) as pool:
        jobs = [pool.submit(_share, plan, control, ranges, mode, seed, share) for share in shares]
        results = [job.result() for job in jobs]
    done: list[Trial | None] = [None] * trials
    for share, result in zip(shares, results, strict=True):
        for number, trial in zip(share, result, strict=True):
            done[number] = trial
    return tuple(trial for trial in done if trial is not None)


def _share(plan: Plan, control: Control, ranges: Perturbation, mode: str, seed: int, numbers: range) -> list[Trial]:
    bench = Bench(plan, control)
    return [bench.trial(mode, ranges, seed, number) for number in numbers]


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
