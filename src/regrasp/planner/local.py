"""The local planner (paper §4): simulated annealing over the matrix V of contact motions between two subgoals."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from regrasp.planner.chain import ContactMotions, anneal
from regrasp.planner.clock import Clock
from regrasp.planner.configurations import Grasp
from regrasp.planner.energy import Energy, Terms
from regrasp.planner.hand import Hand
from regrasp.planner.motion import Motion, detail
from regrasp.planner.motions import MOTION_COUNT, ONTO, RELOCATE, STAY, MotionSteps, commands
from regrasp.planner.outcome import Failure, Progress, Report
from regrasp.planner.path import Path
from regrasp.planner.relocation import choose
from regrasp.planner.scan import Relocation, Scan, new_scan
from regrasp.search.annealing import Settings as Annealing
from regrasp.search.annealing import State as AnnealingState

Codes = NDArray[np.int16]

THOROUGH = 32  # candidates that a relocation of an old V compares


@dataclass(frozen=True)
class LocalPlanner:
    """Settings of the local planner.

    attempts: annealing runs on an arc before it counts as failed. warm: `annealing.acceptance` of a run that starts from
    an old V: low, so that what is good in it is kept.
    """

    attempts: int = 3
    warm: float = 0.02
    annealing: Annealing = field(default_factory=Annealing)
    energy: Energy = field(default_factory=Energy)
    steps: MotionSteps = field(default_factory=MotionSteps)
    relocation: Relocation = field(default_factory=Relocation)


def terms_of(hand: Hand, settings: LocalPlanner) -> Terms:
    """The settings as the kernels take them."""
    energy, relocation = settings.energy, settings.relocation
    return Terms(
        energy.collision, energy.equilibrium, energy.force, energy.change, energy.stability, energy.clearance,
        energy.margins, relocation.outlook, relocation.sample, relocation.lift * hand.radius,
        commands(settings.steps, hand.radius),
    )  # fmt: skip


def random_motions(n: int, k: int, candidates: int, rng: np.random.Generator) -> Codes:
    """A random V, every entry drawn on its own (paper §5: "random generated initial V matrices").

    candidates: of the scan, one of which every relocation names.
    """
    V = rng.integers(0, MOTION_COUNT, (n, k)).astype(np.int16)
    return np.where(V == RELOCATE, ONTO + rng.integers(0, candidates, (n, k)), V).astype(np.int16)


@dataclass(frozen=True)
class ArcResult:
    """A planned arc: its motion, the grasp at its end, the history of E(V)."""

    motion: Motion
    grasp: Grasp
    energy: NDArray[np.float64]


def resumed(
    hand: Hand, path: Path, scan: Scan, terms: Terms, start: Grasp, old: NDArray[np.int8], rng: np.random.Generator
) -> ContactMotions:
    """The problem at an old V, whose relocations (RELOCATE, as in a plan) choose their candidates one after the other."""
    V = np.where(old == RELOCATE, STAY, old).astype(np.int16)
    problem = ContactMotions(hand, path, scan, terms, start, V)
    for j, i in zip(*np.nonzero(old == RELOCATE), strict=True):
        V[j, i] = ONTO + choose(*problem.model, problem.current, j, i, rng.random(THOROUGH))
        problem.reset(V)
    return problem


def plan_arc(
    hand: Hand, path: Path, start: Grasp, names: tuple[str, ...], settings: LocalPlanner, rng: np.random.Generator,
    report: Report, stage: str, clock: Clock, parts: int, warm: NDArray[np.int8] | None = None,
) -> ArcResult | Failure:  # fmt: skip
    """Contact motions along one nominal path from the grasp at its start, or which constraint failed, where, for whom.

    Each annealing run has one of `parts` equal parts of the time then left. The first starts from the V `warm` (n, k), if
    there is one, and not as hot as the others.
    """
    terms = terms_of(hand, settings)
    scan = new_scan(hand, path, settings.relocation)
    n, k = len(path.R_WO), len(names)
    history: list[NDArray[np.float64]] = []
    worst: Motion | None = None
    for attempt in range(settings.attempts):
        if attempt > 0 and clock.up():
            break
        annealing = settings.annealing
        if warm is not None and attempt == 0:
            annealing = replace(annealing, acceptance=min(settings.warm, annealing.acceptance))
            problem = resumed(hand, path, scan, terms, start, warm, rng)
        else:
            problem = ContactMotions(hand, path, scan, terms, start, random_motions(n, k, len(scan.p_O), rng))
        watch = watcher(report, stage, annealing.iterations)
        result = anneal(problem, annealing, rng, watch, clock.share(parts).elapsed)
        history.append(np.asarray(result.energies))
        problem.reset(result.best)
        motion = detail(hand, path, terms, problem.found, problem.current, problem.work, names)
        if not motion.violations:
            return ArcResult(motion, problem.grasp(n), np.concatenate(history))
        if worst is None or len(motion.violations) < len(worst.violations):
            worst = motion
    assert worst is not None
    return failure_of(worst, stage, n)


def watcher(report: Report, stage: str, total: int) -> Callable[[AnnealingState[Codes]], bool]:
    """The annealing's hook: tells its state as Progress of this stage, never stops it."""

    def tell(state: AnnealingState[Codes]) -> bool:
        report(Progress(stage, state.iteration, total, state.energy, state.best_energy))
        return False

    return tell


REMEDIES = {
    "equilibrium": "more friction, a larger max_force, another agent or a support",
    "collision": "a thinner hand, a smaller planner.local.energy.clearance, or more room",
    "reach": "a larger hand, another start.grasp, or a goal nearer to the hand",
}


def failure_of(motion: Motion, stage: str, n: int) -> Failure:
    """The first violation of the best motion found, in words."""
    first = motion.violations[0]
    return Failure(
        first.constraint,
        f"{stage}, interval {first.interval + 1} of {n}",
        first.who or "object",
        f"{first.detail} ({len(motion.violations)} violations in the best motion found)",
        REMEDIES[first.constraint],
    )
