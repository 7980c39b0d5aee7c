"""A pinhole camera: rays through pixels, pixels of points, and the place from which a scene is best seen."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FIELD = np.radians(16.0)
"""Opening angle, rad: narrow, so that sizes in a row of frames can be compared by eye."""


@dataclass(frozen=True)
class Camera:
    """A pinhole at `eye` (W, m) with axes right, up, forward as the rows of `R` (3, 3).

    Its image has `width` × `height` px; `reach` is the half height of what is seen at unit distance, the tangent of
    half the opening angle.
    """

    eye: Array
    R: Array
    reach: float
    width: int
    height: int

    def rays(self, pixels: Array) -> Array:
        """Unit directions in W (n, 3) through image points (n, 2), in px from the top left corner."""
        u = (pixels[:, 0] - self.width / 2) * (2 * self.reach / self.height)
        v = (self.height / 2 - pixels[:, 1]) * (2 * self.reach / self.height)
        direction = u[:, None] * self.R[0] + v[:, None] * self.R[1] + self.R[2]
        return np.asarray(direction / np.linalg.norm(direction, axis=1, keepdims=True))

    def project(self, points: Array) -> Array:
        """Image points (..., 2), in px from the top left corner, of points in W (..., 3)."""
        seen = (np.asarray(points) - self.eye) @ self.R.T
        scale = self.height / (2 * self.reach) / seen[..., 2]
        return np.stack([self.width / 2 + seen[..., 0] * scale, self.height / 2 - seen[..., 1] * scale], axis=-1)

    def pixel_size(self, distance: float) -> float:
        """Width of one pixel at `distance` from the eye, m."""
        return 2 * self.reach * distance / self.height


def axes(forward: Array) -> Array:
    """Rows right, up, forward (3, 3) of a camera looking along `forward` (not vertical), z upwards in the image."""
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, forward), forward])


def direction(azimuth: float, elevation: float) -> Array:
    """Viewing direction (3,) from azimuth (0: from +x, turning towards +y) and elevation above the horizon, rad."""
    return -np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])


def fit(forward: Array, centres: Array, radii: Array, width: int, height: int, margin: float = 1.08) -> Camera:
    """The camera looking along `forward` that shows all spheres (centres (n, 3) in W, radii (n,), m) largest."""
    R = axes(forward)
    reach = float(np.tan(FIELD / 2))
    seen = centres @ R.T
    low, high = (seen - radii[:, None]).min(axis=0), (seen + radii[:, None]).max(axis=0)
    half = (high - low) / 2
    distance = half[2] + margin * max(half[1], half[0] * height / width) / reach
    middle = (low + high) / 2
    return Camera((middle - [0.0, 0.0, distance]) @ R, R, reach, width, height)


def proportion(forward: Array, centres: Array, radii: Array) -> float:
    """Height over width of what a camera looking along `forward` must show: spheres, as in `fit`."""
    seen = centres @ axes(forward).T
    extent = (seen + radii[:, None]).max(axis=0) - (seen - radii[:, None]).min(axis=0)
    return float(extent[1] / max(extent[0], 1e-9))


def candidates() -> Sequence[Array]:
    """Viewing directions worth trying for a scene in space: all round it, from moderate heights."""
    return [direction(a, e) for e in np.radians([22.0, 38.0, 55.0]) for a in np.radians(np.arange(-80.0, 280.0, 20.0))]
