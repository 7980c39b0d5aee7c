"""Contacts on triangulated surfaces: against closed forms for a ball and a rounded box."""

from collections.abc import Iterator

import numpy as np
import pytest

from regrasp.scene import solids
from regrasp.scene.grids import Grid, Spline, nodes, skin_of
from regrasp.scene.schema import Object
from regrasp.verify.contacts import NORMAL, TOUCH, beside
from regrasp.verify.skin import Surface, Tip

BOX = Object(shape="box", size=(0.03, 0.02, 0.025), rounding=0.004, mass=1.0)
TIPS = {
    "sphere": (0, np.array([0.012, 0.0, 0.0, 0.0])),
    "ellipsoid": (1, np.array([0.015, 0.01, 0.012, 0.0])),
    "capsule": (2, np.array([0.008, 0.01, 0.0, 0.0])),
    "box": (4, np.array([0.012, 0.01, 0.008, 0.003])),
}


@pytest.fixture(scope="module")
def grid() -> Grid:
    """Of the rounded box, its distances at nodes 1 mm apart."""
    half = np.array(BOX.size)
    origin, shape = nodes(-half, half, 0.001)
    points = origin + 0.001 * np.argwhere(np.ones(shape, bool))
    return Grid(origin, 0.001, solids.distance(*solids.kind(BOX), points).reshape(shape))


@pytest.fixture(scope="module")
def surface(grid: Grid) -> Surface:
    return Surface(skin_of(grid), grid)


def on_the_spline(grid: Grid, surface: Surface, seed: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Points of the spline's surface and its unit normals there."""
    rng, spline = np.random.default_rng(seed), Spline(grid)
    p = surface.skin.vertices[rng.choice(len(surface.skin.vertices), 60)] + 3e-4 * rng.normal(size=(60, 3))
    for _ in range(5):
        value, gradient = spline(p)
        p = p - (value / np.sum(gradient**2, axis=1))[:, None] * gradient
    normals = spline(p)[1]
    yield from zip(p, normals / np.linalg.norm(normals, axis=1, keepdims=True), strict=True)


def test_the_patches_are_the_spline_as_a_ball_feels_it(grid: Grid, surface: Surface) -> None:
    """A ball put onto the spline's surface touches it to 0.005 mm, at the point and with the normal where it was put."""
    size = TIPS["sphere"][1]
    for p_O, n in on_the_spline(grid, surface, 1):
        assert abs(surface.nearest(Tip(0, size, np.eye(3), p_O + size[0] * n))[0]) < 5e-6
        back = Tip(0, size, np.eye(3), p_O + (size[0] + 1e-3) * n)
        _, point = surface.nearest(back)
        assert np.linalg.norm(point - p_O) < 6e-5
        assert np.arccos(min(1.0, back.normal(point) @ n)) < np.radians(0.3)


def test_a_ball_on_a_face_is_off_by_the_way_from_where_it_is_nearest(surface: Surface) -> None:
    """Stated 0.3 mm aside it is refused, 0.05 mm aside it is not."""
    radius, n = 0.012, np.array([0.0, 0.0, 1.0])
    under = np.array([0.004, -0.003, BOX.size[2]])
    ball = Tip(0, TIPS["sphere"][1], np.eye(3), under + radius * n)
    for aside in (0.0, 5e-5, 3e-4):
        foot, _, off, turn = beside(surface, ball, under + [aside, 0.0, 0.0], n)
        np.testing.assert_allclose(foot, under + [aside, 0.0, 0.0], atol=1e-5)
        assert off == pytest.approx(aside, abs=2e-5)
        assert turn == pytest.approx(aside / radius, abs=2e-3)
        assert (off < TOUCH) == (aside < 1e-4)


def test_a_ball_in_a_hollow_hardly_wider_is_measured_where_it_is_stated() -> None:
    """Its nearest point is not: a micrometre of the surface moves that by tenths of a millimetre."""
    radius, pit = 0.012, 0.0125
    half, centre = np.array([0.02, 0.02, 0.01]), np.array([0.0, 0.0, 0.01 + pit - 0.002])
    origin, shape = nodes(-half, half, 0.0005)
    points = origin + 0.0005 * np.argwhere(np.ones(shape, bool))
    outside = np.abs(points) - half
    box = np.linalg.norm(np.maximum(outside, 0.0), axis=1) + np.minimum(outside.max(axis=1), 0.0)
    values = np.maximum(box, pit - np.linalg.norm(points - centre, axis=1))
    grid = Grid(origin, 0.0005, values.reshape(shape))
    hollow = Surface(skin_of(grid), grid)
    for lean in (0.0, 0.05, 0.1):
        n = np.array([-np.sin(lean), 0.0, np.cos(lean)])
        p = centre - pit * n
        foot, _, off, turn = beside(hollow, Tip(0, TIPS["sphere"][1], np.eye(3), p + radius * n), p, n)
        assert np.linalg.norm(foot - p) < 2e-5
        assert off < TOUCH
        assert turn < NORMAL


@pytest.mark.parametrize("name", TIPS)
def test_gap_point_and_normal_of_a_tip_are_those_of_the_body(surface: Surface, name: str) -> None:
    """Tips put at a known height over known points: on faces, round edges and corners. The spline's surface, on which the
    skin lies, is within 0.012 mm of the box; its normals, where the edges' curvature begins, within 1.5°."""
    kind, size = TIPS[name]
    rng = np.random.default_rng(0)
    core = np.array(BOX.size) - BOX.rounding
    for _ in range(40):
        n = rng.normal(size=3)
        n /= np.linalg.norm(n)
        edge = rng.random(3) < 0.6
        p = np.where(edge, np.sign(n) * core, rng.uniform(-0.9, 0.9, 3) * core)
        n = np.where(edge, n, 0.0)
        if not edge.any():
            continue
        n /= np.linalg.norm(n)
        p_O = p + BOX.rounding * n
        Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        R = Q * np.sign(np.linalg.det(Q))
        height = rng.uniform(0.0, 0.001)
        centre = p_O + height * n - R @ lowest(kind, size, R.T @ -n)
        gap, point = surface.nearest(Tip(kind, size, R, centre))
        assert gap == pytest.approx(height, abs=2e-5)
        if name in ("box", "capsule"):  # their flat and straight parts may touch in no single point
            continue
        assert np.linalg.norm(point - p_O) < 2.5e-4
        found = Tip(kind, size, R, centre + 1e-3 * n)
        _, point = surface.nearest(found)
        assert np.arccos(min(1.0, found.normal(point) @ n)) < np.radians(1.5)


def lowest(kind: int, size: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The tip's point furthest along d, in T."""
    if kind == 0:
        return size[0] * d
    if kind == 1:
        return size[:3] ** 2 * d / np.linalg.norm(size[:3] * d)
    if kind == 2:
        return np.array([0.0, 0.0, np.sign(d[2]) * size[1]]) + size[0] * d
    return np.sign(d) * (size[:3] - size[3]) + size[3] * d


def test_a_tip_inside_is_as_deep_as_it_is(surface: Surface) -> None:
    kind, size = TIPS["sphere"]
    gap, _ = surface.nearest(Tip(kind, size, np.eye(3), np.array([0.005, 0.003, 0.025 + 0.012 - 2e-4])))
    assert gap == pytest.approx(-2e-4, abs=1e-6)


def test_the_foot_of_a_point_beside_the_spline_is_its_own_with_its_normal(grid: Grid, surface: Surface) -> None:
    """That is what the judge measures where a contact is stated."""
    for p_O, n in on_the_spline(grid, surface, 2):
        foot, normal = surface.foot(p_O + 5e-5 * n)
        assert np.linalg.norm(foot - p_O) < 1e-6
        assert np.arccos(min(1.0, normal @ n)) < np.radians(0.02)


def test_a_point_with_no_surface_beside_it_has_no_foot(grid: Grid, surface: Surface) -> None:
    """Beyond the grid, where a mirrored spline has other zeros, and in the middle, where no way leads to the surface."""
    size = 0.001 * (np.array(grid.values.shape) - 1)
    centre = grid.origin + 0.5 * size
    for axis in range(3):
        for side in (-1.0, 1.0):
            beyond = centre.copy()
            beyond[axis] += side * (size[axis] - BOX.size[axis])  # the mirror image of a face
            foot, _ = surface.foot(beyond)
            assert np.all(np.isnan(foot)) or np.linalg.norm(foot - beyond) > 5e-3
            _, _, off, turn = beside(surface, Tip(0, TIPS["sphere"][1], np.eye(3), beyond), beyond, np.eye(3)[axis])
            assert not (off < TOUCH and turn < NORMAL)
    foot, _ = surface.foot(centre)
    assert np.all(np.isnan(foot)) or np.linalg.norm(foot - centre) > 5e-3
