"""The chain over V on whole jobs, against the same chain with every exact shortcut off: each V whole, nothing remembered."""

import dataclasses
import statistics
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import Row, compared, row, seconds_of
from regrasp.bench.searches import PAPER_ITERATIONS, Job, job, search
from regrasp.planner.chain import Codes, ContactMotions, anneal
from regrasp.planner.configurations import keep_only
from regrasp.planner.local import random_motions, terms_of
from regrasp.planner.memory import forget
from regrasp.planner.scan import new_scan
from regrasp.planner.terms import Shortcuts
from regrasp.scene.load import builtin
from regrasp.search.annealing import Settings as Annealing

PLAIN = Shortcuts(changed=0, memory=0, warm=0, bound=0)
SWITCHED: dict[str, dict[str, int]] = {
    "evaluating only what a change reaches": {"changed": 0},
    "memory": {"memory": 0},
    "warm force programs": {"warm": 0},
    "the early end at the threshold": {"bound": 0},
}
"""Shortcut in words → the change of `Shortcuts` that switches it off."""
ALL = "all of them"
ARC = "first arc of "


@dataclass(frozen=True)
class Chain:
    """One annealing run from a random V: s per move, trial moves too, energies after every iteration, what was counted."""

    seconds_per_move: float
    energies: NDArray[np.float64]
    best: Codes
    counts: dict[str, int]


def problem_of(work: Job, V: Codes, shortcuts: Shortcuts) -> ContactMotions:
    """Eq. (1) on the job with V evaluated, nothing known of the scan."""
    hand, local = work.task.hand, work.task.settings.local
    scan = new_scan(hand, work.path, local.relocation)
    return ContactMotions(hand, work.path, scan, terms_of(hand, local), work.grasp, V, shortcuts)


def start_of(work: Job, seed: int) -> Codes:
    """A random V whose relocations name candidates of the scan as the job's settings have it."""
    settings = work.task.settings.local.relocation
    candidates = len(new_scan(work.task.hand, work.path, settings).p_O)
    return random_motions(len(work.path.R_WO), len(work.task.names), candidates, np.random.default_rng(seed))


def chain(work: Job, seed: int, annealing: Annealing, shortcuts: Shortcuts) -> Chain:
    """Anneal from a random V that has been evaluated."""
    problem = problem_of(work, start_of(work, seed), shortcuts)
    started = time.perf_counter()
    found = anneal(problem, annealing, np.random.default_rng(seed))
    seconds = time.perf_counter() - started
    done, moves = problem.work.counts, annealing.iterations + annealing.trials
    counts = {field.name: int(getattr(done, field.name)[0]) for field in dataclasses.fields(done)}
    return Chain(seconds / moves, found.energies, found.best, counts)


def pair(work: Job, seed: int, annealing: Annealing, reference: Shortcuts = PLAIN) -> tuple[Chain, Chain]:
    """One annealing with all shortcuts and with the reference's; both must be one chain."""
    fast, slow = (chain(work, seed, annealing, shortcuts) for shortcuts in (Shortcuts(), reference))
    np.testing.assert_allclose(fast.energies, slow.energies, rtol=1e-9)
    return fast, slow


def gains(group: str, work: Job, annealing: Annealing, seeds: int) -> list[Row]:
    """What each shortcut gains by itself, and all together: s per move, beside the same chain without."""
    found = []
    for words, change in [*SWITCHED.items(), (ALL, {key: 0 for each in SWITCHED.values() for key in each})]:
        pairs = [pair(work, seed, annealing, Shortcuts(**change)) for seed in range(seeds)]
        ours, reference = ([chain.seconds_per_move for chain in side] for side in zip(*pairs, strict=True))
        note = more_work([(fast.counts, slow.counts) for fast, slow in pairs])
        found.append(compared(group, f"reference without {words}", ours, reference, note=note))
    return found


def paper(work: Job, seeds: int, iterations: int = PAPER_ITERATIONS) -> list[Row]:
    """The paper's job from random V's to finished motions; then what its shortcuts gain."""
    annealing = dataclasses.replace(work.task.settings.local.annealing, iterations=iterations)
    runs = [search(work, work.random_start(seed), annealing, seed) for seed in range(seeds)]
    times = [run.seconds for run in runs]
    feasible = f"{sum(run.feasible for run in runs)} of {seeds} feasible"
    group = "the paper's job"
    return [
        row(group, "from a random V to the motion", times, "s", note=f"slowest {max(times):.3f} s; {feasible}"),
        row(group, "energy at the end", [run.after for run in runs], ""),
        *gains(f"{group}, one move", work, annealing, min(seeds, 5)),
    ]


def scenes(iterations: int, seeds: int) -> list[Row]:
    """What the shortcuts gain on the first arc of every built-in scene."""
    annealing = Annealing(iterations=iterations, trials=100)
    return [each for name in builtin() for each in gains(f"{ARC}{name}, one move", job(name), annealing, seeds)]


def more_work(counts: list[tuple[dict[str, int], dict[str, int]]]) -> str:
    """How many times more often the reference did what."""
    words = {
        "configurations": "contacts followed",
        "programs": "force programs",
        "pivots": "pivots",
        "ways": "free motions",
    }
    times = {key: statistics.median(b[key] / max(a[key], 1) for a, b in counts) for key in words}
    return ", ".join(f"{words[key]} × {times[key]:.1f}" for key in words if abs(times[key] - 1.0) > 0.05)


def from_scratch(problem: ContactMotions, V: Codes) -> float:
    """s of the evaluation of a whole V of which nothing is known, not even the scan."""
    _, _, scan, _, found, work = problem.model
    keep_only(found, 1 + np.arange(V.shape[1])[None])
    for memory in (work.pairs, work.sums, work.ways):
        forget(memory)
    scan.row[:] = 0
    scan.used[0] = 1
    return seconds_of(lambda: problem.reset(V))


def moves_apart(work: Job, repeats: int) -> list[Row]:
    """What one move is made of: the proposal, and its evaluation beside the same V's evaluated whole."""
    V = start_of(work, 0)
    annealed = chain(work, 0, Annealing(iterations=1000), Shortcuts()).best
    fast, slow = problem_of(work, annealed, Shortcuts()), problem_of(work, annealed, PLAIN)
    rng = np.random.default_rng(0)
    for _ in range(500):  # until the scan is known about as well as it is in the middle of a run
        fast.propose(rng)
    proposing, ours, reference = [], [], []
    for _ in range(repeats):
        spent = [0.0, 0.0, 0.0]
        for _ in range(100):
            started = time.perf_counter()
            move = fast.propose(rng)
            bound = fast.energy() + rng.exponential(1.0)
            proposed = time.perf_counter()
            value = fast.evaluate(move, bound)
            evaluated = time.perf_counter()
            slow.reset(move.V)
            spent[2] += time.perf_counter() - evaluated
            spent[0] += proposed - started
            spent[1] += evaluated - proposed
            whole = slow.energy()
            assert (value == np.inf and whole > bound) or np.isclose(value, whole, rtol=1e-9)
        proposing.append(spent[0] / 100)
        ours.append(spent[1] / 100)
        reference.append(spent[2] / 100)
    scratch = [from_scratch(fast, V) for _ in range(repeats)]
    group = "one move, its call from Python included"
    return [
        row(group, "propose", proposing, "s"),
        compared(group, "evaluate", ours, reference, note="reference: V whole, no shortcuts"),
        row(group, "evaluate a random V from scratch", scratch, "s", note="nothing known of the scan either"),
    ]
