"""What happened to a plan in physics: frames of an execution side by side with its curves, and what a clip of it shows."""

import itertools
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from regrasp.control.reference import Phases, reference
from regrasp.errors import InputError
from regrasp.plan import Plan
from regrasp.scene.world import World, from_plan
from regrasp.verify.execution import Execution
from regrasp.verify.physics import PERIOD
from regrasp.view import sheet
from regrasp.view.frames import Arrow, State, choose, put_all
from regrasp.view.ink import AGENT_FORCE, DARK
from regrasp.view.plot import Panel
from regrasp.view.show import Show, colours, frame, set_up

Array = NDArray[np.float64]
Limits = tuple[float, float]
"""m and rad by which the object may be off."""

PLANNED = "#4d4d4d"
LEAST = 0.02
"""Forces below this part of the largest are not drawn."""
PLOT = 250


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

    @property
    def time(self) -> Array:
        """Times (S,) of the records, s."""
        return self.run.time

    def state(self, row: int) -> State:
        """The simulated world at a record, with the planned pose of the object and the forces, planned and measured."""
        largest = float(np.linalg.norm(self.run.planned_W, axis=2).max())
        return _state(self.show.world, self.show.plan, self.run, self.pose, self.contact, row, largest)

    def words(self, row: int) -> str:
        """Time and error of a record, and after the last what went wrong."""
        run, (shift, turn) = self.run, self.run.off[row]
        text = f"t = {run.time[row]:.2f} s, off by {1e3 * shift:.1f} mm {np.degrees(turn):.1f}°"
        return f"{text}: {run.trouble.what}" if run.trouble and row == len(run.time) - 1 else text

    def seen_by(self, show: Show) -> "Film":
        """The same with another camera or stage."""
        return replace(self, show=show)


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
    states = [_state(world, plan, run, pose, contact, int(row), largest) for row in some]
    return Film(set_up(plan, world, states, largest), run, pose, contact)


def replayed(film: Film, goal: Limits, tube: Limits, count: int = 4) -> Image.Image:
    """At most `count` (2 or more) instants of an execution, and below them the object's error and the agents' forces.

    goal: the error allowed at the end; tube: on the way.
    """
    run, plan = film.run, film.show.plan
    rows = instants(film, count)
    entries = [*sheet.forces(film.show, False)]
    entries += [replace(entries[0], words="planned force", colour=PLANNED, width=1.5)] if entries else []
    entries += [sheet.Entry("planned pose", DARK, width=1.2), sheet.WAY, sheet.GOAL]
    frames = [frame(film.show, film.state(row)) for row in rows]
    page, ink, top = sheet.lay(film.show, frames, [film.words(row) for row in rows], entries, PLOT)
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


def instants(film: Film, count: int) -> list[int]:
    """At most `count` records that tell the story of the plan as far as it went, the first and the last among them."""
    run, plan = film.run, film.show.plan
    chosen = choose(plan, count, int(run.interval[-1]) + 1)
    times = [plan.time[i.interval, i.sample] - plan.time[0, 0] for i in chosen]
    rows = [int(np.argmin(np.abs(run.time - time))) for time in times]
    return sorted({*rows[:-1], len(run.time) - 1})


def _state(world: World, plan: Plan, run: Execution, pose: Array, contact: Array, row: int, largest: float) -> State:
    data = mujoco.MjData(world.model)
    put_all(world, run.qpos[row], data)
    arrows = []
    for p, f in zip(contact[row], run.planned_W[row], strict=True):
        if np.linalg.norm(f) > LEAST * largest:
            arrows.append(Arrow(p, f, PLANNED, 1.5))
    for agent, f in zip(world.agents, run.force_W[row], strict=True):
        if np.linalg.norm(f) > LEAST * largest:
            arrows.append(Arrow(_touch(world, data, agent.tip_geoms), f, AGENT_FORCE))
    interval = int(run.interval[row])
    begin, end = plan.time[interval, [0, -1]] - plan.time[0, 0]
    part = float(np.clip((run.time[row] - begin) / (end - begin), 0.0, 1.0))
    return State(run.qpos[row], interval, part, tuple(arrows), planned=pose[row])


def _touch(world: World, data: mujoco.MjData, tip: NDArray[np.int64]) -> Array:
    """The point of the object nearest to a tip, W."""
    best, ends, point = np.inf, np.empty(6), data.geom_xpos[tip[0]].copy()
    for piece, geom in itertools.product(tip, world.object_geoms):
        distance = mujoco.mj_geomDistance(world.model, data, piece, geom, world.model.stat.extent, ends)
        if distance < best:
            best, point = distance, ends[3:].copy()
    return point


def _panel(column: int, width: float, top: float, until: float, largest: float) -> Panel:
    return Panel(sheet.GAP + column * width + 44, top + 44, width - 44 - 36, PLOT - 44 - 36, until, largest)
