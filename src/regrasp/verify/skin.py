"""Contact of tips with an object that is a mesh, measured on its triangulated surface.

It is the zero of a tricubic spline through signed distances. Triangles lie on it, and between their vertices it is, to some
micrometres, that of cubic patches that meet the vertices' normals (Vlachos, Peters, Boyd & Mitchell 2001). A tip's signed
distance is a closed form, and its least value on the patches is the gap: looked for first at the vertices, then ever finer on
the patches about the best of them. The surface under a stated point, and its normal there, are the spline's.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from regrasp.scene import solids
from regrasp.scene.grids import Grid, Skin, Spline

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

VERTICES = 5  # whose patches are looked at
PATCHES = 4  # of them that are looked at more closely
FINER, FINEST = 4.0, 4e-3  # how much smaller each round's part of a patch is, and the last one's
WHOLE = np.array([(i, j) for i in range(6) for j in range(6 - i)]) / 5.0
"""Shares of a patch's corners 1 and 2, all over it."""
AROUND = np.array([(i, j) for i in range(-2, 3) for j in range(-2, 3)]) / 2.0
"""… and about one point."""
NEWTON = 4  # steps to a foot
SURE = 1e-7  # m that a foot may be off the spline's zero
SLOPE = 0.01  # of the distance, squared, at least: where it is less no way leads to the surface
STEP = 1e-6  # m, for the gradient of a tip's distance


@dataclass(frozen=True)
class Tip:
    """A tip's surface (`solids.kind`) at a pose in the object's frame."""

    kind: int
    size: Array
    R_OT: Array
    p_OT: Array

    def distance(self, points: Array) -> Array:
        """Signed distance (N,) of points (N, 3) in O from the tip, m."""
        return solids.distance(self.kind, self.size, (points - self.p_OT) @ self.R_OT)

    def normal(self, point: Array) -> Array:
        """Unit direction from a point (3,) to the tip, O."""
        steps = STEP * np.eye(3)
        gradient = self.distance(point + steps) - self.distance(point - steps)
        return np.asarray(-gradient / np.linalg.norm(gradient))


@dataclass(frozen=True)
class Surface:
    """The surface of a grid's spline: the patches of its skin, and the spline itself."""

    skin: Skin
    grid: Grid

    @cached_property
    def _spline(self) -> Spline:
        return Spline(self.grid)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.skin.vertices)

    @cached_property
    def _faces_at(self) -> tuple[Ints, Ints]:
        """Faces sorted by their vertices, and where those of each vertex begin."""
        flat = self.skin.faces.ravel()
        order = np.argsort(flat, kind="stable")
        return order // 3, np.searchsorted(flat[order], np.arange(len(self.skin.vertices) + 1))

    @cached_property
    def _longest(self) -> float:
        corners = self.skin.vertices[self.skin.faces]
        return float(np.max(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))

    def nearest(self, tip: Tip) -> tuple[float, Array]:
        """The least signed distance of the surface from the tip, m, and the point (3,) of it, in O."""
        distance, face, uv = self._nearest(tip)
        return distance, bezier(self._patches(face[None]), uv[None, None])[0, 0]

    def foot(self, point: Array) -> tuple[Array, Array]:
        """The surface's point under a point (3,) beside it, and its unit outward normal there, (3,) each, in O.

        By Newton's method along the spline's gradient, which leads to the nearest point but for the square of the distance.
        The patches do not do for the normal: it is off by up to 1° between vertices, 0.2 mm on a fingertip. No point (NaN)
        where none is found, and none outside the grid.
        """
        low = self.grid.origin
        high = low + self.grid.spacing * (np.array(self.grid.values.shape) - 1)
        foot = point
        for _ in range(NEWTON):
            value, gradient = self._spline(np.clip(foot, low, high)[None])
            foot = foot - value[0] / max(float(gradient[0] @ gradient[0]), SLOPE) * gradient[0]
        value, gradient = self._spline(foot[None])
        if not (np.all((low < foot) & (foot < high)) and abs(float(value[0])) < SURE):
            return np.full(3, np.nan), np.full(3, np.nan)
        return foot, gradient[0] / np.linalg.norm(gradient[0])

    def _patches(self, faces: Ints) -> Array:
        return patches(self.skin.vertices[faces], self.skin.normals[faces])

    def _nearest(self, tip: Tip) -> tuple[float, Ints, Array]:
        """The least distance, and where it is: the corners (3,) of the patch, and shares (2,) of the last two."""
        reach = float(np.sum(tip.size[:3])) + self._longest
        near = np.array(self._tree.query_ball_point(tip.p_OT, reach), np.int64)
        if len(near) == 0:
            near = np.atleast_1d(self._tree.query(tip.p_OT)[1])
        best = near[np.argsort(tip.distance(self.skin.vertices[near]), kind="stable")[:VERTICES]]
        by_vertex, start = self._faces_at
        faces = self.skin.faces[np.unique(np.concatenate([by_vertex[start[v] : start[v + 1]] for v in best]))]
        control = self._patches(faces)
        uv = np.broadcast_to(WHOLE, (len(faces), *WHOLE.shape))
        width = 1.0
        while True:
            points = bezier(control, uv)
            away = tip.distance(points.reshape(-1, 3)).reshape(points.shape[:2])
            at = away.argmin(axis=1)
            least = away[np.arange(len(at)), at]
            if width < FINEST:
                patch = int(least.argmin())
                return float(least[patch]), faces[patch], uv[patch, at[patch]]
            kept = np.argsort(least, kind="stable")[:PATCHES]
            width /= FINER
            faces, control, uv = faces[kept], control[kept], inside(uv[kept, at[kept]][:, None] + width * AROUND)


def inside(uv: Array) -> Array:
    """Shares (…, 2) moved into the triangle where they lie outside."""
    uv = np.clip(uv, 0.0, 1.0)
    return np.maximum(uv - 0.5 * np.maximum(uv.sum(axis=-1, keepdims=True) - 1.0, 0.0), 0.0)


def patches(corners: Array, normals: Array) -> Array:
    """The ten control points (F, 10, 3) of the cubic patches over triangles (F, 3, 3) with unit normals at their corners.

    In order: the corners, two points on each of the sides 01, 12, 20, the middle.
    """
    sides = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        for p, q in ((a, b), (b, a)):
            n = normals[:, p]
            lift = np.sum((corners[:, q] - corners[:, p]) * n, axis=1, keepdims=True)
            sides.append((2 * corners[:, p] + corners[:, q] - lift * n) / 3)
    mean = np.mean(sides, axis=0)
    return np.stack([*corners.transpose(1, 0, 2), *sides, mean + (mean - corners.mean(axis=1)) / 2], axis=1)


def bezier(control: Array, uv: Array) -> Array:
    """Points (F, N, 3) of cubic patches at the shares uv (F, N, 2) of the corners 1 and 2."""
    u, v = uv[..., 0], uv[..., 1]
    w = 1.0 - u - v
    weights = [
        w**3, u**3, v**3,
        3 * w * w * u, 3 * w * u * u, 3 * u * u * v, 3 * u * v * v, 3 * v * v * w, 3 * v * w * w,
        6 * u * v * w,
    ]  # fmt: skip
    return np.einsum("kfn,fkx->fnx", np.array(weights), control)
