"""The solid of a mesh: the mesh opened by a ball, as a signed distance, as a spline on a grid, as triangles."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from regrasp.errors import InputError
from regrasp.scene import solids
from regrasp.scene.grids import Spline
from regrasp.scene.openings import FILL, Opening, opened
from regrasp.scene.schema import Object
from regrasp.scene.triangles import Triangles
from tests.scene import shapes

HALF, ROUNDING = np.array([0.03, 0.02, 0.025]), 0.006
BALL = 0.018  # m, of one and a half fingertips
ROUNDED = Object(shape="box", size=tuple(HALF), rounding=ROUNDING, mass=1.0)


def turned_box(spacing: float) -> tuple[Opening, np.ndarray]:
    mesh = shapes.box(*(2 * HALF))
    turn = trimesh.transformations.random_rotation_matrix(np.random.default_rng(3).random(3))
    mesh.apply_transform(turn)
    return opened(Triangles(np.array(mesh.vertices), np.array(mesh.faces), spacing), ROUNDING, spacing, BALL), turn[
        :3, :3
    ]


def test_a_box_opened_is_the_rounded_box() -> None:
    """Its core is the box that is smaller by the rounding, to the grid's last corner; its distance that of the rounded box."""
    found, R = turned_box(0.002)
    core = np.abs(found.core.vertices @ R) - (HALF - ROUNDING)
    assert np.max(np.abs(core.max(axis=1))) < 2e-4
    assert np.quantile(np.abs(core.max(axis=1)), 0.99) < 2e-5
    points = np.random.default_rng(0).normal(size=(2000, 3))
    points *= 0.04 / np.linalg.norm(points, axis=1, keepdims=True)
    true = solids.distance(*solids.kind(ROUNDED), points)
    mine = found.core.nearest(points @ R.T)[0] - ROUNDING
    np.testing.assert_allclose(mine, true, atol=2e-4)
    assert np.sqrt(np.mean((mine - true) ** 2)) < 2e-5


def test_the_spline_and_the_skin_keep_to_the_solid_and_converge() -> None:
    """Where edges are round the curvature jumps: the error falls with the square of the spacing."""
    errors = []
    for spacing in (0.003, 0.0015):
        found, R = turned_box(spacing)
        values, gradients = Spline(found.grid)(found.skin.vertices)
        assert np.max(np.abs(values)) < 1e-8
        away = np.abs(solids.distance(*solids.kind(ROUNDED), found.skin.vertices @ R))
        errors.append(np.sqrt(np.mean(away**2)))
        np.testing.assert_allclose(np.linalg.norm(gradients, axis=1), 1.0, atol=0.1)
        assert np.all(np.sum(gradients * found.skin.normals, axis=1) > 0.9)
    assert errors[1] < 0.4 * errors[0]
    assert found.error < 5e-5
    mesh = trimesh.Trimesh(found.skin.vertices, found.skin.faces, process=False)
    assert mesh.volume == pytest.approx(solids.volume(ROUNDED), rel=2e-3)


def test_flat_faces_stay_where_they_are() -> None:
    found, R = turned_box(0.002)
    p = found.skin.vertices @ R
    flat = np.sum(np.abs(p) > HALF - ROUNDING - 0.004, axis=1) == 1
    assert np.sum(flat) > 300
    np.testing.assert_allclose((np.abs(p[flat]) - HALF).max(axis=1), 0.0, atol=1e-5)


def test_concave_corners_stay_and_convex_ones_become_round(tmp_path: Path) -> None:
    mesh = shapes.bracket()
    found = opened(Triangles(np.array(mesh.vertices), np.array(mesh.faces), 0.002), 0.004, 0.002, BALL)

    def height(*p: float) -> float:
        return float(found.core.nearest(np.array([p]))[0][0]) - 0.004

    assert height(0.0201, 0.0, 0.0201) == pytest.approx(1e-4, abs=5e-5)  # just out of the inner corner
    gap = (np.sqrt(2.0) - 1.0) * 0.004
    assert height(0.0, 0.0, 0.0) == pytest.approx(gap, abs=5e-5)  # the outer corner is cut
    assert found.lost == pytest.approx((1 - np.pi / 4) * 0.004**2 * (2 * 0.24 + 5 * 0.03) / (0.002 * 0.03), rel=0.15)


def test_too_little_left_is_refused() -> None:
    thin = shapes.box(0.06, 0.06, 0.006)
    triangles = Triangles(np.array(thin.vertices), np.array(thin.faces), 0.001)
    with pytest.raises(InputError, match=r"no part of the mesh is 0.008 m thick"):
        opened(triangles, 0.004, 0.001, BALL)
    with pytest.raises(InputError, match=r"object.rounding: 0.0005 m is too fine"):
        opened(triangles, 0.0005, 0.001, BALL)


def test_a_shallow_pit_is_filled_as_far_as_the_ball_gets_and_a_deep_one_hardly() -> None:
    """The ball rests on the pit's rim, of radius a: its lowest point is r − √(r² − a²) below the face."""
    face, radius, shallow, deep = 0.007, 0.008, 1e-4, 1e-3
    pitted = shapes.box(0.02, 0.02, 2 * face)
    for side, depth in ((1.0, shallow), (-1.0, deep)):
        ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
        ball.apply_translation([0.0, 0.0, side * (face + radius - depth)])
        pitted = trimesh.boolean.difference([pitted, ball], engine="manifold")
    found = opened(Triangles(np.array(pitted.vertices), np.array(pitted.faces), 5e-4), 0.004, 5e-4, BALL)
    a = np.sqrt(radius**2 - (radius - shallow) ** 2)
    left = BALL - np.sqrt(BALL**2 - a**2), deep - FILL
    bottoms = np.array([[0.0, 0.0, face - left[0]], [0.0, 0.0, left[1] - face]])
    assert np.max(np.abs(Spline(found.grid).values(bottoms))) < 3e-5


def test_nothing_is_filled_where_all_is_convex() -> None:
    """But for what the distances of nodes are too large by."""
    bodies = [opened(Triangles(np.array(shapes.box(*(2 * HALF)).vertices), np.array(shapes.box(*(2 * HALF)).faces), 0.002),
                     ROUNDING, 0.002, ball) for ball in (0.0, BALL)]  # fmt: skip
    assert np.max(np.abs(bodies[1].grid.values - bodies[0].grid.values)) < 2e-5
