"""Sets of triangles: nearest points, what lies inside, and the mass properties of what they enclose."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

CANDIDATES = 8  # triangles looked at for a nearest point
CHUNK = 100_000  # points looked at together
ASIDE = (
    0.000131,
    0.000173,
)  # of the spacing: by so much columns of nodes miss vertices and edges that lie on the nodes' lines


@dataclass(frozen=True)
class Triangles:
    """vertices (V, 3), m; faces (F, 3), anticlockwise seen from outside; spacing: m, of the points that stand for them."""

    vertices: Array
    faces: Ints
    spacing: float

    @cached_property
    def corners(self) -> Array:
        """(F, 3, 3): the corners of every triangle."""
        return self.vertices[self.faces]

    @cached_property
    def _samples(self) -> "tuple[cKDTree, Ints]":
        """A tree of points that lie everywhere on the triangles within about `spacing` of one another, and whose they are."""
        from scipy.spatial import cKDTree

        corners = self.corners
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        count = np.maximum(1, np.ceil(longest / self.spacing)).astype(np.int64)
        points, owners = [], []
        for n in np.unique(count):
            which = np.flatnonzero(count == n)
            i, j = np.nonzero(np.add.outer(np.arange(n), np.arange(n)) < n)
            weights = np.stack([i + 1 / 3, j + 1 / 3, n - i - j - 2 / 3], axis=1) / n
            points.append(np.einsum("sk,fkx->fsx", weights, corners[which]).reshape(-1, 3))
            owners.append(np.repeat(which, len(weights)))
        return cKDTree(np.concatenate(points)), np.concatenate(owners)

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Distance (N,) of the points (N, 3) from the triangles, and the feet (N, 3) there.

        Of each point the triangles of its nearest samples are measured exactly. Where none of them is the nearest, the
        distance is too large by less than spacing² / (2 distance).
        """
        tree, owner = self._samples
        count = min(CANDIDATES, len(owner))
        distance, foot = np.empty(len(points)), np.empty((len(points), 3))
        for first in range(0, len(points), CHUNK):
            p = points[first : first + CHUNK]
            _, found = tree.query(p, k=count)
            s, t, square = self._feet(p, owner[found.reshape(len(p), count)])
            best, rows = square.argmin(axis=1), np.arange(len(p))
            a, b, c = self.corners[owner[found.reshape(len(p), count)[rows, best]]].transpose(1, 0, 2)
            s, t = s[rows, best, None], t[rows, best, None]
            feet = a + s * (b - a) + t * (c - a)
            foot[first : first + CHUNK] = feet
            distance[first : first + CHUNK] = np.linalg.norm(p - feet, axis=1)
        return distance, foot

    @cached_property
    def _sides(self) -> tuple[Array, Array, Array, Array]:
        """Of every triangle a b c: a, the sides b − a and c − a, and their squares and product (F, 3)."""
        a, e, f = self.corners[:, 0], self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]
        return a, e, f, np.stack([np.sum(e * e, axis=1), np.sum(e * f, axis=1), np.sum(f * f, axis=1)], axis=1)

    def _feet(self, p: Array, faces: Ints) -> tuple[Array, Array, Array]:
        """Feet a + s (b − a) + t (c − a) of points p (N, 3) on triangles (N, K): s, t and squares of distances (N, K).

        Each side's nearest point in turn, and the foot on the plane where that lies within (Ericson 2005, §5.1.5).
        """
        a, e, f, products = (part[faces] for part in self._sides)
        v = p[:, None] - a
        ve, vf, vv = np.einsum("nkx,nkx->nk", v, e), np.einsum("nkx,nkx->nk", v, f), np.einsum("nkx,nkx->nk", v, v)
        ee, ef, ff = products[..., 0], products[..., 1], products[..., 2]

        def part(along: Array, length: Array) -> Array:
            return np.clip(along / np.maximum(length, 1e-300), 0.0, 1.0)

        def square(s: Array, t: Array) -> Array:
            return vv - 2 * (s * ve + t * vf) + s * s * ee + 2 * s * t * ef + t * t * ff

        none = np.zeros_like(ve)
        across = part(vf - ve - ef + ee, ee + ff - 2 * ef)
        s, t = part(ve, ee), none
        least = square(s, t)
        for u, w in ((none, part(vf, ff)), (1.0 - across, across)):
            other = square(u, w)
            s, t, least = np.where(other < least, u, s), np.where(other < least, w, t), np.minimum(other, least)
        det = ee * ff - ef * ef
        scale = 1.0 / np.where(det > 1e-14 * ee * ff, det, np.inf)  # a triangle without area has its sides only
        u, w = (ff * ve - ef * vf) * scale, (ee * vf - ef * ve) * scale
        within = (u > 0.0) & (w > 0.0) & (u + w < 1.0) & (scale > 0.0)
        s, t = np.where(within, u, s), np.where(within, w, t)
        return s, t, np.where(within, square(u, w), least)

    def distances(self, origin: Array, spacing: float, shape: tuple[int, ...], exact: tuple[float, float]) -> Array:
        """Distance (nx, ny, nz) of the nodes origin + spacing (i, j, k), exact where it lies between the two numbers, m.

        Elsewhere it is that from the foot of the nearest node beside a triangle, too large by a part of the spacing.
        """
        from scipy import ndimage

        low = np.floor((self._samples[0].data - origin) / spacing).astype(np.int64)
        beside = np.zeros(shape, bool)
        for corner in np.ndindex(2, 2, 2):
            index = low + corner
            index = index[np.all((index >= 0) & (index < shape), axis=1)]
            beside[tuple(index.T)] = True
        rough, source = ndimage.distance_transform_edt(~beside, sampling=spacing, return_indices=True)
        slack = 2.0 * spacing  # the nodes beside a point are within √3 spacings of it
        near = beside | ((rough >= exact[0] - slack) & (rough <= exact[1] + slack))
        feet = np.full((*shape, 3), np.nan)
        distance = np.empty(shape)
        index = np.argwhere(near)
        distance[near], feet[near] = self.nearest(origin + spacing * index)
        index = np.argwhere(~near)
        foot = feet[tuple(source[:, ~near])]
        distance[~near] = np.linalg.norm(origin + spacing * index - foot, axis=1)
        return distance

    def inside(self, origin: Array, spacing: float, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """(nx, ny, nz): whether the nodes origin + spacing (i, j, k) lie inside, by the winding number along z.

        Shells that overlap count once.
        """
        nx, ny, nz = shape
        a = (self.corners[:, :, :2] - origin[:2]) / spacing - ASIDE
        low = np.clip(np.ceil(a.min(axis=1)), 0, (nx, ny)).astype(np.int64)
        high = np.clip(np.floor(a.max(axis=1)) + 1, 0, (nx, ny)).astype(np.int64)
        wide, deep = np.maximum(high - low, 0).T
        crossings = np.zeros((nx, ny, nz + 1), np.int32)
        total = wide * deep
        for group in np.array_split(np.arange(len(a)), max(1, int(total.sum() // 2_000_000))):
            face = np.repeat(group, total[group])
            number = np.arange(len(face)) - np.repeat(np.cumsum(total[group]) - total[group], total[group])
            i, j = low[face, 0] + number // np.maximum(deep[face], 1), low[face, 1] + number % np.maximum(deep[face], 1)
            u, v, w = (a[face, c] for c in range(3))
            p = np.stack([i, j], axis=1)
            whole = _turn(u, v, w)
            s, t = _turn(v, w, p), _turn(w, u, p)
            r = whole - s - t
            up = np.sign(whole).astype(np.int32)
            hit = (up * s > 0) & (up * t > 0) & (up * r > 0)
            s, t, r, face, i, j = s[hit], t[hit], r[hit], face[hit], i[hit], j[hit]
            z = (np.stack([s, t, r], axis=1) * self.corners[face, :, 2]).sum(axis=1) / whole[hit]
            k = np.clip(np.ceil((z - origin[2]) / spacing), 0, nz).astype(np.int64)
            np.add.at(crossings, (i, j, k), up[hit])
        # A column enters through faces that look down and leaves through those that look up.
        return np.cumsum(-crossings[:, :, :nz], axis=2) > 0


def _turn(a: Array, b: Array, c: Array) -> Array:
    """Twice the signed area of the triangles a b c in the plane, (N,)."""
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])


def moments(vertices: Array, faces: Ints) -> tuple[float, Array, Array]:
    """Volume, centroid (3,) and ∫ x xᵀ dV about the centroid (3, 3) of what the faces enclose, exactly.

    Sums over the tetrahedra that the faces make with a point (Tonon 2004).
    """
    origin = vertices.mean(axis=0)
    corners = vertices[faces] - origin
    volume = np.linalg.det(corners) / 6.0
    total, sums = float(volume.sum()), corners.sum(axis=1)
    centre = volume @ sums / 4.0 / total
    second = np.einsum("f,fx,fy->xy", volume, sums, sums) + np.einsum("f,fkx,fky->xy", volume, corners, corners)
    return total, origin + centre, second / 20.0 - total * np.outer(centre, centre)
