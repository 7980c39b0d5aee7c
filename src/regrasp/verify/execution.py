"""One execution of a plan in physics, recorded: where the object went, what the contacts bore, what went wrong."""

import time
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from regrasp.control.controller import Control, Controller, agent_joints
from regrasp.control.feedback import displacement
from regrasp.control.impedance import Gains
from regrasp.control.reference import Reference, delayed
from regrasp.scene.world import World
from regrasp.verify.physics import PERIOD, Physics, Reality

Array = NDArray[np.float64]

EVERY = 5
"""Periods from one record to the next."""
LOST = 0.5
"""Parts of the object's radius by which it may be off its path before it counts as dropped, …"""
TURNED = np.radians(45.0)
"""… and the turn."""


@dataclass(frozen=True)
class Touch:
    """A contact that the plan does not have: the bodies' geoms and the plan's time, s."""

    first: str
    second: str
    time: float


@dataclass(frozen=True)
class Trouble:
    """Why an execution could not go on: numbers that went bad, or a drop. time: s, on the plan's clock; body: its name."""

    what: str
    body: str
    time: float


@dataclass(frozen=True)
class Execution:
    """S records, every EVERY periods from the release of the object on; k agents.

    time (S,): on the plan's clock, s. interval (S,): of the plan. qpos (S, nq): of the model. error (S, 6): the object's
    displacement from its path, m and rad in W. force_W, planned_W (S, k, 3): of the agents on the object, measured and
    planned, N. bears (S, k): who should be in contact. slip (S, k): how far the tip has come on the object
    by sliding so far, where the plan has it roll or stay, m. strained (S, k): whether a drive was at its limit. touches:
    contacts that the plan does not have, the first of each pair. seconds: of simulated time; wall: that it took.
    """

    time: Array
    interval: NDArray[np.int64]
    qpos: Array
    error: Array
    force_W: Array
    planned_W: Array
    bears: NDArray[np.bool_]
    slip: Array
    strained: NDArray[np.bool_]
    touches: tuple[Touch, ...]
    trouble: Trouble | None
    seconds: float
    wall: float

    @property
    def off(self) -> Array:
        """|shift| in m and |turn| in rad of the object off its path, (S, 2)."""
        return np.stack([np.linalg.norm(self.error[:, :3], axis=1), np.linalg.norm(self.error[:, 3:], axis=1)], axis=1)


def execute(
    world: World, reference: Reference, sliding: NDArray[np.bool_], wanted: Gains, reality: Reality,
    control: Control, sees: bool, rng: np.random.Generator,
) -> Execution:  # fmt: skip
    """Run a reference in a world of the given reality. sliding (N, k): whom the plan lets slide; rng: of the sensor and
    the timing errors."""
    began = time.perf_counter()
    if reality.delay > 0.0:
        reference = delayed(reference, agent_joints(world), reality.delay, rng)
    physics = Physics(world, reality, wanted)
    controller = Controller(world, reference, control)
    physics.place(reference.q[0])
    record = Recorder(world, physics, reference, sliding)
    every = max(1, round(control.feedback.period / PERIOD))
    trouble = None
    row = 0
    for row in range(len(reference)):
        if row == reference.start:
            physics.release()
        command = controller.command(row, physics.q, physics.qd)
        if row % every == 0:
            seen = None
            if sees:
                turn = Rotation.from_rotvec(reality.noise[1] * rng.standard_normal(3)).as_matrix()
                seen = (physics.p_WO + reality.noise[0] * rng.standard_normal(3), turn @ physics.R_WO)
            controller.update(row, seen)
        physics.step(command)
        if row % EVERY == 0 or physics.data.warning.number.any():  # a bad number is soon in every body
            trouble = find_trouble(world, physics, reference, row)
            if trouble:
                break
            if row >= reference.start:
                record.take(row)
    return record.execution(trouble, (row + 1) * PERIOD, time.perf_counter() - began)


def find_trouble(world: World, physics: Physics, reference: Reference, row: int) -> Trouble | None:
    """Warnings of MuJoCo, numbers that are not finite, a dropped object."""
    model, data, now = physics.model, physics.data, reference.time(row)
    for kind in np.flatnonzero(data.warning.number):
        name = mujoco.mjtWarning(int(kind)).name.removeprefix("mjWARN_").lower()
        dof = int(data.warning.lastinfo[kind])
        body = model.body(int(model.dof_bodyid[min(max(dof, 0), model.nv - 1)])).name
        return Trouble(f"MuJoCo warns: {name}", body, now)
    bad = ~np.isfinite(data.qvel)
    if bad.any():
        return Trouble("not a finite number", model.body(int(model.dof_bodyid[np.argmax(bad)])).name, now)
    error = displacement(reference.p_WO[row], reference.R_WO[row], physics.p_WO, physics.R_WO)
    upright = float(np.trace(physics.R_WO @ reference.R_WO[row].T)) > 1.0 + 2.0 * np.cos(TURNED)
    if np.linalg.norm(error[:3]) > LOST * model.geom_rbound[world.object_geoms].max() or not upright:
        return Trouble("dropped", "object", now)
    return None


class Recorder:
    """Takes records of a world under way."""

    def __init__(self, world: World, physics: Physics, reference: Reference, sliding: NDArray[np.bool_]) -> None:
        self._physics, self._reference, self._sliding = physics, reference, sliding
        model = physics.model
        self._agent = np.full(model.ngeom, -1)
        for i, agent in enumerate(world.agents):
            self._agent[agent.tip_geom] = i
        self._object = np.isin(np.arange(model.ngeom), world.object_geoms)
        self._legal = self._agent >= 0
        self._legal[world.support_geoms] = True
        self._joints = agent_joints(world)
        self._limit = np.where(model.actuator_forcelimited, model.actuator_forcerange[:, 1], np.inf)
        self._rows: list[int] = []
        self._qpos: list[Array] = []
        self._error: list[Array] = []
        self._force: list[Array] = []
        self._slid = np.zeros((len(world.agents), 3))  # in the object's frame
        self._slip: list[Array] = []
        self._strained: list[NDArray[np.bool_]] = []
        self._touches: dict[tuple[int, int], Touch] = {}

    def take(self, row: int) -> None:
        """Record the state after the step of this row."""
        physics, ref = self._physics, self._reference
        force, slip = self._contacts(row)
        data = physics.data
        self._rows.append(row)
        self._qpos.append(data.qpos.copy())
        self._error.append(displacement(ref.p_WO[row], ref.R_WO[row], physics.p_WO, physics.R_WO))
        self._force.append(force)
        self._slid += slip @ physics.R_WO * (EVERY * PERIOD)
        self._slip.append(np.linalg.norm(self._slid, axis=1))
        full = np.abs(data.actuator_force) >= 0.999 * self._limit
        at = full[physics.drives.actuator]
        self._strained.append(np.array([at[mine].any() for mine in self._joints]))

    def _contacts(self, row: int) -> tuple[Array, Array]:
        """Force on the object and velocity of slip over it (k, 3), in W; contacts the plan does not have are noted."""
        data, k = self._physics.data, len(self._joints)
        force, slip = np.zeros((k, 3)), np.zeros((k, 3))
        interval = max(0, self._reference.interval[row])
        contact = data.contact
        for (a, b), address, frame in zip(contact.geom, contact.efc_address, contact.frame, strict=True):
            if address < 0:
                continue
            if self._object[b]:
                other, sign = a, 1.0
            else:
                other, sign = b, -1.0
            if not (self._object[a] or self._object[b]) or not self._legal[other]:
                self._note(int(a), int(b), row)
                continue
            i = self._agent[other]
            if i < 0:
                continue
            # Rows of an elliptic contact: normal, then the two tangents of its frame; forces act on the second geom.
            force[i] += sign * (data.efc_force[address : address + 3] @ frame.reshape(3, 3))
            if self._reference.bears[row, i] and not self._sliding[interval, i]:
                slip[i] = -sign * (data.efc_vel[address + 1 : address + 3] @ frame.reshape(3, 3)[1:])
        return force, slip

    def _note(self, a: int, b: int, row: int) -> None:
        if (a, b) not in self._touches:
            model = self._physics.model
            self._touches[a, b] = Touch(model.geom(a).name, model.geom(b).name, self._reference.time(row))

    def execution(self, trouble: Trouble | None, seconds: float, wall: float) -> Execution:
        """All records as one value."""
        ref, rows = self._reference, np.array(self._rows, dtype=int)
        k, nq = len(self._joints), self._physics.model.nq
        return Execution(
            time=(rows - ref.start) * ref.period,
            interval=ref.interval[rows],
            qpos=np.array(self._qpos).reshape(-1, nq),
            error=np.array(self._error).reshape(-1, 6),
            force_W=np.array(self._force).reshape(-1, k, 3),
            planned_W=ref.force_W[rows],
            bears=ref.bears[rows],
            slip=np.array(self._slip).reshape(-1, k),
            strained=np.array(self._strained, dtype=bool).reshape(-1, k),
            touches=tuple(self._touches.values()),
            trouble=trouble,
            seconds=seconds,
            wall=wall,
        )
