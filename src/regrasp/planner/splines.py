"""The spline that a plan follows between the samples of an interval (`regrasp.plan`), as matrices: it is linear in them."""

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]

FINER = 5
"""Steps between two samples."""


@cache
def dense(m: int) -> tuple[Array, Array]:
    """(FINER · m + 1, m + 1) each: values of m + 1 samples' spline, FINER times as dense, and its rates per interval."""
    u = np.linspace(0.0, 1.0, FINER * m + 1)
    spline = CubicSpline(np.linspace(0.0, 1.0, m + 1), np.eye(m + 1))
    return spline(u), spline(u, 1)
