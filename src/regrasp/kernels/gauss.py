"""The inverse of the Gauss map: from an outward normal to the point of a surface that has it."""

import math

from regrasp.kernels.grids import Grids, grid_project
from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import Triple, Vector, minus, norm
from regrasp.kernels.surfaces import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE, Size

FACING = (
    1e-6  # a component of a unit normal smaller than this is zero: the surface is met with a face, an edge or a line
)
FAR = 10.0  # m, from which a mesh's closest point is sought
OPPOSED = 1e-10  # rad by which the normal of a mesh's point may be off
ITERATIONS = 20


@kernel
def _side(n: float, half: float) -> float:
    """Where a core of half extent `half` is furthest along a normal's component; its middle where all of it is."""
    if n > FACING:
        return half
    return -half if n < -FACING else 0.0


@kernel
def support_point(kind: int, size: Size, grids: Grids, n: Vector) -> Triple:
    """The point of a closed surface that is furthest along the unit vector n: n is the outward normal there.

    Where all of a face, an edge or a line has that normal, its middle. On a mesh that is not convex a point which is the
    furthest of those next to it. Not for PLANE.
    """
    if kind == SPHERE:
        return size[0] * n[0], size[0] * n[1], size[0] * n[2]
    if kind == ELLIPSOID:
        x, y, z = size[0] * n[0], size[1] * n[1], size[2] * n[2]
        length = math.sqrt(x * x + y * y + z * z)
        return size[0] * x / length, size[1] * y / length, size[2] * z / length
    if kind == CAPSULE:
        return size[0] * n[0], size[0] * n[1], size[0] * n[2] + _side(n[2], size[1])
    e = size[3]
    if kind == CYLINDER:
        across = math.sqrt(n[0] * n[0] + n[1] * n[1])
        wide = (size[0] - e) / across if across > FACING else 0.0
        return (e + wide) * n[0], (e + wide) * n[1], e * n[2] + _side(n[2], size[1] - e)
    if kind == BOX:
        return (
            e * n[0] + _side(n[0], size[0] - e),
            e * n[1] + _side(n[1], size[1] - e),
            e * n[2] + _side(n[2], size[2] - e),
        )
    return _mesh_point(grids, int(size[0]), n)


@kernel
def _mesh_point(grids: Grids, m: int, n: Vector) -> Triple:
    # The closest point to x + FAR n is further along n than x, and has the normal n when it is x itself.
    o, h, s = grids.origin, grids.spacing[m], grids.shape
    half = 0.5 * h
    x = (o[m, 0] + half * (s[m, 0] - 1), o[m, 1] + half * (s[m, 1] - 1), o[m, 2] + half * (s[m, 2] - 1))
    for _ in range(ITERATIONS):
        _, y, _ = grid_project(grids, m, (x[0] + FAR * n[0], x[1] + FAR * n[1], x[2] + FAR * n[2]))
        moved = norm(minus(y, x))
        x = y
        if moved <= OPPOSED * FAR:
            break
    return x
