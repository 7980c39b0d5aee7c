"""Times of a plan: quasi-static motion may be stretched at will, so intervals last as long as joints, object and forces ask."""

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from regrasp.plan import RELOCATE
from regrasp.planner.course import Course
from regrasp.planner.splines import slopes
from regrasp.planner.turns import angle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Timing:
    """Durations of intervals.

    speed: part of each joint's speed limit used while all agents are in contact or at rest. free_speed: the same in intervals
    in which one moves freely. object_speed: m/s, of the object's fastest surface point. shortest: of any interval in which
    something moves, s. settle: least duration of a hand-over, s. force_rate: weights per second by which an agent's force
    may change.
    """

    speed: float = 0.25
    free_speed: float = 0.9
    object_speed: float = 0.04
    shortest: float = 0.1
    settle: float = 0.12
    force_rate: float = 4.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value, most = getattr(self, field.name), 1.0 if field.name in ("speed", "free_speed") else math.inf
            if not 0.0 < value <= most or value == math.inf:
                raise ValueError(f"{field.name} is {value}, legal: above 0{', at most 1' if most == 1.0 else ''}")


def moves_freely(course: Course, owner: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N,): whether an agent lifts off, lands or retires in the interval; owner: whose each joint is, agents' joints first."""
    moved = np.any(course.joints != course.joints[:, :1], axis=1)[:, : len(owner)]
    return np.asarray(np.any(moved & (course.V[:, owner] >= RELOCATE), axis=1))


def durations(
    course: Course, force: Array, owner: NDArray[np.int64], speeds: Array, radius: float, timing: Timing
) -> Array:
    """Duration of each interval (N,), s.

    force (N, M, k, 3): of the agents, in weights; owner: whose each joint of an agent is, these first; speeds (nq,): limit of
    each joint; radius: of the object, m.
    """
    m = course.joints.shape[1] - 1
    part = np.where(moves_freely(course, owner), timing.free_speed, timing.speed)
    rate = np.max(np.abs(m * slopes(m) @ course.joints) / speeds, axis=(1, 2)) / part
    way = np.linalg.norm(np.diff(course.object_position, axis=1), axis=-1).sum(axis=1)
    turn = np.swapaxes(course.object_rotation[:, :-1], -1, -2) @ course.object_rotation[:, 1:]
    change = m * np.linalg.norm(np.diff(force, axis=1), axis=-1).max(axis=(1, 2))
    least = np.where(course.moves, timing.shortest, timing.settle)
    carried = (way + radius * angle(turn).sum(axis=1)) / timing.object_speed
    return np.asarray(np.maximum.reduce([rate, carried, change / timing.force_rate, least]))
