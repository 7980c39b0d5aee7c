"""Scratch arrays on the stack are arrays: of their shape, each its own, and their memory is given back."""

import numpy as np
from numba import njit

from regrasp.kernels.rotations import multiply
from regrasp.kernels.stack import stack


@njit
def fill(a: np.ndarray, first: float) -> None:
    """Numbers from `first` on, by a kernel that doesn't know where its array comes from."""
    for r in range(a.shape[0]):
        for c in range(a.shape[1]):
            a[r, c] = first
            first += 1.0


@njit
def layers(out: np.ndarray) -> tuple[int, int, int, int]:
    """Shapes, and what stands in two arrays and in a row of one of them after all were written."""
    cube, flat, row = stack((2, 3, 4)), stack((3, 4)), stack(4)
    fill(cube[0], 100.0)
    fill(cube[1], 200.0)
    fill(flat, 300.0)
    row[:] = flat[2]
    out[0], out[1], out[2], out[3, 0], out[3, 1], out[3, 2] = (
        cube[0],
        cube[1],
        flat,
        row,
        cube[1, 2],
        cube.reshape(24)[:4],
    )
    return cube.size, flat.shape[0], flat.shape[1], row.shape[0]


@njit
def power(R: np.ndarray, n: int, out: np.ndarray) -> None:
    """out = Rⁿ, two scratch arrays in every turn of the loop."""
    out[:] = np.eye(3)
    for _ in range(n):
        a, b = stack((3, 3)), stack((3, 3))
        a[:] = out
        multiply(R, a, b)
        out[:] = b


def test_arrays_have_their_shapes_and_do_not_overlap() -> None:
    out = np.zeros((4, 3, 4))
    assert layers(out) == (24, 3, 4, 4)
    numbers = np.arange(12.0).reshape(3, 4)
    np.testing.assert_array_equal(out[:3], [100 + numbers, 200 + numbers, 300 + numbers])
    np.testing.assert_array_equal(out[3], [300 + numbers[2], 200 + numbers[2], 100 + numbers[0]])


def test_an_array_in_a_loop_takes_its_memory_once() -> None:
    """A million turns, whose arrays together would be far larger than a stack."""
    angle, out = 2.0 * np.pi / 1000, np.empty((3, 3))
    R = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    power(R, 1_000_000, out)
    np.testing.assert_allclose(out, np.eye(3), atol=1e-8)
