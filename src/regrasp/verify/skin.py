"""Contact of tips with an object that is a mesh, measured on its triangulated surface.

Between its vertices the surface is that of curved triangles: cubic patches that meet the vertices' normals (Vlachos, Peters,
Boyd & Mitchell 2001). A tip's signed distance is a closed form, and its least value on the surface is the gap: looked for
first at the vertices, then ever finer on the patches about the best of them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from regrasp.scene import solids
from regrasp.scene.grids import Skin

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

VERTICES = 5  # whose patches are looked at
ALL_ABOUT = 40  # … for the foot of a point: a large patch may have small ones about it that share none of its corners
PATCHES = 4  # of them that are looked at more closely
FINER, FINEST = 4.0, 4e-3  # how much smaller each round's part of a patch is, and the last one's
WHOLE = np.array([(i, j) for i in range(6) for j in range(6 - i)]) / 5.0
"""Shares of a patch's corners 1 and 2, all over it."""
AROUND = np.array([(i, j) for i in range(-2, 3) for j in range(-2, 3)]) / 2.0
"""… and about one point."""
BALL = solids.KINDS.index("sphere")
DIFFERENCE = 1e-3  # in shares of a patch, for its tangents
NEWTON = 3  # steps to a foot
SLIVER, SPECK = 0.1, 1e-12  # sine of the angle between sides, and m², of patches that hardly have an area
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
    """The patches of a skin."""

    skin: Skin

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
        distance, face, uv = self._nearest(tip, VERTICES)
        return distance, bezier(self._patches(face[None]), uv[None, None])[0, 0]

    def foot(self, point: Array) -> tuple[Array, Array]:
        """The surface's point nearest to a point (3,) beside it, and its unit outward normal there, (3,) each, in O.

        From the nearest one of those looked at, by Gauss and Newton's steps on its patch. On a sliver, whose tangents are not
        to be relied on, the normal is between those of its corners.
        """
        _, face, uv = self._nearest(Tip(BALL, np.zeros(4), np.eye(3), point), ALL_ABOUT)
        control = self._patches(face[None])[0]
        for _ in range(NEWTON):
            across, on = tangents(control, uv), bezier(control[None], uv[None, None])[0, 0]
            uv = inside(uv + np.linalg.lstsq(across.T, point - on)[0])
        x, y = tangents(control, uv)
        normal = np.cross(x, y)
        if float(np.linalg.norm(normal)) < max(SLIVER * float(np.linalg.norm(x) * np.linalg.norm(y)), SPECK):
            normal = np.array([1.0 - uv.sum(), *uv]) @ self.skin.normals[face]
        return bezier(control[None], uv[None, None])[0, 0], normal / np.linalg.norm(normal)

    def _patches(self, faces: Ints) -> Array:
        return patches(self.skin.vertices[faces], self.skin.normals[faces])

    def _nearest(self, tip: Tip, count: int) -> tuple[float, Ints, Array]:
        """The least distance, and where it is: the corners (3,) of the patch, and shares (2,) of the last two.

        count: vertices whose patches are looked at.
        """
        reach = float(np.sum(tip.size[:3])) + self._longest
        near = np.array(self._tree.query_ball_point(tip.p_OT, reach), np.int64)
        if len(near) == 0:
            near = np.atleast_1d(self._tree.query(tip.p_OT)[1])
        best = near[np.argsort(tip.distance(self.skin.vertices[near]), kind="stable")[:count]]
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


def tangents(control: Array, uv: Array) -> Array:
    """Derivatives (2, 3) of a cubic patch's (10, 3) points by the shares uv (2,)."""
    steps = DIFFERENCE * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    a, b, c, d = bezier(control[None], (uv + steps)[None])[0]
    return np.stack([a - b, c - d]) / (2.0 * DIFFERENCE)
