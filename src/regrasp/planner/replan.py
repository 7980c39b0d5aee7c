"""Planning again while a plan runs: from where object and fingers are measured to be, starting from the old V."""

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from regrasp.errors import InputError
from regrasp.kernels.chains import forward
from regrasp.kernels.surfaces import project
from regrasp.plan import Plan
from regrasp.planner.assemble import Segment, assemble
from regrasp.planner.clock import Clock, start_clock
from regrasp.planner.configurations import Grasp
from regrasp.planner.grasp import build_grasp
from regrasp.planner.method import Settings, Task, plan_pieces, router_of, task_of, way_path
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Pose, distance
from regrasp.planner.poses import FREE
from regrasp.planner.resume import Codes, coming, resampled, with_touching
from regrasp.planner.scan import touch_down
from regrasp.planner.supports import gap
from regrasp.scene.load import validate
from regrasp.scene.schema import Scene
from regrasp.scene.world import from_plan
from regrasp.settings import demand, read

Array = NDArray[np.float64]

REHEARSAL = 0.05
"""s of annealing before the first step."""


@dataclass(frozen=True)
class Replanning:
    """When and how a running plan is planned again.

    position, m, and rotation, rad: how far the object may be off its path before. touch: m, within which of the object's
    surface a tip counts as touching it, and the object as standing on a support. iterations: of the annealing of each arc.
    time_limit: s, for a whole step, 0 for none; the annealing runs share what is left of it. spare: s, kept of that for what
    comes after them, forces and times.
    """

    position: float = 0.005
    rotation: float = math.radians(5.0)
    touch: float = 0.003
    iterations: int = 1000
    time_limit: float = 0.0
    spare: float = 0.03

    def __post_init__(self) -> None:
        demand(self, positive=("position", "rotation", "touch"), from_zero=("time_limit", "spare"))


@dataclass(frozen=True)
class Answer:
    """What one step says: the plan to follow now.

    new: whether it is another one than before; it begins at the time of the step, where the object and the joints were
    measured. off: m and rad between the measured pose and the path before. failure: why there is no new plan though the
    object is off its path. seconds: that the step took.
    """

    plan: Plan
    new: bool
    off: tuple[float, float]
    failure: Failure | None
    seconds: float


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
        planner = replace(planner, local=replace(planner.local, annealing=annealing))
        self._seed, self._rng = seed, np.random.default_rng(seed)
        self._task = task_of(from_plan(plan.scene, plan.xml, plan.assets), planner)
        # Kernels are loaded, or compiled, as they are first called: not in a step that has to be in time.
        self._planned(float(plan.time[0, 0]), pose_at(plan, plan.time[0, 0]), plan.joints[0, 0], start_clock(REHEARSAL))
        self._rng = np.random.default_rng(seed)

    def step(self, t: float, X_WO: Pose, q: Array) -> Answer:
        """The plan to follow from time t, s, on the plan's clock, with the object at X_WO = (R, p) and the joints at q (nq,).

        It is the one before while the object is on its path, and also where no new one is found.
        """
        began = time.perf_counter()
        shape = len(self._task.hand.home)
        X_WO, q = (np.asarray(X_WO[0], float), np.asarray(X_WO[1], float)), np.asarray(q, float)
        if X_WO[0].shape != (3, 3) or X_WO[1].shape != (3,) or q.shape != (shape,):
            raise InputError("step", "wrong shapes", f"R (3, 3), p (3,), q ({shape},)")
        failure: Failure | None = None
        new, off = None, (math.inf, math.inf)
        if all(np.all(np.isfinite(part)) for part in (*X_WO, q)):
            off = apart(pose_at(self.plan, t), X_WO)
            if off[0] > self.settings.position or off[1] > self.settings.rotation:
                found = self._planned(t, X_WO, q, self._clock())
                new, failure = (None, found) if isinstance(found, Failure) else (found, None)
        else:
            failure = Failure("start", "measurement", "", "a number is not finite", "look at the sensors")
        if new is not None:
            self.plan = new
        return Answer(self.plan, new is not None, off, failure, time.perf_counter() - began)

    def _clock(self) -> Clock:
        """The time of a step that the search has."""
        limit, spare = self.settings.time_limit, self.settings.spare
        return start_clock(max(limit - spare, 1e-3) if limit else 0.0)

    def _planned(self, t: float, X_WO: Pose, q: Array, search: Clock) -> Plan | Failure:
        """A plan from the measured state at t: straight to the next subgoal, to a later one, or by a new route."""
        settings, task = self.settings, self._task
        j = interval_at(self.plan, t)
        X_WO = self._settled(X_WO, j)
        hit = task.router.blocked(X_WO, 0.0)
        if hit:
            return Failure("collision", "start", "object", f"the object is inside {hit}", "clear its way")
        if not task.router.in_reach(X_WO):
            return Failure("reach", "start", "object", "no agent reaches the object", "bring it back")
        try:
            scene = started(self.plan, X_WO)
        except InputError as error:
            return Failure("start", error.field, "object", error.reason, error.hint)
        grasp = measured_grasp(task, X_WO, q, settings.touch)
        if isinstance(grasp, Failure):
            return grasp
        subgoals = [pose_of(row) for row in self.plan.route[self.plan.segment[j] + 1 :]]
        warms = self._warms(j, grasp)
        failure: Failure | None = None
        for skipped in range(len(subgoals)):
            left = [np.concatenate(warms[: skipped + 1]), *warms[skipped + 1 :]]
            found = self._along(subgoals[skipped:], left, X_WO, grasp, search)
            if not isinstance(found, Failure):
                break
            failure = failure or found
        else:
            assert failure is not None
            route = self._route(X_WO, subgoals[-1], search)
            if not route:
                return failure
            found = self._along(route, np.array_split(np.concatenate(warms), len(route)), X_WO, grasp, search)
            if isinstance(found, Failure):
                return failure
        segments, passed = found
        local, planner = task.settings.local, task.settings
        plan = assemble(
            replace(task.world, scene=scene), task.hand, segments, [X_WO, *passed], task.supports, local.energy.margins,
            planner.loads, planner.timing, self._seed, planner, True,
        )  # fmt: skip
        return plan if isinstance(plan, Failure) else replace(plan, time=plan.time + t)

    def _settled(self, X_WO: Pose, j: int) -> Pose:
        """The pose put exactly onto the supports that carry the object in interval j, where it is measured near them."""
        plan, grid = self.plan, self._task.router.grid
        carry = {plan.support_names[p] for p in np.flatnonzero(plan.support_mode[j])}
        for index, support in enumerate(grid.supports):
            if support.name in carry and abs(gap(support, grid.kind_O, grid.size_O, *X_WO)) <= self.settings.touch:
                X_WO = grid.snapped(X_WO, index)
        return X_WO

    def _warms(self, j: int, grasp: Grasp) -> list[Codes]:
        """What of V is to come from interval j on, segment by segment, for agents that touch as in the grasp."""
        segment = self.plan.segment
        rest = range(int(segment[j]) + 1, int(segment[-1]) + 1)
        later = [coming(self.plan, int(np.argmax(segment == s)), s) for s in rest]
        return [with_touching(coming(self.plan, j, int(segment[j])), grasp.holds == 1), *later]

    def _route(self, X_WO: Pose, goal: Pose, clock: Clock) -> list[Pose]:
        """Subgoals of a new route, or none where there is no way."""
        task = self._task
        router = router_of(task.world.scene, task.hand, task.supports, X_WO, goal, task.settings)
        route = router.route(router.grid.start, clock.up)
        found = [] if isinstance(route, Failure) else [router.grid.pose(node) for node in route[1:]]
        return [pose for pose in found if pose is not None]

    def _along(
        self, subgoals: list[Pose], warms: list[Codes], X_WO: Pose, grasp: Grasp, clock: Clock
    ) -> tuple[list[Segment], list[Pose]] | Failure:
        """Segments from X_WO through the subgoals, and the poses at their ends; warms: the old V on the way to each."""
        task, grid = self._task, self._task.router.grid
        segments: list[Segment] = []
        for a, (subgoal, warm) in enumerate(zip(subgoals, warms, strict=True)):
            support = grid.touched(X_WO) if grid.touched(X_WO) == grid.touched(subgoal) else FREE
            looks = task.router.looks(distance(X_WO, subgoal, task.hand.radius))
            if a == 0 and not task.router.clear(*grid.between(X_WO, subgoal, support, looks)):
                return Failure("route", "segment 1", "object", "something is in its way", "clear its way")
            pieces = way_path(task, X_WO, subgoal, support)
            n = sum(len(path.R_WO) for path in pieces)
            found = plan_pieces(
                task, pieces, grasp, len(segments), self._rng, lambda _: None, clock, len(subgoals) - a - 1,
                resampled(warm, n) if len(warm) else None,
            )  # fmt: skip
            planned, grasp, failure = found
            if failure:
                return failure
            segments += planned
            X_WO = subgoal
        return segments, [(s.motion.path.R_WO[-1, -1], s.motion.path.p_WO[-1, -1]) for s in segments]


def interval_at(plan: Plan, t: float) -> int:
    """The interval of time t; the first before the plan begins, the last after it has ended."""
    return int(np.clip(np.searchsorted(plan.time[:, 0], t, side="right") - 1, 0, len(plan.time) - 1))


def pose_at(plan: Plan, t: float) -> Pose:
    """The object's pose (R, p) that the plan has at time t."""
    j = interval_at(plan, t)
    knots = plan.time[j]
    u = float(np.clip(t, knots[0], knots[-1]))
    turns = Rotation.from_quat(plan.object_quaternion[j].copy(), scalar_first=True)
    return Slerp(knots, turns)(u).as_matrix(), CubicSpline(knots, plan.object_position[j])(u)


def pose_of(row: Array) -> Pose:
    """The pose (R, p) of a row of a plan's route."""
    return Rotation.from_quat(row[3:].copy(), scalar_first=True).as_matrix(), row[:3].copy()


def apart(a: Pose, b: Pose) -> tuple[float, float]:
    """Distance, m, and angle, rad, of two poses."""
    return float(np.linalg.norm(b[1] - a[1])), float(Rotation.from_matrix(b[0] @ a[0].T).magnitude())


def started(plan: Plan, X_WO: Pose) -> Scene:
    """The plan's scene with another start, whatever the grasp. Raises InputError where its freedoms forbid the pose."""
    wxyz = Rotation.from_matrix(X_WO[0]).as_quat(scalar_first=True)
    pose = {"position": X_WO[1].tolist(), "quaternion": wxyz.tolist()}
    return validate({**plan.scene, "start": {"pose": pose}})


def measured_grasp(task: Task, X_WO: Pose, q: Array, touch: float) -> Grasp | Failure:
    """The grasp of joints q (nq,) with the object at X_WO: an agent touches whose tip is within `touch` of its surface.

    The contact is the point of the surface nearest to the tip's centre; the agent's joints are corrected until it is
    exact. All other agents are where they are.
    """
    hand, (R_WO, p_WO) = task.hand, X_WO
    contacts: dict[int, tuple[Array, Array, Array]] = {}
    for i, name in enumerate(task.names):
        mine = q[hand.chains.start[i] : hand.chains.start[i + 1]].copy()
        R_WL, p_WL = np.empty((len(mine) + 1, 3, 3)), np.empty((len(mine) + 1, 3))
        foot, n = np.empty(3), np.empty(3)
        forward(hand.chains, i, mine, R_WL, p_WL)
        centre = R_WO.T @ (p_WL[-1] - p_WO)
        high = project(hand.kind_O, hand.size_O, centre, foot, n) - hand.size_T[i, 0]
        if high < -touch:
            return Failure(
                "collision", "start", name, f"its tip is {-1e3 * high:.1f} mm inside the object", "a better measurement"
            )
        if high > touch:
            continue
        direction = R_WO.T @ R_WL[-1] @ hand.axis_T[i]
        if not touch_down(hand, i, R_WO, p_WO, foot, n, 0.0, direction, mine, R_WL, p_WL):
            return Failure("reach", "start", name, "cannot hold its contact within its joints' range", "bring it back")
        contacts[i] = (mine, foot, n)
    grasp = build_grasp(hand, R_WO, contacts)
    off = np.repeat(grasp.holds == 0, np.diff(hand.chains.start))
    return replace(grasp, q=np.where(off, q, grasp.q))
