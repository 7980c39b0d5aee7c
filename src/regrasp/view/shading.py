"""Shaded pictures of a MuJoCo model by casting rays: no display, no OpenGL, every shape exact."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import heap, kernel
from regrasp.kernels.rotations import dot
from regrasp.view.camera import Camera
from regrasp.view.rays import BUNDLE, Shapes, cast, first, from_point, shapes

Array = NDArray[np.float64]

BACKGROUND = np.array([0.975, 0.975, 0.97])
DRAWN, OBJECT, HIDDEN = 0, 1, 5
"""Geom groups of the model to be drawn: everything else, the object, and what is not to be seen."""

TILE = 8
"""Side of the squares that a picture is drawn in, px: as many rays as a bundle has."""


@dataclass(frozen=True)
class Stage:
    """What is drawn and how: a model whose geoms are grouped, their colours and line marks, and the light.

    colour (ngeom, 3) in 0…1; marked (ngeom,) whether a geom carries coordinate lines, which show its turning as the
    radial lines of the paper's Fig. 2 do: the object those of its frame, a tip those of its own; centre (3,) and
    radius: where the interest is, W, m; flat: seen from the side, without shadows; subrays: a pixel on an edge is the
    mean of subrays² rays.
    """

    model: mujoco.MjModel
    colour: Array
    marked: NDArray[np.bool_]
    centre: Array
    radius: float
    flat: bool
    subrays: int = 3


class Look(NamedTuple):
    """How geoms look in one state: colour (ngeom, 3); lined, with coordinate lines of the frame R (ngeom, 3, 3), p
    (ngeom, 3) in W; plane, a floor or wall."""

    colour: Array
    lined: NDArray[np.bool_]
    R: Array
    p: Array
    plane: NDArray[np.bool_]


def hits(
    stage: Stage, data: mujoco.MjData, origin: Array, rays: Array, groups: tuple[int, ...]
) -> tuple[NDArray[np.int64], Array, Array]:
    """First hits of unit rays (n, 3) from `origin`, W: geom (n,) or −1, distance (n,) in m or inf, normal (n, 3)."""
    n = len(rays)
    geom, distance, normal = np.empty(n, np.int64), np.empty(n), np.zeros((n, 3))
    cast(shapes(stage.model, data, groups), origin, rays, geom, distance, normal)
    return geom, distance, normal


def shade(stage: Stage, data: mujoco.MjData, camera: Camera, pixels: Array) -> Array:
    """Colours (n, 3) at image points (n, 2): Lambert and sky light, a hard shadow, lines on marked geoms."""
    model, far = stage.model, float(np.linalg.norm(stage.centre - camera.eye))
    on_object = (model.geom_group == OBJECT)[:, None]
    look = Look(
        stage.colour,
        stage.marked,
        np.where(on_object, data.xmat[model.geom_bodyid], data.geom_xmat).reshape(-1, 3, 3),
        np.where(on_object, data.xpos[model.geom_bodyid], data.geom_xpos),
        model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE,
    )
    light = stage.centre + 12 * stage.radius * _light(camera)
    colour = np.empty((len(pixels), 3))
    _paint(
        shapes(model, data, (DRAWN, OBJECT)), look, camera.eye, camera.rays(pixels), light, not stage.flat,
        stage.centre, stage.radius, 1.3 * camera.pixel_size(far), BACKGROUND, colour,
    )  # fmt: skip
    return colour


def picture(stage: Stage, data: mujoco.MjData, camera: Camera) -> Array:
    """The image (height, width, 3) in 0…1 of the model in the state of `data` (after mj_kinematics), edges smoothed."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width]
    centres = np.stack([x.ravel(), y.ravel()], axis=1) + 0.5
    # Tile after tile, as rays next to one another meet the same shapes.
    order = np.argsort((y // TILE * camera.width + x // TILE).ravel(), kind="stable")
    image = np.empty((camera.height, camera.width, 3))
    image.reshape(-1, 3)[order] = shade(stage, data, camera, centres[order])
    edge = np.zeros(image.shape[:2], bool)
    for axis in (0, 1):
        step = np.abs(np.diff(image, axis=axis)).max(axis=2) > 0.03
        first, second = (slice(None, -1), slice(1, None))
        index = (first, slice(None)) if axis == 0 else (slice(None), first)
        after = (second, slice(None)) if axis == 0 else (slice(None), second)
        edge[index] |= step
        edge[after] |= step
    rough = order[edge.ravel()[order]]
    total = np.zeros((len(rough), 3))
    offsets = (np.arange(stage.subrays) + 0.5) / stage.subrays - 0.5
    for du in offsets:
        for dv in offsets:
            total += shade(stage, data, camera, centres[rough] + [du, dv])
    image.reshape(-1, 3)[rough] = total / stage.subrays**2
    return image


def silhouette(stage: Stage, data: mujoco.MjData, camera: Camera) -> NDArray[np.bool_]:
    """Where (height, width) the object's image is, with everything else out of the way."""
    inside = np.zeros((camera.height, camera.width), bool)
    geoms = np.flatnonzero(stage.model.geom_group == OBJECT)
    centre, bound = data.geom_xpos[geoms], stage.model.geom_rbound[geoms]
    nearest = np.maximum((centre - camera.eye) @ camera.R[2] - bound, 1e-9)
    reach = (bound / (nearest * camera.pixel_size(1.0)))[:, None]
    middle, limit = camera.project(centre), [camera.width, camera.height]
    left, top = np.clip(np.floor((middle - reach).min(axis=0)), 0, limit).astype(int)
    right, bottom = np.clip(np.ceil((middle + reach).max(axis=0)), 0, limit).astype(int)
    y, x = np.mgrid[top:bottom, left:right]
    rays = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1) + 0.5)
    inside[top:bottom, left:right] = (hits(stage, data, camera.eye, rays, (OBJECT,))[0] >= 0).reshape(x.shape)
    return inside


def _light(camera: Camera) -> Array:
    """Direction to the light, W: above, from the left of and behind the camera."""
    towards = -0.45 * camera.R[0] + 0.45 * camera.R[1] - 0.8 * camera.R[2] + np.array([0.0, 0.0, 0.9])
    return towards / np.linalg.norm(towards)


@heap
def _paint(
    shapes: Shapes, look: Look, eye: Array, rays: Array, light: Array, shadows: bool, centre: Array, radius: float,
    half_width: float, background: Array, colour: Array,
) -> None:  # fmt: skip
    """Colours (n, 3) of what unit rays (n, 3) from the eye see. A floor without end fades into the background around
    what matters: the sphere (centre, radius)."""
    seen, lit = from_point(shapes, eye), from_point(shapes, light)
    ids, distance, normals = np.empty(BUNDLE, np.int64), np.empty(BUNDLE), np.empty((BUNDLE, 3))
    points, down, far, shown = np.empty((BUNDLE, 3)), np.empty((BUNDLE, 3)), np.empty(BUNDLE), np.empty(BUNDLE)
    others, lit_at, unused = np.empty(BUNDLE, np.int64), np.empty(BUNDLE), np.empty((BUNDLE, 3))
    for begin in range(0, len(rays), BUNDLE):
        bundle = rays[begin : begin + BUNDLE]
        size = len(bundle)
        first(shapes, seen[0], seen[1], bundle, ids[:size], distance[:size], normals[:size])
        for i in range(size):
            shown[i] = 0.0 if ids[i] < 0 else 1.0
            for c in range(3):
                # From the light what hits nothing is looked for at the centre, as a direction is needed.
                points[i, c] = eye[c] + distance[i] * bundle[i, c] if ids[i] >= 0 else centre[c]
            if ids[i] >= 0 and look.plane[ids[i]]:
                shown[i] = min(max(1.6 - _apart(points[i], centre) / (2.5 * radius), 0.0), 1.0)
                if shown[i] == 0.0:
                    points[i] = centre
            far[i] = _apart(points[i], light)
            for c in range(3):
                down[i, c] = (points[i, c] - light[c]) / far[i]
        if shadows:
            first(shapes, lit[0], lit[1], down[:size], others[:size], lit_at[:size], unused[:size])
        for i in range(size):
            own = colour[begin + i]
            for c in range(3):
                own[c] = background[c]
            if shown[i] == 0.0:
                continue
            id, n = ids[i], normals[i]
            facing = -dot(n, bundle[i])
            for c in range(3):
                n[c] *= math.copysign(1.0, facing)
            lambert = min(max(-dot(n, down[i]), 0.0), 1.0)
            if shadows and lit_at[i] < far[i] - 2e-3 * radius:
                lambert *= 0.35
            strength = 0.40 + 0.16 * (0.5 + 0.5 * n[2]) + 0.14 * abs(facing) + 0.36 * lambert
            if look.lined[id]:
                strength *= 1.0 - 0.55 * _line(look.R[id], look.p[id], points[i], n, half_width)
            for c in range(3):
                lit_colour = look.colour[id, c] * strength
                own[c] = min(max(shown[i] * lit_colour + (1.0 - shown[i]) * background[c], 0.0), 1.0)


@kernel
def _line(R: Array, origin: Array, p: Array, n: Array, half_width: float) -> float:
    """How much of a hit lies on a coordinate line of a frame: where x, y or z = 0 cuts a surface with normal n, W.

    The distance to the plane is divided by the slope of the surface against it, so that lines keep their width.
    """
    on = 0.0
    for c in range(3):
        away, steep = 0.0, 0.0
        for r in range(3):
            away += (p[r] - origin[r]) * R[r, c]
            steep += n[r] * R[r, c]
        slope = math.sqrt(min(max(1.0 - steep * steep, 1e-4), 1.0))
        on = max(on, min(max(1.5 - abs(away) / (half_width * slope), 0.0), 1.0))
    return on


@kernel
def _apart(p: Array, q: Array) -> float:
    return math.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)
