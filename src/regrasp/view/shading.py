"""Shaded pictures of a MuJoCo model by casting rays: no display, no OpenGL, every shape exact."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.view.camera import Camera
from regrasp.view.rays import cast, shapes

Array = NDArray[np.float64]

BACKGROUND = np.array([0.975, 0.975, 0.97])
FLOOR = np.array([0.90, 0.90, 0.89])
DRAWN, OBJECT, HIDDEN = 0, 1, 5
"""Geom groups of the model to be drawn: everything else, the object, and what is not to be seen."""
SUBRAYS = 3
"""A pixel on an edge is the mean of SUBRAYS² rays."""


@dataclass(frozen=True)
class Stage:
    """What is drawn and how: a model whose geoms are grouped, their colours and line marks, and the light.

    colour (ngeom, 3) in 0…1; marked (ngeom,) whether a geom carries coordinate lines, which show its turning as the
    radial lines of the paper's Fig. 2 do: the object those of its frame, a tip those of its own; centre (3,) and
    radius: where the interest is, W, m; flat: seen from the side, without shadows.
    """

    model: mujoco.MjModel
    colour: Array
    marked: NDArray[np.bool_]
    centre: Array
    radius: float
    flat: bool


def hits(
    stage: Stage, data: mujoco.MjData, origin: Array, rays: Array, groups: tuple[int, ...]
) -> tuple[NDArray[np.int64], Array, Array]:
    """First hits of unit rays (n, 3) from `origin`, W: geom (n,) or −1, distance (n,) in m or inf, normal (n, 3)."""
    n = len(rays)
    geom, distance, normal = np.empty(n, np.int64), np.empty(n), np.zeros((n, 3))
    cast(shapes(stage.model, data, groups), origin, rays, geom, distance, normal)
    return geom, distance, normal


def shade(stage: Stage, data: mujoco.MjData, camera: Camera, pixels: Array) -> Array:
    """Colours (n, 3) at image points (n, 2): Lambert and sky light, a soft-edged shadow, lines on marked geoms."""
    rays = camera.rays(pixels)
    geom, distance, normal = hits(stage, data, camera.eye, rays, (DRAWN, OBJECT))
    colour = np.tile(BACKGROUND, (len(rays), 1))
    hit = np.flatnonzero(geom >= 0)
    if not hit.size:
        return colour
    id, n, p = geom[hit], normal[hit], camera.eye + distance[hit, None] * rays[hit]
    n = np.where(np.sum(n * rays[hit], axis=1, keepdims=True) > 0, -n, n)
    base = stage.colour[id]
    width = camera.pixel_size(float(np.linalg.norm(stage.centre - camera.eye)))
    base = base * (1 - 0.55 * _lines(stage, data, id, p, n, 1.3 * width))[:, None]
    light = stage.centre + 12 * stage.radius * _light(camera)
    to_light = light - p
    far = np.linalg.norm(to_light, axis=1)
    lambert = np.clip(np.sum(n * to_light, axis=1) / far, 0, 1)
    if not stage.flat:
        _, first, _ = hits(stage, data, light, -to_light / far[:, None], (DRAWN, OBJECT))
        lambert *= np.where(first < far - 2e-3 * stage.radius, 0.35, 1.0)
    facing = np.clip(-np.sum(n * rays[hit], axis=1), 0, 1)
    sky = 0.5 + 0.5 * n[:, 2]
    lit = base * (0.40 + 0.16 * sky + 0.14 * facing + 0.36 * lambert)[:, None]
    planes = stage.model.geom_type[id] == mujoco.mjtGeom.mjGEOM_PLANE
    if planes.any():
        # A floor without end fades into the background around what matters.
        away = np.linalg.norm(p[planes] - stage.centre, axis=1) / (2.5 * stage.radius)
        fade = np.clip(1.6 - away, 0, 1)[:, None]
        lit[planes] = fade * lit[planes] + (1 - fade) * BACKGROUND
    colour[hit] = np.clip(lit, 0, 1)
    return colour


def picture(stage: Stage, data: mujoco.MjData, camera: Camera) -> Array:
    """The image (height, width, 3) in 0…1 of the model in the state of `data` (after mj_kinematics), edges smoothed."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width]
    centres = np.stack([x.ravel(), y.ravel()], axis=1) + 0.5
    image = shade(stage, data, camera, centres).reshape(camera.height, camera.width, 3)
    edge = np.zeros(image.shape[:2], bool)
    for axis in (0, 1):
        step = np.abs(np.diff(image, axis=axis)).max(axis=2) > 0.03
        first, second = (slice(None, -1), slice(1, None))
        index = (first, slice(None)) if axis == 0 else (slice(None), first)
        after = (second, slice(None)) if axis == 0 else (slice(None), second)
        edge[index] |= step
        edge[after] |= step
    rough = np.flatnonzero(edge)
    total = np.zeros((len(rough), 3))
    offsets = (np.arange(SUBRAYS) + 0.5) / SUBRAYS - 0.5
    for du in offsets:
        for dv in offsets:
            total += shade(stage, data, camera, centres[rough] + [du, dv])
    image.reshape(-1, 3)[rough] = total / SUBRAYS**2
    return image


def silhouette(stage: Stage, data: mujoco.MjData, camera: Camera) -> NDArray[np.bool_]:
    """Where (height, width) the object's image is, with everything else out of the way."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width]
    rays = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1) + 0.5)
    return (hits(stage, data, camera.eye, rays, (OBJECT,))[0] >= 0).reshape(camera.height, camera.width)


def _light(camera: Camera) -> Array:
    """Direction to the light, W: above, from the left of and behind the camera."""
    towards = -0.45 * camera.R[0] + 0.45 * camera.R[1] - 0.8 * camera.R[2] + np.array([0.0, 0.0, 0.9])
    return towards / np.linalg.norm(towards)


def _lines(stage: Stage, data: mujoco.MjData, geom: NDArray[np.int64], p: Array, n: Array, half_width: float) -> Array:
    """How much (n,) of each hit lies on a coordinate line of its frame: where x, y or z = 0 cuts a marked surface.

    The distance to the plane is divided by the slope of the surface against it, so that lines keep their width.
    """
    on = np.zeros(len(geom))
    for id in np.unique(geom):
        if not stage.marked[id]:
            continue
        at = geom == id
        if stage.model.geom_group[id] == OBJECT:
            body = stage.model.geom_bodyid[id]
            R, origin = data.xmat[body].reshape(3, 3), data.xpos[body]
        else:
            R, origin = data.geom_xmat[id].reshape(3, 3), data.geom_xpos[id]
        local, slope = (p[at] - origin) @ R, np.sqrt(np.clip(1 - (n[at] @ R) ** 2, 1e-4, 1))
        on[at] = np.clip(1.5 - np.abs(local) / (half_width * slope), 0, 1).max(axis=1)
    return on
