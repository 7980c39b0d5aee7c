"""Signed distance to a solid, sampled on a grid of nodes, and the surface that a grid describes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from regrasp.scene.contours import contour

Array = NDArray[np.float64]

NODES = 3e6  # at most, about: 24 MB
MARGIN = 5  # cells beyond the solid: at the grid's faces a spline is less exact
STEP = 1e-3  # of the spacing, for differences
PROJECTIONS = 2  # Newton steps that put the skin's vertices onto the surface
BEND = 0.1  # rad by which the normal may turn over a triangle of the skin, …
SPLITS = 3  # … unless it has been cut so often
SLOPE = 0.3  # of the distance, at least: it is smaller on the axes of symmetry only


@dataclass(frozen=True)
class Grid:
    """Signed distances at the nodes origin + spacing (i, j, k), in the solid's frame O.

    Attributes:
        origin: (3,) node (0, 0, 0), m.
        spacing: distance between neighbouring nodes, m.
        values: (nx, ny, nz) signed distance to the surface, m, negative inside.
    """

    origin: Array
    spacing: float
    values: Array


@dataclass(frozen=True)
class Spline:
    """The tricubic spline through a grid's values; its zeros are the solid's surface."""

    grid: Grid

    @cached_property
    def _coefficients(self) -> Array:
        from scipy import ndimage

        return np.asarray(ndimage.spline_filter(self.grid.values, order=3, mode="mirror"))

    def values(self, points: Array) -> Array:
        """The spline at points (N, 3), m."""
        from scipy import ndimage

        nodes = ((points - self.grid.origin) / self.grid.spacing).T
        return np.asarray(
            ndimage.map_coordinates(self._coefficients, nodes, order=3, mode="mirror", prefilter=False), dtype=float
        )

    def __call__(self, points: Array) -> tuple[Array, Array]:
        """Values (N,) and gradients (N, 3), by central differences."""
        step = STEP * self.grid.spacing
        sides = [(self.values(points + step * e) - self.values(points - step * e)) / (2 * step) for e in np.eye(3)]
        return self.values(points), np.stack(sides, axis=1)


@dataclass(frozen=True)
class Skin:
    """A solid's surface as triangles: vertices (V, 3) on it, m, its unit normals there (V, 3), faces (F, 3)."""

    vertices: Array
    normals: Array
    faces: NDArray[np.int64]


def skin_of(grid: Grid) -> Skin:
    """The triangulated zeros of the grid's spline."""
    spline = Spline(grid)
    vertices, faces = contour(grid.origin, grid.spacing, grid.values, spline)
    skin = _on_zeros(spline, vertices, faces)
    for _ in range(SPLITS):
        vertices, faces = _split(skin)
        if len(faces) == len(skin.faces):
            break
        skin = _on_zeros(spline, vertices, faces)
    return skin


def _on_zeros(spline: Spline, vertices: Array, faces: NDArray[np.int64]) -> Skin:
    """The vertices put onto the spline's zeros."""
    for _ in range(PROJECTIONS):
        value, gradient = spline(vertices)
        vertices = vertices - (value / np.maximum(np.sum(gradient**2, axis=1), SLOPE**2))[:, None] * gradient
    gradient = spline(vertices)[1]
    return Skin(vertices, gradient / np.linalg.norm(gradient, axis=1, keepdims=True), faces)


def _split(skin: Skin) -> tuple[Array, NDArray[np.int64]]:
    """The skin with every triangle over which the normal turns by more than BEND cut into four.

    A side that only one of its two triangles has cut is a straight line to the other: a crack less wide than a patch bends.
    """
    normals = skin.normals[skin.faces]
    bends = np.min(np.sum(normals * np.roll(normals, 1, axis=1), axis=2), axis=1) < np.cos(BEND)
    cut, kept = skin.faces[bends], skin.faces[~bends]
    sides = np.sort(np.concatenate([cut[:, [0, 1]], cut[:, [1, 2]], cut[:, [2, 0]]]), axis=1)
    unique, number = np.unique(sides, axis=0, return_inverse=True)
    middles = skin.vertices[unique].mean(axis=1)
    m = (len(skin.vertices) + number.reshape(3, -1)).T
    four = [
        np.stack([cut[:, 0], m[:, 0], m[:, 2]], axis=1), np.stack([m[:, 0], cut[:, 1], m[:, 1]], axis=1),
        np.stack([m[:, 2], m[:, 1], cut[:, 2]], axis=1), m,
    ]  # fmt: skip
    return np.vstack([skin.vertices, middles]), np.concatenate([kept, *four])


def nodes(low: Array, high: Array, spacing: float) -> tuple[Array, tuple[int, int, int]]:
    """Origin and shape of the grid about a box that leaves MARGIN free cells on all sides."""
    count = np.ceil((high - low) / spacing).astype(int) + 2 * MARGIN + 1
    origin = 0.5 * (low + high) - 0.5 * spacing * (count - 1)
    return origin, (int(count[0]), int(count[1]), int(count[2]))


def spacing_for(extents: Array, radius: float) -> float:
    """The spacing in m that resolves edges of this radius and the whole, as far as NODES nodes suffice."""
    wanted = min(radius / 2, float(np.max(extents)) / 64)
    return max(wanted, float(np.prod(extents) / NODES) ** (1 / 3))
