"""Start grasps to choose from: the best that `start.grasp: auto` finds for the way ahead, each with what it bears."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.basis import program
from regrasp.kernels.forces import EDGES
from regrasp.plan import Plan
from regrasp.planner.balance import balance
from regrasp.planner.configurations import Grasp
from regrasp.planner.legs import moved, stances_for
from regrasp.planner.method import check_ends, plan_of, start_grasp
from regrasp.planner.motions import OFF, STAY
from regrasp.planner.outcome import Failure, Progress, Report
from regrasp.planner.path import Path
from regrasp.planner.pieces import first_piece, rest_at
from regrasp.planner.poses import START
from regrasp.planner.reserve import Margins
from regrasp.planner.task import Settings, Task, prepare
from regrasp.planner.warm import warmed
from regrasp.scene.schema import Scene

Array = NDArray[np.float64]

FINE = 1e-3  # of μ, to which the least friction is found


@dataclass(frozen=True)
class Hold:
    """One agent's contact.

    p_O, n_O (3,): where it touches, and the object's outward normal there; q: its joints; force_W (3,): on the object, N.
    """

    agent: str
    p_O: Array
    n_O: Array
    q: Array
    force_W: Array


@dataclass(frozen=True)
class Proposal:
    """A start grasp.

    holds: of the agents in contact, all others are off. friction: part of μ without which no forces hold the object at rest;
    the smaller, the safer. rest: a plan of one interval in which the object stays where it is.
    """

    holds: tuple[Hold, ...]
    friction: float
    rest: Plan

    def to_dict(self) -> dict[str, Any]:
        """Plain data: the agents that hold and those that are off."""
        return {
            "friction": self.friction,
            "holds": [
                {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(hold).items()}
                for hold in self.holds
            ],
            "off": [name for name in self.rest.agent_names if name not in {hold.agent for hold in self.holds}],
        }


def propose(
    scene: Scene, seed: int, count: int, settings: Settings, progress: Report | None = None
) -> tuple[Proposal, ...] | Failure:
    """At most `count` start grasps for the first piece of the route, the one that the planner would take first.

    A grasp that the scene gives is the only one.
    """
    report = progress or (lambda _: None)
    with warmed(report):
        task = prepare(
            scene, replace(settings, grasp=replace(settings.grasp, restarts=max(settings.grasp.restarts, 3 * count)))
        )
        report(Progress("route", 0, 1, np.nan, np.nan))
        route = check_ends(task) or task.router.route(START, lambda: False, lambda _: None)
        if isinstance(route, Failure):
            return route
        given = start_grasp(task, route[0])
        if isinstance(given, Failure):
            return given
        if given is not None:
            return _all(task, (given,), seed)
        rng = np.random.default_rng(seed)
        stances = stances_for(task, first_piece(task, route[0].arc, None), rng, task.off)
        return stances if isinstance(stances, Failure) else _all(task, tuple(s.grasp for s in stances[:count]), seed)


def _all(task: Task, grasps: tuple[Grasp, ...], seed: int) -> tuple[Proposal, ...] | Failure:
    path = rest_at(task, task.router.start_pose, 1, None)
    made = [_proposal(task, path, grasp, seed) for grasp in grasps]
    found = tuple(each for each in made if isinstance(each, Proposal))
    return found or next(each for each in made if isinstance(each, Failure))


def _proposal(task: Task, path: Path, grasp: Grasp, seed: int) -> Proposal | Failure:
    V = np.where(grasp.holds == 1, STAY, OFF).astype(np.int16)[None]
    held = moved(task, path, grasp, V, "start")
    if isinstance(held, Failure):
        return held
    rest = plan_of(task, [held[0]], seed, True)
    if isinstance(rest, Failure):
        return rest
    start = task.hand.chains.start
    holds = tuple(
        Hold(name, rest.p_OC_O[0, 0, i], rest.n_O[0, 0, i], grasp.q[start[i] : start[i + 1]], rest.force_W[0, 0, i])
        for i, name in enumerate(task.names)
        if grasp.holds[i]
    )
    return Proposal(holds, least_friction(task, path, grasp, np.nan_to_num(rest.n_O[0, 0])), rest)


def least_friction(task: Task, path: Path, grasp: Grasp, n_O: Array) -> float:
    """The smallest part of μ, of agents and supports, with which forces hold the object at the path's start, by bisection.

    n_O (k, 3): the object's outward normals at the contacts. Nothing is kept in reserve.
    """
    k, slots = len(task.names), path.support_mode.shape[1]
    lp, codes, t = program(EDGES * (k + slots), k), np.full(k, STAY, np.int16), np.zeros((k, 3))
    low, high = 0.0, 1.0
    while high - low > FINE:
        use = 0.5 * (low + high)
        margins = Margins(1.0 - use, 0.0, 0.0, np.inf)
        held, _, _ = balance(task.hand, path, 0, 0, grasp.holds, codes, grasp.p_OC, n_O, t, margins, False, lp)
        low, high = (low, use) if held else (use, high)
    return high
