"""A scene made ready for planning, and the settings of all that plans it."""

import math
from dataclasses import dataclass, field

import numpy as np

from regrasp.planner.hand import Hand, geom_index, hand_of
from regrasp.planner.loads import Loads
from regrasp.planner.local import LocalPlanner
from regrasp.planner.path import Pose
from regrasp.planner.route import GlobalPlanner, Router
from regrasp.planner.stances import GraspSearch
from regrasp.planner.supports import Support, supports_of
from regrasp.planner.timing import Timing
from regrasp.scene.schema import Scene
from regrasp.scene.world import World, build


@dataclass(frozen=True)
class Settings:
    """All settings of the planner; a scene's `planner` section and the command line's flags are these fields.

    intervals: at most so many per arc (n of the paper). samples: steps in which an interval is computed.
    turn: rad, and travel: parts of the object's radius, that the object moves in one interval at most.
    arcs: local planning runs before the whole is given up. patience: failures from one subgoal before all begins anew.
    time_limit: s, 0 for none. The annealing runs share what is left of it and cool by the clock, so that they are cold
    in time, and the best V so far counts; a run without a complete plan by then fails and returns the best so far, which is
    not feasible. Compilation counts too.
    """

    intervals: int = 30
    samples: int = 12
    turn: float = 0.08
    travel: float = 0.16
    arcs: int = 36
    patience: int = 3
    time_limit: float = 0.0
    local: LocalPlanner = field(default_factory=LocalPlanner)
    route: GlobalPlanner = field(default_factory=GlobalPlanner)
    grasp: GraspSearch = field(default_factory=GraspSearch)
    loads: Loads = field(default_factory=Loads)
    timing: Timing = field(default_factory=Timing)

    def __post_init__(self) -> None:
        if not 0.0 <= self.time_limit < math.inf:
            raise ValueError(f"time_limit is {self.time_limit}, legal: 0 s (none) or more")


@dataclass(frozen=True)
class Task:
    """A scene made ready for planning."""

    world: World
    hand: Hand
    supports: tuple[Support, ...]
    router: Router
    settings: Settings

    @property
    def names(self) -> tuple[str, ...]:
        """The agents' names."""
        return tuple(agent.name for agent in self.world.agents)

    @property
    def off(self) -> tuple[int, ...]:
        """The agents that the scene has off at the start."""
        return tuple(self.names.index(name) for name in self.world.scene.start.off)


def prepare(scene: Scene, settings: Settings) -> Task:
    """World, kernel arrays, supports and pose grid of a scene."""
    return task_of(build(scene), settings)


def task_of(world: World, settings: Settings) -> Task:
    """A world made ready for planning from its scene's start to its goal."""
    scene, hand = world.scene, hand_of(world)
    supports = supports_of(world, hand)
    start, goal = (scene.start.pose.R, scene.start.pose.p), (scene.goal.pose.R, scene.goal.pose.p)
    return Task(world, hand, supports, router_of(world, hand, supports, start, goal, settings), settings)


def router_of(
    world: World, hand: Hand, supports: tuple[Support, ...], start: Pose, goal: Pose, settings: Settings
) -> Router:
    """The global planner of a scene's surroundings between any two poses."""
    energy = settings.local.energy
    return Router(
        hand, world.scene.freedoms, supports, start, goal, np.array(world.scene.gravity), energy.margins, energy.clearance,
        settings.route, names_of(world),
    )  # fmt: skip


def names_of(world: World) -> dict[int, str]:
    """What the static bodies are called, by their place in Hand.geoms."""
    index = geom_index(world)
    return {
        row: world.model.geom(int(g)).name or "a part of the hand" for g in world.static_geoms for row in index[int(g)]
    }
