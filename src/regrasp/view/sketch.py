"""A plan as far as the search has come: the best motions found yet, without times and forces, to be looked at only."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.plan import OFF, Plan
from regrasp.scene.world import World

if TYPE_CHECKING:
    from regrasp.planner.motion import Motion
    from regrasp.planner.path import Pose

PACE = 0.2
"""s that an interval is shown for."""


def sketch(world: World, motions: Sequence["Motion"], route: Sequence["Pose"]) -> Plan:
    """The motions one after another, on their way along a route."""
    return _plan(
        world,
        np.concatenate([motion.path.R_WO for motion in motions]),
        np.concatenate([motion.path.p_WO for motion in motions]),
        np.concatenate([motion.joints for motion in motions]),
        np.concatenate([motion.V for motion in motions]),
        np.concatenate([motion.twist for motion in motions]),
        np.stack([np.concatenate([getattr(m, name) for m in motions]) for name in ("p_OC_O", "n_O", "x_O")]),
        np.repeat(np.arange(len(motions)), [len(motion.V) for motion in motions]),
        route,
    )


def rest(world: World) -> Plan:
    """The agents at home beside the object at its start."""
    k, start = len(world.agents), world.scene.start.pose
    joints = np.concatenate([limb.home for limb in world.limbs])
    pose = np.array(start.R), np.array(start.p)
    return _plan(
        world, np.tile(pose[0], (1, 2, 1, 1)), np.tile(pose[1], (1, 2, 1)), np.tile(joints, (1, 2, 1)),
        np.full((1, k), OFF, np.int8), np.zeros((1, k, 4)), np.full((3, 1, 2, k, 3), np.nan), np.zeros(1, int), [pose, pose],
    )  # fmt: skip


def _plan(
    world: World, R: NDArray[np.float64], p: NDArray[np.float64], joints: NDArray[np.float64], V: NDArray[np.int8],
    twist: NDArray[np.float64], contact: NDArray[np.float64], segment: NDArray[np.int64], route: Sequence["Pose"],
) -> Plan:  # fmt: skip
    N, M, k = *p.shape[:2], V.shape[1]
    return Plan(
        time=PACE * (np.arange(N)[:, None] + np.linspace(0.0, 1.0, M)),
        object_position=p,
        object_quaternion=_quaternions(R),
        joints=joints,
        V=V,
        twist=twist,
        p_OC_O=contact[0],
        n_O=contact[1],
        x_O=contact[2],
        force_W=np.zeros((N, M, k, 3)),
        support_mode=np.zeros((N, 0), np.int8),
        support_p_O=np.zeros((N, M, 0, 3)),
        support_n_W=np.zeros((N, M, 0, 3)),
        support_force_W=np.zeros((N, M, 0, 3)),
        segment=segment,
        route=np.concatenate([[p for _, p in route], _quaternions(np.array([R for R, _ in route]))], axis=1),
        energy=np.zeros(0),
        energy_segment=np.zeros(0, np.int64),
        support_names=(),
        agent_names=tuple(agent.name for agent in world.agents),
        joint_names=tuple(world.model.joint(int(j)).name for j in world.joints),
        scene=world.scene.model_dump(mode="json"),
        xml=world.xml,
        assets=world.assets,
        seed=0,
        settings={},
        versions={},
        feasible=False,
    )


def _quaternions(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions w x y z (…, 4) of rotations (…, 3, 3)."""
    found = np.empty((R.size // 9, 4))
    for quaternion, own in zip(found, np.ascontiguousarray(R, float).reshape(-1, 9), strict=True):
        mujoco.mju_mat2Quat(quaternion, own)
    return found.reshape(*R.shape[:-2], 4)
