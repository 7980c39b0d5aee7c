"""Convex hulls of vertices as cores (`kernels.cores`)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.cores import COUNT, FIRST, ROW
from regrasp.kernels.features import TOUCH
from regrasp.kernels.patches import SLOTS

Array = NDArray[np.float64]

NUMBERS = SLOTS // 2  # of the corners that may bear force in one face


def hull_core(vertices: Array) -> Array:
    """The core of the hull of vertices (V, 3), the middle of whose bounding box is the origin: (4 + 4 V,)."""
    core = np.empty(FIRST + ROW * len(vertices))
    core[:COUNT] = np.max(np.abs(vertices), axis=0)
    core[COUNT] = len(vertices)
    rows = core[FIRST:].reshape(-1, ROW)
    rows[:, :3], rows[:, 3] = vertices, numbers(vertices)
    return core


def numbers(vertices: Array) -> Array:
    """A number, 0 … NUMBERS − 1, for each vertex (V, 3): no two of one face have the same; −1 where a face has too many.

    Of such a face those come first that come first among the vertices. The least used number is taken, so that a vertex
    is the only one of its number nearby.
    """
    from scipy.spatial import ConvexHull

    planes = np.unique(np.round(ConvexHull(vertices).equations, 6), axis=0)
    on = np.abs(vertices @ planes[:, :3].T + planes[:, 3]) <= TOUCH
    beside = on.astype(np.int64) @ on.T.astype(np.int64) > 0
    given, used = np.full(len(vertices), -1), np.zeros(NUMBERS, np.int64)
    for v in range(len(vertices)):
        free = np.setdiff1d(np.arange(NUMBERS), given[beside[v]])
        if len(free):
            given[v] = free[np.argmin(used[free])]
            used[given[v]] += 1
    return given.astype(float)


def widened(cores: Sequence[Array]) -> Array:
    """Cores of any length as the rows of one array."""
    rows = np.zeros((len(cores), max((len(core) for core in cores), default=3)))
    for row, core in zip(rows, cores, strict=True):
        row[: len(core)] = core
    return rows
