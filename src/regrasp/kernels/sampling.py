"""Points spread near-uniformly by area over a surface."""

import functools
import itertools
import math

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.grids import Grids, grid_field, grid_project
from regrasp.kernels.native import heap
from regrasp.kernels.rotations import Array
from regrasp.kernels.surfaces import BOX, CAPSULE, CYLINDER, ELLIPSOID, MESH, SPHERE, project


def sample(kind: int, size: Array, grids: Grids, count: int) -> tuple[Array, Array]:
    """Points (count, 3) spread near-uniformly by area over a closed surface, and their outward normals (count, 3).

    Deterministic: an area-preserving map carries the Fibonacci lattice of the unit square onto the surface (patch by
    patch for a box); for a mesh see `_sample_mesh`. Raises ValueError for the PLANE, which has no finite area, and for a count
    below one.
    """
    if kind not in (SPHERE, ELLIPSOID, CAPSULE, CYLINDER, BOX, MESH) or count < 1:
        raise ValueError(
            f"cannot sample {count} points on surface kind {kind}: a closed surface and count ≥ 1 are needed"
        )
    size = np.asarray(size, dtype=np.float64)
    if kind == MESH:
        return _sample_mesh(grids, size, count)
    if kind == BOX:
        points = _sample_box(size, count)
    elif kind == ELLIPSOID:
        points = _sample_ellipsoid(size, count)
    else:
        points = _sample_revolution(kind, size, count)
    normals = np.empty((count, 3))
    for point, normal in zip(points, normals, strict=True):
        project(kind, size, grids, point, point, normal)
    return points, normals


def _lattice(count: int) -> tuple[Array, Array]:
    i = np.arange(count, dtype=np.float64)
    v: Array = (0.5 + i * (math.sqrt(5.0) - 1.0) / 2.0) % 1.0
    return (i + 0.5) / count, v


def _sample_revolution(kind: int, size: Array, count: int) -> Array:
    u, v = _lattice(count)
    if kind == CYLINDER:
        # The meridian from pole to pole; between its corners ρ² (on the caps) and z (on the side) are linear in area.
        rim = np.linspace(0.0, math.pi / 2.0, 513)
        rho = size[0] - size[3] + size[3] * np.sin(rim)
        z = size[1] - size[3] + size[3] * np.cos(rim)
        rho = np.concatenate(([0.0], rho, rho[::-1], [0.0]))
        z = np.concatenate(([size[1]], z, -z[::-1], [-size[1]]))
        area = np.cumsum((rho[1:] + rho[:-1]) * np.hypot(np.diff(rho), np.diff(z)))
        area = np.concatenate(([0.0], area / area[-1]))
        rho, z = np.sqrt(np.interp(u, area, rho**2)), np.interp(u, area, z)
    else:
        # Archimedes: on a sphere, as on its cylinder, area is proportional to height.
        half = size[1] if kind == CAPSULE else 0.0
        z = (2.0 * u - 1.0) * (size[0] + half)
        rho = np.sqrt(size[0] ** 2 - np.maximum(np.abs(z) - half, 0.0) ** 2)
    return np.stack((rho * np.cos(2.0 * math.pi * v), rho * np.sin(2.0 * math.pi * v), z), axis=1)


def _sample_ellipsoid(size: Array, count: int) -> Array:
    # Area density over (z/c, longitude) of the unit sphere; u picks z by the marginal, v the longitude at that z.
    def density(height: Array, longitude: Array) -> Array:
        x2 = (size[1] * size[2] * np.cos(longitude)) ** 2 + (size[0] * size[2] * np.sin(longitude)) ** 2
        return np.sqrt((1.0 - height**2) * x2 + (size[0] * size[1] * height) ** 2)

    def cumulative(weights: Array) -> Array:
        total = np.zeros(weights.shape)
        np.cumsum(0.5 * (weights[..., 1:] + weights[..., :-1]), axis=-1, out=total[..., 1:])
        return total / total[..., -1:]

    u, v = _lattice(count)
    # Cosine spacing resolves the poles of a needle or a disc, where the density falls off fastest.
    polar, longitude = np.linspace(0.0, math.pi, 1025), np.linspace(0.0, 2.0 * math.pi, 1025)
    # The density is the same in all octants: the mean over a circle is the trapezoidal rule on a quarter of it.
    octant = density(-np.cos(polar[:513, None]), longitude[None, :257])
    band = (0.5 * (octant[:, 0] + octant[:, -1]) + octant[:, 1:-1].sum(axis=1)) / 256.0
    band = np.concatenate([band, band[-2::-1]]) * np.sin(polar)
    h = -np.cos(np.interp(u, cumulative(band), polar))
    turned = cumulative(density(h[:, None], longitude))
    angle = np.array([np.interp(v[i], turned[i], longitude) for i in range(count)])
    rho = np.sqrt(1.0 - h**2)
    return size[:3] * np.stack((rho * np.cos(angle), rho * np.sin(angle), h), axis=1)


def _sample_box(size: Array, count: int) -> Array:
    e, core = size[3], size[:3] - size[3]
    signs = [np.array(s, dtype=np.float64) for s in itertools.product((-1, 0, 1), repeat=3) if any(s)]
    # A face, edge or corner is that of the core box, carried out along a segment, an arc or an octant of radius e.
    spread = {1: 1.0, 2: e * math.pi / 2.0, 3: e * e * math.pi / 2.0}
    areas = np.array([spread[int(np.count_nonzero(s))] * np.prod(2.0 * core[s == 0.0]) for s in signs])
    ends = np.rint(np.cumsum(areas) / areas.sum() * count).astype(int)
    patches = []
    for s, patch_count in zip(signs, np.diff(ends, prepend=0), strict=True):
        u, v = _lattice(patch_count)
        turn, rise = v * math.pi / 2.0, np.sqrt(1.0 - u * u)
        outward = {
            1: [np.ones(patch_count)],
            2: [np.cos(turn), np.sin(turn)],
            3: [rise * np.cos(turn), rise * np.sin(turn), u],
        }[int(np.count_nonzero(s))]
        points = np.empty((patch_count, 3))
        points[:, s != 0.0] = s[s != 0.0] * (core[s != 0.0] + e * np.stack(outward, axis=1))
        points[:, s == 0.0] = core[s == 0.0] * (2.0 * np.stack((u, v), axis=1)[:, : np.count_nonzero(s == 0.0)] - 1.0)
        patches.append(points)
    return np.concatenate(patches)


CLOUD, DENSE = 8000, 12  # points of a mesh from which one sample is chosen: at least so many, and so many for each
ROUNDS = 3  # of Lloyd's method
FAR = 2.0  # spacings from a point to the farthest corner of its half cell, and what a coefficient is off its value by


def _sample_mesh(grids: Grids, size: Array, count: int) -> tuple[Array, Array]:
    """`sample` of a mesh: of a cloud, equally dense by area, as many points, centres of equal parts.

    Of the cloud the furthest points are taken one after another, then each moves to the middle of the part next to it
    (Lloyd). Two sides of a thin wall are as far apart as their normals say.
    """
    from scipy.spatial import cKDTree

    cloud, normals, area = _cloud(grids, int(size[0]), max(CLOUD, DENSE * count))
    places = np.concatenate((cloud, 0.5 * math.sqrt(area / count) * normals), axis=1)
    chosen, tree = _furthest(places, count), cKDTree(places)
    for _ in range(ROUNDS):
        nearest = cKDTree(places[chosen]).query(places)[1]
        held = np.bincount(nearest, minlength=count)
        middles = np.stack([np.bincount(nearest, column, count) / np.maximum(held, 1) for column in places.T], axis=1)
        chosen = np.where(held > 0, tree.query(middles)[1], chosen)
    return cloud[chosen], normals[chosen]


@functools.lru_cache(maxsize=8)
def _cloud(grids: Grids, m: int, least: int) -> tuple[Array, Array, float]:
    """At least so many points of grid m's surface, equally dense by area, their normals, and the surface's area.

    They are the closest points to a lattice in a thin shell on both sides of the surface: what a shell's volume has too much
    on its outer side it lacks on the inner.
    """
    o, n, h = grids.origin[m], grids.shape[m], float(grids.spacing[m])
    parts = 1
    while True:
        axes = [o[a] + h / parts * (np.arange((n[a] - 1) * parts) + 0.5) for a in range(3)]
        shell = _shell(grids, m, axes[0], axes[1], axes[2], 0.5 * h)
        if len(shell) >= least:
            break
        parts *= 2
    area = len(shell) * (h / parts) ** 3 / h  # the shell's volume through its width
    few = np.sort(np.random.default_rng(0).choice(len(shell), least, replace=False))
    return *_feet(grids, m, shell[few]), area


@heap
def _feet(grids: Grids, m: int, points: Array) -> tuple[Array, Array]:
    """The closest points of grid m's surface to points (·, 3), and the normals there."""
    feet, normals = np.empty_like(points), np.empty_like(points)
    for i in range(len(points)):
        _, foot, n = grid_project(grids, m, (points[i, 0], points[i, 1], points[i, 2]))
        feet[i, 0], feet[i, 1], feet[i, 2] = foot
        normals[i, 0], normals[i, 1], normals[i, 2] = n
    return feet, normals


@heap
def _furthest(places: Array, count: int) -> NDArray[np.int64]:
    """Of places (·, d) so many: the furthest from their middle, then one by one the furthest from those already chosen."""
    n, d = places.shape
    chosen, away, from_here = np.zeros(count, np.int64), np.full(n, np.inf), np.zeros(d)
    for a in range(d):
        from_here[a] = np.sum(places[:, a]) / n
    for i in range(count):
        best = 0
        for p in range(n):
            square = 0.0
            for a in range(d):
                square += (places[p, a] - from_here[a]) ** 2
            # The middle of all is no place that was chosen.
            away[p] = square if i <= 1 else min(away[p], square)
            if away[p] > away[best]:
                best = p
        chosen[i] = best
        for a in range(d):
            from_here[a] = places[best, a]
    return chosen


@heap
def _shell(grids: Grids, m: int, x: Array, y: Array, z: Array, half: float) -> Array:
    """The points (·, 3) of a lattice that are no further than `half` from grid m's surface.

    The coefficient at the node next to a point differs from the distance there by less than FAR spacings.
    """
    o, h, start = grids.origin[m], grids.spacing[m], grids.start[m]
    rows, deep = grids.shape[m, 1] + 2, grids.shape[m, 2] + 2
    p, found = np.empty(3), 0
    points = np.empty((len(x) * len(y), 3))
    for i in range(len(x)):
        a = int((x[i] - o[0]) / h + 0.5) + 1
        for j in range(len(y)):
            b = int((y[j] - o[1]) / h + 0.5) + 1
            for k in range(len(z)):
                c = int((z[k] - o[2]) / h + 0.5) + 1
                if abs(grids.coefficients[start + (a * rows + b) * deep + c]) > half + FAR * h:
                    continue
                p[0], p[1], p[2] = x[i], y[j], z[k]
                if abs(grid_field(grids, m, p)[0]) > half:
                    continue
                if found == len(points):
                    points = np.concatenate((points, np.empty_like(points)))
                points[found] = p
                found += 1
    return points[:found]
