"""Kernels without the memory manager: slices are assigned as numpy assigns them, and nothing can be allocated."""

import numpy as np
import pytest
from numba import njit
from numba.core.errors import NumbaError

from regrasp.kernels.native import kernel
from regrasp.kernels.stack import stack


def assign(rows: np.ndarray, block: np.ndarray, numbers: np.ndarray, cube: np.ndarray, square: np.ndarray) -> None:
    """Assignments of every form that kernels use."""
    cube[0] = square
    cube[1, :, :] = block[2, :3, :3]
    cube[2, 1:, 0] = rows[:2]
    cube[-1, 0] = square[:, 1]
    rows[2:] = square[2, : len(rows) - 2]
    numbers[1:3], numbers[3:] = rows[:2], 7
    square[:] = 0.5


def arguments() -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(0)
    return rng.random(5), rng.random((3, 4, 5)), np.arange(6), rng.random((3, 3, 3)), rng.random((3, 3))


def test_slices_are_assigned_as_numpy_does() -> None:
    wanted, got = arguments(), arguments()
    assign(*wanted)
    kernel(assign)(*got)
    for a, b in zip(wanted, got, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_kernel_allocates_nothing() -> None:
    def makes(n: int) -> float:
        return np.zeros(n)[0]

    with pytest.raises(NumbaError, match="zeros"):
        kernel(makes)(3)


@kernel
def triangle(n: int, out: np.ndarray) -> None:
    """Scratch arrays of lengths that are known at run time only, mixed with such that are not."""
    flat, block = stack(n), stack((2, n, 3))
    for a in range(n):
        flat[a] = a
        for b in range(3):
            block[0, a, b], block[1, a, b] = 10 * a + b, -1.0
    for a in range(n):
        out[a] = flat[a] + block[0, a, 2] + block[1, a, 1] + block.shape[0] * block.shape[2] * len(flat)


@njit
def triangles(n: int, times: int, out: np.ndarray) -> None:
    """Many calls of it, whose arrays together would be larger than a stack."""
    for _ in range(times):
        triangle(n, out)


def test_scratch_arrays_of_any_length_are_given_back() -> None:
    out = np.zeros(50)
    triangles(50, 100_000, out)
    np.testing.assert_array_equal(out, 11.0 * np.arange(50) + 1.0 + 300.0)
