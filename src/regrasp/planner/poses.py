"""The object's quantised configuration space (paper §3) as a graph that grows where it is searched.

Its nodes are poses with the surfaces that touch there, its arcs the moves of `moves`, as far as the surroundings let them. Two
poses of one cell, one orientation and the same surfaces are one node, the one that was found first, so that the graph is
finite. The exact goal is joined to every node from which an arc leads there.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.features import TOUCH
from regrasp.kernels.surfaces import SPHERE
from regrasp.planner.arcs import Arc, straight
from regrasp.planner.hand import Hand
from regrasp.planner.moves import AXES, LEAST, freedoms_of, pivots, rolls, shifts, turns
from regrasp.planner.path import Pose, distance
from regrasp.planner.supports import Patch, Support, patch_of
from regrasp.planner.surroundings import Surroundings, gaps_at, go
from regrasp.planner.turns import from_quaternion, from_rotvec, rotvec

Array = NDArray[np.float64]
START, GOAL = 0, 1
CELL = 0.75  # of a step: less than one, so that no two points of the lattice share a cell
FINE = 0.1  # the same for poses at which the object is about to tip
AROUND = 12  # orientations next to one
THERE = (5e-5, 5e-4)  # m and rad: an arc that ends so near the goal ends there
LIMITS = 7  # halvings that find where the object no longer rests
SHORT = 0.95  # of the way to there
SAME = (1e-5, 1e-4)  # m and rad: poses that are one


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
    """The set of rotations R_WO searched in the air: start, goal, and those that the freedoms allow, about `step` rad apart.

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
    circle = np.arange(math.ceil(2.0 * math.pi / step)) * (2.0 * math.pi / math.ceil(2.0 * math.pi / step))
    for angles in itertools.product(circle, repeat=len(axes)):
        if any(angles):
            R = np.eye(3)
            for axis, angle in zip(axes, angles, strict=True):
                R = from_rotvec(angle * np.eye(3)[axis]) @ R
            found.append(R @ start)
    return found


def angles(rotations: Array, R: Array) -> Array:
    """Angles (n,) between rotations (n, 3, 3) and R, from the chords that their columns make: ‖R_i − R‖ = √8 sin(θ/2)."""
    chord = np.sqrt(np.sum((rotations - R) ** 2, axis=(1, 2)) / 8.0)
    return np.asarray(2.0 * np.arcsin(np.minimum(chord, 1.0)))


@dataclass(frozen=True)
class Resolution:
    """How finely the poses are searched: m between positions, rad between orientations, m of clearance from obstacles."""

    step: float
    angle: float
    clearance: float


@dataclass
class Blocked:
    """A body that stopped moves, and where it did so nearest to the goal."""

    body: int
    far: float
    pose: Pose


@dataclass
class PoseGraph:
    """Nodes 0, 1, 2, …, the start and the goal first, with their poses, what touches there, and the arcs found."""

    hand: Hand
    around: Surroundings
    supports: tuple[Support, ...]
    freedoms: tuple[str, ...]
    start: Pose
    goal: Pose
    resolution: Resolution
    rests: Callable[[Pose], bool]
    poses: list[Pose] = field(init=False)
    held: list[tuple[int, ...]] = field(init=False)
    arcs: dict[tuple[int, int], Arc] = field(init=False, default_factory=dict)
    blocked: dict[int, Blocked] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.rotations = np.array(orientations(self.freedoms, self.start[0], self.goal[0], self.resolution.angle))
        self.free = freedoms_of(self.freedoms)
        self._seen = self.start[0][None]
        self._cells: dict[object, int] = {}
        self._ways: dict[int, list[int]] = {}
        self._rest: dict[int, bool] = {}
        self.poses, self.held = [self.start, self.goal], [self.touched(self.start), self.touched(self.goal)]
        self._cells[self._cell(self.start, self._turn(self.start[0]), self.held[START], CELL)] = START

    def touched(self, pose: Pose) -> tuple[int, ...]:
        """The supports that the object touches at a pose."""
        gaps = np.empty(len(self.around.kind))
        gaps_at(self.around, *pose, 2.0 * TOUCH, gaps)
        return tuple(int(b) for b in np.flatnonzero(np.abs(gaps[: len(self.supports)]) <= TOUCH))

    def resting(self, node: int) -> bool:
        """Whether the object stays at a node by itself."""
        if node not in self._rest:
            self._rest[node] = bool(self.held[node]) and self.rests(self.poses[node])
        return self._rest[node]

    def patches(self, node: int) -> list[Patch]:
        """The contact patches of a node."""
        found = [patch_of(self.hand, self.supports[b], *self.poses[node]) for b in self.held[node]]
        return [patch for patch in found if patch is not None]

    def _turn(self, R: Array) -> int:
        """Which of the orientations met so far stands for R; a sphere's are all one."""
        if self.hand.kind_O == SPHERE:
            return 0
        far = angles(self._seen, R)
        turn = int(np.argmin(far))
        if far[turn] > 0.4 * self.resolution.angle:
            self._seen = np.concatenate([self._seen, R[None]])
            turn = len(self._seen) - 1
        return turn

    def _cell(self, pose: Pose, turn: int, held: tuple[int, ...], size: float) -> object:
        p = np.round((pose[1] - self.start[1]) / (size * self.resolution.step)).astype(int)
        return (size, *p.tolist(), turn, held)

    def went(self, arc: Arc, held: tuple[int, ...]) -> tuple[Arc, int]:
        """The part of the arc that the object can go from where it touches `held`, and the body that stops it, or −1."""
        flags, kept = np.zeros(len(self.around.kind), np.uint8), np.zeros(len(self.around.kind), np.uint8)
        flags[list(held)] = 1
        fine = max(0.002, 0.02 * self.hand.radius)
        steps = max(2, math.ceil(arc.length(self.hand.radius) / fine))
        u, body = go(self.around, *arc.start, arc.w, arc.c, arc.d, steps, self.resolution.clearance, flags, kept)
        return arc.part(u, tuple(int(b) for b in np.flatnonzero(kept))), body

    def neighbours(self, node: int) -> list[int]:
        """Where arcs lead from a node, made when first asked."""
        if node not in self._ways:
            self._ways[node] = [] if node == GOAL else self._made(node)
        return self._ways[node]

    def _made(self, node: int) -> list[int]:
        pose, held, patches = self.poses[node], self.held[node], self.patches(node)
        found: dict[int, None] = {}

        def add(arc: Arc, cell: float = CELL) -> None:
            other = self._joined(node, arc, cell)
            if other is not None and other != node:
                found[other] = None

        step, angle, rounding = self.resolution.step, self.resolution.angle, float(np.max(self.around.radius_O))
        add_goal = straight(pose, self.goal)
        if self.free.allow(add_goal):
            arc, _ = self.went(add_goal, held)
            if self.near_goal(arc.goal):
                add(arc)
        for whole in itertools.chain(
            shifts(pose, patches, step, self.goal),
            turns(pose, patches, self._beside(pose[0]), angle, self.goal),
            rolls(pose, patches, self.hand.kind_O, self.hand.size_O, angle),
        ):
            if not self.free.allow(whole):
                continue
            arc, body = self.went(whole, held)
            self._note(body, arc.goal)
            far = arc.length(self.hand.radius) / max(whole.length(self.hand.radius), 1e-12)
            on_surface = whole.kind in ("slide", "roll") or (whole.kind == "turn" and patches)
            if far >= (0.2 if body < len(self.supports) else 0.5) and (arc.on or not on_surface):
                add(arc)
                if arc.on and self.resting(node) and not self.rests(arc.goal):
                    add(self._still_resting(arc), FINE)
        for whole in pivots(pose, patches, rounding):
            if not self.free.allow(whole):
                continue
            arc, body = self.went(whole, held)
            if arc.angle < LEAST or not arc.on:
                continue
            left = float(rotvec(self.goal[0] @ pose[0].T) @ whole.w) / whole.angle
            if LEAST < left <= arc.angle + THERE[1]:
                add(arc.part(min(1.0, left / arc.angle), arc.on))
            if 0 <= body < len(self.supports):
                add(arc)
            elif body >= 0:
                self._note(body, arc.goal)
            if angle < arc.angle:
                add(arc.part(angle / arc.angle, arc.on))
        return list(found)

    def _still_resting(self, arc: Arc) -> Arc:
        """The part of an arc that ends a little before the object no longer rests on its supports."""
        low, high = 0.0, 1.0
        for _ in range(LIMITS):
            middle = 0.5 * (low + high)
            if self.rests(arc.pose(middle)):
                low = middle
            else:
                high = middle
        return arc.part(SHORT * low, arc.on)

    def _beside(self, R: Array) -> list[Array]:
        """Orientations of the set next to R, and the goal's."""
        if self.hand.kind_O == SPHERE:
            return [self.goal[0]] if angles(self.goal[0][None], R)[0] > SAME[1] else []
        far = angles(self.rotations, R)
        order = np.argsort(far, kind="stable")
        near = [int(a) for a in order if SAME[1] < far[a]][:AROUND]
        near = [a for a in near if far[a] <= 1.6 * self.resolution.angle] or near[:4]
        return [self.rotations[a] for a in dict.fromkeys([*near, GOAL]) if far[a] > SAME[1]]

    def near_goal(self, pose: Pose) -> bool:
        """Whether a pose counts as the goal."""
        apart = float(np.linalg.norm(pose[1] - self.goal[1]))
        return apart <= THERE[0] and float(angles(self.goal[0][None], pose[0])[0]) <= THERE[1]

    def _joined(self, node: int, arc: Arc, size: float) -> int | None:
        """The node at the end of an arc from `node`, which is made if there is none; None where another one has its cell."""
        end = arc.goal
        if self.near_goal(end):
            other = GOAL
        else:
            held, turn = self.touched(end), self._turn(end[0])
            cells = [self._cell(end, turn, held, each) for each in dict.fromkeys((size, CELL, FINE))]
            there = [self._cells[cell] for cell in cells if cell in self._cells]
            same = [each for each in there if self._alike(self.poses[each], end)]
            if same:
                other = same[0]
            elif cells[0] in self._cells:
                other = there[0]
                arc, body = self.went(straight(self.poses[node], self.poses[other], arc.kind), self.held[node])
                if body >= 0 or set(arc.on) != set(self.held[node]) & set(self.held[other]) or not self.free.allow(arc):
                    return None
            else:
                other = self._cells[cells[0]] = len(self.poses)
                self.poses.append(end)
                self.held.append(held)
        if other != node:
            kept = self.arcs.get((node, other))
            if kept is None or arc.length(self.hand.radius) < kept.length(self.hand.radius) - 1e-9:
                self.arcs[node, other] = arc
        return other

    def _alike(self, a: Pose, b: Pose) -> bool:
        """Whether two poses are one."""
        return bool(np.linalg.norm(a[1] - b[1]) <= SAME[0] and angles(a[0][None], b[0])[0] <= SAME[1])

    def _note(self, body: int, pose: Pose) -> None:
        """Remember an obstacle that stopped a move."""
        if body < 0:
            return
        far = distance(pose, self.goal, self.hand.radius)
        known = self.blocked.setdefault(body, Blocked(body, far, pose))
        if far < known.far:
            known.far, known.pose = far, pose
