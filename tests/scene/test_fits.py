"""Primitives about convex hulls: they hold them, they are tight, and they turn with them."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp.scene import fits
from regrasp.scene.fits import Primitive


def depth(primitive: Primitive, points: np.ndarray) -> np.ndarray:
    """Signed distance of points from a primitive's surface (of a box and cylinder a bound of it), negative inside."""
    local = (points - primitive.p) @ primitive.R
    a, b, _ = primitive.size
    if primitive.kind == "box":
        return np.max(np.abs(local) - primitive.size, axis=1)
    if primitive.kind == "cylinder":
        return np.maximum(np.hypot(local[:, 0], local[:, 1]) - a, np.abs(local[:, 2]) - b)
    along = np.clip(local[:, 2], -b, b) if primitive.kind == "capsule" else np.zeros(len(local))
    return np.linalg.norm(local - along[:, None] * [0.0, 0.0, 1.0], axis=1) - a


def ball(rng: np.random.Generator, count: int) -> np.ndarray:
    points = rng.normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


SHAPES = {
    "ball": lambda rng: 0.02 * ball(rng, 300),
    "rod": lambda rng: 0.01 * ball(rng, 300) + 0.05 * np.sign(rng.normal(size=(300, 1))) * [0, 0, 1],
    "bar": lambda rng: np.sign(rng.normal(size=(200, 3))) * [0.01, 0.02, 0.06],
    "drum": lambda rng: np.concatenate([
        np.stack([0.03 * np.cos(t), 0.03 * np.sin(t), np.full(40, z)], axis=1)
        for t in [np.linspace(0, 2 * np.pi, 40, endpoint=False)] for z in (-0.01, 0.01)
    ]),
    "cone": lambda rng: np.concatenate([[[0, 0, 0.1]], 0.04 * (ball(rng, 200) * [1, 1, 0])]),
    "cloud": lambda rng: rng.normal(size=(60, 3)) * [0.01, 0.02, 0.03],
    "plate": lambda rng: rng.uniform(-0.05, 0.05, size=(40, 3)) * [1, 1, 0],
}  # fmt: skip


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("seed", range(3))
def test_the_hull_lies_inside(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, shift = Rotation.random(random_state=seed), rng.normal(size=3)
    points = turn.apply(SHAPES[name](rng)) + shift
    found = fits.enclosing(points)
    corners = points[rng.integers(0, len(points), (2000, 4))]
    inside = np.einsum("ij,ijk->ik", rng.dirichlet(np.ones(4), 2000), corners)
    for sample in (points, inside):
        nearest = np.min([depth(each, sample) for each in found], axis=0)
        assert nearest.max() < 1e-9
    for each in found:
        np.testing.assert_allclose(each.R @ each.R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(each.R) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("name", "kind", "volume"),
    [
        ("ball", None, 4 / 3 * np.pi * 0.02**3),
        ("rod", "capsule", np.pi * 0.01**2 * (0.1 + 4 / 3 * 0.01)),
        ("bar", "box", 8 * 0.01 * 0.02 * 0.06),
        ("drum", "cylinder", np.pi * 0.03**2 * 0.02),
    ],
)
def test_what_is_a_primitive_is_found_to_be_it(name: str, kind: str | None, volume: float) -> None:
    """Up to the corners that its samples leave out."""
    turn = Rotation.random(random_state=5)
    (found,) = fits.enclosing(turn.apply(SHAPES[name](np.random.default_rng(0))))
    assert kind in (None, found.kind)
    assert found.volume == pytest.approx(volume, rel=0.1)


def test_a_long_cone_takes_several_and_less_volume_for_it() -> None:
    points = SHAPES["cone"](np.random.default_rng(0))
    found = fits.enclosing(points)
    assert 1 < len(found) <= fits.PIECES
    assert sum(each.volume for each in found) > ConvexHull(points).volume


def test_excess_is_how_far_a_sphere_stands_before_the_faces_of_its_cube() -> None:
    cube = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    about = Primitive("sphere", np.array([np.sqrt(3), 0, 0]), np.eye(3), np.zeros(3))
    assert fits.excess((about,), cube) == pytest.approx(np.sqrt(3) - 1, rel=0.01)
    assert fits.excess(fits.enclosing(cube), cube) == pytest.approx(0.0, abs=1e-12)


def test_a_slab_is_the_part_of_the_hull_between_two_heights() -> None:
    rng = np.random.default_rng(2)
    corners = fits.hull(rng.normal(size=(100, 3)))
    axis = np.array([0.6, 0.0, 0.8])
    slab = fits.between(corners, axis, -0.3, 0.9)
    assert (slab @ axis).min() == pytest.approx(-0.3)
    assert (slab @ axis).max() == pytest.approx(0.9)
    planes, whole = ConvexHull(slab).equations, ConvexHull(corners).equations
    points = rng.normal(size=(5000, 3))
    height = points @ axis
    expected = np.all(points @ whole[:, :3].T + whole[:, 3] <= 0, axis=1) & (height >= -0.3) & (height <= 0.9)
    np.testing.assert_array_equal(np.all(points @ planes[:, :3].T + planes[:, 3] <= 1e-12, axis=1), expected)


@pytest.mark.parametrize("seed", range(4))
def test_the_round_end_of_a_finger_is_its_sphere(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, shift = Rotation.random(random_state=seed), rng.normal(size=3)
    cap = ball(rng, 3000)
    cap[:, 2] = np.abs(cap[:, 2])
    foot = np.stack([1.2 * np.cos(t := rng.uniform(0, 7, 50)), 1.2 * np.sin(t), np.full(50, -4.0)], axis=1)
    points = turn.apply(0.01 * np.concatenate([cap, foot])) + shift
    centre, radius, error = fits.end_sphere(points, turn.apply([0, 0, 1.0]))
    np.testing.assert_allclose(centre, shift, atol=1e-4)
    assert radius == pytest.approx(0.01, rel=0.01)
    assert error < 2e-4


def test_the_sphere_of_a_blunt_end_is_no_wider_than_the_finger_and_says_how_far_off_it_is() -> None:
    points = np.sign(np.random.default_rng(0).normal(size=(100, 3))) * [0.008, 0.008, 0.03]
    centre, radius, error = fits.end_sphere(points, np.array([0.0, 0.0, 1.0]))
    assert radius <= 0.008 * np.sqrt(2) * 1.01
    assert centre[2] + radius == pytest.approx(0.03)
    assert error > 0.001
