"""The local planner (paper §4): simulated annealing over the matrix V of contact motions between two subgoals."""

import functools
import math
import threading
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from regrasp.planner.chain import ContactMotions, anneal
from regrasp.planner.clock import Clock
from regrasp.planner.configurations import Grasp
from regrasp.planner.hand import Hand
from regrasp.planner.motion import Motion, detail
from regrasp.planner.motions import MOTION_COUNT, ONTO, RELOCATE, STAY, MotionSteps, commands
from regrasp.planner.outcome import Failure, Progress, Report
from regrasp.planner.path import Path, head
from regrasp.planner.relocation import choose
from regrasp.planner.scan import Relocation, Scan, new_scan
from regrasp.planner.terms import Energy, Terms
from regrasp.processors import available
from regrasp.search.annealing import Settings as Annealing
from regrasp.search.annealing import State as AnnealingState

Codes = NDArray[np.int16]

THOROUGH = 32  # candidates that a relocation of an old V compares


@dataclass(frozen=True)
class LocalPlanner:
    """Settings of the local planner.

    attempts: annealing runs on an arc before it counts as failed. threads: that make them side by side, 0 for as many as there
    are cores; the result does not depend on it. warm: `annealing.acceptance` of a run that starts from an old V: low, so that
    what is good in it is kept.
    """

    attempts: int = 3
    threads: int = 0
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
    """The best motion found on an arc, its V with the candidates of its relocations, the grasp at its end, the history of E(V).

    onward: V of the intervals ahead. moves: made in all annealing runs. failure: which constraint the motion breaks, where,
    for whom; None where it breaks none.
    """

    motion: Motion
    V: Codes
    onward: Codes
    grasp: Grasp
    energy: NDArray[np.float64]
    moves: int
    failure: Failure | None


def resumed(
    hand: Hand, path: Path, scan: Scan, terms: Terms, start: Grasp, old: Codes, rng: np.random.Generator
) -> ContactMotions:
    """The problem at an old V, whose relocations without a candidate (RELOCATE, as in a plan) choose theirs in turn."""
    V = np.where(old == RELOCATE, STAY, old).astype(np.int16)
    problem = ContactMotions(hand, path, scan, terms, start, V)
    for j, i in zip(*np.nonzero(old == RELOCATE), strict=True):
        V[j, i] = ONTO + choose(*problem.model, problem.current, j, i, rng.random(THOROUGH))
        problem.reset(V)
    return problem


def plan_arc(
    hand: Hand, path: Path, start: Grasp, names: tuple[str, ...], settings: LocalPlanner, rng: np.random.Generator,
    report: Report, stage: str, clock: Clock, parts: int, warm: Codes | None = None, ahead: int = 0,
) -> ArcResult:  # fmt: skip
    """Contact motions along one nominal path from the grasp at its start.

    The last `ahead` of its intervals are searched with the others, so that these end in a grasp that goes on, but are not
    part of the result: whether they break a constraint does not count.

    Each annealing run has one of `parts` equal parts of the time then left, and numbers of its own to draw. Runs go side by
    side, and the first of them, in their order, that breaks no constraint counts: so the result does not depend on how many
    threads there are. Where the time is limited, it is the first to be done, and a run for whose moves there is too little of
    it ends as soon as it breaks no constraint. The first run starts from the V `warm` (n, k), if there is one, and not as hot
    as the others.
    """
    done, one = threading.Event(), threading.Lock()
    n = len(path.R_WO) - ahead
    part = head(path, n)

    def beside(terms: Terms, V: Codes) -> ContactMotions:
        return ContactMotions(hand, part, new_scan(hand, part, settings.relocation), terms, start, V[:n])

    def result_of(V: Codes, terms: Terms) -> tuple[Motion, Grasp]:
        problem = beside(terms, V)
        return detail(hand, part, terms, problem.found, problem.current, problem.work, names), problem.grasp(n)

    def search(run: int, rng: np.random.Generator) -> ArcResult | None:
        if run > 0 and (done.is_set() or clock.up()):
            return None
        annealing, terms, scan = settings.annealing, terms_of(hand, settings), new_scan(hand, path, settings.relocation)
        if warm is not None and run == 0:
            annealing = replace(annealing, acceptance=min(settings.warm, annealing.acceptance))
            problem = resumed(hand, path, scan, terms, start, warm, rng)
        else:
            V = random_motions(len(path.R_WO), len(names), len(scan.p_O), rng)
            problem = ContactMotions(hand, path, scan, terms, start, V)

        def watch(state: AnnealingState[Codes]) -> bool:
            def best() -> list[Motion]:
                return [result_of(state.best, terms)[0]]

            if run == waited[0]:
                total = annealing.iterations
                with one:
                    lowest = min(state.best_energy, least[0])
                    report(Progress(stage, state.iteration, total, state.energy, lowest, motions=best))
            return done.is_set() or (hurried(state.iteration) and enough(state))

        def hurried(iteration: int) -> bool:
            return share.elapsed() * annealing.iterations > iteration

        def enough(state: AnnealingState[Codes]) -> bool:
            if state.best_energy == seen[0]:
                return False
            seen[0] = state.best_energy
            looked().reset(state.best[:n])
            return looked().breaks_nothing()

        @functools.cache  # most runs are never short of time
        def looked() -> ContactMotions:
            return beside(terms, problem.snapshot())

        seen, share = [math.nan], clock.share(parts)
        result = anneal(problem, annealing, rng, watch, share.elapsed)
        with one:  # the interpreter runs one thread at a time anyway, and who comes second may find all done
            if done.is_set():
                return None
            motion, grasp = result_of(result.best, terms)
            failure = failure_of(motion, stage, n) if motion.violations else None
            if failure is None and clock.end < math.inf:
                done.set()
        return ArcResult(
            motion,
            result.best[:n],
            result.best[n:],
            grasp,
            np.asarray(result.energies),
            len(result.energies) - 1,
            failure,
        )

    rngs, waited, least = rng.spawn(settings.attempts), [0], [math.inf]
    results: list[ArcResult] = []
    with ThreadPoolExecutor(settings.threads or available()) as pool:
        try:
            runs = [pool.submit(search, run, mine) for run, mine in enumerate(rngs)]
            for run in runs if clock.end == math.inf else as_completed(runs):
                result = run.result()
                if result is not None:
                    results.append(result)
                    total, shown = settings.annealing.iterations, functools.partial(list[Motion], (result.motion,))
                    with one:
                        least[0] = min(least[0], float(result.energy.min()))
                        report(Progress(stage, result.moves, total, float(result.energy[-1]), least[0], motions=shown))
                    if result.failure is None:
                        break
                waited[0] += 1  # a run beside the one that counts has nothing to report
        finally:
            done.set()
    best = min(results, key=lambda result: len(result.motion.violations))
    return replace(
        best,
        energy=np.concatenate([result.energy for result in results]),
        moves=sum(result.moves for result in results),
    )


REMEDIES = {
    "equilibrium": "more friction, a larger max_force, another agent or a support",
    "collision": "a thinner hand, a smaller planner.local.energy.clearance, or more room",
    "reach": "a larger hand, another start.grasp, or a goal nearer to the hand",
}


def failure_of(motion: Motion, stage: str, n: int) -> Failure:
    """The first violation of a motion, in words."""
    first = motion.violations[0]
    return Failure(
        first.constraint,
        f"{stage}, interval {first.interval + 1} of {n}",
        first.who or "object",
        f"{first.detail} ({len(motion.violations)} violations found)",
        REMEDIES[first.constraint],
    )
