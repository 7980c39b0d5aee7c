"""Nominal paths along the arcs of a route, in pieces that a local planner takes at once, with the arms that carry hands."""

import math

import numpy as np
from numpy.typing import NDArray

from regrasp.planner.arcs import Arc
from regrasp.planner.arms import ways
from regrasp.planner.configurations import Grasp
from regrasp.planner.path import Path, Pose, nominal_path
from regrasp.planner.task import Task

Array = NDArray[np.float64]
Piece = tuple[Array, Array, int]
AHEAD = 8  # intervals beyond a piece that are searched with it


def intervals(task: Task, arc: Arc, least: int = 4) -> int:
    """Into how many intervals an arc is divided."""
    s, radius = task.settings, task.hand.radius
    return max(least, math.ceil(arc.angle / s.turn - 1e-9), math.ceil(arc.way / (s.travel * radius) - 1e-9))


def paths_of(task: Task, arcs: list[Arc], grasp: Grasp | None) -> list[Path]:
    """The nominal paths along consecutive arcs, one for each way of the arms that carry hands: one where there are none."""
    counts = [intervals(task, arc) for arc in arcs]
    m = task.settings.samples
    R, p = [arcs[0].start[0][None]], [arcs[0].start[1][None]]
    for arc, n in zip(arcs, counts, strict=True):
        turns, places = arc.poses(np.arange(1, n * m + 1) / (n * m))
        R.append(turns)
        p.append(places)
    return ways_along(task, np.concatenate(R), np.concatenate(p), sum(counts), grasp)


def first_piece(task: Task, arc: Arc, grasp: Grasp | None, least: int = 4, pause: int = 0) -> Path:
    """The first piece of an arc, the arms going with the object as far as they can, or at rest where they can't go at all.

    pause: intervals at rest before it.
    """
    R, p, n = pieces_of(task, arc, least)[0]
    still = np.zeros(pause * task.settings.samples, np.int64)
    rows = np.concatenate([still, np.arange(len(R))])
    piece = R[rows], p[rows], pause + n
    found = ways_along(task, *piece, grasp)
    return found[0] if found else _path(task, *piece, np.tile(arm_joints(task, grasp), (len(piece[0]), 1)))


def pieces_of(task: Task, arc: Arc, least: int = 4) -> list[Piece]:
    """Poses R, p along an arc in pieces of at most `Settings.intervals` intervals, `least` or more in all; each's count."""
    n, m = intervals(task, arc, least), task.settings.samples
    pieces = math.ceil(n / task.settings.intervals)
    each = math.ceil(n / pieces)
    R, p = arc.poses(np.linspace(0.0, 1.0, pieces * each * m + 1))
    parts = [slice(c * each * m, (c + 1) * each * m + 1) for c in range(pieces)]
    return [(R[part], p[part], each) for part in parts]


def with_ahead(task: Task, piece: Piece, coming: list[Piece]) -> tuple[Piece, int]:
    """A piece with the first AHEAD intervals of what comes after it, if anything does, and their count."""
    if not coming:
        return piece, 0
    (R, p, n), (R_next, p_next, n_next) = piece, coming[0]
    ahead = min(AHEAD, n_next)
    rows = slice(1, ahead * task.settings.samples + 1)
    return (np.concatenate([R, R_next[rows]]), np.concatenate([p, p_next[rows]]), n + ahead), ahead


def rest_at(task: Task, pose: Pose, n: int, grasp: Grasp | None) -> Path:
    """n intervals in which neither the object nor an arm moves."""
    count = n * task.settings.samples + 1
    q = np.tile(arm_joints(task, grasp), (count, 1))
    return _path(task, np.repeat(pose[0][None], count, axis=0), np.repeat(pose[1][None], count, axis=0), n, q)


def arm_joints(task: Task, grasp: Grasp | None) -> Array:
    """Where the arms are that carry hands: as in the grasp at hand, at rest before the first."""
    return task.hand.arm_home if grasp is None else grasp.arm_q


def ways_along(task: Task, R: Array, p: Array, n: int, grasp: Grasp | None) -> list[Path]:
    """The nominal paths along n · samples + 1 given poses, one for each way of the arms from where they are in the grasp."""
    clearance = task.settings.local.energy.clearance
    return [_path(task, R, p, n, q) for q in ways(task.hand, R, p, arm_joints(task, grasp), clearance)]


def _path(task: Task, R: Array, p: Array, n: int, arm_q: Array) -> Path:
    gravity = np.array(task.world.scene.gravity)
    return nominal_path(R, p, n, task.settings.samples, gravity, task.hand, task.supports, arm_q)
