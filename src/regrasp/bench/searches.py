"""The paper's own job, timed, and the local minima of its energy (§5)."""

import dataclasses
import math
import statistics
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import wilcoxon

from regrasp.bench.kernels import compile_kernels, say
from regrasp.errors import RegraspError
from regrasp.planner.chain import Change, Codes, ContactMotions, anneal
from regrasp.planner.configurations import Grasp
from regrasp.planner.energy import make_room
from regrasp.planner.local import random_motions, terms_of
from regrasp.planner.method import opening
from regrasp.planner.motion import detail
from regrasp.planner.motions import MOTION_COUNT, ONTO, RELOCATE
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Path
from regrasp.planner.relocation import choose
from regrasp.planner.scan import DIRECTIONS, new_scan
from regrasp.planner.task import Settings, Task, prepare
from regrasp.scene.load import load
from regrasp.search import annealing as generic
from regrasp.search.annealing import Settings as Annealing
from regrasp.settings import read

PAPER_SECONDS = 3600.0
"""§5: "computing 30 subintervals on a PC with 4000 SA iterations takes one hour"."""
PAPER_ITERATIONS = 4000
PAPER_SCENE = "fig4-relocation"
JOBS: dict[str, dict[str, Any]] = {"fig3-puma3": {}, PAPER_SCENE: {"intervals": 30, "turn": math.pi / 60}}
"""Scenes whose first segment is searched, with settings: of the half turn, 90° in the paper's 30 intervals."""


@dataclass(frozen=True)
class Job:
    """One segment with the grasp at its start: what the local planner works on."""

    task: Task
    path: Path
    grasp: Grasp

    def random_start(self, seed: int) -> Codes:
        """A random V."""
        candidates = DIRECTIONS * self.task.settings.local.relocation.candidates
        return random_motions(len(self.path.R_WO), len(self.task.names), candidates, np.random.default_rng(seed))


class SingleEntries(ContactMotions):
    """Eq. (1) with the least moves that reach every V: one entry at a time, as in the paper, which names no others."""

    def propose(self, rng: np.random.Generator) -> Change:
        """One entry drawn anew."""
        make_room(self.found, self.work, self.current)
        V = self.current.V.copy()
        j, i = (int(rng.integers(size)) for size in V.shape)
        code = int(rng.integers(MOTION_COUNT))
        if code == RELOCATE:
            code = ONTO + choose(*self.model, self.current, j, i, rng.random(self.model[3].sample))
        V[j, i] = code
        return Change(V, i, j, j)


MOVES: dict[str, type[ContactMotions]] = {"one entry": SingleEntries, "the planner's": ContactMotions}


@dataclass(frozen=True)
class Run:
    """One search on a Job: s from V to the finished motion, E of the first and the best V, V itself.

    processor_seconds: what the process had of its cores in that time; more than `seconds` if it used several.
    feasible: every constraint holds at every sample.
    """

    seconds: float
    processor_seconds: float
    evaluations: int
    before: float
    after: float
    V: Codes
    feasible: bool


def job(name: str, **changes: Any) -> Job:
    """The first segment of a built-in scene, with changed settings; RegraspError if it has no route or no grasp."""
    scene = load(name)
    settings = dataclasses.replace(read(Settings, scene.planner), **changes)
    task = prepare(scene, settings)
    begun = opening(task, np.random.default_rng(0))
    if isinstance(begun, Failure):
        raise RegraspError(f"{name}: {begun}")
    return Job(task, *begun)


def search(job: Job, V: Codes, annealing: Annealing, seed: int, moves: type[ContactMotions] = ContactMotions) -> Run:
    """Search from V as the local planner does, up to the motion with all joints, contacts and forces."""
    hand, local = job.task.hand, job.task.settings.local
    started, processor = time.perf_counter(), time.process_time()
    terms, scan = terms_of(hand, local), new_scan(hand, job.path, local.relocation)
    problem = moves(hand, job.path, scan, terms, job.grasp, V)
    before = problem.energy()
    run = anneal if moves is ContactMotions else generic.anneal
    result = run(problem, annealing, np.random.default_rng(seed))
    problem.reset(result.best)
    motion = detail(hand, job.path, terms, problem.found, problem.current, problem.work, job.task.names)
    seconds, processor = time.perf_counter() - started, time.process_time() - processor
    trials = annealing.trials if annealing.acceptance > 0.0 else 0
    evaluations = len(result.energies) - 1 + trials
    return Run(seconds, processor, evaluations, before, result.best_energy, result.best, not motion.violations)


def paper(seeds: int) -> dict[str, Any]:
    """The paper's job (§5): 30 intervals, four Puma fingers, 4000 iterations, relocation allowed, one core."""
    compiling = compile_kernels()
    work = job(PAPER_SCENE, **JOBS[PAPER_SCENE])
    annealing = dataclasses.replace(work.task.settings.local.annealing, iterations=PAPER_ITERATIONS)
    runs = []
    for seed in range(seeds):
        runs.append(search(work, work.random_start(seed), annealing, seed))
        say(f"{PAPER_SCENE}, seed {seed}: {runs[-1].seconds:.2f} s, energy {runs[-1].after:.2f}")
    seconds = statistics.median(run.seconds for run in runs)
    answer = {
        "scene": PAPER_SCENE,
        "intervals": len(work.path.R_WO),
        "agents": len(work.task.names),
        "iterations": PAPER_ITERATIONS,
        "runs": seeds,
        "compiling_seconds": compiling,
        "seconds": seconds,
        "processor_seconds": statistics.median(run.processor_seconds for run in runs),
        "slowest_seconds": max(run.seconds for run in runs),
        "evaluations_per_second": statistics.median(run.evaluations / run.seconds for run in runs),
        "energy_before": statistics.median(run.before for run in runs),
        "energy_after": statistics.median(run.after for run in runs),
        "feasible": sum(run.feasible for run in runs),
        "paper_seconds": PAPER_SECONDS,
        "ratio": PAPER_SECONDS / seconds,
    }
    table = Table(title=f"the paper's job on {PAPER_SCENE}", title_justify="left")
    for heading in ("", "the paper", "here"):
        table.add_column(heading, justify="left" if not heading else "right")
    table.add_row("intervals × agents", "30 × 4", f"{answer['intervals']} × {answer['agents']}")
    table.add_row("iterations", str(PAPER_ITERATIONS), str(PAPER_ITERATIONS))
    table.add_row("time, median of the runs", "1 h", f"{seconds:.2f} s")
    table.add_row("processor time, median", "", f"{answer['processor_seconds']:.2f} s")
    table.add_row("slowest run", "", f"{answer['slowest_seconds']:.2f} s")
    table.add_row("ratio", "1", f"{answer['ratio']:.0f}")
    table.add_row("evaluations per second", "", f"{answer['evaluations_per_second']:.0f}")
    table.add_row("energy of the random V, median", "", f"{answer['energy_before']:.1f}")
    table.add_row("energy at the end, median", "", f"{answer['energy_after']:.2f}")
    table.add_row("runs in which every constraint holds", "", f"{answer['feasible']} of {seeds}")
    Console().print(table)
    return answer


def minima(seeds: int) -> dict[str, Any]:
    """Downhill searches and annealing from the same random V's (§5): downhill ends in many minima, annealing lower.

    Both evaluate as many V's. The paper's claim is about changes of one entry; the planner's own moves, of several
    intervals, are shown beside them. Passed if, one entry at a time, downhill ends in more than one V and Wilcoxon's
    signed-rank test, one-sided, gives p < 0.05 for annealing's ends being lower.
    """
    compile_kernels()
    rows = []
    for name, changes in JOBS.items():
        work = job(name, **changes)
        warm = work.task.settings.local.annealing
        cold = dataclasses.replace(warm, acceptance=0.0, iterations=warm.iterations + warm.trials)
        for moves, problem in MOVES.items():
            ends: dict[str, list[Run]] = {"downhill": [], "annealing": []}
            for seed in range(seeds):
                V = work.random_start(seed)
                for kind, settings in (("downhill", cold), ("annealing", warm)):
                    ends[kind].append(search(work, V, settings, seed, problem))
                    say(f"{name}, {moves}, seed {seed}: {kind} ends at {ends[kind][-1].after:.2f}")
            rows.append({"scene": name, "moves": moves, **comparison(ends["downhill"], ends["annealing"])})
    console = Console()
    for name in JOBS:
        table = Table(title=f"{name}: ends of searches from {seeds} random V's", title_justify="left")
        for heading in ("moves", "search", "V's", "least", "median", "greatest", "feasible", "p"):
            table.add_column(heading, justify="left" if heading in ("moves", "search") else "right", no_wrap=True)
        for row in rows:
            for kind in ("downhill", "annealing") if row["scene"] == name else ():
                end = row[kind]
                table.add_row(
                    row["moves"], kind, str(end["different"]), f"{end['least']:.2f}", f"{end['median']:.2f}",
                    f"{end['greatest']:.2f}", str(end["feasible"]), f"{row['p']:.2g}" if kind == "annealing" else "",
                )  # fmt: skip
        console.print(table)
    console.print(
        "V's: how many ends differ. p: that annealing ends lower, Wilcoxon's signed ranks, one-sided.", soft_wrap=True
    )
    shown = [row["downhill"]["different"] > 1 and row["p"] < 0.05 for row in rows if row["moves"] == "one entry"]
    return {"passed": all(shown), "searches": rows}


def comparison(downhill: list[Run], annealed: list[Run]) -> dict[str, Any]:
    """Where the two searches ended, and how sure it is that annealing ends lower."""
    gain = np.array([a.after - d.after for a, d in zip(annealed, downhill, strict=True)])
    # The test is not defined where all pairs are equal; then nothing is shown.
    p = float(wilcoxon(gain, alternative="less").pvalue) if np.any(gain) else 1.0
    return {
        "downhill": distribution(downhill),
        "annealing": distribution(annealed),
        "lower": int(np.sum(gain < 0.0)),
        "higher": int(np.sum(gain > 0.0)),
        "p": p,
    }


def distribution(runs: list[Run]) -> dict[str, Any]:
    """How many ends differ, and where their energies lie."""
    energies = [run.after for run in runs]
    return {
        "different": len({run.V.tobytes() for run in runs}),
        "different_energies": len({round(energy, 6) for energy in energies}),
        "least": min(energies),
        "median": statistics.median(energies),
        "greatest": max(energies),
        "feasible": sum(run.feasible for run in runs),
    }
