"""The spline that a plan's motion follows between its samples (`regrasp.plan`), as matrices that act on the samples.

The not-a-knot cubic spline through m + 1 equidistant samples is linear in them; its knots are 0 … m.
"""

import functools

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FINE = 5
"""Points per step at which a spline is looked at."""


@functools.cache
def values(m: int) -> Array:
    """(FINE m + 1, m + 1): the spline's values at FINE points per step; m ≥ 3."""
    u, y0, y1, s0, s1 = _steps(m)
    v = 1.0 - u
    return _frozen(v * v * (1.0 + 2.0 * u) * y0 + u * u * (1.0 + 2.0 * v) * y1 + u * v * (v * s0 - u * s1))


@functools.cache
def slopes(m: int) -> Array:
    """(FINE m + 1, m + 1): the spline's derivatives at FINE points per step, per step; m ≥ 3."""
    u, y0, y1, s0, s1 = _steps(m)
    v = 1.0 - u
    return _frozen(6.0 * u * v * (y1 - y0) + v * (v - 2.0 * u) * s0 + u * (u - 2.0 * v) * s1)


def _steps(m: int) -> tuple[Array, Array, Array, Array, Array]:
    """For each fine point: its place in its step, values at the step's ends and slopes there (rows on the samples)."""
    fine = np.arange(FINE * m + 1)
    step = np.minimum(fine // FINE, m - 1)
    y, s = np.eye(m + 1), _knot_slopes(m)
    return (fine / FINE - step)[:, None], y[step], y[step + 1], s[step], s[step + 1]


def _knot_slopes(m: int) -> Array:
    """(m + 1, m + 1): slopes at the knots, where the second derivative is continuous, and the third at knots 1 and m − 1."""
    if m < 3:
        raise ValueError(f"a cubic spline needs 4 samples, got {m + 1}")
    A, B = np.zeros((m + 1, m + 1)), np.zeros((m + 1, m + 1))
    for i in range(1, m):
        A[i, i - 1 : i + 2] = 1.0, 4.0, 1.0
        B[i, i - 1], B[i, i + 1] = -3.0, 3.0
    A[0, :2], B[0, :3] = (1.0, 2.0), (-2.5, 2.0, 0.5)
    A[m, m - 1 :], B[m, m - 2 :] = (2.0, 1.0), (-0.5, -2.0, 2.5)
    return np.asarray(np.linalg.solve(A, B), np.float64)


def _frozen(matrix: Array) -> Array:
    matrix.setflags(write=False)
    return matrix
