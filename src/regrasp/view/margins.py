"""What contacts and joints of a plan have left, sample by sample."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.plan import FIRST_SLIDE, RELOCATE, Plan
from regrasp.scene.world import World

Array = NDArray[np.float64]


def friction_margin(plan: Plan, world: World) -> Array:
    """1 − |f_t| / (μ f_n) of every agent that rolls or stays, (N, M, k): 0 on the cone's edge, 1 along the normal.

    NaN where there is no contact, no force, or a slide, whose force is on the edge by law.
    """
    f = np.einsum("jsab,jsib->jsia", _rotations(plan), plan.force_W)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal = -np.sum(f * plan.n_O, axis=-1)
        tangential = np.linalg.norm(f + normal[..., None] * plan.n_O, axis=-1)
        margin = 1.0 - tangential / (np.array([agent.friction for agent in world.agents]) * normal)
    slides = (plan.V >= FIRST_SLIDE) & (plan.V < RELOCATE)
    return np.where((normal > 0.0) & ~slides[:, None], margin, np.nan)


def joint_margin(plan: Plan, world: World) -> Array:
    """Least distance of an agent's joints from their limits, (N, M, k), in half ranges: 0 at a limit, 1 half-way between.

    NaN where none of the agent's joints has limits.
    """
    found, first = [], 0
    for agent in world.agents:
        q = plan.joints[:, :, first : first + len(agent.qpos)]
        first += len(agent.qpos)
        limited = np.isfinite(agent.lower) & np.isfinite(agent.upper)
        half = (agent.upper - agent.lower)[limited] / 2
        room = np.minimum(q[..., limited] - agent.lower[limited], agent.upper[limited] - q[..., limited]) / half
        found.append(room.min(axis=-1, initial=np.inf))
    margin = np.stack(found, axis=-1)
    return np.where(np.isfinite(margin), margin, np.nan)


def _rotations(plan: Plan) -> Array:
    """R_OW at every sample, (N, M, 3, 3)."""
    R_WO = np.empty((plan.time.size, 9))
    for row, quaternion in zip(R_WO, plan.object_quaternion.reshape(-1, 4), strict=True):
        mujoco.mju_quat2Mat(row, quaternion)
    return R_WO.reshape(*plan.time.shape, 3, 3).swapaxes(2, 3)
