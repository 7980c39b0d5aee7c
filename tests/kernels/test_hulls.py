"""Hulls of vertices: support, distances, faces and contact patches are those of the same body in closed form."""

import numpy as np
import pytest

from regrasp.kernels.cores import BOX, HULL, PLANE, POINT, support
from regrasp.kernels.distances import distance
from regrasp.kernels.features import RIM, feature
from regrasp.kernels.patches import ROOM, SCRATCH, SLOTS, contact, patch
from regrasp.planner.hulls import hull_core, numbers, widened

HALF = np.array([0.03, 0.02, 0.04])
CORNERS = HALF * (2 * np.array(list(np.ndindex(2, 2, 2)), float) - 1)
HULL_BOX = hull_core(CORNERS)


def turn(rng: np.random.Generator) -> np.ndarray:
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return np.ascontiguousarray(Q * np.sign(np.linalg.det(Q)))


def test_the_core_of_a_box_of_vertices_says_its_half_extents() -> None:
    np.testing.assert_allclose(HULL_BOX[:3], HALF)
    assert HULL_BOX[3] == 8
    np.testing.assert_array_equal(np.sort(numbers(CORNERS)), np.arange(8))


def test_support_is_that_of_the_box() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        R, d = turn(rng), rng.normal(size=3)
        np.testing.assert_allclose(support(HULL, HULL_BOX, R, tuple(d)), support(BOX, HALF, R, tuple(d)), atol=1e-15)


@pytest.mark.parametrize("other", [POINT, BOX, PLANE, HULL])
def test_distance_is_that_of_the_box(other: int) -> None:
    """Apart and overlapping by less than the radii, whatever the other body is."""
    rng = np.random.default_rng(1)
    core = {POINT: np.zeros(3), BOX: HALF, PLANE: np.zeros(3), HULL: HULL_BOX}[other]
    seen = 0
    for _ in range(400):
        R_A, R_B, p = turn(rng), turn(rng), rng.uniform(-0.12, 0.12, 3)
        pair = [
            distance(kind, size, 0.004, R_A, np.zeros(3), other, core, 0.003, R_B, p, np.inf)
            for kind, size in ((HULL, HULL_BOX), (BOX, HALF))
        ]
        if pair[1] > -0.007:
            assert pair[0] == pytest.approx(pair[1], abs=1e-7)
            seen += 1
    assert seen > 60


def corners_of(kind: int, core: np.ndarray, R: np.ndarray, d: np.ndarray) -> np.ndarray:
    points = np.zeros((RIM, 4))
    count = feature(kind, core, R, np.array([0.1, 0.2, 0.3]), tuple(d), points)
    return points[:count]


def test_faces_edges_and_corners_are_those_of_the_box() -> None:
    rng = np.random.default_rng(2)
    counts = set()
    for i in range(60):
        R = turn(rng)
        d = R[:, i % 3] * (-1) ** i
        if i % 4 == 1:
            d = (d + R[:, (i + 1) % 3]) / np.sqrt(2.0)
        elif i % 4 == 2:
            d = rng.normal(size=3)
            d /= np.linalg.norm(d)
        mine, true = corners_of(HULL, HULL_BOX, R, d), corners_of(BOX, HALF, R, d)
        assert len(mine) == len(true)
        counts.add(len(mine))
        order = lambda rows: rows[np.lexsort(np.round(rows[:, :3], 9).T)][:, :3]  # noqa: E731
        np.testing.assert_allclose(order(mine), order(true), atol=1e-12)
        assert len(set(mine[:, 3])) == len(mine)
        if len(mine) == 4:  # in order round the face: the sides are edges of the box, not diagonals
            sides = np.linalg.norm(mine[:, :3] - np.roll(mine[:, :3], 1, axis=0), axis=1)
            assert np.max(sides) < np.linalg.norm(mine[2, :3] - mine[0, :3])
    assert counts == {1, 2, 4}


def test_a_face_of_many_corners_keeps_those_that_reach_farthest() -> None:
    angles = 2 * np.pi * np.arange(40) / 40
    ring = np.stack([0.03 * np.cos(angles), 0.03 * np.sin(angles)], axis=1)
    prism = np.vstack([np.column_stack([ring, np.full(40, z)]) for z in (-0.02, 0.02)])
    found = corners_of(HULL, hull_core(prism), np.eye(3), np.array([0.0, 0.0, -1.0]))
    assert len(found) == RIM
    np.testing.assert_allclose(found[:, 2], 0.28)
    given = numbers(prism)
    for face in (given[:40], given[40:]):
        assert sorted(face[face >= 0]) == list(range(8))


def test_a_hull_rests_on_a_plane_a_box_and_a_hull_as_the_box_does() -> None:
    """Signed distance, normal and the patch's area."""
    rng = np.random.default_rng(3)
    for kind_S, core_S in (
        (PLANE, np.zeros(3)),
        (BOX, np.array([0.1, 0.1, 0.02])),
        (HULL, hull_core(np.array([0.1, 0.1, 0.02]) * (2 * np.array(list(np.ndindex(2, 2, 2)), float) - 1))),
    ):
        spin = rng.uniform(0, np.pi)
        R = np.array([[np.cos(spin), -np.sin(spin), 0.0], [np.sin(spin), np.cos(spin), 0.0], [0.0, 0.0, 1.0]])
        top = 0.0 if kind_S == PLANE else 0.02
        p = np.array([0.01, -0.02, top + HALF[2] + 0.003])
        areas = []
        for kind, core in ((HULL, HULL_BOX), (BOX, HALF)):
            h, n = contact(kind_S, core_S, 0.0, np.eye(3), np.zeros(3), kind, core, 0.003, R, p)
            assert h == pytest.approx(0.0, abs=1e-9)
            np.testing.assert_allclose(n, [0.0, 0.0, 1.0], atol=1e-9)
            polygon, present, points = np.empty((ROOM, 3)), np.zeros(SLOTS, np.uint8), np.zeros((SLOTS, 3))
            count = patch(
                kind_S,
                core_S,
                np.eye(3),
                np.zeros(3),
                kind,
                core,
                0.003,
                R,
                p,
                n,
                np.empty((SCRATCH, ROOM, 4)),
                polygon,
                present,
                points,
            )
            assert count == 4
            assert np.sum(present[:8]) == 4
            np.testing.assert_allclose(points[present.astype(bool), 2], top, atol=1e-9)
            a = polygon[:4]
            areas.append(np.linalg.norm(np.cross(a[2] - a[0], a[3] - a[1])) / 2)
        assert areas[0] == pytest.approx(areas[1], rel=1e-9)
        assert areas[1] == pytest.approx(4 * HALF[0] * HALF[1], rel=1e-9)


def test_a_triangle_is_a_face() -> None:
    tetrahedron = np.array([[0.03, 0.0, -0.01], [-0.015, 0.026, -0.01], [-0.015, -0.026, -0.01], [0.0, 0.0, 0.03]])
    tetrahedron -= 0.5 * (tetrahedron.min(axis=0) + tetrahedron.max(axis=0))
    core = hull_core(tetrahedron)
    p = np.array([0.0, 0.0, core[2]])
    polygon, present, points = np.empty((ROOM, 3)), np.zeros(SLOTS, np.uint8), np.zeros((SLOTS, 3))
    h, n = contact(PLANE, np.zeros(3), 0.0, np.eye(3), np.zeros(3), HULL, core, 0.0, np.eye(3), p)
    count = patch(
        PLANE,
        np.zeros(3),
        np.eye(3),
        np.zeros(3),
        HULL,
        core,
        0.0,
        np.eye(3),
        p,
        n,
        np.empty((SCRATCH, ROOM, 4)),
        polygon,
        present,
        points,
    )
    assert h == pytest.approx(0.0, abs=1e-12)
    assert count == 3
    np.testing.assert_allclose(polygon[:3, 2], 0.0, atol=1e-12)
    assert np.sum(present) == 3


def test_rows_of_cores_are_as_wide_as_the_widest() -> None:
    rows = widened([np.zeros(3), HULL_BOX])
    assert rows.shape == (2, len(HULL_BOX))
    assert widened([np.zeros(3)]).shape == (1, 3)
