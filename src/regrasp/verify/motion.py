"""The continuous motion of a plan, sampled finer than the plan, through MuJoCo's kinematics."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from regrasp.plan import Plan
from regrasp.scene.world import World

Array = NDArray[np.float64]

RESOLUTION = 5
"""Every gap between two samples of the plan is divided into at least so many steps, …"""
FINEST = 20
"""… and into at most so many, …"""
STRIDE = 5e-3
"""… so that no geom's centre moves farther than this (m) between judged instants: nothing jumps past a thin body."""


@dataclass(frozen=True)
class Motion:
    """The motion at S instants per interval; instants 0, K, 2K, … of an interval are the plan's samples."""

    K: int
    time: Array
    """(N, S), s."""
    joints: Array
    """(N, S, nq)."""
    joint_speed: Array
    """(N, S, nq), derivative of the spline."""
    p_WO: Array
    """(N, S, 3)."""
    R_WO: Array
    """(N, S, 3, 3)."""
    p_OT: Array
    """(N, S, k, 3), tip geoms in the object's frame."""
    R_OT: Array
    """(N, S, k, 3, 3)."""
    geom_xpos: Array
    """(N, S, G, 3)."""
    geom_xmat: Array
    """(N, S, G, 9)."""


def fine(values: Array, K: int) -> Array:
    """Values (N, M, ...) at the plan's samples, linear in between: (N, (M − 1) K + 1, ...)."""
    N, M = values.shape[:2]
    u = (np.arange(K) / K).reshape((1, 1, K) + (1,) * (values.ndim - 2))
    inner = values[:, :-1, None] * (1 - u) + values[:, 1:, None] * u
    return np.concatenate([inner.reshape(N, (M - 1) * K, *values.shape[2:]), values[:, -1:]], axis=1)


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) divided by their length; a zero vector stays zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300))


def rotation_vector(R_A: Array, R_B: Array) -> Array:
    """log(R_B R_Aᵀ) of matrices (..., 3, 3): the rotation (..., 3) that takes A to B, in the frame of both."""
    product = R_B @ np.swapaxes(R_A, -1, -2)
    turns = Rotation.from_matrix(product.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(turns).reshape(product.shape[:-1])


def interpolate(plan: Plan, world: World) -> Motion:
    """The motion of the plan in its world at RESOLUTION times its samples, or finer where STRIDE asks for it."""
    _, xpos, _ = _kinematics(world, plan.joints, plan.object_position, plan.object_quaternion)
    longest = float(np.linalg.norm(np.diff(xpos, axis=1), axis=-1).max())
    K = int(np.clip(math.ceil(longest / STRIDE), RESOLUTION, FINEST))
    time = fine(plan.time, K)
    N, S = time.shape
    joints, speed = np.empty((N, S, plan.joints.shape[2])), np.empty((N, S, plan.joints.shape[2]))
    position = np.empty((N, S, 3))
    for j in range(N):
        spline = CubicSpline(plan.time[j], plan.joints[j])
        joints[j], speed[j] = spline(time[j]), spline(time[j], 1)
        position[j] = CubicSpline(plan.time[j], plan.object_position[j])(time[j])
    quaternion = _slerp(plan.object_quaternion, K)
    tips, xpos, xmat = _kinematics(world, joints, position, quaternion)
    R_WO = Rotation.from_quat(quaternion.reshape(-1, 4), scalar_first=True).as_matrix().reshape(N, S, 3, 3)
    R_WT = xmat[:, :, tips].reshape(N, S, len(tips), 3, 3)
    R_OW = np.swapaxes(R_WO, -1, -2)[:, :, None]
    return Motion(
        K, time, joints, speed, position, R_WO,
        p_OT=(R_OW @ (xpos[:, :, tips] - position[:, :, None])[..., None])[..., 0],
        R_OT=R_OW @ R_WT,
        geom_xpos=xpos,
        geom_xmat=xmat,
    )  # fmt: skip


def _slerp(quaternion: Array, K: int) -> Array:
    N, M = quaternion.shape[:2]
    start = Rotation.from_quat(quaternion[:, :-1].reshape(-1, 4), scalar_first=True)
    end = Rotation.from_quat(quaternion[:, 1:].reshape(-1, 4), scalar_first=True)
    turn = (end * start.inv()).as_rotvec()
    steps = [(Rotation.from_rotvec(turn * (i / K)) * start).as_quat(scalar_first=True) for i in range(K)]
    inner = np.stack(steps, axis=1).reshape(N, (M - 1) * K, 4)
    return np.concatenate([inner, quaternion[:, -1:]], axis=1)


def _kinematics(world: World, joints: Array, position: Array, quaternion: Array) -> tuple[list[int], Array, Array]:
    """Tip geoms of the agents, geom_xpos (N, S, G, 3) and geom_xmat (N, S, G, 9) at each instant."""
    model = world.model
    data = mujoco.MjData(model)
    addresses = world.joint_qpos
    N, S = joints.shape[:2]
    xpos, xmat = np.empty((N, S, model.ngeom, 3)), np.empty((N, S, model.ngeom, 9))
    a = world.object_qpos
    for j in range(N):
        for s in range(S):
            data.qpos[addresses] = joints[j, s]
            data.qpos[a : a + 3] = position[j, s]
            data.qpos[a + 3 : a + 7] = quaternion[j, s]
            mujoco.mj_kinematics(model, data)
            xpos[j, s], xmat[j, s] = data.geom_xpos, data.geom_xmat
    return [agent.tip_geom for agent in world.agents], xpos, xmat
