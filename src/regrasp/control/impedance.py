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

from regrasp.scene.world import Agent, Limb, World
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
    M = world.coupling.matrix.T @ M[np.ix_(world.joint_dofs, world.joint_dofs)] @ world.coupling.matrix
    # Of an arm that carries a hand all tips' levers count, each as if it had the stiffness to itself.
    levers = [_levers(world, data, limb, settings) for limb in world.limbs]
    owner = np.repeat(np.arange(len(levers)), [len(squares) for squares, _ in levers])
    group = np.array([limb.arm if isinstance(limb, Agent) else at - len(world.agents)
                      for at, limb in enumerate(world.limbs)])  # fmt: skip
    group = np.where(group < 0, -1 - np.arange(len(group)), group)[owner]
    K, D = np.zeros(len(owner)), np.zeros(len(owner))
    squares, mean = (np.concatenate(part) for part in zip(*levers, strict=True))
    friction = model.dof_damping[world.joint_dofs] @ world.coupling.matrix**2
    for one in np.unique(group):
        mine = group == one
        inertia = M[np.ix_(mine, mine)]
        least_inertia = 1.0 / np.diag(np.linalg.inv(inertia))
        K[mine] = np.minimum(settings.stiffness * squares[mine], (STEADY / period) ** 2 * least_inertia)
        moved = np.diag(inertia) + model.body_mass[world.object_body] * mean[mine]
        wanted = 2.0 * settings.damping * np.sqrt(K[mine] * moved)
        damping = np.maximum(wanted - friction[mine], 0.0)  # the joints' own friction damps too
        fastest = period * np.linalg.eigvals(np.linalg.solve(inertia, np.diag(damping))).real.max()
        D[mine] = damping / max(1.0, fastest)
    out = np.zeros((2, len(joints)))
    out[:, world.coupling.free] = K, D
    return Gains(*out)


def _levers(world: World, data: mujoco.MjData, limb: Limb, settings: Impedance) -> tuple[Array, Array]:
    """Σ l² over the tips that a limb's free joints move, by which their stiffness grows, and the mean of l², (n_free,)."""
    model, C, free = world.model, limb.coupling.matrix, limb.coupling.free
    hinge = model.jnt_type[limb.joints[free]] == int(mujoco.mjtJoint.mjJNT_HINGE)
    agents = (
        [limb] if isinstance(limb, Agent) else [a for a in world.agents if a.arm >= 0 and world.arms[a.arm] is limb]
    )
    squares, mean = np.zeros(len(hinge)), np.zeros(len(hinge))
    for agent in agents:
        J = np.empty((3, model.nv))
        mujoco.mj_jac(model, data, J, None, data.geom_xpos[agent.tip_geom], agent.tip_body)
        lever = np.linalg.norm(J[:, limb.dofs] @ C, axis=0)
        # A slide's lever is 1, not a length. A hinge through the tip's centre still moves its surface.
        least = max(settings.lever * lever[hinge].max(initial=0.0), model.geom_rbound[agent.tip_geom])
        squares += np.where(hinge, np.maximum(lever, least), lever) ** 2
        mean += lever**2 / len(agents)
    return squares, mean


@dataclass(frozen=True)
class Command:
    """What a drive gets in one control period: joint targets, their rates and the torque fed forward, (nq,) each."""

    q: Array
    qd: Array
    feedforward: Array
