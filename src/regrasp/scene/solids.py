"""Convex solids: MuJoCo geoms whose union is exactly the shape, their mass properties and their distances."""

import math
from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.schema import Primitive

Array = NDArray[np.float64]
Pose = tuple[Array, Array]

COLOUR = (0.85, 0.55, 0.25, 1.0)
KINDS = ("sphere", "ellipsoid", "capsule", "cylinder", "box")
RIM_ERROR = 2e-5  # m, how far the capsules of a cylinder's rim may stray from the torus they stand for
HALVINGS = 60  # of the interval that holds the multiplier of an ellipsoid's nearest point
ORIGIN: Pose = (np.eye(3), np.zeros(3))


def kind(shape: Primitive) -> tuple[int, Array]:
    """The surface's code (0 sphere, 1 ellipsoid, 2 capsule, 3 cylinder, 4 box) and its four sizes, m.

    Sphere (r, ·, ·, ·), ellipsoid (a, b, c, ·), capsule (r, half length, ·, ·), cylinder (R, half height, ·, rounding),
    box (x, y, z, rounding): half extents with the rounding included.
    """
    size = np.zeros(4)
    size[: len(shape.size)] = shape.size
    size[3] = shape.rounding
    return KINDS.index(shape.shape), size


def extents(shape: Primitive) -> Array:
    """Half extents of the solid's bounding box, (3,), m."""
    size = shape.size
    match shape.shape:
        case "sphere":
            return np.full(3, size[0])
        case "capsule":
            return np.array([size[0], size[0], size[0] + size[1]])
        case "cylinder":
            return np.array([size[0], size[0], size[1]])
        case _:
            return np.array(size)


def least_radius(shape: Primitive) -> float:
    """The least radius of curvature of the solid's surface, m."""
    size = sorted(shape.size)
    return {"sphere": size[0], "ellipsoid": size[0] ** 2 / size[-1], "capsule": shape.size[0]}.get(
        shape.shape, shape.rounding
    )


def distance(code: int, size: Array, points: Array) -> Array:
    """Signed distance (N,) of points (N, 3) in the solid's frame, m; code and size (4,) as in `kind`."""
    p, r = np.abs(points), size[3]
    match KINDS[code]:
        case "sphere":
            return np.asarray(np.linalg.norm(p, axis=1) - size[0])
        case "ellipsoid":
            return _ellipsoid(p, size[:3])
        case "capsule":
            return np.hypot(np.hypot(p[:, 0], p[:, 1]), np.maximum(p[:, 2] - size[1], 0.0)) - size[0]
        case "cylinder":
            excess = np.stack([np.hypot(p[:, 0], p[:, 1]), p[:, 2]], axis=1) - (size[:2] - r)
        case _:
            excess = p - (size[:3] - r)
    return np.asarray(np.linalg.norm(np.maximum(excess, 0.0), axis=1) + np.minimum(excess.max(axis=1), 0.0) - r)


def _ellipsoid(p: Array, semi: Array) -> Array:
    """Signed distance of points (N, 3) with coordinates ≥ 0 from an ellipsoid: the foot is a² p / (a² + t) (Eberly 2013)."""
    p = np.maximum(p, 1e-12)  # on a plane of symmetry the multiplier sits at its pole
    smallest = float(semi.min())
    low = -(smallest**2) + smallest * p[:, int(np.argmin(semi))]
    high = np.maximum(-(smallest**2) + np.linalg.norm(semi * p, axis=1), low)
    for _ in range(HALVINGS):
        t = 0.5 * (low + high)
        beyond = np.sum((semi * p / (semi**2 + t[:, None])) ** 2, axis=1) > 1.0
        low, high = np.where(beyond, t, low), np.where(beyond, high, t)
    t = 0.5 * (low + high)
    foot = semi**2 * p / (semi**2 + t[:, None])
    return np.asarray(np.sign(t) * np.linalg.norm(p - foot, axis=1))


def volume(shape: Primitive) -> float:
    """Volume of the solid, m³."""
    size = shape.size
    match shape.shape:
        case "sphere":
            return 4 / 3 * math.pi * size[0] ** 3
        case "ellipsoid":
            return 4 / 3 * math.pi * size[0] * size[1] * size[2]
        case "box":
            x, y, z = size
            return _slices(x, shape.rounding, lambda t, rho: _box_area(y, z, shape.rounding, rho))
        case _:
            R, r = size[0], size[0] if shape.shape == "capsule" else shape.rounding
            half = size[1] + (R if shape.shape == "capsule" else 0.0)
            return _slices(half, r, lambda t, rho: math.pi * (R - r + rho) ** 2)


def inertia(shape: Primitive) -> Array:
    """Principal moments of inertia about the centre along the frame's axes for a mass of 1, (3,), m²."""
    if shape.shape in ("sphere", "ellipsoid"):
        semi = np.array(shape.size if shape.shape == "ellipsoid" else shape.size * 3)
        second = semi**2 / 5  # mean square coordinates
    elif shape.shape == "box":
        second = np.array([_box_second(np.roll(shape.size, -axis), shape.rounding) for axis in range(3)])
    else:
        R = shape.size[0]
        r = R if shape.shape == "capsule" else shape.rounding
        half = shape.size[1] + (R if shape.shape == "capsule" else 0.0)
        second = _round_second(R, half, r)
    return np.asarray(second.sum() - second)


def _slices(half: float, r: float, function: Callable[[Array, Array], Array]) -> float:
    """∫ function(z, ρ) dz over a solid of half height `half` with edges rounded by r.

    ρ = r over the straight middle; at the height r sin φ above it the section has shrunk to ρ = r cos φ. Gauss-Legendre
    with 24 nodes is exact to round-off, the integrands being trigonometric polynomials of low degree.
    """
    nodes, weights = np.polynomial.legendre.leggauss(24)
    middle = half - r
    phi = math.pi / 4 * (nodes + 1)
    flat = middle / 2 * weights @ function(middle / 2 * (nodes + 1), np.full_like(nodes, r))
    round_ = math.pi / 4 * weights @ (function(middle + r * np.sin(phi), r * np.cos(phi)) * r * np.cos(phi))
    return 2.0 * float(flat + round_)


def _box_second(size: Array, r: float) -> float:
    """Mean square of the first coordinate over a rounded box of half extents `size`."""
    x, y, z = size
    volume = _slices(x, r, lambda t, rho: _box_area(y, z, r, rho))
    return _slices(x, r, lambda t, rho: t**2 * _box_area(y, z, r, rho)) / volume


def _box_area(y: float, z: float, r: float, rho: Array) -> Array:
    """Area of a rounded box's section whose edges have shrunk from the radius r to ρ."""
    return np.asarray(4 * (y - r) * (z - r) + 4 * rho * (y + z - 2 * r) + math.pi * rho**2)


def _round_second(R: float, half: float, r: float) -> Array:
    """Mean squares of the coordinates over a rounded cylinder about z; a capsule is one with r = R."""

    def radius(rho: Array) -> Array:
        return R - r + rho

    volume = _slices(half, r, lambda z, rho: math.pi * radius(rho) ** 2)
    across = _slices(half, r, lambda z, rho: math.pi / 4 * radius(rho) ** 4) / volume
    along = _slices(half, r, lambda z, rho: z**2 * math.pi * radius(rho) ** 2) / volume
    return np.array([across, across, along])


def add_geoms(body: mujoco.MjsBody, shape: Primitive, X: Pose = ORIGIN) -> None:
    """Adds the geoms object/0, object/1, … whose union is the solid, its frame at the pose X = (R, p) in the body's."""
    G = mujoco.mjtGeom
    size, r = np.array(shape.size), shape.rounding
    if shape.shape == "box":
        # The box shrunk by r and grown again by a ball: three boxes, each pushed out along one axis, and the edges.
        core = size - r
        for axis in range(3):
            _add(body, X, G.mjGEOM_BOX, core + r * np.eye(3)[axis])
        for axis in range(3):
            for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                start = np.insert(np.multiply(signs, np.delete(core, axis)), axis, core[axis])
                end = start.copy()
                end[axis] *= -1
                _add(body, X, G.mjGEOM_CAPSULE, [r, 0, 0], ends=(start, end))
    elif shape.shape == "cylinder":
        R, half = size
        _add(body, X, G.mjGEOM_CYLINDER, [R - r, half, 0])
        _add(body, X, G.mjGEOM_CYLINDER, [R, half - r, 0])
        for z in (half - r, r - half):
            rim = _rim(R - r)
            for k in range(len(rim)):
                _add(body, X, G.mjGEOM_CAPSULE, [r, 0, 0], ends=(np.append(rim[k - 1], z), np.append(rim[k], z)))
    else:
        code = {"sphere": G.mjGEOM_SPHERE, "ellipsoid": G.mjGEOM_ELLIPSOID, "capsule": G.mjGEOM_CAPSULE}[shape.shape]
        _add(body, X, code, np.append(size, np.zeros(3 - len(size))))


def _rim(radius: float) -> Array:
    """Corners of a regular polygon that stays within RIM_ERROR of the circle on both sides, (n, 2)."""
    n = max(8, math.ceil(math.pi / math.acos((1 - RIM_ERROR / radius) / (1 + RIM_ERROR / radius))))
    angles = 2 * math.pi * np.arange(n) / n
    return (radius + RIM_ERROR) * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _add(
    body: mujoco.MjsBody, X: Pose, geom: mujoco.mjtGeom, size: object, ends: tuple[Array, Array] | None = None
) -> None:
    R, p = X
    added = body.add_geom(name=f"object/{len(body.geoms)}", type=geom, size=size, rgba=COLOUR)
    if ends is not None:
        added.fromto = [*(R @ ends[0] + p), *(R @ ends[1] + p)]
    else:
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, R.ravel())
        added.pos, added.quat = p, quaternion
