"""Rotations against scipy, where conversions lose digits: no turn, tiny ones, half turns, every largest component."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp.planner.turns import angle, from_quaternion, from_rotvec, quaternion, rotvec

AXES = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 1, 1], [3, -1, 2], [1e-9, 1, -1e-9]])
UNIT = AXES / np.linalg.norm(AXES, axis=1, keepdims=True)
ANGLES = np.array([0.0, 1e-300, 1e-12, 1e-8, 1e-4, 0.3, 1.5, 3.0, np.pi - 1e-9])
VECTORS = ANGLES[:, None, None] * UNIT


def test_matrix_of_a_rotation_vector_is_scipys() -> None:
    theirs = Rotation.from_rotvec(VECTORS.reshape(-1, 3)).as_matrix().reshape(*VECTORS.shape[:2], 3, 3)
    np.testing.assert_allclose(from_rotvec(VECTORS), theirs, atol=3e-16)


def test_rotation_vector_comes_back_from_its_matrix() -> None:
    """To round-off, relative to the vector; within 1e-9 rad of half a turn the axis may point either way."""
    R = from_rotvec(VECTORS)
    np.testing.assert_allclose(rotvec(R), VECTORS, rtol=1e-14, atol=4e-16)
    np.testing.assert_allclose(angle(R), np.broadcast_to(ANGLES[:, None], R.shape[:2]), rtol=1e-14, atol=4e-16)


def test_half_turns_have_a_rotation_vector() -> None:
    R = 2.0 * UNIT[:, :, None] * UNIT[:, None, :] - np.eye(3)
    np.testing.assert_allclose(angle(R), np.pi, rtol=1e-15)
    np.testing.assert_allclose(from_rotvec(rotvec(R)), R, atol=2e-15)


@pytest.mark.parametrize("seed", range(3))
def test_quaternions_are_scipys(seed: int) -> None:
    """Of random rotations and of those whose quaternion has one component only, up to sign."""
    theirs = Rotation.random(500, rng=np.random.default_rng(seed))
    q = np.vstack([theirs.as_quat(scalar_first=True), np.eye(4)])
    R = np.concatenate(
        [theirs.as_matrix(), np.eye(3)[None], 2.0 * np.eye(3)[:, :, None] * np.eye(3)[:, None] - np.eye(3)]
    )
    ours = quaternion(R)
    np.testing.assert_allclose(np.abs(np.sum(ours * q, axis=1)), 1.0, atol=1e-15)
    np.testing.assert_allclose(ours * np.sign(np.sum(ours * q, axis=1))[:, None], q, atol=1e-15)
    np.testing.assert_allclose(from_quaternion(ours), R, atol=2e-15)
