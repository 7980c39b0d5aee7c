"""The matrices of the not-a-knot spline against scipy's spline, and what such a spline reproduces exactly."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from regrasp.planner.splines import FINE, slopes, values


@pytest.mark.parametrize("m", [3, 4, 5, 12, 40])
def test_matrices_are_scipys_spline(m: int) -> None:
    """Values to round-off, derivatives to round-off of the matrix entries, for rough samples too."""
    y = np.random.default_rng(m).normal(size=(m + 1, 7))
    spline, fine = CubicSpline(np.arange(m + 1), y), np.linspace(0.0, m, FINE * m + 1)
    np.testing.assert_allclose(values(m) @ y, spline(fine), atol=1e-13)
    np.testing.assert_allclose(slopes(m) @ y, spline(fine, 1), atol=1e-13)


@pytest.mark.parametrize("degree", range(4))
def test_cubics_are_reproduced(degree: int) -> None:
    m = 6
    x, fine = np.arange(m + 1.0), np.linspace(0.0, m, FINE * m + 1)
    np.testing.assert_allclose(values(m) @ x**degree, fine**degree, atol=1e-12)
    np.testing.assert_allclose(slopes(m) @ x**degree, degree * fine ** max(degree - 1, 0), atol=1e-12)


def test_samples_are_kept_to_the_last_bit() -> None:
    np.testing.assert_array_equal(values(8)[::FINE], np.eye(9))


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(ValueError, match="4 samples"):
        values(2)
