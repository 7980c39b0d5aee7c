"""Arcs: what joins, what stays where it is, what does not slip, and that none is shorter than the way between its ends."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tables import velocity

from regrasp.planner.arcs import Arc, straight
from regrasp.planner.path import Pose, distance, interpolate

U = np.linspace(0.0, 1.0, 11)
ANGLES = (0.0, 1e-9, 0.3, np.pi / 2, np.pi - 1e-7, 3.0, 5.0)  # of which the last is no shortest way


def poses(count: int, seed: int = 0) -> list[Pose]:
    rng = np.random.default_rng(seed)
    turns = Rotation.random(count, rng=rng).as_matrix()
    return list(zip(turns, 0.1 * rng.normal(size=(count, 3)), strict=True))


def arcs(seed: int = 0) -> list[Arc]:
    """Turns by every angle about points near and far, that move or don't."""
    rng = np.random.default_rng(seed)
    found = []
    for angle, far, way in itertools.product(ANGLES, (0.0, 0.03, 1.0), (0.0, 0.1)):
        ((R, p),) = poses(1, len(found))
        axis, c, d = rng.normal(size=(3, 3))
        found.append(Arc((R, p), angle * axis / np.linalg.norm(axis), p + far * c, way * d, "turn", (0, 2)))
    return found


def same(a: Pose, b: Pose) -> None:
    np.testing.assert_allclose(a[0], b[0], atol=1e-12)
    np.testing.assert_allclose(a[1], b[1], atol=1e-12)


@pytest.mark.parametrize("arc", arcs(), ids=lambda arc: f"{arc.angle:.1f}")
def test_an_arc_begins_at_its_start_and_its_parts_are_its_own(arc: Arc) -> None:
    same(arc.pose(0.0), arc.start)
    same(arc.goal, arc.pose(1.0))
    R, p = arc.poses(U)
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (len(U), 1, 1)), atol=1e-12)
    one, two = arc.halves()
    same(one.goal, two.start)
    same(two.goal, arc.goal)
    part = arc.part(0.3, (1,))
    assert (part.kind, part.on, one.on, two.on) == (arc.kind, (1,), arc.on, arc.on)
    for u, *pose in zip(U.tolist(), R, p, strict=True):
        same(arc.pose(u), (pose[0], pose[1]))
        same(one.pose(u), arc.pose(0.5 * u))
        same(two.pose(u), arc.pose(0.5 + 0.5 * u))
        same(part.pose(u), arc.pose(0.3 * u))


def test_no_arc_is_shorter_than_the_way_of_its_origin_and_the_distance_of_its_ends() -> None:
    """Nor longer than its halves. Exact where the origin goes straight, or round a point that stays."""
    radius = 0.04
    for arc in arcs() + arcs(1):
        assert arc.length(radius) >= distance(arc.start, arc.goal, radius) - 1e-12
        assert arc.length(radius) == pytest.approx(arc.length(0.0) + radius * np.linalg.norm(arc.w), abs=1e-12)
        assert arc.length(radius) <= sum(half.length(radius) for half in arc.halves()) + 1e-12
        p = arc.poses(np.linspace(0.0, 1.0, 2001))[1]
        true = np.sum(np.linalg.norm(np.diff(p, axis=0), axis=1))
        assert arc.length(0.0) >= true - 1e-12
        if not np.any(arc.d) or not np.any(arc.w) or np.array_equal(arc.c, arc.start[1]):
            assert arc.length(0.0) == pytest.approx(true, rel=1e-6, abs=1e-12)


def test_a_straight_arc_is_the_constant_twist_to_its_goal() -> None:
    """By the shortest way, as long as the distance; for no motion at all too, and for half a turn."""
    ends = poses(20)
    half = (Rotation.from_rotvec([np.pi, 0, 0]).as_matrix() @ ends[0][0], ends[0][1])
    for start, goal in [*itertools.pairwise(ends), (ends[0], ends[0]), (ends[0], half)]:
        arc = straight(start, goal)
        same(arc.goal, goal)
        assert arc.angle <= np.pi + 1e-12
        assert arc.length(0.04) == pytest.approx(distance(start, goal, 0.04), abs=1e-12)
        for mine, theirs in zip(arc.poses(U), interpolate(start, goal, U), strict=True):
            np.testing.assert_allclose(mine, theirs, atol=1e-12)
    assert straight(ends[0], ends[0]).length(0.04) == pytest.approx(0.0, abs=1e-9)


def test_a_pivot_leaves_every_point_of_its_axis_where_it_is() -> None:
    (start,) = poses(1)
    w, c = np.array([0.5, -1.0, 1.0]), np.array([0.02, 0.03, 0.0])
    arc = Arc(start, w, c, np.zeros(3), "pivot")
    for along in (-0.3, 0.0, 1.0):
        x_O = start[0].T @ (c + along * w - start[1])
        R, p = arc.poses(U)
        np.testing.assert_allclose(R @ x_O + p, np.tile(c + along * w, (len(U), 1)), atol=1e-12)
    off = start[0].T @ (c + np.cross(w, [0, 0, 0.1]) - start[1])
    np.testing.assert_allclose(
        np.linalg.norm(R @ off + p - c, axis=1), np.linalg.norm(np.cross(w, [0, 0, 0.1])), atol=1e-12
    )


def test_what_rolls_does_not_move_where_it_touches() -> None:
    """d = r w × n: the material point r below the moving centre is at rest at every moment, and no other one of the circle."""
    ((R, _),), n, r = poses(1), np.array([0.0, 0.6, 0.8]), 0.03
    w = 2.5 * np.cross(n, [1.0, 0.0, 0.0])
    centre = np.array([0.1, -0.2, 0.3])
    for offset in (np.zeros(3), np.array([0.02, 0.01, -0.03])):  # the origin on the axis, or beside it
        arc = Arc((R, centre + offset), w, centre, r * np.cross(w, n), "roll")
        for u in U.tolist():
            touch = centre + u * arc.d - r * n
            np.testing.assert_allclose(velocity(arc.pose, u, touch), 0.0, atol=1e-9)
            assert np.linalg.norm(velocity(arc.pose, u, touch + 2.0 * r * n)) == pytest.approx(2 * r * 2.5, rel=1e-6)
