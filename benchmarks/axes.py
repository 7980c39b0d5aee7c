"""The paper's job made longer, with more fingers, with more candidates, among obstacles: one job for each value on an axis."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.jobs import problem_of, start_of
from regrasp.bench.searches import JOBS, PAPER_SCENE, Job
from regrasp.errors import RegraspError
from regrasp.planner.arcs import straight
from regrasp.planner.configurations import UNKNOWN, Configurations, Grasp
from regrasp.planner.method import opening
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Path, nominal_path
from regrasp.planner.pieces import first_piece
from regrasp.planner.scan import Relocation
from regrasp.planner.task import Settings, Task, prepare
from regrasp.planner.terms import Shortcuts
from regrasp.scene.load import load, validate
from regrasp.scene.schema import Scene
from regrasp.settings import read

Array = NDArray[np.float64]


def paper_settings() -> Settings:
    """The paper's 30 intervals for 90°."""
    return dataclasses.replace(read(Settings, load(PAPER_SCENE).planner), **JOBS[PAPER_SCENE])


def job_of(scene: Scene, settings: Settings) -> Job:
    """The first segment of a scene; RegraspError if it has no route or no grasp."""
    task = prepare(scene, settings)
    begun = opening(task, np.random.default_rng(0))
    if isinstance(begun, Failure):
        raise RegraspError(f"{scene.name}: {begun}")
    return Job(task, *begun)


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
    return dataclasses.replace(work, path=nominal_path(R, p, n, m, gravity, hand, task.supports))


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
    return Job(task, unheld(task), grasp)


def unheld(task: Task) -> Path:
    """The nominal path of a scene's first segment, whoever could hold the object along it."""
    return first_piece(task, straight(task.router.start_pose, task.router.goal_pose), None)


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
    """(N, 3): middles of the agents' bodies in all configurations of which they were looked at."""
    return found.p_WG[: found.used[0]][found.own[: found.used[0]] != UNKNOWN].reshape(-1, 3)


AXES: dict[str, tuple[Callable[[int], Job], tuple[int, ...]]] = {
    "intervals": (longer, (10, 20, 40, 80, 120, 240)),
    "agents": (handed, (2, 3, 4, 5, 6, 7, 8)),
    "candidates": (scanned, (30, 60, 120, 240, 480)),
    "obstacles": (among, (0, 10, 25, 50, 100, 200)),
}
"""Axis → the job at a value on it, and the values."""
