"""Joint impedance: τ = K (q_d − q) + D (q̇_d − q̇) + τ_ff, the law that carries a plan to a robot.

K and D are diagonal and follow from the model: every joint has the stiffness that its lever to the fingertip makes of
one stiffness at the tip, and the damping that its inertia asks for, both as far as the control period allows. τ_ff holds
the robot against gravity and makes the plan's contact forces, τ_ff = g(q) + d q̇_d − Jᵀ(−f): a finger that presses on the
object with f needs Jᵀ f.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.world import World
from regrasp.settings import demand

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Impedance:
    """How stiff the joints are.

    stiffness: N/m that each joint alone would give the tip. damping: ratio, 1 is critical. lever: part of the longest
    lever among its agent's hinges that counts for a hinge whose axis passes near the tip.
    """

    stiffness: float = 600.0
    damping: float = 1.0
    lever: float = 0.3

    def __post_init__(self) -> None:
        demand(self, positive=("stiffness", "damping", "lever"))


@dataclass(frozen=True)
class Gains:
    """Joint stiffness K and damping D (nq,), agent after agent: N m/rad and N m s/rad, or N/m and N s/m.

    Zero for joints that follow others, which have no drives.
    """

    K: Array
    D: Array


STEADY = 0.4
"""Largest √(K/m)·T. Sampled with the period T, the law turns a joint of inertia m unstable from 2 (√(1 + ζ²) − ζ) on: 0.83
at the damping ratio ζ = 1. The other half is left to joints that move along with it, and to inertias that vary."""


def gains(world: World, joints: Array, settings: Impedance, period: float) -> Gains:
    """The gains for a world whose agents stand at `joints` (nq,), under control every `period`, s.

    Whatever the settings, K_i ≤ (STEADY/T)² m_i with m_i = 1/(M⁻¹)_ii, the inertia that a joint shows when the others
    are free, the least that it can show; and λ(M⁻¹D) ≤ 1/T. With M q̈ = −K q − D q̇ held over each period and rates taken
    before places, all decays if 4 M − 2 T D − T² K is positive definite; here it is, for up to 12 joints.
    """
    model = world.model
    data = mujoco.MjData(model)
    data.qpos[:] = world.start
    data.qpos[world.joint_qpos] = joints
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    K: list[Array] = []
    D: list[Array] = []
    for agent in world.agents:
        J = np.empty((3, model.nv))
        mujoco.mj_jac(model, data, J, None, data.geom_xpos[agent.tip_geom], agent.tip_body)
        C, free = agent.coupling.matrix, agent.coupling.free
        lever = np.linalg.norm(J[:, agent.dofs] @ C, axis=0)
        hinge = model.jnt_type[agent.joints[free]] == int(mujoco.mjtJoint.mjJNT_HINGE)
        # A slide's lever is 1, not a length. A hinge through the tip's centre still moves its surface.
        least = max(settings.lever * lever[hinge].max(initial=0.0), model.geom_rbound[agent.tip_geom])
        inertia = C.T @ M[np.ix_(agent.dofs, agent.dofs)] @ C
        least_inertia = 1.0 / np.diag(np.linalg.inv(inertia))
        stiffness = settings.stiffness * np.where(hinge, np.maximum(lever, least), lever) ** 2
        stiffness = np.minimum(stiffness, (STEADY / period) ** 2 * least_inertia)
        moved = np.diag(inertia) + model.body_mass[world.object_body] * lever**2
        wanted = 2.0 * settings.damping * np.sqrt(stiffness * moved)
        # The joints' own friction damps too.
        damping = np.maximum(wanted - model.dof_damping[agent.dofs] @ C**2, 0.0)
        fastest = period * np.linalg.eigvals(np.linalg.solve(inertia, np.diag(damping))).real.max()
        for row, values in ((K, stiffness), (D, damping / max(1.0, fastest))):
            row.append(np.zeros(len(free)))
            row[-1][free] = values
    return Gains(np.concatenate(K), np.concatenate(D))


@dataclass(frozen=True)
class Command:
    """What a drive gets in one control period: joint targets, their rates and the torque fed forward, (nq,) each."""

    q: Array
    qd: Array
    feedforward: Array
