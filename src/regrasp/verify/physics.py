"""The world a plan is executed in: the plan's model with free object, drives in the joints and a fixture for the start.

It may differ from the planned one, as the real one does.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from regrasp.control.impedance import Command, Gains
from regrasp.errors import InputError
from regrasp.scene.world import World

Array = NDArray[np.float64]

PERIOD = 0.002
"""Of physics and controller, s."""
RIGID = 2.0 * PERIOD
"""Time constant of contacts, s, the least that the period allows: MuJoCo's default lets tips sink in, which
the fingers' stiffness turns into lost force; plans are made for rigid bodies."""
FIXTURE = "start fixture"
SHORT, LEAST = 1e-3, 1e-6
"""Part of what is asked of a drive, and N m or N, by which it may miss that: more than rounding."""


@dataclass(frozen=True)
class Reality:
    """How the world differs from the planned one.

    friction (k + supports,): factors on the coefficients of tips and supports. mass: factor. shift (3,), m, and turn
    (3,), rad, in W: of the object at the start. delay: s, bound of the contact changes' timing errors. noise: m and rad,
    standard deviations of the measured object pose.
    """

    friction: Array
    mass: float
    shift: Array
    turn: Array
    delay: float
    noise: tuple[float, float]


def nominal(world: World) -> Reality:
    """The world as planned."""
    return Reality(
        np.ones(len(world.agents) + len(world.support_geoms)), 1.0, np.zeros(3), np.zeros(3), 0.0, (0.0, 0.0)
    )


@dataclass(frozen=True)
class Drives:
    """Affine actuators, one per agent joint that follows no other: joint force = gain·ctrl + offset + stiff·q + damp·q̇,
    each (nd,), as far as the limits of actuator and joint allow. driven (nd,): which of the joints (nq,) these are. gains: K
    and D (nq,) of the law.
    """

    driven: NDArray[np.int64]
    actuator: NDArray[np.int64]
    gain: Array
    offset: Array
    stiff: Array
    damp: Array
    gains: Gains

    def torque(self, command: Command, q: Array, qd: Array) -> Array:
        """What the command asks of the joints (nq,): τ = K (q_d − q) + D (q̇_d − q̇) + τ_ff."""
        return self.gains.K * (command.q - q) + self.gains.D * (command.qd - qd) + command.feedforward

    def control(self, torque: Array, q: Array, qd: Array) -> Array:
        """ctrl (nd,) that makes the joints obey; torque, q, qd (nq,)."""
        torque, q, qd = torque[self.driven], q[self.driven], qd[self.driven]
        return np.asarray((torque - self.offset - self.stiff * q - self.damp * qd) / self.gain)


def drive(world: World, spec: mujoco.MjSpec, wanted: Gains) -> None:
    """Gives every limb's joint that has no actuator and follows no other an impedance drive; its force limit holds too.

    A position servo gets the gains of the law: one tuned to hold its place stiffly neither feels nor keeps a light grip.
    """
    model = world.model
    driven = {
        int(model.actuator_trnid[a, 0]): a
        for a in np.flatnonzero(model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT))
    }
    for at, joint in enumerate(world.joints):
        if int(joint) not in driven and world.coupling.free[at]:
            actuator = spec.add_actuator(
                name=f"drive of {model.joint(int(joint)).name}", target=model.joint(int(joint)).name,
                trntype=mujoco.mjtTrn.mjTRN_JOINT, gaintype=mujoco.mjtGain.mjGAIN_FIXED,
                biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            )  # fmt: skip
            actuator.gainprm[0] = wanted.K[at]
            actuator.biasprm[1:3] = -wanted.K[at], -wanted.D[at]
        elif int(joint) in driven and model.actuator_biasprm[driven[int(joint)], 1] < 0.0:
            servo, gear = spec.actuators[driven[int(joint)]], model.actuator_gear[driven[int(joint)], 0]
            servo.gainprm[0] = wanted.K[at] / gear**2
            servo.biasprm[1:3] = -wanted.K[at] / gear**2, -wanted.D[at] / gear**2


def drives_of(world: World, model: mujoco.MjModel, wanted: Gains) -> Drives:
    """The drives of a model in which every agent joint that follows no other has its actuator."""
    joints = world.joints
    driven = np.flatnonzero(world.coupling.free)
    at = []
    for joint in joints[driven]:
        found = np.flatnonzero(
            (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)) & (model.actuator_trnid[:, 0] == joint)
        )
        name = model.joint(int(joint)).name
        if len(found) > 1:
            raise InputError("model.actuator", f"{len(found)} actuators move joint {name!r}", "one drive per joint")
        a = int(found[0])
        plain = (
            model.actuator_gaintype[a] == int(mujoco.mjtGain.mjGAIN_FIXED)
            and model.actuator_biastype[a] in (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
            and model.actuator_dyntype[a] == int(mujoco.mjtDyn.mjDYN_NONE)
        )
        if not plain or model.actuator_gainprm[a, 0] == 0.0:
            raise InputError(
                "model.actuator", f"the drive of joint {name!r} is not affine in its control",
                "legal: motor, position and velocity actuators without dynamics",
            )  # fmt: skip
        at.append(a)
    gear = model.actuator_gear[at, 0]
    stiff, damp = gear**2 * model.actuator_biasprm[at, 1], gear**2 * model.actuator_biasprm[at, 2]
    affine = model.actuator_biastype[at] == int(mujoco.mjtBias.mjBIAS_AFFINE)
    stiff, damp = np.where(affine, stiff, 0.0), np.where(affine, damp, 0.0)
    return Drives(
        driven, np.array(at), gear * model.actuator_gainprm[at, 0],
        np.where(affine, gear * model.actuator_biasprm[at, 0], 0.0), stiff, damp, wanted,
    )  # fmt: skip


class Physics:
    """A MuJoCo world under way: `hold` the object, then step and `release`."""

    def __init__(self, world: World, reality: Reality, wanted: Gains) -> None:
        spec = mujoco.MjSpec.from_string(world.xml, assets=dict(world.assets))
        spec.option.timestep = PERIOD
        drive(world, spec, wanted)
        weld = spec.add_equality(
            name=FIXTURE, type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name1="world", name2="object"
        )
        weld.solref = [RIGID, 1.0]
        self.model = model = spec.compile()
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a reset would hide that numbers went bad
        model.geom_solref[:] = RIGID, 1.0
        model.eq_solref[model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)] = RIGID, 1.0
        k = len(world.agents)
        for agent, factor in zip(world.agents, reality.friction[:k], strict=True):
            model.geom_friction[agent.tip_geoms, 0] *= factor
        model.geom_friction[world.support_geoms, 0] *= reality.friction[k:]
        model.body_mass[world.object_body] *= reality.mass
        model.body_inertia[world.object_body] *= reality.mass
        self.data = data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        self.drives = drives_of(world, model, wanted)
        self._fixture = model.equality(FIXTURE).id
        self.world = world
        self._qpos = world.joint_qpos
        self._dofs = world.joint_dofs
        self._borne = model.jnt_actgravcomp[world.joints] != 0
        self._asked = np.zeros(len(self._qpos))
        pose = world.scene.start.pose
        turned = Rotation.from_rotvec(reality.turn) * Rotation.from_quat(pose.wxyz, scalar_first=True)
        place = [*(np.array(pose.p) + reality.shift), *turned.as_quat(scalar_first=True)]
        model.eq_data[self._fixture, :11] = [0.0, 0.0, 0.0, *place, 1.0]
        data.qpos[:] = world.start
        data.qpos[world.object_qpos : world.object_qpos + 7] = place

    @property
    def q(self) -> Array:
        """Joints of the agents (nq,)."""
        return np.asarray(self.data.qpos[self._qpos])

    @property
    def qd(self) -> Array:
        """Rates of the agents' joints (nq,)."""
        return np.asarray(self.data.qvel[self._dofs])

    @property
    def p_WO(self) -> Array:
        """Position of the object (3,)."""
        return np.asarray(self.data.qpos[self.world.object_qpos : self.world.object_qpos + 3]).copy()

    @property
    def R_WO(self) -> Array:
        """Rotation of the object (3, 3)."""
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, self.data.qpos[self.world.object_qpos + 3 : self.world.object_qpos + 7])
        return R.reshape(3, 3)

    def place(self, q: Array) -> None:
        """Set the agents' joints, at rest."""
        self.data.qpos[self._qpos] = q
        self.data.qvel[:] = 0.0

    def release(self) -> None:
        """Open the fixture that holds the object."""
        self.data.eq_active[self._fixture] = 0

    def step(self, command: Command) -> None:
        """One period under the command."""
        data, q, qd = self.data, self.q, self.qd
        self._asked = self.drives.torque(command, q, qd)
        data.ctrl[self.drives.actuator] = self.drives.control(self._asked, q, qd)
        mujoco.mj_step(self.model, data)

    @property
    def short(self) -> NDArray[np.bool_]:
        """Whose drive gave something else in the last step than it was asked for (nq,): whichever limit it met."""
        data, asked = self.data, self._asked
        # Drives that bear the weight of their bodies by themselves do that on top of what they are asked for.
        given = data.qfrc_actuator[self._dofs] - self._borne * data.qfrc_gravcomp[self._dofs]
        return np.asarray(np.abs(given - asked) > SHORT * np.abs(asked) + LEAST)


@contextmanager
def quiet() -> Iterator[None]:
    """Keeps MuJoCo from telling its warnings on stderr and in a file MUJOCO_LOG.TXT; its data count them all the same."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
