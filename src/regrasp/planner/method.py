"""The method (paper §3, Fig. 1): subgoals from the global planner, motions between them from the local planner, in a loop."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from regrasp.plan import Plan
from regrasp.planner.arcs import Arc
from regrasp.planner.assemble import Segment, assemble
from regrasp.planner.clock import Clock, start_clock
from regrasp.planner.configurations import Grasp
from regrasp.planner.grasp import given_grasp
from regrasp.planner.legs import Planned, plan_leg, stances_for, told
from regrasp.planner.outcome import Failure, Outcome, Progress, Report, Tried
from regrasp.planner.path import Path, Pose
from regrasp.planner.pieces import first_piece
from regrasp.planner.poses import GOAL, START
from regrasp.planner.route import Leg
from regrasp.planner.task import Settings, Task, prepare
from regrasp.planner.warm import warmed
from regrasp.scene.schema import Scene

Array = NDArray[np.float64]

SOON = 200  # poses of the first route that are looked at when the time is up
SPARE = 0.06  # s of a time limit for what comes after the search, forces and times, but no more than an eighth of it


def start_grasp(task: Task, leg: Leg) -> Grasp | Failure | None:
    """The start grasp the scene gives, None where the planner shall choose one."""
    given = task.world.scene.start.grasp
    if given == "auto":
        return None
    return given_grasp(task.hand, first_piece(task, leg.arc, None), given, task.names)


def opening(task: Task, rng: np.random.Generator) -> tuple[Path, Grasp] | Failure:
    """What the local planner begins with: the first piece of the route, and a grasp at its start."""
    route = task.router.route(START, lambda: False, lambda _: None)
    if isinstance(route, Failure):
        return route
    path = first_piece(task, route[0].arc, None)
    grasp = start_grasp(task, route[0])
    if grasp is None:
        stances = stances_for(task, path, rng, task.off)
        grasp = stances if isinstance(stances, Failure) else stances[0].grasp
    return grasp if isinstance(grasp, Failure) else (path, grasp)


def check_ends(task: Task) -> Failure | None:
    """Start or goal inside an obstacle, which no route mends."""
    for where, pose, remedy in (
        ("start", task.router.start_pose, "another start.pose"),
        ("goal", task.router.goal_pose, "another goal.pose"),
    ):
        hit = task.router.blocked(pose, 0.0)
        if hit:
            return Failure("collision", f"{where}.pose", "object", f"the object is inside {hit}", remedy)
    return None


def out_of_time(limit: float, done: int, last: Failure | None) -> Failure:
    """The time limit ended the run after `done` segments; `last` failed before."""
    before = f"; last failure: {last}" if last else ""
    return Failure(
        "time", f"segment {done + 1}", "", f"no complete plan in {limit:g} s{before}", "more time, or no limit"
    )


def plan_scene(scene: Scene, seed: int, settings: Settings, progress: Report | None = None) -> Outcome:
    """Plan a scene: the loop of the paper's Fig. 1.

    The global planner gives a route of subgoals; the local planner plans its first leg from the grasp at hand; where it
    fails, the leg's cost goes up and the next route may differ. The same seed gives the same plan on any number of threads,
    unless the time is limited.
    """
    limit = settings.time_limit
    clock = start_clock(limit - min(SPARE, limit / 8.0))
    report = progress or (lambda _: None)
    with warmed(report):
        task = prepare(scene, settings)
        repairs = task.world.repairs + task.world.links.said
        return replace(plan_task(task, seed, clock, report), repairs=repairs)


def plan_task(task: Task, seed: int, clock: Clock, report: Report) -> Outcome:
    """`plan_scene` of a scene made ready."""
    settings, rng = task.settings, np.random.default_rng(seed)
    failure = check_ends(task)
    if failure:
        return Outcome(None, failure)
    here, grasp, stuck = START, None, 0
    segments: list[Segment] = []
    broken: list[Segment] = []
    tried: list[Tried] = []
    for attempt in range(settings.arcs):
        along(task, report, segments, [])(Progress("route", attempt, settings.arcs, math.nan, math.nan, motions=list))
        # A first arc is planned however little time there is, so that there is something to show, if it is soon found.
        stop = clock.up if attempt > 0 else lambda: clock.up() and len(task.router.graph.poses) > SOON
        route = task.router.route(here, stop, report)
        if attempt > 0 and clock.up():
            break
        if isinstance(route, Failure):
            return Outcome(None, failure or route, tuple(tried))
        if not segments:
            given = start_grasp(task, route[0])
            if isinstance(given, Failure):
                return Outcome(None, given, tuple(tried))
            grasp = given
        arcs = [leg.arc for leg in route]
        planned = plan_leg(task, arcs, grasp, len(segments), rng, along(task, report, segments, arcs), clock)
        if isinstance(planned, Failure):
            planned = Planned([], grasp, "", planned)
        failed = planned.failure
        tried.append(Tried(arcs[0].kind, arcs[0].start, arcs[0].goal, "" if failed else planned.how, failed))
        if failed:
            failure, stuck = failed, stuck + 1
            broken = segments + planned.segments
            task.router.failed(route[0])
            here = route[0].nodes[0]
            if stuck == settings.patience:
                # The grasp at hand leads nowhere: begin again with another one, and with what the arcs have taught.
                here, grasp, stuck, segments = task.router.restarted(), None, 0, []
            continue
        grasp, stuck = planned.grasp, 0
        segments += planned.segments
        here = route[0].nodes[-1]
        if here == GOAL:
            plan = plan_of(task, segments, seed, True)
            if not isinstance(plan, Failure):
                return Outcome(plan, None, tuple(tried))
            failure, broken = plan, segments
            here, grasp, segments = task.router.restarted(), None, []
    if not clock.up():
        return Outcome(None, failure, tuple(tried))
    ended = out_of_time(settings.time_limit, len(segments), failure)
    return Outcome(best_so_far(task, segments, broken, seed), ended, tuple(tried))


def along(task: Task, report: Report, segments: list[Segment], arcs: list[Arc]) -> Report:
    """The report with what is planned, and the route: what that has come along, and the arcs still to come."""
    start = task.world.scene.start.pose
    route = ((start.R, start.p), *(end_pose(segment) for segment in segments), *(arc.goal for arc in arcs))
    return told(lambda progress: report(replace(progress, route=route)), segments)


def plan_of(task: Task, segments: list[Segment], seed: int, complete: bool) -> Plan | Failure:
    """The plan of these segments, or why no forces carry it."""
    s, start = task.settings, task.world.scene.start.pose
    subgoals = [(start.R, start.p), *(end_pose(segment) for segment in segments)]
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
    most = max(segments, broken, key=len)
    if not most:
        return None
    found = plan_of(task, most, seed, False)
    return None if isinstance(found, Failure) else found
