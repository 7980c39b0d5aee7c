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
    for _ in range(PROJECTIONS):
        value, gradient = spline(vertices)
        vertices = vertices - (value / np.maximum(np.sum(gradient**2, axis=1), SLOPE**2))[:, None] * gradient
    gradient = spline(vertices)[1]
    return Skin(vertices, gradient / np.linalg.norm(gradient, axis=1, keepdims=True), faces)


def nodes(low: Array, high: Array, spacing: float) -> tuple[Array, tuple[int, int, int]]:
    """Origin and shape of the grid about a box that leaves MARGIN free cells on all sides."""
    count = np.ceil((high - low) / spacing).astype(int) + 2 * MARGIN + 1
    origin = 0.5 * (low + high) - 0.5 * spacing * (count - 1)
    return origin, (int(count[0]), int(count[1]), int(count[2]))


def spacing_for(extents: Array, radius: float) -> float:
    """The spacing in m that resolves edges of this radius and the whole, as far as NODES nodes suffice."""
    wanted = min(radius / 2, float(np.max(extents)) / 64)
    return max(wanted, float(np.prod(extents) / NODES) ** (1 / 3))
