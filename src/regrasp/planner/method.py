"""The method (paper §3, Fig. 1): subgoals from the global planner, motions between them from the local planner, in a loop."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from regrasp.plan import Plan
from regrasp.planner.assemble import Segment, assemble
from regrasp.planner.clock import Clock, start_clock
from regrasp.planner.configurations import Grasp
from regrasp.planner.grasp import GraspSearch, find_grasp, given_grasp
from regrasp.planner.hand import Hand, hand_of
from regrasp.planner.loads import Loads
from regrasp.planner.local import LocalPlanner, plan_arc, terms_of
from regrasp.planner.outcome import Failure, Outcome, Progress, Report
from regrasp.planner.path import Path, Pose, distance, nominal_path
from regrasp.planner.poses import FREE, Node, PoseGrid
from regrasp.planner.route import GlobalPlanner, Router
from regrasp.planner.scan import new_scan
from regrasp.planner.supports import Support, supports_of
from regrasp.planner.timing import Timing
from regrasp.planner.warm import warmed
from regrasp.scene.schema import Scene
from regrasp.scene.world import World, build

Array = NDArray[np.float64]


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
    turn: float = 0.06
    travel: float = 0.12
    arcs: int = 24
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


def prepare(scene: Scene, settings: Settings) -> Task:
    """World, kernel arrays, supports and pose grid of a scene."""
    return task_of(build(scene), settings)


def task_of(world: World, settings: Settings) -> Task:
    """A world made ready for planning from its scene's start to its goal."""
    scene, hand = world.scene, hand_of(world)
    supports = supports_of(world, hand)
    start, goal = (scene.start.pose.R, scene.start.pose.p), (scene.goal.pose.R, scene.goal.pose.p)
    return Task(world, hand, supports, router_of(scene, hand, supports, start, goal, settings), settings)


def router_of(
    scene: Scene, hand: Hand, supports: tuple[Support, ...], start: Pose, goal: Pose, settings: Settings
) -> Router:
    """The global planner of a scene's surroundings between any two poses."""
    step, angle = settings.route.step * hand.radius, settings.route.angle
    grid = PoseGrid(start, goal, scene.freedoms, step, angle, hand, supports)
    g = np.array(scene.gravity)
    up_W = -g / np.linalg.norm(g) if np.any(g) else np.zeros(3)
    return Router(hand, grid, supports, up_W, settings.route)


def arc_path(task: Task, a: Node, b: Node) -> list[Path]:
    """The nominal path from subgoal a to b, in pieces of at most `intervals` intervals."""
    start, goal = task.router.grid.pose(a), task.router.grid.pose(b)
    assert start is not None
    assert goal is not None
    return way_path(task, start, goal, a.support if a.support == b.support else FREE)


def way_path(task: Task, start: Pose, goal: Pose, support: int, least: int = 4) -> list[Path]:
    """The same between two poses, on the support that carries both (FREE: none does), in `least` intervals or more."""
    s, grid, hand = task.settings, task.router.grid, task.hand
    shift = float(np.linalg.norm(goal[1] - start[1]))
    angle = distance(start, goal, 1.0) - shift
    n = max(least, math.ceil(angle / s.turn - 1e-9), math.ceil(shift / (s.travel * hand.radius) - 1e-9))
    pieces = math.ceil(n / s.intervals)
    each = math.ceil(n / pieces)
    R, p = grid.between(start, goal, support, pieces * each * s.samples)
    step = each * s.samples
    gravity = np.array(task.world.scene.gravity)
    return [
        nominal_path(
            R[c * step : (c + 1) * step + 1], p[c * step : (c + 1) * step + 1], each, s.samples, gravity, hand,
            task.supports,
        )
        for c in range(pieces)
    ]  # fmt: skip


def first_grasp(task: Task, path: Path, rng: np.random.Generator) -> Grasp | Failure:
    """The start grasp the scene gives, or one found for the first arc."""
    scene, hand = task.world.scene, task.hand
    if scene.start.grasp != "auto":
        return given_grasp(hand, path, scene.start.grasp, task.names)
    off = tuple(task.names.index(name) for name in scene.start.off)
    terms, scan = terms_of(hand, task.settings.local), new_scan(hand, path, task.settings.local.relocation)
    return find_grasp(hand, path, scan, terms, off, task.names, task.settings.grasp, rng)


def check_ends(task: Task) -> Failure | None:
    """Start or goal inside an obstacle, which no route mends."""
    grid = task.router.grid
    for where, pose, remedy in (
        ("start", grid.start_pose, "another start.pose"),
        ("goal", grid.goal_pose, "another goal.pose"),
    ):
        hit = task.router.blocked(pose, 0.0)
        if hit:
            return Failure("collision", f"{where}.pose", "object", f"the object is inside {hit}", remedy)
    return None


def plan_pieces(
    task: Task, pieces: list[Path], grasp: Grasp, first: int, rng: np.random.Generator, report: Report,
    clock: Clock, later: int,
) -> tuple[list[Segment], Grasp, Failure | None]:  # fmt: skip
    """Local plans of consecutive pieces of an arc, each from where the one before ends; `later` more arcs follow.

    The segments end with the first that fails.
    """
    planned: list[Segment] = []
    for path in pieces:
        stage = f"segment {first + len(planned) + 1}"
        parts = len(pieces) - len(planned) + later
        result = plan_arc(task.hand, path, grasp, task.names, task.settings.local, rng, report, stage, clock, parts)
        planned.append(Segment(result.motion, result.energy))
        grasp = result.grasp
        if result.failure:
            return planned, grasp, result.failure
    return planned, grasp, None


def out_of_time(limit: float, done: int, last: Failure | None) -> Failure:
    """The time limit ended the run after `done` segments; `last` failed before."""
    before = f"; last failure: {last}" if last else ""
    return Failure(
        "time", f"segment {done + 1}", "", f"no complete plan in {limit:g} s{before}", "more time, or no limit"
    )


def plan_scene(scene: Scene, seed: int, settings: Settings, progress: Report | None = None) -> Outcome:
    """Plan a scene: the loop of the paper's Fig. 1.

    The global planner gives a route of subgoals; the local planner plans its first arc from the grasp at hand; where it
    fails, the arc's cost goes up and the next route may differ. The same seed gives the same plan on any number of threads,
    unless the time is limited.
    """
    clock = start_clock(settings.time_limit)
    report = progress or (lambda _: None)
    with warmed(report):
        return plan_task(prepare(scene, settings), seed, clock, report)


def plan_task(task: Task, seed: int, clock: Clock, report: Report) -> Outcome:
    """`plan_scene` of a scene made ready."""
    settings, rng = task.settings, np.random.default_rng(seed)
    failure = check_ends(task)
    if failure:
        return Outcome(None, failure)
    here, grasp, stuck = task.router.grid.start, None, 0
    segments: list[Segment] = []
    broken: list[Segment] = []
    for attempt in range(settings.arcs):
        report(Progress("route", attempt, settings.arcs, math.nan, math.nan))
        # A first arc is planned however little time there is, so that there is something to show.
        route = task.router.route(here, clock.up if attempt > 0 else lambda: False)
        if attempt > 0 and clock.up():
            break
        if isinstance(route, Failure):
            return Outcome(None, failure or route)
        pieces = arc_path(task, here, route[1])
        if grasp is None or not segments:
            grasp_or = first_grasp(task, pieces[0], rng)
            if isinstance(grasp_or, Failure):
                return Outcome(None, grasp_or)
            grasp = grasp_or
        planned, end, failed = plan_pieces(task, pieces, grasp, len(segments), rng, report, clock, len(route) - 2)
        if failed:
            failure, stuck = failed, stuck + 1
            broken = segments + planned
            task.router.failed(here, route[1])
            if stuck == settings.patience:
                # The grasp at hand leads nowhere: begin again with another one, and with what the arcs have taught.
                here, grasp, stuck, segments = task.router.grid.start, None, 0, []
            continue
        grasp, stuck = end, 0
        segments += planned
        here = route[1]
        if here == task.router.grid.goal:
            plan = plan_of(task, segments, seed, True)
            return Outcome(None, plan) if isinstance(plan, Failure) else Outcome(plan, None)
    if not clock.up():
        return Outcome(None, failure)
    return Outcome(best_so_far(task, segments, broken, seed), out_of_time(settings.time_limit, len(segments), failure))


def plan_of(task: Task, segments: list[Segment], seed: int, complete: bool) -> Plan | Failure:
    """The plan of these segments, or why no forces carry it."""
    s = task.settings
    subgoals = [task.router.grid.start_pose, *(end_pose(segment) for segment in segments)]
    return assemble(
        task.world, task.hand, segments, subgoals, task.supports, s.local.energy.margins, s.loads, s.timing, seed, s,
        complete,
    )  # fmt: skip


def end_pose(segment: Segment) -> Pose:
    """The object's pose at the end of a segment."""
    path = segment.motion.path
    return path.R_WO[-1, -1], path.p_WO[-1, -1]


def best_so_far(task: Task, segments: list[Segment], broken: list[Segment], seed: int) -> Plan | None:
    """What there is when the time is up: the segments that got furthest, with the failed ones after them, not feasible."""
    found = plan_of(task, max(segments, broken, key=len), seed, False)
    return None if isinstance(found, Failure) else found
