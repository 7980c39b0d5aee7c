"""Rotations of many frames at once: matrices, rotation vectors, quaternions.

The same as scipy's `Rotation`, whose import alone takes longer than all that planning does with rotations.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def quaternion(R: Array) -> Array:
    """Unit quaternions w x y z (…, 4) of rotation matrices (…, 3, 3); the component of largest size is positive."""
    x, y, z = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    # Four times q qᵀ, with w last; its row with the largest diagonal entry is q without loss of digits (Shepperd 1978).
    square = np.empty((*R.shape[:-2], 4, 4))
    square[..., [0, 1, 2, 3], [0, 1, 2, 3]] = 1.0 + np.stack([x - y - z, y - x - z, z - x - y, x + y + z], axis=-1)
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        square[..., a, b] = square[..., b, a] = R[..., a, b] + R[..., b, a]
        square[..., 3, c] = square[..., c, 3] = R[..., b, a] - R[..., a, b]
    largest = np.argmax(np.diagonal(square, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(square, largest[..., None, None], axis=-2)[..., 0, :]
    return np.roll(q / np.linalg.norm(q, axis=-1, keepdims=True), 1, axis=-1)


def angle(R: Array) -> Array:
    """Angles (…) in [0, π] of rotation matrices (…, 3, 3)."""
    q = quaternion(R)
    return 2.0 * np.arctan2(np.linalg.norm(q[..., 1:], axis=-1), np.abs(q[..., 0]))


def rotvec(R: Array) -> Array:
    """Rotation vectors (…, 3), axis times angle in [0, π], of rotation matrices (…, 3, 3)."""
    q = quaternion(R)
    q = np.where(q[..., :1] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    half = np.arctan2(sine, q[..., :1])
    return q[..., 1:] * 2.0 / np.sinc(half / np.pi)


def from_rotvec(v: Array) -> Array:
    """Rotation matrices (…, 3, 3) of rotation vectors v (…, 3) (Rodrigues' formula)."""
    theta = np.linalg.norm(v, axis=-1)[..., None, None]
    K = cross_matrix(v)
    return np.eye(3) + np.sinc(theta / np.pi) * K + 0.5 * np.sinc(0.5 * theta / np.pi) ** 2 * (K @ K)


def from_quaternion(q: Array) -> Array:
    """Rotation matrices (…, 3, 3) of unit quaternions w x y z (…, 4)."""
    K = cross_matrix(q[..., 1:])
    return np.eye(3) + 2.0 * (q[..., 0, None, None] * K + K @ K)


def cross_matrix(v: Array) -> Array:
    """(…, 3, 3): K with K a = v × a."""
    K = np.zeros((*v.shape[:-1], 3, 3))
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        K[..., b, a], K[..., a, b] = v[..., c], -v[..., c]
    return K
