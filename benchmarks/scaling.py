"""How the cost of an evaluation and of a move grows: with intervals, agents, candidates, obstacles; and with threads."""

import dataclasses
import math
import statistics
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.jobs import against_plain, from_scratch, problem_of, start_of
from benchmarks.measure import Row, compared, exponent, row, seconds_of
from regrasp.bench.searches import JOBS, PAPER_SCENE, Job
from regrasp.errors import RegraspError
from regrasp.planner.chain import ContactMotions
from regrasp.planner.configurations import Configurations, Grasp, bodies_along
from regrasp.planner.energy import Shortcuts
from regrasp.planner.method import Settings, Task, arc_path, first_grasp, prepare
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Path, nominal_path
from regrasp.planner.scan import Relocation, candidate_free, new_scan
from regrasp.scene.load import load, validate
from regrasp.scene.schema import Scene
from regrasp.search.annealing import Settings as Annealing
from regrasp.settings import read

Array = NDArray[np.float64]
INTERVALS = (10, 20, 40, 80, 120, 240)
AGENTS = (2, 3, 4, 5, 6, 7, 8)
CANDIDATES = (30, 60, 120, 240, 480)
OBSTACLES = (0, 10, 25, 50, 100, 200)
WHOLE, MOVE = "one evaluation from scratch", "one move"
SINES = 5_000_000
RANDOM_V = 5  # V's that are evaluated from scratch


AXES: dict[str, tuple[int, ...]] = {
    "intervals": INTERVALS,
    "agents": AGENTS,
    "candidates": CANDIDATES,
    "obstacles": OBSTACLES,
}


def rows(axis: str, quick: bool, seeds: int) -> list[Row]:
    """Both costs at every value on one axis (quick: at three), then how they grow with it."""
    annealing = Annealing(iterations=60, trials=20) if quick else Annealing(iterations=300, trials=100)
    jobs = {"intervals": longer, "agents": handed, "candidates": scanned, "obstacles": among}[axis]
    values = AXES[axis]
    if quick:
        values = values[0], values[len(values) // 2], values[-1]
    return along(axis, {value: jobs(value) for value in values}, annealing, seeds)


def along(axis: str, jobs: dict[int, Job], annealing: Annealing, seeds: int) -> list[Row]:
    """The rows of an axis from its jobs."""
    whole, moves = [], []
    for value, work in jobs.items():
        name = f"{value} {axis}"
        if axis == "candidates":
            times = [scan_all(work) for _ in range(RANDOM_V)]
            whole.append(row(f"{axis}: scan of all, one agent", name, times, "s", x=value))
        else:
            V = [start_of(work, seed) for seed in range(RANDOM_V)]
            problem = problem_of(work, V[0], Shortcuts())
            times = [statistics.mean(from_scratch(problem, each) for each in V) for _ in range(RANDOM_V)]
            done = counted_work(problem, RANDOM_V * RANDOM_V)
            whole.append(row(f"{axis}: {WHOLE}", name, times, "s", x=value, note=done))
        moves.append(against_plain(f"{axis}: {MOVE}", name, work, annealing, seeds, x=value))
    return [*whole, *moves, *growth(whole), *growth(moves)]


def counted_work(problem: ContactMotions, evaluations: int) -> str:
    """What one of so many evaluations did, beside the one that made the problem."""
    counts = problem.work.counts
    words = {"configurations": "contacts", "programs": "programs", "pivots": "pivots", "ways": "free motions"}
    return ", ".join(f"{getattr(counts, key)[0] / (evaluations + 1):.0f} {word}" for key, word in words.items())


def growth(rows: list[Row]) -> list[Row]:
    """The exponent of the cost over the axis, ours and the reference's, and of the last of its steps alone."""
    x, y = [float(each.x) for each in rows if each.x], [each.value for each in rows if each.x]
    plain = [each.reference for each in rows if each.x and each.reference]
    slope = exponent(x, y)
    against = exponent(x, plain) if len(plain) == len(x) else None
    note = f"× {y[-1] / y[0]:.3g} from {x[0]:g} to {x[-1]:g}"
    if len(x) > 2:
        note += f"; {exponent(x[-2:], y[-2:]):.2f} over the last step"
    return [Row(rows[0].group, "exponent", slope, "", 0.0, len(x), reference=against, note=note)]


def paper_settings() -> Settings:
    """The paper's 30 intervals for 90°."""
    return dataclasses.replace(read(Settings, load(PAPER_SCENE).planner), **JOBS[PAPER_SCENE])


def job_of(scene: Scene, settings: Settings) -> Job:
    """The first segment of a scene; RegraspError if it has no route or no grasp."""
    task = prepare(scene, settings)
    path = first_path(task)
    grasp = first_grasp(task, path, np.random.default_rng(0))
    if isinstance(grasp, Failure):
        raise RegraspError(f"{scene.name}: {grasp}")
    return Job(task, path, grasp)


def first_path(task: Task) -> Path:
    """The nominal path of a scene's first segment."""
    route = task.router.route(task.router.grid.start, lambda: False)
    if isinstance(route, Failure):
        raise RegraspError(f"{task.world.scene.name}: {route}")
    return arc_path(task, route[0], route[1])[0]


def paper_job() -> Job:
    """The paper's."""
    return job_of(load(PAPER_SCENE), paper_settings())


def longer(n: int) -> Job:
    """The paper's quarter turn there and back as often as n intervals of 3° need: each costs what the others cost."""
    work = paper_job()
    hand, task, m, quarter = work.task.hand, work.task, paper_settings().samples, math.pi / 2
    angle = math.pi / 60 * np.arange(n * m + 1) / m
    angle = quarter - np.abs(angle % (2.0 * quarter) - quarter)
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(len(angle))
    R = np.array([[c, -s, zero], [s, c, zero], [zero, zero, zero + 1.0]]).transpose(2, 0, 1) @ work.path.R_WO[0, 0]
    p = np.tile(work.path.p_WO[0, 0], (len(angle), 1))
    gravity = np.array(task.world.scene.gravity)
    return dataclasses.replace(work, path=nominal_path(R, p, n, m, gravity, task.supports, hand.kind_O, hand.size_O))


def handed(k: int) -> Job:
    """The paper's job with k Puma fingers on the ring."""
    base = load(PAPER_SCENE)
    scene = changed(base, model={"hand": "puma", "fingers": k})
    if k > 2:
        return job_of(scene, paper_settings())
    # Two tips do not hold the object. They stand where two of four do, and every force program is infeasible.
    task, four = prepare(scene, paper_settings()), paper_job().grasp
    rows = [0, 2]
    grasp = Grasp(
        four.q.reshape(4, -1)[rows].ravel(), four.holds[rows], four.p_OC[rows], four.p_TC[rows], four.R_OT[rows]
    )
    return Job(task, first_path(task), grasp)


def changed(scene: Scene, **fields: Any) -> Scene:
    """The scene with fields replaced, checked again."""
    return validate({**scene.model_dump(mode="json", exclude_defaults=True), **fields})


def scanned(candidates: int) -> Job:
    """The paper's job with so many points on the object."""
    work, settings = paper_job(), paper_settings()
    local = dataclasses.replace(settings.local, relocation=Relocation(candidates=candidates))
    return dataclasses.replace(
        work, task=dataclasses.replace(work.task, settings=dataclasses.replace(settings, local=local))
    )


def scan_all(work: Job) -> float:
    """s to find out of every candidate whether agent 0 can stand there at the start."""
    hand, local = work.task.hand, work.task.settings.local
    scan = new_scan(hand, work.path, local.relocation)
    R_B, p_B = bodies_along(hand, work.path)

    def every() -> None:
        for c in range(len(scan.p_O)):
            candidate_free(hand, work.path, scan, R_B[0], p_B[0], 0, 0, c, local.energy.clearance)

    return seconds_of(every)


def among(count: int) -> Job:
    """The paper's job among spheres, boxes and capsules around the hand, kept from where it worked without them.

    Places are drawn in a cylinder as large as the hand's reach and kept if they are clear of every body of every
    configuration that a short annealing met.
    """
    work = paper_job()
    problem = problem_of(work, start_of(work, 0), Shortcuts())
    problem.trials(500, np.random.default_rng(0))
    rng, clear, met = np.random.default_rng(1), 0.06, bodies_met(problem.found)
    bodies: list[dict[str, Any]] = []
    while len(bodies) < count:
        r, a = 0.7 * math.sqrt(rng.random()), rng.uniform(0.0, 2.0 * math.pi)
        p = np.array([r * math.cos(a), r * math.sin(a), rng.uniform(0.03, 0.5)])
        if np.min(np.linalg.norm(met - p, axis=1)) < clear + 0.03:
            continue
        shape = ("sphere", "box", "capsule")[len(bodies) % 3]
        size = rng.uniform(0.006, 0.015, {"sphere": 1, "box": 3, "capsule": 2}[shape]).tolist()
        pose = {"position": p.tolist(), "euler": rng.uniform(-1.5, 1.5, 3).tolist()}
        bodies.append({"name": f"obstacle{len(bodies)}", "shape": shape, "size": size, "pose": pose})
    scene = changed(load(PAPER_SCENE), environment=bodies)
    task = prepare(scene, paper_settings())
    return Job(task, work.path, work.grasp)


def bodies_met(found: Configurations) -> Array:
    """(N, 3): middles of the agents' bodies in all configurations."""
    return found.p_WG[1 : found.used[0]].reshape(-1, 3)


@njit(nogil=True)
def sines(count: int) -> float:
    """Arithmetic alone, without memory: how many processors there are to be had."""
    x = 0.0
    for i in range(count):
        x += math.sin(x + i)
    return x


def threads(work: Job, moves: int, repeats: int) -> list[Row]:
    """Moves per second of two chains on two threads, against the same two one after the other."""
    T = np.full(moves, 0.5)
    V = [start_of(work, seed) for seed in range(2)]
    problems = [problem_of(work, each, Shortcuts()) for each in V]

    def chain(c: int) -> None:
        problems[c].reset(V[c])
        problems[c].moves(T, V[c].copy(), problems[c].energy(), np.random.default_rng(0))

    def spin(_: int) -> None:
        sines(SINES)

    return [
        both("moves", chain, moves, repeats, ""),
        both("sines, which share nothing", spin, SINES, repeats, "what the machine gives at the time"),
    ]


def both(name: str, work: Callable[[int], None], count: int, repeats: int, note: str) -> Row:
    """Two pieces of work on two threads and one after the other: how many per second."""

    def together() -> None:
        list(pool.map(work, (0, 1)))

    def in_turn() -> None:
        work(0)
        work(1)

    with ThreadPoolExecutor(2) as pool:
        together()
        pairs = [(2 * count / seconds_of(together), 2 * count / seconds_of(in_turn)) for _ in range(repeats)]
    two, one = zip(*pairs, strict=True)
    return compared("threads, reference: one thread", f"{name}, two threads", two, one, "1/s", note=note)
