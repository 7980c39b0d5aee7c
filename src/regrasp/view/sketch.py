"""A plan as far as the search has come: the best motions found yet, without times and forces, to be looked at only."""

from collections.abc import Sequence

import numpy as np

from regrasp.plan import OFF, Plan
from regrasp.planner.assemble import pose_row, quaternions
from regrasp.planner.motion import Motion
from regrasp.planner.path import Pose
from regrasp.scene.world import World

PACE = 0.2
"""s that an interval is shown for."""


def sketch(world: World, motions: Sequence[Motion], route: Sequence[Pose]) -> Plan:
    """The motions one after another along a route; where there are none, the agents at home beside the resting object."""
    k, start = len(world.agents), world.scene.start.pose
    contact = {name: np.concatenate([getattr(m, name) for m in motions]) for name in ("p_OC_O", "n_O", "x_O")} if motions else {}
    if motions:
        R = np.concatenate([motion.path.R_WO for motion in motions])
        p = np.concatenate([motion.path.p_WO for motion in motions])
        joints = np.concatenate([motion.joints for motion in motions])
        V = np.concatenate([motion.V for motion in motions])
        twist = np.concatenate([motion.twist for motion in motions])
    else:
        R, p = np.tile(start.R, (1, 2, 1, 1)), np.tile(start.p, (1, 2, 1))
        joints = np.tile(np.concatenate([agent.home for agent in world.agents]), (1, 2, 1))
        V, twist = np.full((1, k), OFF, np.int8), np.zeros((1, k, 4))
        contact = dict.fromkeys(("p_OC_O", "n_O", "x_O"), np.full((1, 2, k, 3), np.nan))
    N, M = R.shape[:2]
    segment = np.repeat(np.arange(len(motions)), [len(motion.V) for motion in motions]) if motions else np.zeros(N, int)
    poses = [*route] if len(route) > 1 else [(np.array(start.R), np.array(start.p))] * 2
    return Plan(
        time=PACE * (np.arange(N)[:, None] + np.linspace(0.0, 1.0, M)),
        object_position=p,
        object_quaternion=quaternions(R),
        joints=joints,
        V=V,
        twist=twist,
        **contact,
        force_W=np.zeros((N, M, k, 3)),
        support_mode=np.zeros((N, 0), np.int8),
        support_p_O=np.zeros((N, M, 0, 3)),
        support_n_W=np.zeros((N, M, 0, 3)),
        support_force_W=np.zeros((N, M, 0, 3)),
        segment=segment,
        route=np.array([pose_row(pose) for pose in poses]),
        energy=np.zeros(0),
        energy_segment=np.zeros(0, np.int64),
        support_names=(),
        agent_names=tuple(agent.name for agent in world.agents),
        joint_names=tuple(world.model.joint(int(j)).name for agent in world.agents for j in agent.joints),
        scene=world.scene.model_dump(mode="json"),
        xml=world.xml,
        assets=world.assets,
        seed=0,
        settings={},
        versions={},
        feasible=False,
    )
