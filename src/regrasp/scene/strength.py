"""How hard an agent can press: from the force limits of its joints and drives, at its posture of rest."""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.couplings import Coupling

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


def normal_force(
    model: mujoco.MjModel, qpos: Array, joints: Ids, coupled: Coupling, tip: int, friction: float
) -> float | None:
    """The normal force, N, that the tip (geom id) bears in every direction, friction included; None without limits.

    A contact force f asks τ_i = J_i·f of joint i, and |J_i·f| ≤ |J_i| |f|. With what the weight of the robot leaves of its
    limit, joint i allows |f| ≤ (τ_i,max − |τ_i,weight|) / |J_i|, and within the friction cone |f| ≤ √(1 + μ²) f_n: the least
    over the joints, at `qpos`, so less than the agent can bear in most directions. A joint that follows another leaves what it
    is asked for to that one.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    J = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, J, None, data.geom_xpos[tip], model.geom_bodyid[tip])
    dofs = model.jnt_dofadr[joints]
    limit = np.array([_limit(model, int(joint)) for joint in joints])
    weight = data.qfrc_bias[dofs] - data.qfrc_gravcomp[dofs] * (model.jnt_actgravcomp[joints] == 0)
    weight = np.abs(coupled.reduce(weight))
    lever = np.linalg.norm(coupled.reduce(J[:, dofs]), axis=0)
    bounded = np.isfinite(limit) & (lever > 1e-9)
    if not bounded.any():
        return None
    force = np.maximum(limit - weight, 0.0)[bounded] / lever[bounded]
    return float(force.min()) / math.sqrt(1 + friction**2)


def _limit(model: mujoco.MjModel, joint: int) -> float:
    """Largest torque or force of either sign at a joint that its own limit and its drives' allow, ∞ where none is given."""
    limits = []
    if model.jnt_actfrclimited[joint]:
        limits.append(np.abs(model.jnt_actfrcrange[joint]).min())
    driven = (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)) & (model.actuator_trnid[:, 0] == joint)
    for a in np.flatnonzero(driven):
        gear = abs(model.actuator_gear[a, 0])
        if model.actuator_forcelimited[a]:
            limits.append(gear * np.abs(model.actuator_forcerange[a]).min())
        motor = model.actuator_biastype[a] == int(mujoco.mjtBias.mjBIAS_NONE)
        if model.actuator_ctrllimited[a] and motor:
            limits.append(gear * abs(model.actuator_gainprm[a, 0]) * np.abs(model.actuator_ctrlrange[a]).min())
    return min((float(limit) for limit in limits if limit > 0.0), default=math.inf)
