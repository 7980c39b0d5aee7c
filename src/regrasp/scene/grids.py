"""Signed distance to a solid, sampled on a grid of nodes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Grid:
    """Signed distances at the nodes origin + spacing (i, j, k), in the solid's frame O.

    Attributes:
        origin: (3,) node (0, 0, 0), m.
        spacing: distance between neighbouring nodes, m.
        values: (nx, ny, nz) signed distance to the surface, m, negative inside.
    """

    origin: NDArray[np.float64]
    spacing: float
    values: NDArray[np.float64]
