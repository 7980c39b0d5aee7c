"""The local planner (paper §4): simulated annealing over the matrix V of contact motions between two subgoals."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from regrasp.planner.clock import Clock
from regrasp.planner.energy import Energy, Terms, adopt, evaluate, new_work
from regrasp.planner.grasp import Grasp, grasp_at, put
from regrasp.planner.hand import Hand
from regrasp.planner.motion import Motion, detail
from regrasp.planner.motions import MOTION_COUNT, RELOCATE, MotionSteps, commands
from regrasp.planner.outcome import Failure, Progress, Report
from regrasp.planner.path import Path
from regrasp.planner.relocation import Relocation, Scan, new_scan
from regrasp.planner.state import empty_state
from regrasp.search.annealing import Settings as Annealing
from regrasp.search.annealing import State as AnnealingState
from regrasp.search.annealing import anneal

Codes = NDArray[np.int8]


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
        energy.margins, relocation.outlook, relocation.tries, relocation.lift * hand.radius,
        commands(settings.steps, hand.radius),
    )  # fmt: skip


def random_motions(n: int, k: int, rng: np.random.Generator) -> Codes:
    """A random V, every entry drawn on its own (paper §5: "random generated initial V matrices")."""
    return rng.integers(0, MOTION_COUNT, (n, k)).astype(np.int8)


@dataclass(frozen=True)
class Change:
    """A proposed V, which differs from the current one in intervals first … final only."""

    V: Codes
    first: int
    final: int


class ContactMotions:
    """Eq. (1) on one arc as a problem for `search.annealing`: the current V and its State, and the trial beside it."""

    def __init__(self, hand: Hand, path: Path, scan: Scan, terms: Terms, start: Grasp, V: Codes) -> None:
        self.hand, self.path, self.scan, self.terms = hand, path, scan, terms
        self.current, self.trial = empty_state(hand, path), empty_state(hand, path)
        put(hand, start, self.current)
        self.work = new_work(hand, path, scan)
        self.reset(V)

    def reset(self, V: Codes) -> None:
        """Take V as the current state, evaluated from scratch."""
        n = len(V)
        self._energy, stop = evaluate(
            self.hand, self.path, self.scan, self.terms, V, 0, n - 1, np.inf, True, self.current, self.trial, self.work
        )
        adopt(self.hand, self.trial, self.current, 0, stop)
        self.stop = 0

    def energy(self) -> float:
        """E of the current V."""
        return self._energy

    def propose(self, rng: np.random.Generator) -> Change:
        """One agent does another motion over a run of intervals, or a change of motion moves to another time."""
        V = self.current.V.copy()
        n, k = V.shape
        i = int(rng.integers(k))
        first = int(rng.integers(n))
        if rng.random() < 0.3:
            # Carry the motion of a neighbouring interval on: moves the time of a change without a new one.
            ahead = bool(rng.random() < 0.5)
            final = min(n - 1, first + int(rng.integers(1, 4)) - 1)
            source = first - 1 if ahead else final + 1
            if 0 <= source < n and V[source, i] != RELOCATE:
                V[first : final + 1, i] = V[source, i]
                return Change(V, first, final)
        code = int(rng.integers(MOTION_COUNT))
        final = first
        if code != RELOCATE and rng.random() < 0.7:
            final = min(n - 1, first + int(rng.integers(1, n + 1)) - 1)
        V[first : final + 1, i] = code
        return Change(V, first, final)

    def evaluate(self, move: Change, bound: float) -> float:
        """E of the proposed V, or inf as soon as it is known to exceed the bound."""
        self._tried, self.stop = evaluate(
            self.hand, self.path, self.scan, self.terms, move.V, move.first, move.final, bound, False,
            self.current, self.trial, self.work,
        )  # fmt: skip
        return self._tried

    def accept(self, move: Change) -> None:
        """Make the proposed V the current one."""
        adopt(self.hand, self.trial, self.current, move.first, self.stop)
        self._energy = self._tried

    def reject(self, move: Change) -> None:
        """Keep the current V: the trial is written anew by the next evaluation."""

    def snapshot(self) -> Codes:
        """The current V."""
        return self.current.V.copy()


@dataclass(frozen=True)
class ArcResult:
    """A planned arc: its motion, the grasp at its end, the history of E(V)."""

    motion: Motion
    grasp: Grasp
    energy: NDArray[np.float64]


def plan_arc(
    hand: Hand, path: Path, start: Grasp, names: tuple[str, ...], settings: LocalPlanner, rng: np.random.Generator,
    report: Report, stage: str, clock: Clock, parts: int, warm: Codes | None = None,
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
            V, annealing = warm, replace(annealing, acceptance=min(settings.warm, annealing.acceptance))
        else:
            V = random_motions(n, k, rng)
        problem = ContactMotions(hand, path, scan, terms, start, V)
        watch = watcher(report, stage, annealing.iterations)
        result = anneal(problem, annealing, rng, watch, clock.share(parts).elapsed)
        history.append(np.asarray(result.energies))
        problem.reset(result.best)
        motion = detail(hand, path, scan, terms, problem.current, result.best, problem.work, names)
        if not motion.violations:
            return ArcResult(motion, grasp_at(problem.current, n), np.concatenate(history))
        if worst is None or len(motion.violations) < len(worst.violations):
            worst = motion
    assert worst is not None
    return failure_of(worst, stage, n)


def watcher(report: Report, stage: str, total: int) -> Callable[[AnnealingState[Codes]], bool]:
    """The annealing's hook: tells its state as Progress of this stage, never stops it."""

    def tell(state: AnnealingState[Codes]) -> bool:
        if state.iteration % 50 == 0:
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
