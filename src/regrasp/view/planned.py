"""The planned motion at any time: what a clip of a plan shows."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.control.reference import Phases, Reference, reference
from regrasp.plan import NONE, Plan
from regrasp.scene.world import World, from_plan
from regrasp.view.frames import Arrow, State, ways
from regrasp.view.ink import AGENT_FORCE, SUPPORT_FORCE
from regrasp.view.show import Show, set_up

Array = NDArray[np.float64]

PERIOD = 0.01
"""s between rows."""
VIEWS = 8
"""Instants that the camera is chosen by."""


@dataclass(frozen=True)
class Planned:
    """A plan as a table in time: `path` begins and ends with the plan."""

    show: Show
    path: Reference

    @property
    def time(self) -> Array:
        """Times (T,) of the rows since the plan's beginning, s."""
        return np.asarray(self.path.period * np.arange(self.path.end - self.path.start + 1), np.float64)

    def state(self, row: int) -> State:
        """The world of the plan at a row."""
        return _state(self.show.world, self.show.plan, self.path, row)

    def words(self, row: int) -> str:
        """Time and interval of a row."""
        plan = self.show.plan
        return f"t = {self.time[row]:.2f} s, interval {self._interval(row) + 1} of {len(plan.V)}"

    def seen_by(self, show: Show) -> "Planned":
        """The same with another camera or stage."""
        return replace(self, show=show)

    def _interval(self, row: int) -> int:
        return int(self.path.interval[self.path.start + row])


def prepare(plan: Plan) -> Planned:
    """The planned motion, and one camera for all of it."""
    world = from_plan(plan.scene, plan.xml, plan.assets)
    path = reference(plan, world, PERIOD, Phases())
    some = np.unique(np.linspace(0, path.end - path.start, VIEWS).astype(int))
    forces = np.concatenate([plan.force_W, plan.support_force_W], axis=2)
    largest = float(np.linalg.norm(forces, axis=-1).max(initial=0.0))
    states = [_state(world, plan, path, int(row)) for row in some]
    return Planned(set_up(plan, world, states, largest), path)


def _state(world: World, plan: Plan, path: Reference, row: int) -> State:
    at = path.start + row
    interval = int(path.interval[at])
    qpos, quaternion = world.start.copy(), np.empty(4)
    mujoco.mju_mat2Quat(quaternion, path.R_WO[at].ravel())
    qpos[world.joint_qpos] = path.q[at]
    qpos[world.object_qpos : world.object_qpos + 7] = [*path.p_WO[at], *quaternion]
    knots = plan.time[interval]
    time = float(np.clip(path.time(at), knots[0], knots[-1]))
    bearing = zip(path.p_WC[at], path.force_W[at], strict=True)
    arrows = [Arrow(p, f, AGENT_FORCE) for p, f in bearing if np.linalg.norm(f) > 0]
    for slot in np.flatnonzero(plan.support_mode[interval] != NONE):
        p_O, f = (
            np.array([np.interp(time, knots, values[interval, :, slot, c]) for c in range(3)])
            for values in (plan.support_p_O, plan.support_force_W)
        )
        if np.linalg.norm(f) > 0:
            arrows.append(Arrow(path.p_WO[at] + path.R_WO[at] @ p_O, f, SUPPORT_FORCE))
    part = (time - knots[0]) / (knots[-1] - knots[0])
    return State(qpos, interval, part, tuple(arrows), ways(world, plan, interval))
