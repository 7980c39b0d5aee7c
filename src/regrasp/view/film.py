"""What happened to a plan in physics: frames of an execution side by side with its curves, or a moving picture."""

import itertools
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from regrasp.control.reference import Phases, reference
from regrasp.errors import InputError
from regrasp.plan import Plan
from regrasp.processors import available
from regrasp.scene.world import World, from_plan
from regrasp.verify.execution import Execution
from regrasp.verify.physics import PERIOD
from regrasp.view import sheet
from regrasp.view.frames import Arrow, State, choose, put_all
from regrasp.view.ink import AGENT_FORCE, DARK, GREY, Ink, rgb
from regrasp.view.plot import Panel
from regrasp.view.show import HEIGHT, WIDTH, Show, colours, frame, set_up

Array = NDArray[np.float64]
Limits = tuple[float, float]
"""m and rad by which the object may be off."""

PLANNED = "#4d4d4d"
LEAST = 0.02
"""Forces below this part of the largest are not drawn."""
PLOT = 250
CLIP_WIDTH, CLIP_HEIGHT, BAR = 480, 420, 32
DELAY = 70
"""ms from one picture of a clip to the next: GIF counts in hundredths of a second."""
LAST = 1500
"""ms for which the last one stands."""
MOST = 150
"""Pictures of a clip; what is longer runs faster."""


@dataclass(frozen=True)
class Film:
    """An execution with all that its pictures have in common.

    pose (S, 7): the object's planned pose at every record, position and quaternion w x y z. contact (S, k, 3): where
    the plan has the agents touch, W, m.
    """

    show: Show
    run: Execution
    pose: Array
    contact: Array


def prepare(plan: Plan, run: Execution) -> Film:
    """The planned motion at the execution's records, and one camera for all of them.

    Raises InputError for an execution without any record.
    """
    if not len(run.time):
        why = run.trouble.what if run.trouble else "no record"
        raise InputError("execution", f"ended before the object was released: {why}", "there is nothing to draw")
    world = from_plan(plan.scene, plan.xml, plan.assets)
    path = reference(plan, world, PERIOD, Phases())
    rows = np.minimum(path.start + np.round(run.time / PERIOD).astype(int), path.end)
    quaternion = np.empty((len(rows), 4))
    for own, R in zip(quaternion, path.R_WO[rows], strict=True):
        mujoco.mju_mat2Quat(own, R.ravel())
    pose, contact = np.concatenate([path.p_WO[rows], quaternion], axis=1), path.p_WC[rows]
    # Impacts last a few records: they must not make all other arrows small.
    measured = np.quantile(np.linalg.norm(run.force_W, axis=2).max(axis=1), 0.99)
    largest = float(max(measured, np.linalg.norm(run.planned_W, axis=2).max()))
    some = np.unique(np.linspace(0, len(rows) - 1, 8).astype(int))
    states = [_state(world, run, pose, contact, int(row), largest) for row in some]
    return Film(set_up(plan, world, states, largest, WIDTH, HEIGHT), run, pose, contact)


def replayed(film: Film, goal: Limits, tube: Limits, count: int = 4) -> Image.Image:
    """At most `count` (2 or more) instants of an execution, and below them the object's error and the agents' forces.

    goal: the error allowed at the end; tube: on the way.
    """
    run, plan = film.run, film.show.plan
    rows = instants(film, count)
    entries = [*sheet.forces(film.show, False)]
    entries += [replace(entries[0], words="planned force", colour=PLANNED, width=1.5)] if entries else []
    entries += [sheet.Entry("planned pose", DARK, width=1.2), sheet.WAY, sheet.GOAL]
    frames = [frame(film.show, state(film, row)) for row in rows]
    page, ink, top = sheet.lay(film.show, frames, [words(run, row) for row in rows], entries, PLOT)
    marks = run.time[rows]
    width = (ink.size[0] - 2 * sheet.GAP) / 3
    until, end = float(max(run.time[-1], 1e-3)), float(plan.time[-1, -1] - plan.time[0, 0])
    for column, (unit, heading) in enumerate(((1e3, "position error, mm"), (180 / np.pi, "rotation error, °"))):
        error = unit * run.off[:, column]
        limit, way = unit * goal[column], unit * tube[column]
        panel = _panel(column, width, top, until, 1.15 * max(error.max(), limit))
        panel.axes(ink, heading, marks)
        panel.limit(ink, limit, end, "allowed at the end", AGENT_FORCE)
        panel.limit(ink, way, 0.0, "allowed on the way", AGENT_FORCE)
        ink.line(panel.at(run.time, error), DARK, 2.0)
    measured, planned = np.linalg.norm(run.force_W, axis=2), np.linalg.norm(run.planned_W, axis=2)
    panel = _panel(2, width, top, until, 1.1 * float(max(measured.max(), planned.max(), 1e-3)))
    panel.axes(ink, "force of each agent, N (dashed: as planned)", marks)
    for i, colour in enumerate(colours(plan)):
        ink.line(panel.at(run.time, measured[:, i]), colour, 2.0)
        ink.line(panel.at(run.time, planned[:, i]), colour, 1.4, dash=(4, 3))
    return ink.on(page)


def clip(film: Film, path: str | os.PathLike[str], speed: float | None = None, cores: int | None = None) -> int:
    """Write an execution as an animated GIF; the number of its pictures.

    speed: of the clip, as a multiple of real time; by default 1, or 2, 4 … where there would be too many pictures.
    cores: processes at work, by default one on each core.
    """
    speed = speed or pace(film.run)
    rows = ticks(film.run, speed)
    camera = replace(film.show.camera, width=CLIP_WIDTH, height=CLIP_HEIGHT)
    film = replace(film, show=replace(film.show, camera=camera, stage=replace(film.show.stage, subrays=2)))
    workers = min(cores or available(), len(rows))
    shares = [rows[first::workers] for first in range(workers)]
    if workers == 1:
        done = [_pictures(film, rows, speed)]
    else:
        with ProcessPoolExecutor(workers) as pool:
            done = list(pool.map(_pictures, [film] * workers, shares, [speed] * workers))
    pictures = [done[number % workers][number // workers] for number in range(len(rows))]
    # One palette for all: what stands still keeps its colour, and only what moves is stored.
    some = [np.asarray(pictures[i]) for i in np.unique(np.linspace(0, len(rows) - 1, 6).astype(int))]
    accents = (255 * np.array([rgb(colour) for colour in (AGENT_FORCE, *colours(film.show.plan))])).round()
    # The colours that carry meaning cover little of a picture: the palette's method would mix them with others.
    some.append(np.repeat(accents.astype(np.uint8), 40 * CLIP_WIDTH, axis=0).reshape(-1, CLIP_WIDTH, 3))
    palette = Image.fromarray(np.concatenate(some)).quantize(255, method=Image.Quantize.MEDIANCUT)
    plain = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures]
    delays = [DELAY] * (len(rows) - 1) + [LAST]
    plain[0].save(Path(path), "GIF", save_all=True, append_images=plain[1:], duration=delays, loop=0, disposal=1)
    return len(rows)


def instants(film: Film, count: int) -> list[int]:
    """At most `count` records that tell the story of the plan as far as it went, the first and the last among them."""
    run, plan = film.run, film.show.plan
    chosen = choose(plan, count, int(run.interval[-1]) + 1)
    times = [plan.time[i.interval, i.sample] - plan.time[0, 0] for i in chosen]
    rows = [int(np.argmin(np.abs(run.time - time))) for time in times]
    return sorted({*rows[:-1], len(run.time) - 1})


def pace(run: Execution) -> float:
    """The slowest of real time, twice, four times … as fast that needs no more than MOST pictures."""
    speed = 1.0
    while len(ticks(run, speed)) > MOST:
        speed *= 2
    return speed


def ticks(run: Execution, speed: float) -> list[int]:
    """Records at which a clip's pictures are taken: every DELAY ms of the clip from the first, and the last."""
    step = speed * DELAY / 1000
    times = run.time[0] + step * np.arange(round((run.time[-1] - run.time[0]) / step) + 1)
    rows = [int(row) for row in np.abs(run.time[:, None] - times).argmin(axis=0)]
    return [*rows[:-1], len(run.time) - 1]


def state(film: Film, row: int) -> State:
    """The simulated world at a record, with the planned pose of the object and the forces, planned and measured."""
    largest = float(np.linalg.norm(film.run.planned_W, axis=2).max())
    return _state(film.show.world, film.run, film.pose, film.contact, row, largest)


def words(run: Execution, row: int) -> str:
    """Time and error of a record, and after the last what went wrong."""
    shift, turn = run.off[row]
    text = f"t = {run.time[row]:.2f} s, off by {1e3 * shift:.1f} mm {np.degrees(turn):.1f}°"
    return f"{text}: {run.trouble.what}" if run.trouble and row == len(run.time) - 1 else text


def _state(world: World, run: Execution, pose: Array, contact: Array, row: int, largest: float) -> State:
    data = mujoco.MjData(world.model)
    put_all(world, run.qpos[row], data)
    arrows = []
    for p, f in zip(contact[row], run.planned_W[row], strict=True):
        if np.linalg.norm(f) > LEAST * largest:
            arrows.append(Arrow(p, f, PLANNED, 1.5))
    for agent, f in zip(world.agents, run.force_W[row], strict=True):
        if np.linalg.norm(f) > LEAST * largest:
            arrows.append(Arrow(_touch(world, data, agent.tip_geoms), f, AGENT_FORCE))
    return State(run.qpos[row], int(run.interval[row]), tuple(arrows), planned=pose[row])


def _touch(world: World, data: mujoco.MjData, tip: NDArray[np.int64]) -> Array:
    """The point of the object nearest to a tip, W."""
    best, ends, point = np.inf, np.empty(6), data.geom_xpos[tip[0]].copy()
    for piece, geom in itertools.product(tip, world.object_geoms):
        distance = mujoco.mj_geomDistance(world.model, data, piece, geom, world.model.stat.extent, ends)
        if distance < best:
            best, point = distance, ends[3:].copy()
    return point


def _pictures(film: Film, rows: Sequence[int], speed: float) -> list[Image.Image]:
    """A clip's pictures: the frame, and a bar below it with time and error."""
    made = []
    for row in rows:
        page = Image.new("RGB", (CLIP_WIDTH, CLIP_HEIGHT + BAR), "white")
        page.paste(frame(film.show, state(film, row)), (0, 0))
        ink = Ink(*page.size)
        middle = CLIP_HEIGHT + BAR / 2
        ink.text(np.array([10, middle]), words(film.run, row), 15, anchor="lm")
        if speed != 1.0:
            ink.text(np.array([CLIP_WIDTH - 10, middle]), f"{speed:g}×", 15, GREY, anchor="rm", bold=True)
        made.append(ink.on(page))
    return made


def _panel(column: int, width: float, top: float, until: float, largest: float) -> Panel:
    return Panel(sheet.GAP + column * width + 44, top + 44, width - 44 - 36, PLOT - 44 - 36, until, largest)
