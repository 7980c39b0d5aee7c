"""Mesh files: read, scaled, mended, or refused with the reason."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from regrasp.errors import InputError
from regrasp.scene.meshes import read
from regrasp.scene.triangles import Triangles, moments
from tests.scene import shapes


@pytest.mark.parametrize("name", ["mesh.stl", "mesh.obj", "mesh.glb"])
def test_every_format_gives_the_same_solid(tmp_path: Path, name: str) -> None:
    mesh = read(shapes.file(tmp_path, shapes.box(60.0, 40.0, 80.0), name), 0.001, "object")
    volume, centre, _ = moments(mesh.vertices, mesh.faces)
    assert mesh.remarks == ()
    assert volume == pytest.approx(0.06 * 0.04 * 0.08, rel=1e-6)
    np.testing.assert_allclose(centre, 0.0, atol=1e-9)


def test_moments_of_a_box_and_a_ball_are_the_closed_forms() -> None:
    a, b, c = 0.06, 0.04, 0.08
    mesh = shapes.box(a, b, c)
    mesh.apply_translation([0.3, -0.2, 0.1])
    volume, centre, second = moments(np.array(mesh.vertices), np.array(mesh.faces))
    np.testing.assert_allclose(centre, [0.3, -0.2, 0.1], rtol=1e-12)
    np.testing.assert_allclose(second, volume / 12 * np.diag([a**2, b**2, c**2]), atol=1e-18)
    errors = []
    for fineness in (2, 3, 4):
        ball = trimesh.creation.icosphere(fineness, 0.05)
        volume, _, second = moments(np.array(ball.vertices), np.array(ball.faces))
        errors.append(
            [abs(volume / (4 / 3 * np.pi * 0.05**3) - 1), abs(np.trace(second) / volume / (3 / 5 * 0.05**2) - 1)]
        )
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.1)


def test_a_hole_is_filled_and_faces_are_turned_and_both_are_said(tmp_path: Path) -> None:
    whole = trimesh.creation.icosphere(3, 0.05)
    open_ = trimesh.Trimesh(whole.vertices, np.delete(whole.faces, [5, 100, 101], axis=0), process=False)
    mesh = read(shapes.file(tmp_path, open_), 1.0, "object")
    assert any("holes filled" in remark for remark in mesh.remarks)
    assert moments(mesh.vertices, mesh.faces)[0] == pytest.approx(whole.volume, rel=1e-3)
    inverted = whole.copy()
    inverted.invert()
    mesh = read(shapes.file(tmp_path, inverted), 1.0, "object")
    assert mesh.remarks == ("faces turned outwards",)
    assert moments(mesh.vertices, mesh.faces)[0] == pytest.approx(whole.volume, rel=1e-6)


def test_bodies_that_overlap_are_one(tmp_path: Path) -> None:
    """Two cubes that share an eighth have the volume of 15/8."""
    one, two = shapes.box(0.04, 0.04, 0.04), shapes.box(0.04, 0.04, 0.04)
    two.apply_translation([0.02, 0.02, 0.02])
    mesh = read(shapes.file(tmp_path, trimesh.util.concatenate([one, two])), 1.0, "object")
    assert mesh.remarks == ("2 bodies made one",)
    assert moments(mesh.vertices, mesh.faces)[0] == pytest.approx(15 / 8 * 0.04**3, rel=1e-6)


def test_what_is_no_solid_is_refused_with_the_reason(tmp_path: Path) -> None:
    cup = shapes.box(0.06, 0.06, 0.06)
    cup.update_faces(cup.face_normals[:, 2] < 0.5)
    (tmp_path / "text.stl").write_text("no mesh")
    for path, scale, line in (
        (shapes.file(tmp_path, cup, "cup.stl"), 1.0, "object.file: the surface has an opening"),
        (
            shapes.file(tmp_path, shapes.box(60, 40, 80), "large.stl"),
            1.0,
            "object.scale: the mesh is 80 m long (in millimetres?",
        ),
        (
            shapes.file(tmp_path, shapes.box(0.06, 0.04, 0.08), "small.stl"),
            0.001,
            "object.scale: the mesh is 8e-05 m long (in metres?",
        ),
        (str(tmp_path / "none.stl"), 1.0, "object.file: no file"),
        (str(tmp_path / "text.stl"), 1.0, "object.file: "),
        (str(tmp_path / "mug.step"), 1.0, "object.file: mug.step is no mesh file (legal: .stl, .obj, .glb)"),
    ):
        with pytest.raises(InputError) as caught:
            read(path, scale, "object")
        assert str(caught.value).startswith(line)


def test_nearest_points_are_exact_and_inside_is_inside() -> None:
    """Against the closed form for a turned box, at points near and far."""
    rng = np.random.default_rng(0)
    mesh = shapes.box(0.06, 0.04, 0.08)
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))
    mesh.apply_transform(turn)
    triangles = Triangles(np.array(mesh.vertices), np.array(mesh.faces), 0.003)
    points = rng.uniform(-0.08, 0.08, (3000, 3))
    excess = np.abs(points @ turn[:3, :3]) - [0.03, 0.02, 0.04]
    true = np.linalg.norm(np.maximum(excess, 0.0), axis=1) + np.minimum(excess.max(axis=1), 0.0)
    distance, foot = triangles.nearest(points)
    np.testing.assert_allclose(distance, np.abs(true), atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(points - foot, axis=1), distance, atol=1e-15)
    origin, spacing, shape = np.full(3, -0.06), 0.004, (31, 31, 31)
    nodes = origin + spacing * np.argwhere(np.ones(shape, bool))
    excess = (np.abs(nodes @ turn[:3, :3]) - [0.03, 0.02, 0.04]).max(axis=1)
    inside = triangles.inside(origin, spacing, shape).ravel()
    sure = np.abs(excess) > 1e-5
    np.testing.assert_array_equal(inside[sure], excess[sure] < 0.0)
