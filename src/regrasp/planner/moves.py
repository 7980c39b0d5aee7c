"""Where the object may go from a pose (paper §3): through the air, along the surfaces that carry it, over its edges.

A contact on a flat surface leaves the object a slide and a turn about the normal; on the edge of its patch a pivot; a round
one rolls. Each move is an arc as long as it could be; the surroundings say how far it gets.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.surfaces import CAPSULE, CYLINDER, SPHERE
from regrasp.planner.arcs import Arc, straight
from regrasp.planner.path import Pose
from regrasp.planner.supports import Patch
from regrasp.planner.turns import rotvec

Array = NDArray[np.float64]
AXES = ("x", "y", "z", "rx", "ry", "rz")

U = np.linspace(0.0, 1.0, 9)  # parts of an arc at which it is compared with the freedoms
FLAT = 1e-6  # directions that differ by less are parallel, or across
OVER = 0.55 * math.pi  # rad: a pivot that meets nothing ends here
STEEP = 0.1  # sine of the slope above which an axis is told from its downhill direction
LEAST = 0.05  # rad: a pivot that gets less far is none
DISC = 8  # corners of a patch that stands for a disc, or more
SHORT = 1e-4  # m: an edge shorter than this is none
ROUND = (SPHERE, CAPSULE, CYLINDER)


@dataclass(frozen=True)
class Freedoms:
    """Axes of W along (shifts) and about (turns) which the scene lets the object move, (3,) of bool."""

    shifts: NDArray[np.bool_]
    turns: NDArray[np.bool_]

    @cached_property
    def all(self) -> bool:
        """Whether the object may move as it likes."""
        return bool(np.all(self.shifts) and np.all(self.turns))

    def allow(self, arc: Arc) -> bool:
        """Whether the whole arc keeps to them."""
        if self.all:
            return True
        if np.any(np.abs(arc.w[~self.turns]) > FLAT * (1.0 + arc.angle)):
            return False
        _, p = arc.poses(U if arc.angle > 0.0 else U[[0, -1]])
        return bool(np.all(np.abs(p - p[0])[:, ~self.shifts] <= 1e-7))


def freedoms_of(names: tuple[str, ...]) -> Freedoms:
    """The scene's names as flags."""
    flags = np.array([axis in names for axis in AXES])
    return Freedoms(flags[:3], flags[3:])


def along_surfaces(d: Array, normals: list[Array]) -> Array | None:
    """Direction d without what leads into a surface that touches; None where nothing of it is left."""
    for _ in range(len(normals)):
        for n in normals:
            d = d - min(0.0, float(d @ n)) * n
    length = float(np.linalg.norm(d))
    if length < STEEP or any(d @ n < -FLAT for n in normals):
        return None
    return np.asarray(d / length)


def shifts(pose: Pose, patches: list[Patch], step: float, goal: Pose) -> Iterator[Arc]:
    """Straight ways: along the axes and the normals, as the surfaces allow, by a step and up to the goal's coordinate."""
    normals = [patch.n_W for patch in patches]
    seen: list[Array] = []
    for d in (*np.eye(3), *(-np.eye(3)), *normals):
        free = along_surfaces(d, normals)
        if free is None or any(free @ other > 1.0 - FLAT for other in seen):
            continue
        seen.append(free)
        kind = "slide" if any(abs(free @ n) <= FLAT for n in normals) else "straight"
        yield Arc(pose, np.zeros(3), pose[1], step * free, kind)
        left = float(free @ (goal[1] - pose[1]))
        if left > FLAT and abs(left - step) > FLAT:
            yield Arc(pose, np.zeros(3), pose[1], left * free, kind)


def turns(pose: Pose, patches: list[Patch], around: list[Array], angle: float, goal: Pose) -> Iterator[Arc]:
    """Turns about the object's origin: in the air to the orientations `around`, on a surface about its normal."""
    if not patches:
        for R in around:
            yield straight(pose, (R, pose[1]), "turn")
        return
    to_goal = rotvec(goal[0] @ pose[0].T)
    for patch in patches:
        for sign in (1.0, -1.0):
            yield Arc(pose, sign * angle * patch.n_W, pose[1], np.zeros(3), "turn")
        left = float(to_goal @ patch.n_W)
        if abs(left) > FLAT and np.linalg.norm(to_goal - left * patch.n_W) <= FLAT:
            yield Arc(pose, left * patch.n_W, pose[1], np.zeros(3), "turn")


def pivots(pose: Pose, patches: list[Patch], rounding: float) -> Iterator[Arc]:
    """Turns over each edge of each contact patch, to the side on which the object leaves the surface.

    A rounded edge of the object rolls over the surface as it turns, or slides about its own centre line where it can't get
    away; about the sharp edge of a body the object turns with its face.
    """
    for patch in patches:
        n, corners = patch.n_W, patch.polygon
        count = len(corners)
        if count < 2:
            continue
        middle = np.mean(corners, axis=0)
        for corner, axis in edges_of(corners, n):
            if count > 2 and float(np.cross(axis, middle - corner) @ n) < 0.0:
                axis = -axis
            w, centre = OVER * axis, corner + rounding * n
            yield Arc(pose, w, centre, rounding * np.cross(w, n), "pivot")
            yield Arc(pose, w, centre, np.zeros(3), "pivot")
            yield Arc(pose, w, corner, np.zeros(3), "pivot")


def edges_of(corners: Array, n: Array) -> Iterator[tuple[Array, Array]]:
    """Points and unit directions of the lines over which an object tips on a patch with these corners (c, 3).

    Its edges; of a disc, which has many corners, the tangents at some; of a line itself, to both sides, and across its ends.
    """
    count = len(corners)
    if count >= DISC:
        for corner in corners[:: count // 4]:
            tangent = np.cross(n, corner - np.mean(corners, axis=0))
            yield corner, tangent / np.linalg.norm(tangent)
        return
    for a in range(count):
        edge = corners[(a + 1) % count] - corners[a]
        length = float(np.linalg.norm(edge))
        if length >= SHORT:
            yield corners[a], edge / length
            if count == 2:
                yield corners[a], np.cross(edge / length, n)


def rolls(pose: Pose, patches: list[Patch], kind_O: int, size_O: Array, angle: float) -> Iterator[Arc]:
    """A sphere, or a cylinder or capsule on its side, rolls along the surface without slipping."""
    if kind_O not in ROUND:
        return
    r = float(size_O[0])
    for patch in patches:
        n = patch.n_W
        ways = [d - (d @ n) * n for d in np.eye(3)]
        if kind_O != SPHERE:
            axis = pose[0][:, 2]
            ways = [np.cross(axis, n)] if abs(axis @ n) <= FLAT else []
        for d, sign in itertools.product(ways, (1.0, -1.0)):
            length = float(np.linalg.norm(d))
            if length > 0.3:
                d = sign * d / length
                yield Arc(pose, angle * np.cross(n, d), pose[1], angle * r * d, "roll")
