"""Planning again while a plan runs: from where object and fingers are measured to be, segment by segment, with the old V."""

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from regrasp.errors import InputError
from regrasp.plan import RELOCATE, Plan
from regrasp.planner.along import apart, interval_at, pose_at, pose_of
from regrasp.planner.arcs import straight
from regrasp.planner.assemble import Segment, assemble
from regrasp.planner.clock import Clock, start_clock
from regrasp.planner.configurations import Grasp
from regrasp.planner.grasp import continued, nothing
from regrasp.planner.local import plan_arc
from regrasp.planner.measured import in_contact, measured_grasp, roomy, settled, started
from regrasp.planner.method import end_pose
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Path, Pose
from regrasp.planner.pieces import first_piece, pieces_of
from regrasp.planner.poses import GOAL, START
from regrasp.planner.resume import Codes, coming, resampled, with_touching
from regrasp.planner.task import Settings, router_of, task_of
from regrasp.planner.terms import Energy
from regrasp.scene.world import from_plan
from regrasp.settings import demand, read

Array = NDArray[np.float64]

REHEARSAL = 0.05
"""s of annealing before the first step."""
CALLS = 2
"""Calls that search the same way before another one is tried."""
PAUSE = 8
"""Intervals that the object rests on the second way, so that fingers can take hold anew before it goes on."""


@dataclass(frozen=True)
class Replanning:
    """When and how a running plan is planned again.

    position, m, and rotation, rad: how far the object may be off its path before. touch: m, within which of the object's
    surface a tip counts as touching it, and the object as standing on a support. lead: s, how long before the end of a plan
    that stops at a subgoal the next one is asked for. intervals: of a way on which a finger has yet to relocate, at least.
    runs: annealing runs of a step, side by side; iterations: of each. time_limit: s, for a whole step, 0 for none; the runs
    have what is left of it. spare: s, kept of that for what comes after them, samples, forces and times.
    """

    position: float = 0.005
    rotation: float = math.radians(5.0)
    touch: float = 0.003
    lead: float = 0.005
    intervals: int = 12
    runs: int = 2
    iterations: int = 1500
    time_limit: float = 0.1
    spare: float = 0.04

    def __post_init__(self) -> None:
        demand(
            self,
            positive=("position", "rotation", "touch", "intervals", "runs"),
            from_zero=("lead", "time_limit", "spare"),
        )


@dataclass(frozen=True)
class Spent:
    """s of a step: state, what is measured made a start; search, the annealing runs and the samples of the best V; forces,
    these and times laid on."""

    state: float = 0.0
    search: float = 0.0
    forces: float = 0.0


@dataclass(frozen=True)
class Answer:
    """What one step says: the plan to follow now.

    new: whether it is another one than before; it begins at the time of the step, where the object and the joints were
    measured. complete: whether it ends at the goal; else it ends at a subgoal on the way, and a step when it has ended gives
    the next. off: m and rad between the measured pose and the path before. failure: why there is no new plan though one is
    needed; the search goes on with the next call. seconds: that the step took, spent: on what; iterations: of annealing, in
    all runs.
    """

    plan: Plan
    new: bool
    complete: bool
    off: tuple[float, float]
    failure: Failure | None
    seconds: float
    spent: Spent
    iterations: int


@dataclass(frozen=True)
class Leg:
    """A part of the way that is still to come: the pose at its end, what the old V has on the way there (r, k)."""

    end: Pose
    V: Codes


class Replanner:
    """A plan under way; `step` it with what is measured as often as the control loop likes.

    What does not change from one step to the next, the world and the kernels' arrays, is made once. The same seed and the
    same measurements give the same plans, unless a time limit cuts the search.
    """

    def __init__(self, plan: Plan, settings: Replanning | None = None, seed: int = 0) -> None:
        """Raises InputError if the plan's model cannot be built or its settings are another version's."""
        self.plan, self.settings = plan, settings or Replanning()
        planner = read(Settings, plan.settings)
        annealing = replace(planner.local.annealing, iterations=self.settings.iterations, trials=20)
        local = replace(planner.local, annealing=annealing, attempts=self.settings.runs)
        planner = replace(planner, local=local)
        self._seed = seed
        self._task = task_of(from_plan(plan.scene, plan.xml, plan.assets), planner)
        self._goal = self._task.router.goal_pose
        self._later: list[Leg] = []
        self._begin_search()
        self._rng = np.random.default_rng(seed)
        # Kernels are loaded, or compiled, as they are first called: not in a step that has to be in time.
        self._planned(float(plan.time[0, 0]), pose_at(plan, plan.time[0, 0]), plan.joints[0, 0], start_clock(REHEARSAL))
        self._begin_search()
        self._rng = np.random.default_rng(seed)

    def step(self, t: float, X_WO: Pose, q: Array) -> Answer:
        """The plan to follow from time t, s, on the plan's clock, with the object at X_WO = (R, p) and the joints at q (nq,).

        It is the one before while the object is on its path and its end not reached, and also where no new one is found yet:
        each further call goes on searching from the best that the calls before have found, and from random starts.
        """
        began = time.perf_counter()
        clock = self._clock()
        shape = self.plan.joints.shape[2]
        X_WO, q = (np.asarray(X_WO[0], float), np.asarray(X_WO[1], float)), np.asarray(q, float)
        if X_WO[0].shape != (3, 3) or X_WO[1].shape != (3,) or q.shape != (shape,):
            raise InputError("step", "wrong shapes", f"R (3, 3), p (3,), q ({shape},)")
        failure: Failure | None = None
        new, off = None, (math.inf, math.inf)
        self._spent, self._iterations = Spent(), 0
        if all(np.all(np.isfinite(part)) for part in (*X_WO, q)):
            off = apart(pose_at(self.plan, t), X_WO)
            if off[0] > self.settings.position or off[1] > self.settings.rotation or (self._later and self._ended(t)):
                found = self._planned(t, X_WO, q, clock)
                if isinstance(found, Failure):
                    failure = found
                else:
                    new, self._later = found
                    self.plan = new
            if failure is None:
                self._begin_search()
        else:
            failure = Failure("start", "measurement", "", "a number is not finite", "look at the sensors")
        seconds = time.perf_counter() - began
        return Answer(self.plan, new is not None, not self._later, off, failure, seconds, self._spent, self._iterations)

    def _clock(self) -> Clock:
        """The time of a step that the search has."""
        limit, spare = self.settings.time_limit, self.settings.spare
        return start_clock(max(limit - spare, 1e-3) if limit else 0.0)

    def _ended(self, t: float) -> bool:
        """Whether the plan at hand is over at time t."""
        return bool(t >= self.plan.time[-1, -1] - self.settings.lead)

    def _begin_search(self) -> None:
        """Nothing has been searched from where object and fingers are."""
        self._calls = 0
        self._best: dict[int, NDArray[np.int16]] = {}
        self._detour: list[Pose] | None = None

    def _planned(self, t: float, X_WO: Pose, q: Array, clock: Clock) -> tuple[Plan, list[Leg]] | Failure:
        """A plan from the measured state at t to the end of a leg, and the legs after it."""
        began = time.perf_counter()
        settings, task = self.settings, self._task
        j = interval_at(self.plan, t)
        X_WO = settled(task, self.plan, j, X_WO, settings.touch)
        hit = task.router.blocked(X_WO, 0.0)
        if hit:
            return Failure("collision", "start", "object", f"the object is inside {hit}", "clear its way")
        if not task.router.in_reach(X_WO):
            return Failure("reach", "start", "object", "no agent reaches the object", "bring it back")
        clearance = task.settings.local.energy.clearance
        grasp = measured_grasp(task, X_WO, q, in_contact(self.plan, j), settings.touch, clearance)
        if isinstance(grasp, Failure):
            return grasp
        way, legs = self._chosen(self._legs(t, j), X_WO)
        if not legs:
            return Failure("route", "start", "object", "something is in its way", "clear its way")
        path, V, rest = self._arc(X_WO, legs, grasp, PAUSE if way == 1 else 0)
        energy = roomy(task.hand, path, grasp, task.settings.local.energy)
        if isinstance(energy, Failure):
            return energy
        searched = time.perf_counter()
        found = self._searched(way, path, V, grasp, energy, clock)
        done = time.perf_counter()
        self._spent = Spent(searched - began, done - searched)
        if isinstance(found, Failure):
            self._calls += 1
            return found
        try:
            plan = self._assembled(t, X_WO, found, energy)
        except InputError as error:
            return Failure("start", error.field, "object", error.reason, error.hint)
        self._spent = replace(self._spent, forces=time.perf_counter() - done)
        if isinstance(plan, Failure):
            self._calls += 1
            return plan
        return plan, rest

    def _legs(self, t: float, j: int) -> list[Leg]:
        """The way that is still to come at time t, in interval j, leg by leg; the last one ends at the goal."""
        plan, legs = self.plan, list(self._later)
        if not self._ended(t):
            segment = plan.segment
            last, ends = int(segment[-1]), [pose_of(row) for row in plan.route]
            first = {s: max(j, int(np.argmax(segment == s))) for s in range(int(segment[j]), last + 1)}
            legs = [Leg(ends[s + 1], coming(plan, row, s)) for s, row in first.items()] + legs
        return legs or [Leg(self._goal, np.empty((0, plan.V.shape[1]), np.int8))]

    def _chosen(self, legs: list[Leg], X_WO: Pose) -> tuple[int, list[Leg]]:
        """The way that this call searches, its number and its legs.

        Straight to the first subgoal, the same after a pause, straight to one later subgoal after the other, then around. None
        where all straight ways are blocked and there is no other.
        """
        task, ways = self._task, len(legs) + 2
        first = self._calls // CALLS
        for turn in range(first, first + ways):
            way = turn % ways
            skipped = max(0, way - 1)
            if skipped < len(legs):
                end = legs[skipped].end
                if task.router.way(X_WO, end) is not None:
                    V = np.concatenate([leg.V for leg in legs[: skipped + 1]])
                    return way, [Leg(end, V), *legs[skipped + 1 :]]
            else:
                around = self._around(X_WO)
                if around:
                    parts = np.array_split(np.concatenate([leg.V for leg in legs]), len(around))
                    return way, [Leg(pose, V) for pose, V in zip(around, parts, strict=True)]
        return 0, []

    def _around(self, X_WO: Pose) -> list[Pose]:
        """Subgoals of a route from the pose to the goal that is not the straight one, if there is one: searched once."""
        if self._detour is None:
            task = self._task
            router = router_of(task.world, task.hand, task.supports, X_WO, self._goal, task.settings)
            router.penalties.penalise(START, GOAL, task.settings.route.penalty)
            route = router.route(START, lambda: False, lambda _: None)
            self._detour = [] if isinstance(route, Failure) else [leg.arc.goal for leg in route]
        return self._detour

    def _arc(self, X_WO: Pose, legs: list[Leg], grasp: Grasp, pause: int) -> tuple[Path, Codes, list[Leg]]:
        """The nominal path of the first arc along the legs, the old V on it, and the legs that then remain.

        pause: intervals at rest before it.
        """
        touching = grasp.holds == 1
        V = legs[0].V
        if len(V) == 0:
            V = np.zeros((1, len(touching)), np.int8)
        V = with_touching(V, touching)
        least = self.settings.intervals if np.any(V == RELOCATE) else 4
        arc = straight(X_WO, legs[0].end)
        path, pieces = first_piece(self._task, arc, grasp, least, pause), pieces_of(self._task, arc, least)
        V, n = resampled(V, sum(count for _, _, count in pieces)), len(path.R_WO) - pause
        rest = [Leg(legs[0].end, V[n:])] if len(pieces) > 1 else []
        still = continued(nothing(grasp), pause).astype(np.int8)
        return path, np.concatenate([still, V[:n]]), rest + legs[1:]

    def _searched(
        self, way: int, path: Path, V: Codes, grasp: Grasp, energy: Energy, clock: Clock
    ) -> Segment | Failure:
        """The arc's motion, from the old V or, in later calls, from the best one so far."""
        task, best = self._task, self._best.get(way)
        warm = best if best is not None and len(best) == len(V) else V.astype(np.int16)
        local = replace(task.settings.local, energy=energy)
        result = plan_arc(
            task.hand, path, grasp, task.names, local, self._rng, lambda _: None, "segment 1", clock, 1, warm
        )
        self._iterations = result.moves
        self._best[way] = result.V
        return result.failure or Segment(result.motion, result.energy)

    def _assembled(self, t: float, X_WO: Pose, segment: Segment, energy: Energy) -> Plan | Failure:
        """The plan of one segment from X_WO at time t. Raises InputError where the scene's freedoms forbid the pose."""
        task, end = self._task, end_pose(segment)
        world = replace(task.world, scene=started(self.plan, X_WO, end))
        plan = assemble(
            world, task.hand, [segment], [X_WO, end], task.supports, energy.margins, task.settings.loads,
            task.settings.timing, self._seed, task.settings, True,
        )  # fmt: skip
        return plan if isinstance(plan, Failure) else replace(plan, time=plan.time + t)
