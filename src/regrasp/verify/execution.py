"""One execution of a plan in physics, recorded: where the object went, what the contacts bore, what went wrong."""

import math
import time
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.spatial.transform import Rotation

from regrasp.control.controller import Control, Controller, agent_joints
from regrasp.control.feedback import displacement
from regrasp.control.impedance import Gains
from regrasp.control.reference import Reference, delayed
from regrasp.scene.world import World
from regrasp.verify.physics import PERIOD, Physics, Reality, quiet

Array = NDArray[np.float64]

EVERY = 10
"""Periods from one record to the next."""
NEAR = 0.06
"""s before touch-down and after lift-off in which a fingertip may touch the object."""
LOST = 0.5
"""Parts of the object's radius by which it may be off its path before it counts as dropped, …"""
TURNED = np.radians(45.0)
"""… and the turn, rad."""


@dataclass(frozen=True)
class Touch:
    """A contact that the plan does not have. first, second: who, a tip by its agent's name, else a body or a static geom;
    an agent comes before the object, a static geom last. time: s, on the plan's clock.
    """

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
    world: World, reference: Reference, wanted: Gains, reality: Reality, control: Control, sees: bool,
    rng: np.random.Generator,
) -> Execution:  # fmt: skip
    """Run a reference in a world of the given reality. sees: with object feedback; rng: of the sensor and the timing
    errors."""
    with quiet():
        return _execute(world, reference, wanted, reality, control, sees, rng)


def _execute(
    world: World, reference: Reference, wanted: Gains, reality: Reality, control: Control, sees: bool,
    rng: np.random.Generator,
) -> Execution:  # fmt: skip
    began = time.perf_counter()
    if reality.delay > 0.0:
        reference = delayed(reference, agent_joints(world), reality.delay, rng)
    physics = Physics(world, reality, wanted)
    controller = Controller(world, reference, control, physics.drives.gains.K)
    physics.place(reference.q[0])
    record = Recorder(world, physics, reference)
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
            error = displacement(reference.p_WO[row], reference.R_WO[row], physics.p_WO, physics.R_WO)
            trouble = find_trouble(world, physics, reference.time(row), error)
            if trouble:
                break
            if row >= reference.start:
                record.take(row, error)
    return record.execution(trouble, (row + 1) * PERIOD, time.perf_counter() - began)


def find_trouble(world: World, physics: Physics, now: float, error: Array) -> Trouble | None:
    """Warnings of MuJoCo, numbers that are not finite, an object dropped: displaced by error (6,)."""
    model, data = physics.model, physics.data
    for kind in np.flatnonzero(data.warning.number):
        name = mujoco.mjtWarning(int(kind)).name.removeprefix("mjWARN_").lower()
        dof = int(data.warning.lastinfo[kind])
        body = model.body(int(model.dof_bodyid[min(max(dof, 0), model.nv - 1)])).name
        return Trouble(f"MuJoCo warns: {name}", body, now)
    bad = ~np.isfinite(data.qvel)
    if bad.any():
        return Trouble("not a finite number", model.body(int(model.dof_bodyid[np.argmax(bad)])).name, now)
    shift, turn = math.hypot(*error[:3]), math.hypot(*error[3:])
    if shift > LOST * model.geom_rbound[world.object_geoms].max() or turn > TURNED:
        return Trouble("dropped", "object", now)
    return None


def geom_names(world: World, model: mujoco.MjModel) -> tuple[list[str], NDArray[np.int64]]:
    """Name and rank of every geom in a Touch: agents (0), the object (1), all else (2)."""
    names, rank = [], np.full(model.ngeom, 2)
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        names.append((model.body(body).name if body else "") or model.geom(geom).name or f"geom {geom}")
    for agent in world.agents:
        rank[agent.geoms] = 0
        for geom in agent.tip_geoms:
            names[geom] = agent.name
    rank[world.object_geoms] = 1
    return names, rank


class Recorder:
    """Takes records of a world under way."""

    def __init__(self, world: World, physics: Physics, reference: Reference) -> None:
        self._physics, self._reference = physics, reference
        model = physics.model
        self._agent = np.full(model.ngeom, -1)
        for i, agent in enumerate(world.agents):
            self._agent[agent.tip_geoms] = i
        self._object = np.isin(np.arange(model.ngeom), world.object_geoms)
        self._support = np.isin(np.arange(model.ngeom), world.support_geoms)
        self._names, self._rank = geom_names(world, model)
        reach = round(NEAR / reference.period)
        self._near = maximum_filter1d(reference.bears, 2 * reach + 1, axis=0, mode="nearest")
        self._joints = agent_joints(world)
        self._rows: list[int] = []
        self._qpos: list[Array] = []
        self._error: list[Array] = []
        self._force: list[Array] = []
        self._slid = np.zeros((len(world.agents), 3))  # in the object's frame
        self._slip: list[Array] = []
        self._strained: list[NDArray[np.bool_]] = []
        self._touches: dict[tuple[str, str], Touch] = {}

    def take(self, row: int, error: Array) -> None:
        """Record the state after the step of this row; error (6,): the object's displacement."""
        physics = self._physics
        force, slip = self._contacts(row)
        self._rows.append(row)
        self._qpos.append(physics.data.qpos.copy())
        self._error.append(error)
        self._force.append(force)
        self._slid += slip @ physics.R_WO * (EVERY * PERIOD)
        self._slip.append(np.linalg.norm(self._slid, axis=1))
        short = physics.short
        self._strained.append(np.array([short[mine].any() for mine in self._joints]))

    def _contacts(self, row: int) -> tuple[Array, Array]:
        """Force on the object and velocity of slip over it (k, 3), in W; contacts the plan does not have are noted."""
        data, k = self._physics.data, len(self._joints)
        force, slip = np.zeros((k, 3)), np.zeros((k, 3))
        bears, slides, near = self._reference.bears[row], self._reference.slides[row], self._near[row]
        contact = data.contact
        columns = (contact.geom, contact.efc_address, contact.dim)
        lists = (column.tolist() for column in columns)  # numpy's own numbers are slow to index with
        for (a, b), address, dim, axes, place in zip(*lists, contact.frame, contact.pos, strict=True):
            if address < 0:
                continue
            other, sign = (a, 1.0) if self._object[b] else (b, -1.0)
            i = self._agent[other]
            if not (self._object[a] or self._object[b]) or not (near[i] if i >= 0 else self._support[other]):
                self._note(a, b, row)
            if i < 0 or not self._object[a + b - other]:
                continue
            # Rows of an elliptic contact of `dim` dimensions: normal, two tangents, then torques; none but the normal
            # without friction. Forces act on the second geom.
            rows, frame = min(dim, 3), axes.reshape(3, 3)
            force[i] += sign * (data.efc_force[address : address + rows] @ frame[:rows])
            if bears[i] and not slides[i]:
                along = data.efc_vel[address + 1 : address + 3] if dim > 1 else frame[1:] @ self._passing(a, b, place)
                slip[i] = -sign * (along @ frame[1:])
        return force, slip

    def _passing(self, a: int, b: int, place: Array) -> Array:
        """Velocity (3,) of geom b over geom a at a place, in W."""
        model, data = self._physics.model, self._physics.data
        J = np.empty((2, 3, model.nv))
        for Jv, geom in zip(J, (a, b), strict=True):
            mujoco.mj_jac(model, data, Jv, None, place, model.geom_bodyid[geom])
        return np.asarray((J[1] - J[0]) @ data.qvel)

    def _note(self, a: int, b: int, row: int) -> None:
        first, second = sorted((a, b), key=lambda geom: self._rank[geom])
        pair = self._names[first], self._names[second]
        self._touches.setdefault(pair, Touch(*pair, self._reference.time(row)))

    def execution(self, trouble: Trouble | None, seconds: float, wall: float) -> Execution:
        """All records as one value."""
        ref, rows = self._reference, np.array(self._rows, dtype=int)
        k, nq = len(self._joints), self._physics.model.nq
        return Execution(
            time=ref.begin + (rows - ref.start) * ref.period,
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
