"""A mesh opened by a ball: its convex edges and corners become round, its flat faces stay where they are.

Opening is to take away all that no ball of the radius r inside the mesh covers. The *core* is where such balls may have their
centres, {x inside : distance to the mesh ≥ r}; the solid is all that is within r of the core. So the solid's signed
distance is that of the core less r, exactly, and its normals are continuous where it is convex.

Of its hollows those are filled which a ball of a tip's size cannot touch the bottom of, as far as that moves the surface by no
more than FILL: what no such ball outside the solid covers is filled where it is shallow. A scan is rough, so that a tip, which
rests on the rims of its pits, would otherwise have its contact nowhere.
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
FINE = 1 / 18  # of the ball: spacing in which the centres of balls that touch from outside are found
LOST = 0.25  # of the volume that opening may take
FILL = 8e-5
"""m that filling may move the surface: no more than a contact may be off. Deeper hollows stay, and no tip fits in them."""


@dataclass(frozen=True)
class Opening:
    """core: triangles of it; grid: signed distance to the solid, its shallow hollows filled; skin: the surface of that.

    error: largest distance of the skin from the solid not filled; lost: part of the mesh's volume that the solid lacks.
    """

    core: Triangles
    grid: Grid
    skin: Skin
    error: float
    lost: float


def opened(mesh: Triangles, rounding: float, spacing: float, ball: float) -> Opening:
    """The mesh opened by `rounding`, hollows narrower than a ball of the radius `ball` filled, m.

    Raises InputError where too little is left.
    """
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
    grid = filled(Grid(origin, spacing, np.where(erosion < 0.0, -away, away) - rounding), core, rounding, ball)
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


def filled(grid: Grid, core: Triangles, rounding: float, ball: float) -> Grid:
    """The grid of the solid within `rounding` of the core, after its shallow hollows are filled.

    A ball outside the solid has its centre at ψ ≥ 0, ψ the signed distance to all that is within ball of the solid. What such
    balls leave is {ψ ≤ −ball}, so that ψ + ball is its signed distance.
    """
    if ball == 0.0:
        return grid
    low, high = core.vertices.min(axis=0), core.vertices.max(axis=0)
    reach, h = rounding + ball, max(grid.spacing, FINE * ball)
    origin, shape = nodes(low - reach, high + reach, h)

    def height(x: Array) -> tuple[Array, Array]:
        distance, foot = core.nearest(x)
        return distance - reach, (x - foot) / np.maximum(distance, 1e-300)[:, None]

    away = core.distances(origin, h, shape, (reach - BAND * h, reach + BAND * h))
    inside = core.inside(origin, h, shape)
    vertices, faces = contour(origin, h, np.where(inside, -reach, away - reach), height)
    over, upwards = height(vertices)
    around = Triangles(vertices - over[:, None] * upwards, faces, spacing=h)
    near = np.abs(grid.values) < BAND * grid.spacing
    short = 0.25 * h**2 / ball  # by about so much a distance may be too large, see `Triangles.nearest`
    closed = ball + short - around.nearest(grid.origin + grid.spacing * np.argwhere(near))[0]
    values = grid.values.copy()
    values[near] = np.minimum(values[near], np.maximum(closed, values[near] - FILL))
    return Grid(grid.origin, grid.spacing, values)
