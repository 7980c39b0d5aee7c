"""Where a plan is at a time, and how far apart poses are."""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from regrasp.plan import Plan
from regrasp.planner.path import Pose
from regrasp.planner.turns import angle, from_quaternion

Array = NDArray[np.float64]


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


def joints_at(plan: Plan, t: float) -> Array:
    """The joints (nq,) that the plan has at time t within it."""
    j = interval_at(plan, t)
    return np.asarray(CubicSpline(plan.time[j], plan.joints[j])(t))


def pose_of(row: Array) -> Pose:
    """The pose (R, p) of a row of a plan's route."""
    return from_quaternion(row[3:]), row[:3].copy()


def apart(a: Pose, b: Pose) -> tuple[float, float]:
    """Distance, m, and angle, rad, of two poses."""
    return float(np.linalg.norm(b[1] - a[1])), float(angle(b[0] @ a[0].T))
