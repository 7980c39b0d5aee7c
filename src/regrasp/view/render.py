"""A plan as one picture: frames side by side as in the paper's Figs. 2 and 4, with contact motions and forces."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from regrasp.plan import MOTIONS, OFF, RELOCATE, Plan
from regrasp.scene.world import World, from_plan
from regrasp.view import strip
from regrasp.view.camera import Camera, candidates, fit
from regrasp.view.frames import Instant, choose, motion_words, put, put_object
from regrasp.view.ink import AGENT_FORCE, AGENTS, DARK, GREY, SUPPORT_FORCE, Ink, chips, rgb
from regrasp.view.shading import DRAWN, HIDDEN, OBJECT, Stage, hits, picture, silhouette

Array = NDArray[np.float64]

WIDTH, HEIGHT, GAP, CAPTION, TITLE = 640, 560, 14, 34, 46
OBJECT_COLOUR = np.array([0.84, 0.81, 0.76])
STATIC_COLOUR = np.array([0.80, 0.81, 0.80])
LONGEST = 1.1
"""Length of the arrow of the largest force, in the object's bounding radii."""


@dataclass(frozen=True)
class Show:
    """A plan with all that its frames have in common: the stage, the camera, the scale of forces (m/N)."""

    plan: Plan
    world: World
    stage: Stage
    camera: Camera
    force_scale: float


def render(plan: Plan, count: int = 6) -> Image.Image:
    """The picture of a plan in at most `count` frames, and its matrix V below them."""
    instants = choose(plan, count)
    show = prepare(plan, instants)
    columns = len(instants) if len(instants) <= 4 else -(-len(instants) // 2)
    rows = -(-len(instants) // columns)
    width = columns * WIDTH + (columns + 1) * GAP
    height = TITLE + rows * (HEIGHT + CAPTION) + GAP + strip.height(plan)
    sheet = Image.new("RGB", (width, height), "white")
    ink = Ink(width, height)
    for number, instant in enumerate(instants):
        corner = (GAP + number % columns * (WIDTH + GAP), TITLE + number // columns * (HEIGHT + CAPTION))
        sheet.paste(frame(show, instant), corner)
        time = plan.time[instant.interval, instant.sample] - plan.time[0, 0]
        words = f"t = {time:.2f} s, interval {instant.interval + 1} of {len(plan.V)}"
        at = np.array([corner[0] + 2.0, corner[1] + HEIGHT + CAPTION / 2])
        ink.text(at, str(number + 1), 16, anchor="lm", bold=True)
        ink.text(at + [18.0, 0.0], words, 15, anchor="lm")
    _title(ink, show)
    strip.draw(ink, plan, instants, _colours(plan), GAP, TITLE + rows * (HEIGHT + CAPTION) + GAP)
    return ink.on(sheet)


def prepare(plan: Plan, instants: Sequence[Instant]) -> Show:
    """World, colours, camera and scale of forces for these instants of a plan."""
    world = from_plan(plan.scene, plan.xml, plan.assets)
    model = copy.copy(world.model)
    colour = np.tile(STATIC_COLOUR, (model.ngeom, 1))
    marked = np.zeros(model.ngeom, bool)
    model.geom_group[:] = HIDDEN
    model.geom_group[world.static_geoms] = DRAWN
    for agent, own in zip(world.agents, _colours(plan), strict=True):
        model.geom_group[agent.geoms] = DRAWN
        # Links are paler than tips: the tips are what the motion is about.
        colour[agent.geoms] = 0.35 * rgb(own) + 0.65 * np.array([0.90, 0.90, 0.90])
        colour[agent.tip_geom] = rgb(own)
        marked[agent.tip_geom] = True
    model.geom_group[world.object_geoms] = OBJECT
    colour[world.object_geoms] = OBJECT_COLOUR
    marked[world.object_geoms] = True
    model.geom_rgba[:, 3] = 1.0
    model.geom_matid[:] = -1
    data = mujoco.MjData(model)
    forces = np.concatenate([plan.force_W, plan.support_force_W], axis=2)
    largest = float(np.linalg.norm(forces, axis=-1).max(initial=0.0))
    scale = LONGEST * _object_radius(world) / largest if largest > 0 else 0.0
    centres, radii = _interest(world, plan, instants, data, scale)
    middle = (centres.min(axis=0) + centres.max(axis=0)) / 2
    radius = float((np.linalg.norm(centres - middle, axis=1) + radii).max())
    flat = set(world.scene.freedoms) <= {"x", "z", "ry"}
    stage = Stage(model, colour, marked, middle, radius, flat)
    if flat:
        camera = fit(np.array([0.0, 1.0, 0.0]), centres, radii, WIDTH, HEIGHT)
    else:
        camera = _best_camera(stage, world, plan, instants, data, centres, radii)
    return Show(plan, world, stage, camera, scale)


def frame(show: Show, instant: Instant) -> Image.Image:
    """One frame: the shaded scene, the goal's outline, the object's way, forces, contact motions."""
    plan, world, camera = show.plan, show.world, show.camera
    data = mujoco.MjData(show.stage.model)
    put(world, plan, instant, data)
    image = picture(show.stage, data, camera)
    ink = Ink(camera.width, camera.height)
    ghost = mujoco.MjData(show.stage.model)
    goal = world.scene.goal.pose
    put_object(world, np.concatenate([goal.p, goal.wxyz]), ghost)
    _ghost(image, silhouette(show.stage, ghost, camera))
    _path(ink, show)
    _frame_axes(ink, show, data)
    _relocations(ink, show, instant)
    _forces(ink, show, instant)
    _motions(ink, show, instant, data)
    return ink.on(Image.fromarray((255 * np.clip(image, 0, 1)).round().astype(np.uint8)))


def _colours(plan: Plan) -> list[str]:
    return [AGENTS[i % len(AGENTS)] for i in range(len(plan.agent_names))]


def _object_radius(world: World) -> float:
    geoms = world.object_geoms
    return float((np.linalg.norm(world.model.geom_pos[geoms], axis=1) + world.model.geom_rbound[geoms]).max())


def _interest(
    world: World, plan: Plan, instants: Sequence[Instant], data: mujoco.MjData, scale: float
) -> tuple[Array, Array]:
    """Spheres in W (centres (n, 3), radii (n,)) a picture must show: object, goal, agents' last bodies, arrows."""
    radius = 1.15 * _object_radius(world)
    centres, radii = [np.array(world.scene.goal.pose.p)], [radius]
    for instant in instants:
        put(world, plan, instant, data)
        centres.append(data.xpos[world.object_body].copy())
        radii.append(radius)
        for agent in world.agents:
            for geom in agent.geoms[world.model.geom_bodyid[agent.geoms] == agent.tip_body]:
                centres.append(data.geom_xpos[geom].copy())
                radii.append(float(world.model.geom_rbound[geom]))
        for head, force, _ in _arrows(plan, instant):
            centres.append(head - scale * force)
            radii.append(0.1 * radius)
    return np.array(centres), np.array(radii)


def _best_camera(
    stage: Stage,
    world: World,
    plan: Plan,
    instants: Sequence[Instant],
    data: mujoco.MjData,
    centres: Array,
    radii: Array,
) -> Camera:
    """The candidate view that hides least: of the tip seen worst, of the tips together, and of the object."""
    tips = np.array([agent.tip_geom for agent in world.agents])

    def score(forward: Array) -> float:
        camera = fit(forward, centres, radii, WIDTH // 8, HEIGHT // 8)
        y, x = np.mgrid[0 : camera.height, 0 : camera.width]
        rays = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1) + 0.5)
        total = 0.0
        for instant in instants:
            put(world, plan, instant, data)
            geom, _, _ = hits(stage, data, camera.eye, rays, (DRAWN, OBJECT))
            seen = np.array([np.sum(geom == tip) for tip in tips], dtype=float)
            size = camera.pixel_size(float(np.linalg.norm(stage.centre - camera.eye)))
            whole = np.pi * (stage.model.geom_size[tips, 0] / size) ** 2
            shares = np.minimum(seen / whole, 1.0)
            total += 1.5 * shares.min() + shares.mean() + np.sum(np.isin(geom, world.object_geoms)) / len(geom) * 4
        return total

    best = max(candidates(), key=score)
    return fit(best, centres, radii, WIDTH, HEIGHT)


def _ghost(image: Array, inside: NDArray[np.bool_]) -> None:
    """Tint where the object will be at the goal, and outline it with a dotted line."""
    wide = np.pad(inside, 1)
    border = inside & ~(wide[:-2, 1:-1] & wide[2:, 1:-1] & wide[1:-1, :-2] & wide[1:-1, 2:])
    y, x = np.nonzero(border)
    middle = np.array([y.mean(), x.mean()]) if y.size else np.zeros(2)
    turn = np.arctan2(y - middle[0], x - middle[1])
    drawn = (turn * 36 / np.pi) % 2 < 1.1
    image[inside] = 0.90 * image[inside] + 0.10 * rgb("#4A6FA5")
    for dy in (0, 1):
        for dx in (0, 1):
            image[np.minimum(y[drawn] + dy, len(image) - 1), np.minimum(x[drawn] + dx, image.shape[1] - 1)] = 0.35


def _path(ink: Ink, show: Show) -> None:
    points = show.plan.object_position.reshape(-1, 3)
    if np.linalg.norm(points - points[0], axis=1).max() > 0.05 * _object_radius(show.world):
        ink.line(show.camera.project(points), GREY, 2.0)


def _frame_axes(ink: Ink, show: Show, data: mujoco.MjData) -> None:
    """The object's axes x, y, z, drawn from its surface outwards; those that point away from the eye are left out."""
    body, radius = show.world.object_body, _object_radius(show.world)
    origin, R = data.xpos[body], data.xmat[body].reshape(3, 3)
    for axis, letter in enumerate("xyz"):
        if R[:, axis] @ show.camera.R[2] > 0.35 or (show.stage.flat and letter == "y"):
            continue
        reach = 0.7 * radius
        start, end = show.camera.project(np.stack([origin, origin + reach * R[:, axis]]))
        if np.linalg.norm(end - start) > 8:
            ink.arrow(start, end, "#555555", 1.6)
            ink.text(end + 9 * (end - start) / np.linalg.norm(end - start), letter, 14, "#444444")


def _relocations(ink: Ink, show: Show, instant: Instant) -> None:
    """The way of every relocating tip through its interval, dashed."""
    data = mujoco.MjData(show.stage.model)
    for i, agent in enumerate(show.world.agents):
        if show.plan.V[instant.interval, i] != RELOCATE:
            continue
        way = []
        for m in range(show.plan.time.shape[1]):
            put(show.world, show.plan, Instant(instant.interval, m), data)
            way.append(data.geom_xpos[agent.tip_geom].copy())
        ink.line(show.camera.project(np.array(way)), DARK, 2.0, dash=(7, 5))


def _forces(ink: Ink, show: Show, instant: Instant) -> None:
    """Every contact force as an arrow whose head is at its contact."""
    for head, force, colour in _arrows(show.plan, instant):
        tail, tip = show.camera.project(np.stack([head - show.force_scale * force, head]))
        ink.arrow(tail, tip, colour)


def _arrows(plan: Plan, instant: Instant) -> list[tuple[Array, Array, str]]:
    """Contact point (W, m), force on the object (W, N) and colour of everything that bears force."""
    at = (instant.interval, instant.sample)
    found = []
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, plan.object_quaternion[at])
    for points, forces, colour in (
        (plan.p_OC_O[at], plan.force_W[at], AGENT_FORCE),
        (plan.support_p_O[at], plan.support_force_W[at], SUPPORT_FORCE),
    ):
        for p_O, f in zip(points, forces, strict=True):
            if np.isfinite(p_O).all() and np.linalg.norm(f) > 0:
                found.append((plan.object_position[at] + R.reshape(3, 3) @ p_O, f, colour))
    return found


def _motions(ink: Ink, show: Show, instant: Instant, data: mujoco.MjData) -> None:
    codes = show.plan.V[instant.interval]
    tips = [agent.tip_geom for agent in show.world.agents]
    size = show.camera.pixel_size(float(np.linalg.norm(show.stage.centre - show.camera.eye)))
    anchors = show.camera.project(data.geom_xpos[tips])
    centre = show.camera.project(data.xpos[show.world.object_body])
    radii = show.world.model.geom_rbound[tips] / size
    words = [motion_words(int(code), MOTIONS) for code in codes]
    colours = [GREY if code == OFF else own for code, own in zip(codes, _colours(show.plan), strict=True)]
    chips(ink, anchors, centre, radii, words, colours)


def _title(ink: Ink, show: Show) -> None:
    """Name of the scene, and what the arrows mean, with a force for scale."""
    name = str(show.plan.scene.get("name", ""))
    ink.text(np.array([GAP, TITLE / 2]), name, 19, anchor="lm", bold=True)
    x, y = float(ink.size[0] - GAP), TITLE / 2
    entries: list[tuple[str, str, float | None]] = [("path of the object", GREY, None), ("goal", DARK, None)]
    if show.force_scale > 0:
        shown = show.force_scale / show.camera.pixel_size(float(np.linalg.norm(show.stage.centre - show.camera.eye)))
        round_force = 10 ** np.floor(np.log10(60 / shown))
        round_force *= max(step for step in (1, 2, 5) if step * round_force * shown <= 60)
        length = float(round_force * shown)
        entries = [
            (f"force of an agent ({round_force:g} N)", AGENT_FORCE, length),
            *([("of a support", SUPPORT_FORCE, length)] if show.plan.support_names else []),
            *entries,
        ]
    for words, colour, arrow in reversed(entries):
        x -= 8.3 * len(words) + 8
        ink.text(np.array([x, y]), words, 14, anchor="lm")
        long = arrow or 30.0
        tail = np.array([x - 10 - long, y])
        if arrow:
            ink.arrow(tail, tail + [long, 0.0], colour)
        else:
            ink.line(np.stack([tail, tail + [long, 0.0]]), colour, 2.0, dash=(4, 4) if words == "goal" else None)
        x -= long + 34
