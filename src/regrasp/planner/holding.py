"""How little force holds the object along an arc (paper §3: an arc's cost), with fingers wherever they find room.

The global planner doesn't know which agent will stand where. It asks for less: the points of the surface that some tip could
touch, clear of all static bodies and within reach of some agent, press as they like within all agents' strength together, and
the supports bear as the object moves over them. Where even that is no equilibrium, no grasp is; a single agent has to hold
the object at one point.
"""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.basis import Program, program
from regrasp.kernels.distances import distance
from regrasp.kernels.features import TOUCH
from regrasp.kernels.forces import EDGES, friction_edges
from regrasp.kernels.native import kernel
from regrasp.kernels.records import Record
from regrasp.kernels.rotations import minus, triple
from regrasp.kernels.sampling import sample
from regrasp.kernels.simplex import OPTIMAL, solve
from regrasp.kernels.stack import stack
from regrasp.kernels.surfaces import frame
from regrasp.planner.arcs import Arc
from regrasp.planner.balance import support_columns
from regrasp.planner.hand import Hand
from regrasp.planner.motions import whole
from regrasp.planner.path import Path, Pose, carried, nominal_path
from regrasp.planner.reserve import Margins
from regrasp.planner.supports import Support, gap
from regrasp.planner.tips import sharpest

Array = NDArray[np.float64]

POINTS = 60  # of the object's surface
U = np.array([0.0, 0.01, 0.02, 0.255, 0.49, 0.5, 0.51, 0.745, 0.98, 0.99, 1.0])
LOOKED_AT = (0, 2, 4)
"""Intervals of two steps between U that are looked at: as the arc begins, half-way, as it ends."""


class Touchable(Record):
    """Where fingers could touch: points p_O, outward normals n_O (C, 3).

    tip: radius of a ball that any tip is larger than next to its contact; clearance: what it keeps clear by.
    """

    p_O: Array
    n_O: Array
    tip: float
    clearance: float


def touchable(hand: Hand, clearance: float) -> Touchable:
    """A near-uniform sampling of the object's surface."""
    p_O, n_O = sample(hand.kind_O, hand.size_O, hand.grids, POINTS)
    return Touchable(p_O, n_O, min(map(sharpest, hand.kind_T, hand.size_T)), clearance)


@kernel
def has_room(hand: Hand, points: Touchable, c: int, R: Array, p: Array) -> bool:
    """Whether a tip at point c of the object at pose (R, p) is clear of all static bodies and within some agent's reach."""
    x, core, eye = stack(3), stack(3), stack((3, 3))
    core[:] = 0.0
    for a in range(3):
        x[a] = p[a]
        for b in range(3):
            eye[a, b] = 1.0 if a == b else 0.0
        for b in range(3):
            x[a] += R[a, b] * (points.p_O[c, b] + points.tip * points.n_O[c, b])
    near = False
    for i in range(len(hand.tip_geom)):
        far = 0.0
        for a in range(3):
            far += (x[a] - hand.origin[i, a]) ** 2
        near = near or far <= hand.span[i] ** 2
    if not near:
        return False
    geoms = hand.geoms
    for g in range(hand.geom_start[len(hand.tip_geom)], hand.arm_geom):
        gap = distance(
            whole(0), core, points.tip, eye, x,
            geoms.kind[g], geoms.core[g], geoms.radius[g], geoms.R_LG[g], geoms.p_LG[g], points.clearance,
        )  # fmt: skip
        if gap < points.clearance:
            return False
    return True


@kernel
def least_force(
    hand: Hand, path: Path, j: int, points: Touchable, margins: Margins, strength: float, lp: Program
) -> float:
    """Σ of the agents' normal forces, in weights, at the start of interval j of a path; inf without equilibrium."""
    R, p = path.R_WO[j, 0], path.p_WO[j, 0]
    start = whole(0)
    lp.b[:3], lp.b[3:] = path.up_O[j, 0], 0.0
    first = support_columns(hand, path, j, start, margins, lp, start)
    mu = np.inf
    for i in range(len(hand.mu)):
        mu = min(mu, (1.0 - margins.friction) * hand.mu[i])
    alone = len(hand.tip_geom) == 1
    lp.cap[0] = strength
    status, value, _ = solve(lp, first, False)
    if status == OPTIMAL:
        return 0.0
    best, at = np.inf, first
    for c in range(len(points.p_O)):
        if not has_room(hand, points, c, R, p):
            continue
        n = points.n_O[c]
        n_in = (-n[0], -n[1], -n[2])
        x, y = frame(triple(n))
        friction_edges(minus(points.p_O[c], hand.p_OM_O), n_in, x, y, mu, hand.radius, lp.A, at)
        for e in range(at, at + EDGES):
            lp.cost[e], lp.group[e] = 1.0, 0
        if alone:
            status, value, _ = solve(lp, at + EDGES, False)
            if status == OPTIMAL and value < best:
                best = value
        else:
            at += EDGES
    if not alone and at > first:
        status, value, _ = solve(lp, at, False)
        if status == OPTIMAL:
            best = value
    return best


def at_rest(hand: Hand, supports: tuple[Support, ...], pose: Pose, margins: Margins, gravity: Array) -> bool:
    """Whether the supports alone hold the object at a pose."""
    R, p = (np.repeat(part[None], 3, axis=0) for part in pose)
    path = nominal_path(R, p, 1, 2, gravity, hand, supports)
    lp = program(EDGES * path.support_mode.shape[1], 1)
    start = whole(0)
    lp.b[:3], lp.b[3:] = path.up_O[0, 0], 0.0
    status, _, _ = solve(lp, support_columns(hand, path, start, start, margins, lp, start), False)
    return bool(status == OPTIMAL)


def arc_force(
    hand: Hand, supports: tuple[Support, ...], arc: Arc, points: Touchable, margins: Margins, gravity: Array
) -> float:
    """The mean of `least_force` as the arc begins, half-way and as it ends, in weights; inf where one of them is.

    Through the air only as it ends: it began as the one before ended.
    """
    strength = float(np.sum(hand.cap))
    if not arc.on and all(gap(hand, support, *arc.start) > TOUCH for support in supports):
        path = in_the_air(hand, arc.goal, gravity)
        return least_force(hand, path, 0, points, margins, strength, program(EDGES * len(points.p_O), 1))
    path = nominal_path(*arc.poses(U), len(U) // 2, 2, gravity, hand, supports)
    lp = program(EDGES * (len(points.p_O) + path.support_mode.shape[1]), 1)
    total = 0.0
    for j in LOOKED_AT:
        total += least_force(hand, path, j, points, margins, strength, lp)
        if total == np.inf:
            break
    return total / len(LOOKED_AT)


def in_the_air(hand: Hand, pose: Pose, gravity: Array) -> Path:
    """One interval of one step in which the object stands still and nothing carries it."""
    R, p = (np.array([part, part]) for part in pose)
    g = float(np.linalg.norm(gravity))
    up_O = -(gravity @ pose[0]) / g if g > 0.0 else np.zeros(3)
    none, slots = np.zeros((1, 2, 0, 3)), np.zeros(0, np.int64)
    bases = carried(hand, R, p, np.tile(hand.arm_home, (2, 1)), np.array([[0, 1]]))
    return Path(
        R[None], p[None], np.array([[up_O, up_O]]), np.zeros((1, 0), np.int64), none, none, none, np.zeros(0), slots, slots,
        *map(np.ascontiguousarray, bases),
    )  # fmt: skip
