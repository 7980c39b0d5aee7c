"""Primitives fitted to convex hulls: the tightest that encloses one, and the sphere that its outer end is."""

import itertools
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Kind = Literal["sphere", "capsule", "cylinder", "box"]
KINDS: tuple[Kind, ...] = ("sphere", "capsule", "cylinder", "box")

FACES = 32
"""Faces of a hull whose directions are tried for a box, the largest ones."""
PIECES = 4
"""Primitives that one hull is enclosed by at most."""
GAIN = 0.8
"""A further primitive, or one with edges instead of one without, has to bring the enclosed volume down to this part."""
ROUNDS = 200
"""Steps towards the farthest point that find a smallest ball; its radius is then exact to 1/√ROUNDS at worst."""
END = math.cos(math.radians(50.0))
"""The outer end of a hull is what faces within 50° of outwards."""


@dataclass(frozen=True)
class Primitive:
    """A convex primitive: pose (R (3, 3), p (3,)) in the frame of what it was fitted to.

    size (3,), m: sphere radius; capsule radius and half length along z; cylinder radius and half height along z; box half
    extents; the rest zero.
    """

    kind: Kind
    size: Array
    R: Array
    p: Array

    @property
    def volume(self) -> float:
        """m³."""
        a, b, c = (float(x) for x in self.size)
        if self.kind == "box":
            return 8 * a * b * c
        if self.kind == "cylinder":
            return 2 * math.pi * a**2 * b
        return 4 / 3 * math.pi * a**3 + (2 * math.pi * a**2 * b if self.kind == "capsule" else 0.0)


def enclosing(points: Array) -> tuple[Primitive, ...]:
    """Primitives that together hold the convex hull of points (n, 3): as few as make sense, each as tight as may be.

    The hull is cut into slabs across its longest axis where that takes a fifth off the volume.
    """
    corners, least = hull(points), volume(points)
    axis = _axes(corners)[:, 0]
    best: tuple[Primitive, ...] = (_tightest(corners),)
    for count in range(2, PIECES + 1):
        if least > GAIN * sum(piece.volume for piece in best):
            break
        heights = corners @ axis
        cuts = np.linspace(heights.min(), heights.max(), count + 1)
        slabs = [between(corners, axis, low, high) for low, high in itertools.pairwise(cuts)]
        pieces = tuple(_tightest(slab) for slab in slabs)
        if sum(piece.volume for piece in pieces) < GAIN * sum(piece.volume for piece in best):
            best = pieces
    return best


def excess(primitives: tuple[Primitive, ...], points: Array) -> float:
    """How far primitives stick out of the convex hull of points (n, 3) they enclose, m: at most, of points sampled."""
    from scipy.spatial import ConvexHull

    planes = ConvexHull(points).equations
    return max(float((planes[:, :3] @ surface(each).T + planes[:, 3:]).max()) for each in primitives)


def surface(primitive: Primitive) -> Array:
    """Points on a primitive's surface, (n, 3), where it may stick out: corners, a rim, 300 points of a round one."""
    local: Array
    if primitive.kind == "box":
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        local = signs * primitive.size
    elif primitive.kind == "cylinder":
        radius, half, _ = primitive.size
        around = 2 * np.pi * np.arange(64) / 64
        rim = np.stack([radius * np.cos(around), radius * np.sin(around), np.full(64, half)], axis=1)
        local = np.concatenate([rim, rim * np.array([1.0, 1.0, -1.0])])
    else:
        i = np.arange(300) + 0.5
        z, angle = 1 - 2 * i / 300, np.pi * (1 + math.sqrt(5)) * i
        ball = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=1)
        local = primitive.size[0] * ball + np.sign(z)[:, None] * [0.0, 0.0, primitive.size[1]]
    return local @ primitive.R.T + primitive.p


def hull(points: Array) -> Array:
    """Corners of the convex hull of points (n, 3), (m, 3); the points themselves where they are flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points


def volume(points: Array) -> float:
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(points).volume)
    except QhullError:
        return 0.0


def between(corners: Array, axis: Array, low: float, high: float) -> Array:
    """Corners of the part of a hull with corners (n, 3) that lies between two heights along an axis (3,)."""
    from scipy.spatial import ConvexHull, QhullError

    heights = corners @ axis
    kept = [corners[(heights >= low) & (heights <= high)]]
    try:
        triangles = ConvexHull(corners).simplices
        i, j = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).T
    except QhullError:
        i, j = np.triu_indices(len(corners), 1)
    for cut in (low, high):
        # The edges that cross the cut span its section.
        cross = (heights[i] - cut) * (heights[j] - cut) < 0.0
        u = (cut - heights[i[cross]]) / (heights[j[cross]] - heights[i[cross]])
        kept.append(corners[i[cross]] + u[:, None] * (corners[j[cross]] - corners[i[cross]]))
    return hull(np.concatenate(kept))


def end_sphere(points: Array, outward: Array) -> tuple[Array, float, float]:
    """Centre (3,), radius and error of the sphere that a hull's outer end is, m.

    points (n, 3); outward (3,): unit direction in which the end lies. The sphere fits the surface that faces outwards
    by least squares; it is no wider than the hull and touches the hull's outermost plane from within. The error is the
    largest distance of that surface from the sphere.
    """
    from scipy.spatial import ConvexHull

    shape = ConvexHull(points)
    facing = shape.equations[:, :3] @ outward > END
    corners = points[shape.simplices[facing]]
    sampled = np.concatenate([corners.reshape(-1, 3), corners.mean(axis=1)])
    system = np.concatenate([2 * sampled, np.ones((len(sampled), 1))], axis=1)
    solution = np.linalg.lstsq(system, np.sum(sampled**2, axis=1), rcond=None)[0]
    centre = solution[:3]
    radius = math.sqrt(max(float(solution[3] + centre @ centre), 0.0))
    across = _complement(outward)
    flat = points @ across.T
    width = _ball(flat)[1]
    radius = min(radius, width)
    centre = centre + (float((points @ outward).max()) - radius - float(centre @ outward)) * outward
    return centre, radius, float(np.abs(np.linalg.norm(sampled - centre, axis=1) - radius).max())


def _tightest(corners: Array) -> Primitive:
    """The primitive of least volume that encloses corners (n, 3); one with edges only where it is much smaller.

    Distances of spheres and capsules have closed forms.
    """
    centre, radius = _ball(corners)
    box = _box(corners)
    directions = np.concatenate([_axes(corners).T, box.R.T])
    smooth = [Primitive("sphere", np.array([radius, 0.0, 0.0]), np.eye(3), centre)]
    smooth += [_capsule(corners, direction) for direction in directions]
    edged = [box, *(_cylinder(corners, direction) for direction in directions)]
    best, other = (min(group, key=lambda each: each.volume) for group in (smooth, edged))
    return other if other.volume < GAIN * best.volume else best


def _axes(corners: Array) -> Array:
    """Principal axes of corners (n, 3) as columns, the longest first."""
    _, _, rows = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=True)
    return np.asarray(rows.T)


def _ball(points: Array) -> tuple[Array, float]:
    """Centre and radius of a ball about points (n, d), nearly the smallest: steps towards the farthest (Bădoiu & Clarkson)."""
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    for i in range(1, ROUNDS):
        farthest = points[np.argmax(np.sum((points - centre) ** 2, axis=1))]
        centre = centre + (farthest - centre) / (i + 1)
    return centre, float(np.sqrt(np.max(np.sum((points - centre) ** 2, axis=1))))


def _capsule(corners: Array, axis: Array) -> Primitive:
    """The shortest capsule about corners (n, 3) along an axis, as thin as their projection allows."""
    across = _complement(axis)
    middle, radius = _ball(corners @ across.T)
    lateral = np.sum((corners @ across.T - middle) ** 2, axis=1)
    depth, heights = np.sqrt(np.maximum(radius**2 - lateral, 0.0)), corners @ axis
    top, bottom = float((heights - depth).max()), float((heights + depth).min())
    half = max((top - bottom) / 2, 0.0)
    centre = (top + bottom) / 2 * axis + middle @ across
    return Primitive("capsule", np.array([radius, half, 0.0]), np.stack([*across, axis], axis=1), centre)


def _cylinder(corners: Array, axis: Array) -> Primitive:
    """The cylinder about corners (n, 3) along an axis."""
    across = _complement(axis)
    middle, radius = _ball(corners @ across.T)
    heights = corners @ axis
    low, high = float(heights.min()), float(heights.max())
    centre = (low + high) / 2 * axis + middle @ across
    return Primitive("cylinder", np.array([radius, (high - low) / 2, 0.0]), np.stack([*across, axis], axis=1), centre)


def _box(corners: Array) -> Primitive:
    """The box of least volume about corners (n, 3) with one side on a face of their hull and one on an edge of its outline."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        shape = ConvexHull(corners)
        normals, triangles = shape.equations[:, :3], corners[shape.simplices]
        areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
        frames = [*normals[np.argsort(-areas)[:FACES]], *_axes(corners).T]
    except QhullError:
        frames = [*_axes(corners).T]
    best: tuple[float, Array] = (math.inf, np.eye(3))
    for normal in frames:
        across = _complement(normal)
        flat = corners @ across.T
        outline = flat[_outline(flat)]
        edges = np.diff(outline, axis=0, append=outline[:1])
        edges = edges[np.linalg.norm(edges, axis=1) > 0.0]
        edges /= np.linalg.norm(edges, axis=1, keepdims=True)
        beside = np.stack([-edges[:, 1], edges[:, 0]], axis=1)
        rectangles = np.ptp(outline @ edges.T, axis=0) * np.ptp(outline @ beside.T, axis=0)
        i = int(np.argmin(rectangles))
        volume = float(rectangles[i] * np.ptp(corners @ normal))
        if volume < best[0]:
            best = volume, np.stack([edges[i] @ across, beside[i] @ across, normal], axis=1)
    R = best[1]
    local = corners @ R
    low, high = local.min(axis=0), local.max(axis=0)
    return Primitive("box", (high - low) / 2, R, R @ ((low + high) / 2))


def _outline(flat: Array) -> NDArray[np.int64]:
    """Corners of the convex hull of points (n, 2) in order; all points where they lie on a line."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(ConvexHull(flat).vertices)
    except QhullError:
        return np.arange(len(flat))


def _complement(axis: Array) -> Array:
    """Two unit vectors, rows (2, 3), that make a right-handed frame with a unit axis (3,)."""
    x = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(x, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x)])
