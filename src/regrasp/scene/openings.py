"""A mesh opened by a ball: its convex edges and corners become round, its flat faces stay where they are.

Opening is to take away all that no ball of the radius r inside the mesh covers. The *core* is where such balls may have their
centres, {x inside : distance to the mesh ≥ r}; the solid is all that is within r of the core. So the solid's signed
distance is that of the core less r, exactly, and its normals are continuous where it is convex.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.errors import InputError
from regrasp.scene.contours import contour
from regrasp.scene.grids import Grid, Skin, nodes, skin_of
from regrasp.scene.triangles import Triangles, moments

Array = NDArray[np.float64]

BAND = 2.5  # spacings on either side of a surface in which distances are exact
COARSEST = 0.75  # of the rounding: a grid of a larger spacing cannot find the core
LOST = 0.25  # of the volume that opening may take


@dataclass(frozen=True)
class Opening:
    """core: triangles of it; grid: signed distance to the solid; skin: the surface that the grid describes.

    error: largest distance of the skin from the solid; lost: part of the mesh's volume that the solid lacks.
    """

    core: Triangles
    grid: Grid
    skin: Skin
    error: float
    lost: float


def opened(mesh: Triangles, rounding: float, spacing: float) -> Opening:
    """The mesh opened by `rounding`, m. Raises InputError where too little is left."""
    if spacing > COARSEST * rounding:
        least = spacing / COARSEST
        raise InputError(
            "object.rounding",
            f"{rounding:g} m is too fine for the object's size",
            f"at least {least:.2g} m, or a resolution",
        )
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    origin, shape = nodes(low, high, spacing)
    band = rounding - BAND * spacing, rounding + BAND * spacing
    inside = mesh.inside(origin, spacing, shape)
    away = mesh.distances(origin, spacing, shape, band)

    def depth(x: Array) -> tuple[Array, Array]:
        distance, foot = mesh.nearest(x)
        return rounding - distance, (foot - x) / np.maximum(distance, 1e-300)[:, None]

    erosion = np.where(inside, rounding - away, rounding + away)
    if not np.any(erosion < 0.0):
        raise InputError("object.rounding", f"no part of the mesh is {2 * rounding:g} m thick", "a smaller rounding")
    core = Triangles(*contour(origin, spacing, erosion, depth), spacing=spacing)
    away = core.distances(origin, spacing, shape, band)
    grid = Grid(origin, spacing, np.where(erosion < 0.0, -away, away) - rounding)
    skin = skin_of(grid)
    error = float(np.max(np.abs(core.nearest(skin.vertices)[0] - rounding)))
    lost = 1.0 - moments(skin.vertices, skin.faces)[0] / moments(mesh.vertices, mesh.faces)[0]
    if lost > LOST:
        raise InputError(
            "object.rounding",
            f"rounded by {rounding:g} m the mesh loses {100 * lost:.0f} % of its volume: walls thinner than {2 * rounding:g} m",
            "less than half the thickness of the thinnest wall",
        )
    return Opening(core, grid, skin, error, lost)
