"""Arcs of the route (paper §3: nominal paths between subgoals): turns about a point that moves."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from regrasp.planner.path import Pose
from regrasp.planner.surroundings import along
from regrasp.planner.turns import from_rotvec, rotvec

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Arc:
    """A path of the object: R(u) = exp(u w) R_0, p(u) = c + u d + exp(u w) (p_0 − c) for u from 0 to 1.

    w: rad, W. c: point of W about which the object turns, m; d: its way meanwhile. With c = p_0 the object goes straight
    and turns about its own origin; with d = 0 it pivots about the line through c along w; with d across w it rolls.
    kind: in words, for reports. on: indices of the supports that the object touches all the way.
    """

    start: Pose
    w: Array
    c: Array
    d: Array
    kind: str
    on: tuple[int, ...] = ()

    def pose(self, u: float) -> Pose:
        """X_WO at part u."""
        R, p = np.empty((3, 3)), np.empty(3)
        along(*self.start, self.w, self.c, self.d, u, R, p)
        return R, p

    def poses(self, u: Array) -> tuple[Array, Array]:
        """Poses R (len(u), 3, 3), p (len(u), 3)."""
        turn = from_rotvec(u[:, None] * self.w)
        p = self.c + u[:, None] * self.d + turn @ (self.start[1] - self.c)
        return turn @ self.start[0], p

    @cached_property
    def goal(self) -> Pose:
        """Where it ends."""
        return self.pose(1.0)

    @cached_property
    def angle(self) -> float:
        """By how much the object turns, rad."""
        return math.sqrt(float(self.w @ self.w))

    @cached_property
    def way(self) -> float:
        """Length of the way of the object's origin, m: |d| + |w × (p_0 − c)|, exact where it goes straight or pivots."""
        (a, b, c), (x, y, z) = self.w, self.start[1] - self.c
        around = math.hypot(b * z - c * y, c * x - a * z, a * y - b * x)
        return math.sqrt(float(self.d @ self.d)) + around

    def length(self, radius: float) -> float:
        """Length of the path, m: way + radius · angle, never less than `path.distance` of its ends."""
        return self.way + radius * self.angle

    def halves(self) -> tuple["Arc", "Arc"]:
        """Its two halves."""
        w, d = 0.5 * self.w, 0.5 * self.d
        return Arc(self.start, w, self.c, d, self.kind, self.on), Arc(
            self.pose(0.5), w, self.c + d, d, self.kind, self.on
        )

    def part(self, u: float, on: tuple[int, ...]) -> "Arc":
        """The first part of it."""
        return Arc(self.start, u * self.w, self.c, u * self.d, self.kind, on)


def straight(start: Pose, goal: Pose, kind: str = "straight") -> Arc:
    """The arc on which the origin moves straight and the object turns by the shortest way."""
    return Arc(start, rotvec(goal[0] @ start[0].T), start[1], goal[1] - start[1], kind)
