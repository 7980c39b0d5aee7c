"""The surface on which a function on a grid is zero, as triangles that keep sharp edges.

Dual contouring (Ju, Losasso, Schaefer & Warren 2002): one vertex in every cell that the surface crosses, where the tangent
planes at the crossings of the cell's edges meet best; a quadrilateral about every edge that is crossed. Planes, and edges
and corners in which planes meet, come out exact, where marching cubes would cut them off.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Function = Callable[[Array], tuple[Array, Array]]

FLAT = 0.01  # tangent planes determine a vertex along the axes of Σ n nᵀ whose eigenvalue is at least this part of the largest
BEYOND = 0.5  # of a cell that its vertex may lie outside of it, where the planes meet there
STEPS = 3  # of regula falsi for a crossing
# The cells about an edge, in order round it, as steps along the two other axes.
AROUND = ((-1, -1), (0, -1), (0, 0), (-1, 0))


def contour(origin: Array, spacing: float, values: Array, function: Function) -> tuple[Array, Ints]:
    """Vertices (V, 3) and faces (F, 3), anticlockwise from the side where the function is positive.

    values (nx, ny, nz): the function at the nodes origin + spacing (i, j, k), positive on the grid's faces; function: points
    (N, 3) → values (N,), gradients (N, 3).
    """
    inside = values < 0.0
    cells_of, points, normals, quads = [], [], [], []
    shape = np.array(values.shape)
    for axis in range(3):
        lower = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
        upper = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        node = np.argwhere(inside[lower] != inside[upper])
        step = np.eye(3, dtype=np.int64)[axis]
        start, end = values[tuple(node.T)], values[tuple((node + step).T)]
        crossing, gradient = _crossings(origin + spacing * node, spacing * step, start, end, function)
        others = [a for a in range(3) if a != axis] if axis != 1 else [2, 0]
        about = np.repeat(node[:, None], 4, axis=1)
        for corner, steps in enumerate(AROUND):
            for a, move in zip(others, steps, strict=True):
                about[:, corner, a] += move
        cell = np.ravel_multi_index(tuple(about.reshape(-1, 3).T), tuple(shape)).reshape(-1, 4)
        quads.append(np.where((start < 0.0)[:, None], cell, cell[:, ::-1]))
        cells_of.append(cell.ravel())
        points.append(np.repeat(crossing, 4, axis=0))
        normals.append(np.repeat(gradient, 4, axis=0))
    cells, number = np.unique(np.concatenate(cells_of), return_inverse=True)
    low = origin + spacing * np.stack(np.unravel_index(cells, tuple(shape)), axis=1)
    vertices = _vertices(number, np.concatenate(points), np.concatenate(normals), low, spacing)
    corners = number[: 4 * sum(map(len, quads))].reshape(-1, 4)
    flipped = np.concatenate(quads) != np.concatenate(cells_of).reshape(-1, 4)
    corners = np.where(flipped.any(axis=1)[:, None], corners[:, ::-1], corners)
    return vertices, _halved(vertices, corners)


def _crossings(start: Array, step: Array, low: Array, high: Array, function: Function) -> tuple[Array, Array]:
    """Where the function is zero on the segments from `start` by `step`, and its unit gradient there."""
    a, b = np.zeros(len(start)), np.ones(len(start))
    t, gradient = a, np.zeros_like(start)
    for _ in range(STEPS):
        t = a + (b - a) * low / (low - high)
        value, gradient = function(start + t[:, None] * step)
        same = (value < 0.0) == (low < 0.0)
        a, low = np.where(same, t, a), np.where(same, value, low)
        b, high = np.where(same, b, t), np.where(same, high, value)
        low, high = np.where(low == 0.0, 1e-300, low), np.where(high == 0.0, -1e-300 * np.sign(low), high)
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    return start + t[:, None] * step, gradient / np.maximum(length, 1e-300)


def _vertices(number: Ints, points: Array, normals: Array, low: Array, spacing: float) -> Array:
    """The point of every cell nearest to the tangent planes of its crossings, next to their mean where these leave it open."""
    count = len(low)

    def summed(rows: Array) -> Array:
        flat = rows.reshape(len(rows), -1)
        sums = np.stack([np.bincount(number, column, minlength=count) for column in flat.T], axis=1)
        return np.asarray(sums, float).reshape(count, *rows.shape[1:])

    mean = summed(points) / np.bincount(number, minlength=count)[:, None]
    A = summed(normals[:, :, None] * normals[:, None])
    b = summed(normals * np.sum(normals * (points - mean[number]), axis=1, keepdims=True))
    sizes, axes = np.linalg.eigh(A)
    kept = sizes >= FLAT * sizes[:, -1:]
    share = np.einsum("cxk,cx->ck", axes, b) * kept / np.where(kept, sizes, 1.0)
    return np.clip(mean + np.einsum("cxk,ck->cx", axes, share), low - BEYOND * spacing, low + (1.0 + BEYOND) * spacing)


def _halved(vertices: Array, quads: Ints) -> Ints:
    """Two triangles for every quadrilateral, along the diagonal over which they fold less."""
    a, b, c, d = (vertices[quads[:, k]] for k in range(4))

    def fold(*corners: Array) -> Array:
        p, q, r, s = corners  # folded along p r
        m, n = np.cross(q - p, r - p), np.cross(r - p, s - p)
        lengths = np.linalg.norm(m, axis=1) * np.linalg.norm(n, axis=1)
        return np.where(lengths > 0.0, np.sum(m * n, axis=1) / np.maximum(lengths, 1e-300), -2.0)

    first = fold(a, b, c, d) >= fold(b, c, d, a)
    return np.concatenate([
        quads[first][:, [0, 1, 2]], quads[first][:, [0, 2, 3]], quads[~first][:, [1, 2, 3]], quads[~first][:, [1, 3, 0]],
    ])  # fmt: skip
