"""The controller of a plan: row after row of the reference, corrected by what is seen of the object."""

from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.control import feedback as object_feedback
from regrasp.control.feedback import Feedback, displacement, tip_shift
from regrasp.control.impedance import Command, Impedance
from regrasp.control.reference import Phases, Reference, solve_steps, weights
from regrasp.control.tension import Release, released
from regrasp.control.yielding import Leash, Pose, beyond, carried, displaced
from regrasp.scene.world import World

Array = NDArray[np.float64]


NO_TORQUE, NO_ERROR = np.zeros(3), np.zeros(6)


@dataclass(frozen=True)
class Control:
    """The `control` section of a scene file: how its robots are controlled."""

    impedance: Impedance = field(default_factory=Impedance)
    feedback: Feedback = field(default_factory=Feedback)
    release: Release = field(default_factory=Release)
    phases: Phases = field(default_factory=Phases)
    leash: Leash = field(default_factory=Leash)


class Controller:
    """Joint targets, rates and feed-forward torques for one period after the other.

    It knows the robot's model, its joint sensors and, if there is one, a measured object pose now and then; the simulated
    world it never sees. stiffness (nq,): K of the drives, zero for joints that follow others.
    """

    def __init__(self, world: World, reference: Reference, control: Control, stiffness: Array) -> None:
        self.world, self.reference, self.control = world, reference, control
        self._model = world.model
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = world.start
        self._addresses = world.joint_qpos
        self._dofs = world.joint_dofs
        self._damping = self._model.dof_damping[self._dofs]
        self._state = object_feedback.init(len(world.agents))
        self._correction = np.zeros(len(self._addresses))
        self._pushed: Pose | None = None
        self._give = np.divide(1.0, stiffness, out=np.zeros(len(stiffness)), where=stiffness > 0.0)
        self._most = np.array([agent.max_force for agent in world.agents])
        self._tips = [agent.tip_geom for agent in world.agents]
        self._owner = np.repeat(np.arange(len(world.limbs)), [len(limb.qpos) for limb in world.limbs])
        freedoms = np.array([agent.freedom for agent in world.agents])
        self._weight = weights(freedoms, self._model.geom_rbound[self._tips])

    def command(self, row: int, q: Array, qd: Array) -> Command:
        """What the drives get for this row of the reference, with the joints at q (nq,), moving at qd."""
        ref, model, data = self.reference, self._model, self._data
        data.qpos[self._addresses] = q
        data.qvel[self._dofs] = qd
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        torque = np.empty(model.nv)
        mujoco.mj_rne(model, data, 0, torque)
        mujoco.mj_passive(model, data)
        torque -= data.qfrc_spring + data.qfrc_gravcomp  # what the model holds by itself
        force, where = self.forces(row)
        for i, agent in enumerate(self.world.agents):
            if ref.bears[row, i]:
                mujoco.mj_applyFT(model, data, force[i], NO_TORQUE, where[i], agent.tip_body, torque)  # += Jᵀ f
        rate = ref.qd[row]
        feedforward = self.world.coupling.reduce(torque[self._dofs] + self._damping * rate)
        return Command(ref.q[row] + self._correction, rate, feedforward)

    def forces(self, row: int) -> tuple[Array, Array]:
        """Forces on the object that are fed forward (k, 3), W, and where they act."""
        ref = self.reference
        force, where = ref.force_W[row], ref.p_WC[row]
        if self._pushed is not None:
            bears = ref.bears[row]
            force, where = force.copy(), where.copy()
            planned = ref.p_WO[row], ref.R_WO[row]
            room = self._most[bears] / np.maximum(np.linalg.norm(force[bears], axis=1), 1e-9)
            grip = max(1.0, min(self.control.leash.grip, float(np.min(room, initial=np.inf))))
            force[bears], where[bears] = carried(force[bears], where[bears], planned, self._pushed, grip)
        return force, where

    def give_way(self, row: int, seen: Pose) -> None:
        """In place of `update` while something pushes the object off its path: the fingers that hold it go with it.

        Keep the row as long, and then follow a plan from where the object has come to.
        """
        ref = self.reference
        if self._pushed is None:
            # The integral that pulled the object back lets go.
            self._pushed, self._correction = (ref.p_WO[row], ref.R_WO[row]), np.zeros(len(self._addresses))
        moved = beyond(self.control.leash, displacement(*self._pushed, *seen))
        p = self._data.geom_xpos[self._tips]
        steps = [tip_shift(moved * bears, self._pushed[0], at) for bears, at in zip(ref.bears[row], p, strict=True)]
        self._correction = self._correction + solve_steps(
            self._jacobians(p), np.array(steps), self._weight, self._owner
        )
        self._pushed = displaced(self._pushed, moved)

    def _jacobians(self, p: Array) -> Array:
        """(k, 6, nq): of the tips at p (k, 3); what joints do that follow others is in the columns of these."""
        J = np.empty((len(p), 6, self._model.nv))
        for i, agent in enumerate(self.world.agents):
            mujoco.mj_jac(self._model, self._data, J[i, :3], J[i, 3:], p[i], agent.tip_body)
        return self.world.coupling.reduce(J[:, :, self._dofs])

    def update(self, row: int, seen: tuple[Array, Array] | None) -> None:
        """Correct the targets, once in a feedback period, after a `command` of about this row.

        seen: the object's measured position and rotation, if it is. Strain between the fingers is let go either way.
        """
        ref, settings, bears = self.reference, self.control.feedback, self.reference.bears[row]
        follows = row >= ref.start
        error = NO_ERROR if seen is None else displacement(ref.p_WO[row], ref.R_WO[row], *seen)
        state = object_feedback.step(settings, self._state, error, bears, follows, ref.free[row])
        p = self._data.geom_xpos[self._tips]
        J = self._jacobians(p)
        if follows:
            d = J[:, :3] @ (self._data.qpos[self._addresses] - ref.q[row] - self._correction)
            slides = ref.slides[row] & bears
            state.own[:, :3] += released(
                self.control.release,
                settings.period,
                p,
                d,
                bears & ~slides,
                slides,
                ref.n_W[row],
                J[:, :3] @ (self._give * J[:, :3]).swapaxes(1, 2),
            )
        steps = np.array(
            [tip_shift(state.c + own, ref.p_WO[row], place) for own, place in zip(state.own, p, strict=True)]
        )
        self._correction = solve_steps(J, steps, self._weight, self._owner)
        self._state = state


def agent_joints(world: World) -> tuple[slice, ...]:
    """Each agent's columns among all agents' joints."""
    ends = np.cumsum([len(agent.qpos) for agent in world.agents])
    return tuple(slice(int(end) - len(agent.qpos), int(end)) for agent, end in zip(world.agents, ends, strict=True))
