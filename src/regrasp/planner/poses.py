"""The object's quantised configuration space (paper §3): positions on a grid, orientations from a near-uniform set.

Any subset of the six freedoms is quantised; the exact start and goal are joined to the grid. Poses near a support exist a
second time, snapped onto it, so that a route can lead along the surface that carries the object.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.features import TOUCH
from regrasp.planner.hand import Hand
from regrasp.planner.path import Pose, distance, interpolate
from regrasp.planner.supports import Support, gap, moved_onto
from regrasp.planner.turns import from_quaternion, from_rotvec, quaternion

Array = NDArray[np.float64]
AXES = ("x", "y", "z", "rx", "ry", "rz")
FREE = -1
START, GOAL = 0, 1


@dataclass(frozen=True, order=True)
class Node:
    """A pose of the grid: cell (x, y, z) in steps from the start, index of its orientation, support (FREE: none).

    Orientations START and GOAL are those of the two exact poses; the goal itself is the one node with exact = True.
    """

    cell: tuple[int, int, int]
    turn: int
    support: int
    exact: bool = False


def super_fibonacci(count: int) -> Array:
    """Near-uniform rotations (count, 4), quaternions w x y z (Alexa 2022, Super-Fibonacci Spirals, Alg. 1)."""
    phi, psi = math.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    t = s / count
    d = 2.0 * math.pi * s
    r, R = np.sqrt(t), np.sqrt(1.0 - t)
    alpha, beta = d / phi, d / psi
    return np.stack([R * np.cos(beta), r * np.sin(alpha), r * np.cos(alpha), R * np.sin(beta)], axis=1)


def orientations(freedoms: tuple[str, ...], start: Array, goal: Array, step: float) -> list[Array]:
    """The set of rotations R_WO searched: start, goal, and those that the freedoms allow, about `step` rad apart.

    One rotation: the whole circle from the start. Two: products of turns about the two world axes. Three: the
    super-Fibonacci set turned so that the start belongs to its grid.
    """
    axes = [AXES.index(name) - 3 for name in AXES[3:] if name in freedoms]
    found = [start, goal]
    if not axes:
        return found
    if len(axes) == 3:
        count = math.ceil(math.pi**2 / (step / 2.0) ** 3 / 2.0)  # volume of SO(3) over that of a ball of a step
        return found + list(from_quaternion(super_fibonacci(count)) @ start)
    turns = np.arange(math.ceil(2.0 * math.pi / step)) * (2.0 * math.pi / math.ceil(2.0 * math.pi / step))
    for angles in itertools.product(turns, repeat=len(axes)):
        if any(angles):
            R = np.eye(3)
            for axis, angle in zip(axes, angles, strict=True):
                R = from_rotvec(angle * np.eye(3)[axis]) @ R
            found.append(R @ start)
    return found


class PoseGrid:
    """Nodes, their poses and their neighbours; knows no obstacles and no costs."""

    def __init__(
        self, start: Pose, goal: Pose, freedoms: tuple[str, ...], step: float, angle: float,
        hand: Hand, supports: tuple[Support, ...],
    ) -> None:  # fmt: skip
        self.start_pose, self.goal_pose, self.step = start, goal, step
        self.moves = [AXES.index(name) for name in AXES[:3] if name in freedoms]
        self.hand, self.supports = hand, supports
        self.rotations = orientations(freedoms, start[0], goal[0], angle)
        self.near = self._neighbour_turns(angle)
        self.start = Node((0, 0, 0), START, self.touched(start))
        self.goal = Node((0, 0, 0), GOAL, self.touched(goal), exact=True)
        self._poses: dict[Node, Pose | None] = {self.start: start, self.goal: goal}

    def _neighbour_turns(self, angle: float) -> list[list[int]]:
        """For each orientation, those within 1.6 steps, and at least its nearest, so that the graph is connected."""
        quaternions = quaternion(np.array(self.rotations))
        near: list[set[int]] = []
        for a, q in enumerate(quaternions):
            closeness = np.abs(quaternions @ q)  # cos(θ/2) for rotations θ apart
            ball = np.flatnonzero(closeness >= math.cos(min(0.8 * angle, 0.5 * math.pi)))
            nearest = np.argsort(-closeness, kind="stable")[:6]
            near.append({int(b) for b in (*ball, *nearest)} - {a})
        for a, others in enumerate(near):
            for b in others:
                near[b].add(a)
        return [sorted(others) for others in near]

    def touched(self, pose: Pose) -> int:
        """The first support that the object touches at a pose, or FREE."""
        for index, support in enumerate(self.supports):
            if abs(gap(self.hand, support, *pose)) <= TOUCH:
                return index
        return FREE

    def snapped(self, pose: Pose, index: int) -> Pose:
        """The pose moved along the normal of the support and the object until they touch."""
        return pose[0], moved_onto(self.hand, self.supports[index], *pose)

    def pose(self, node: Node) -> Pose | None:
        """X_WO of a node; None where snapping would move it by more than a step or along a held axis."""
        if node not in self._poses:
            p = self.start_pose[1] + self.step * np.array(node.cell, float)
            pose: Pose | None = (self.rotations[node.turn], p)
            if node.support != FREE:
                assert pose is not None
                moved = self.snapped(pose, node.support)
                shift = moved[1] - p
                held = [axis for axis in range(3) if axis not in self.moves]
                pose = moved if np.linalg.norm(shift) <= self.step and np.all(np.abs(shift[held]) <= TOUCH) else None
            self._poses[node] = pose
        return self._poses[node]

    def neighbours(self, node: Node) -> list[Node]:
        """Nodes one step away in position or in orientation, on and off each support; and the goal, straight away."""
        if node.exact:
            return []
        found = [self.goal]
        around = [(node.cell, turn) for turn in (node.turn, *self.near[node.turn])]
        for axis, sign in itertools.product(self.moves, (-1, 1)):
            beside = list(node.cell)
            beside[axis] += sign
            around.append(((beside[0], beside[1], beside[2]), node.turn))
        for cell, turn in around:
            for support in range(FREE, len(self.supports)):
                other = Node(cell, turn, support)
                if other != node and self.pose(other) is not None:
                    found.append(other)
        return found

    def arc(self, a: Node, b: Node, count: int) -> tuple[Array, Array]:
        """count + 1 poses (R, p) from a to b, see `between`."""
        start, goal = self.pose(a), self.pose(b)
        assert start is not None
        assert goal is not None
        return self.between(start, goal, a.support if a.support == b.support else FREE, count)

    def between(self, start: Pose, goal: Pose, support: int, count: int) -> tuple[Array, Array]:
        """count + 1 poses (R, p): straight, and all the way on the support that carries both ends, if one does."""
        R, p = interpolate(start, goal, np.linspace(0.0, 1.0, count + 1))
        if support != FREE:
            for s in range(1, count):
                p[s] = self.snapped((R[s], p[s]), support)[1]
        return R, p

    def length(self, a: Node, b: Node, radius: float) -> float:
        """Distance of two nodes' poses (`path.distance`), m."""
        start, goal = self.pose(a), self.pose(b)
        assert start is not None
        assert goal is not None
        return distance(start, goal, radius)
