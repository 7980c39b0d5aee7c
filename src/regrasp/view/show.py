"""What all frames of one picture or film share: the stage, one camera, the scale of forces; and the drawing of a frame."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from regrasp.plan import MOTIONS, OFF, Plan
from regrasp.scene.world import World
from regrasp.view.camera import Camera
from regrasp.view.frames import State, motion_words, put_all, put_object
from regrasp.view.framing import framed, interest
from regrasp.view.ink import AGENTS, DARK, GREY, Ink, chips, rgb
from regrasp.view.shading import DRAWN, HIDDEN, OBJECT, Stage, picture, silhouette
from regrasp.view.viewpoint import LONGEST, object_radius, towards

Array = NDArray[np.float64]

WIDTH = 640
OBJECT_COLOUR = np.array([0.84, 0.81, 0.76])
STATIC_COLOUR = np.array([0.80, 0.81, 0.80])


@dataclass(frozen=True)
class Show:
    """A plan with all that its frames have in common: the stage, the camera, the scale of forces (m/N)."""

    plan: Plan
    world: World
    stage: Stage
    camera: Camera
    force_scale: float


def set_up(plan: Plan, world: World, states: Sequence[State], largest: float) -> Show:
    """Colours, camera and scale of forces for these states of a plan's world; largest: force, N."""
    model = copy.copy(world.model)
    colour = np.tile(STATIC_COLOUR, (model.ngeom, 1))
    marked = np.zeros(model.ngeom, bool)
    model.geom_group[:] = HIDDEN
    model.geom_group[world.static_geoms] = DRAWN
    for arm in world.arms:
        model.geom_group[arm.geoms] = DRAWN
    for agent, own in zip(world.agents, colours(plan), strict=True):
        model.geom_group[agent.geoms] = DRAWN
        # Links are paler than tips: the tips are what the motion is about.
        colour[agent.geoms] = 0.35 * rgb(own) + 0.65 * np.array([0.90, 0.90, 0.90])
        colour[agent.tip_geoms] = rgb(own)
        marked[agent.tip_geoms] = True
    model.geom_group[world.object_geoms] = OBJECT
    colour[world.object_geoms] = OBJECT_COLOUR
    marked[world.object_geoms] = True
    model.geom_rgba[:, 3] = 1.0
    model.geom_matid[:] = -1
    data = mujoco.MjData(model)
    scale = LONGEST * object_radius(world) / largest if largest > 0 else 0.0
    centres, radii = interest(world, states, data, scale)
    middle = (centres.min(axis=0) + centres.max(axis=0)) / 2
    radius = float((np.linalg.norm(centres - middle, axis=1) + radii).max())
    flat = set(world.scene.freedoms) <= {"x", "z", "ry"}
    stage = Stage(model, colour, marked, middle, radius, flat)
    forward = -towards(world, [state.qpos for state in states])
    return Show(plan, world, stage, framed(forward, centres, radii, WIDTH), scale)


def frame(show: Show, state: State) -> Image.Image:
    """One frame: the shaded scene, the goal's tint and outline, the object's way, what should be, tips' ways, forces,
    contact motions."""
    world, camera = show.world, show.camera
    data = mujoco.MjData(show.stage.model)
    put_all(world, state.qpos, data)
    image = picture(show.stage, data, camera)
    ghost = mujoco.MjData(show.stage.model)
    goal = world.scene.goal.pose
    put_object(world, np.concatenate([goal.p, goal.wxyz]), ghost)
    _tint(image, silhouette(show.stage, ghost, camera))
    if state.planned is not None:
        put_object(world, state.planned, ghost)
        _outline(image, silhouette(show.stage, ghost, camera))
    ink = Ink(camera.width, camera.height)
    _path(ink, show)
    _frame_axes(ink, show, data)
    for way in state.ways:
        ink.line(camera.project(way), DARK, 2.0, dash=(7, 5))
    for arrow in state.arrows:
        tail, tip = camera.project(np.stack([arrow.head - show.force_scale * arrow.force, arrow.head]))
        ink.arrow(tail, tip, arrow.colour, arrow.width)
    _motions(ink, show, state, data)
    return ink.on(Image.fromarray((255 * np.clip(image, 0, 1)).round().astype(np.uint8)))


def colours(plan: Plan) -> list[str]:
    """The agents' own colours."""
    return [AGENTS[i % len(AGENTS)] for i in range(len(plan.agent_names))]


def _tint(image: Array, inside: NDArray[np.bool_]) -> None:
    """Tint where the object will be at the goal, and outline it with a dotted line."""
    y, x = np.nonzero(_border(inside))
    middle = np.array([y.mean(), x.mean()]) if y.size else np.zeros(2)
    turn = np.arctan2(y - middle[0], x - middle[1])
    drawn = (turn * 36 / np.pi) % 2 < 1.1
    image[inside] = 0.90 * image[inside] + 0.10 * rgb("#4A6FA5")
    for dy in (0, 1):
        for dx in (0, 1):
            image[np.minimum(y[drawn] + dy, len(image) - 1), np.minimum(x[drawn] + dx, image.shape[1] - 1)] = 0.35


def _outline(image: Array, inside: NDArray[np.bool_]) -> None:
    """A thin dark line round it."""
    border = _border(inside)
    image[border] = 0.2 * image[border] + 0.8 * rgb(DARK)


def _border(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The outermost pixels (height, width) of a region."""
    wide = np.pad(inside, 1)
    return inside & ~(wide[:-2, 1:-1] & wide[2:, 1:-1] & wide[1:-1, :-2] & wide[1:-1, 2:])


def _path(ink: Ink, show: Show) -> None:
    points = show.plan.object_position.reshape(-1, 3)
    if np.linalg.norm(points - points[0], axis=1).max() > 0.05 * object_radius(show.world):
        ink.line(show.camera.project(points), GREY, 2.0)


def _frame_axes(ink: Ink, show: Show, data: mujoco.MjData) -> None:
    """The object's axes x, y, z, drawn from its surface outwards; those that point away from the eye are left out."""
    body, radius = show.world.object_body, object_radius(show.world)
    origin, R = data.xpos[body], data.xmat[body].reshape(3, 3)
    for axis, letter in enumerate("xyz"):
        if R[:, axis] @ show.camera.R[2] > 0.35 or (show.stage.flat and letter == "y"):
            continue
        reach = 0.7 * radius
        start, end = show.camera.project(np.stack([origin, origin + reach * R[:, axis]]))
        if np.linalg.norm(end - start) > 8:
            ink.arrow(start, end, "#555555", 1.6)
            ink.text(end + 9 * (end - start) / np.linalg.norm(end - start), letter, 14, "#444444")


def _motions(ink: Ink, show: Show, state: State, data: mujoco.MjData) -> None:
    codes = show.plan.V[state.interval]
    tips = [agent.tip_geom for agent in show.world.agents]
    size = show.camera.pixel_size(float(np.linalg.norm(show.stage.centre - show.camera.eye)))
    anchors = show.camera.project(data.geom_xpos[tips])
    centre = show.camera.project(data.xpos[show.world.object_body])
    radii = show.world.model.geom_rbound[tips] / size
    words = [motion_words(int(code), MOTIONS) for code in codes]
    own = [GREY if code == OFF else colour for code, colour in zip(codes, colours(show.plan), strict=True)]
    chips(ink, anchors, centre, radii, words, own)
