"""Joint impedance: τ = K (q_d − q) + D (q̇_d − q̇) + τ_ff, the law that carries a plan to a robot.

K and D are diagonal and follow from the model: every joint has the stiffness that its lever to the fingertip makes of
one stiffness at the tip, and the damping that its inertia asks for. τ_ff holds the robot against gravity and makes
the plan's contact forces, τ_ff = g(q) + d q̇_d − Jᵀ(−f): a finger that presses on the object with f needs Jᵀ f.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.world import World

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Impedance:
    """How stiff the joints are.

    stiffness: N/m that each joint alone would give the tip. damping: ratio, 1 is critical. lever: part of its agent's
    longest lever that counts for a joint whose axis passes near the tip.
    """

    stiffness: float = 600.0
    damping: float = 1.0
    lever: float = 0.3

    def __post_init__(self) -> None:
        for name in ("stiffness", "damping", "lever"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}, legal: more than 0")


@dataclass(frozen=True)
class Gains:
    """Joint stiffness K and damping D (nq,), agent after agent: N m/rad and N m s/rad, or N/m and N s/m."""

    K: Array
    D: Array


def gains(world: World, joints: Array, settings: Impedance) -> Gains:
    """The gains for a world whose agents stand at `joints` (nq,)."""
    model = world.model
    data = mujoco.MjData(model)
    data.qpos[:] = world.start
    data.qpos[np.concatenate([agent.qpos for agent in world.agents])] = joints
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    K, D = [], []
    for agent in world.agents:
        J = np.empty((3, model.nv))
        mujoco.mj_jac(model, data, J, None, data.geom_xpos[agent.tip_geom], agent.tip_body)
        lever = np.linalg.norm(J[:, agent.dofs], axis=0)
        stiffness = settings.stiffness * np.maximum(lever, settings.lever * lever.max()) ** 2
        wanted = 2.0 * settings.damping * np.sqrt(stiffness * M[agent.dofs, agent.dofs])
        K.append(stiffness)
        D.append(np.maximum(wanted - model.dof_damping[agent.dofs], 0.0))  # the joint's own friction damps too
    return Gains(np.concatenate(K), np.concatenate(D))


@dataclass(frozen=True)
class Command:
    """What a drive gets in one control period: joint targets, their rates and the torque fed forward, (nq,) each."""

    q: Array
    qd: Array
    feedforward: Array
