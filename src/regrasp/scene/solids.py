"""The object's solid: MuJoCo geoms whose union is exactly the shape, and the mass properties of the true shape."""

import math
from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.schema import Object

Array = NDArray[np.float64]

COLOUR = (0.85, 0.55, 0.25, 1.0)
KINDS = ("sphere", "ellipsoid", "capsule", "cylinder", "box")
RIM_ERROR = 2e-5  # m, how far the capsules of a cylinder's rim may stray from the torus they stand for


def kind(shape: Object) -> tuple[int, Array]:
    """The surface's code (0 sphere, 1 ellipsoid, 2 capsule, 3 cylinder, 4 box) and its four sizes, m.

    Sphere (r, ·, ·, ·), ellipsoid (a, b, c, ·), capsule (r, half length, ·, ·), cylinder (R, half height, ·, rounding),
    box (x, y, z, rounding): half extents with the rounding included.
    """
    size = np.zeros(4)
    size[: len(shape.size)] = shape.size
    size[3] = shape.rounding
    return KINDS.index(shape.shape), size


def inertia(shape: Object) -> Array:
    """Principal moments of inertia about the centre along the axes of O, (3,), kg m²."""
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
    return shape.mass * (second.sum() - second)


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

    def area(_: Array, rho: Array) -> Array:
        return 4 * (y - r) * (z - r) + 4 * rho * (y + z - 2 * r) + math.pi * rho**2

    return _slices(x, r, lambda t, rho: t**2 * area(t, rho)) / _slices(x, r, area)


def _round_second(R: float, half: float, r: float) -> Array:
    """Mean squares of the coordinates over a rounded cylinder about z; a capsule is one with r = R."""

    def radius(rho: Array) -> Array:
        return R - r + rho

    volume = _slices(half, r, lambda z, rho: math.pi * radius(rho) ** 2)
    across = _slices(half, r, lambda z, rho: math.pi / 4 * radius(rho) ** 4) / volume
    along = _slices(half, r, lambda z, rho: z**2 * math.pi * radius(rho) ** 2) / volume
    return np.array([across, across, along])


def add_geoms(body: mujoco.MjsBody, shape: Object) -> None:
    """Adds the geoms object/0, object/1, … whose union is the solid, and the solid's own mass properties."""
    body.explicitinertial = True
    body.mass = shape.mass
    body.ipos, body.iquat = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    body.inertia = inertia(shape)
    G = mujoco.mjtGeom
    size, r = np.array(shape.size), shape.rounding
    if shape.shape == "box":
        # The box shrunk by r and grown again by a ball: three boxes, each pushed out along one axis, and the edges.
        core = size - r
        for axis in range(3):
            _add(body, G.mjGEOM_BOX, core + r * np.eye(3)[axis])
        for axis in range(3):
            for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                start = np.insert(np.multiply(signs, np.delete(core, axis)), axis, core[axis])
                end = start.copy()
                end[axis] *= -1
                _add(body, G.mjGEOM_CAPSULE, [r, 0, 0], ends=(start, end))
    elif shape.shape == "cylinder":
        R, half = size
        _add(body, G.mjGEOM_CYLINDER, [R - r, half, 0])
        _add(body, G.mjGEOM_CYLINDER, [R, half - r, 0])
        for z in (half - r, r - half):
            rim = _rim(R - r)
            for k in range(len(rim)):
                _add(body, G.mjGEOM_CAPSULE, [r, 0, 0], ends=(np.append(rim[k - 1], z), np.append(rim[k], z)))
    else:
        code = {"sphere": G.mjGEOM_SPHERE, "ellipsoid": G.mjGEOM_ELLIPSOID, "capsule": G.mjGEOM_CAPSULE}[shape.shape]
        _add(body, code, np.append(size, np.zeros(3 - len(size))))


def _rim(radius: float) -> Array:
    """Corners of a regular polygon that stays within RIM_ERROR of the circle on both sides, (n, 2)."""
    n = max(8, math.ceil(math.pi / math.acos((1 - RIM_ERROR / radius) / (1 + RIM_ERROR / radius))))
    angles = 2 * math.pi * np.arange(n) / n
    return (radius + RIM_ERROR) * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _add(body: mujoco.MjsBody, geom: mujoco.mjtGeom, size: object, ends: tuple[Array, Array] | None = None) -> None:
    added = body.add_geom(name=f"object/{len(body.geoms)}", type=geom, size=size, rgba=COLOUR)
    if ends is not None:
        added.fromto = [*ends[0], *ends[1]]
