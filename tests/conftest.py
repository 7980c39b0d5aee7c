"""A plan made without the planner: the fingers of a built-in scene at home, the object carried from start to goal."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from regrasp.plan import RELOCATE, Plan
from regrasp.scene.load import load
from regrasp.scene.world import build

N, M = 5, 4


@pytest.fixture(scope="session")
def home_plan() -> Callable[[str], Plan]:
    """Scene name → a plan whose agents stand still by the object, agent i pushing with 1 + i N towards its centre."""
    made: dict[str, Plan] = {}

    def make(name: str) -> Plan:
        if name not in made:
            made[name] = _make(name)
        return made[name]

    return make


def _make(name: str) -> Plan:
    world = build(load(name))
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.start
    mujoco.mj_kinematics(world.model, data)
    tips = data.geom_xpos[[agent.tip_geom for agent in world.agents]]
    start, goal, k, P = world.scene.start.pose, world.scene.goal.pose, len(world.agents), len(world.scene.carriers)
    u = np.linspace(0, 1, N * (M - 1) + 1)[np.arange(N)[:, None] * (M - 1) + np.arange(M)]
    turn = Slerp([0, 1], Rotation.from_matrix([start.R, goal.R]))(u.ravel())
    p = start.p + u[..., None] * (np.array(goal.p) - start.p)
    inward = p[:, :, None] - tips
    inward /= np.linalg.norm(inward, axis=-1, keepdims=True)
    n_O = -np.einsum("sji,skj->ski", turn.as_matrix(), inward.reshape(N * M, k, 3)).reshape(N, M, k, 3)
    V = np.zeros((N, k), np.int8)
    V[2, 0] = RELOCATE
    force = inward * (1.0 + np.arange(k))[:, None]
    force[2, :, 0] = 0.0
    contact = np.where((V == RELOCATE)[:, None, :, None], np.nan, n_O)
    quaternion = turn.as_quat(scalar_first=True).reshape(N, M, 4)
    joints = np.concatenate([world.start[agent.qpos] for agent in world.agents])
    return Plan(
        time=u * N,
        object_position=p,
        object_quaternion=quaternion,
        joints=np.tile(joints, (N, M, 1)),
        V=V,
        twist=np.zeros((N, k, 4)),
        p_OC_O=world.object_size[:3].max() * contact,
        n_O=contact,
        x_O=contact,
        force_W=force,
        support_mode=np.zeros((N, P), np.int8),
        support_p_O=np.zeros((N, M, P, 3)),
        support_n_W=np.zeros((N, M, P, 3)),
        support_force_W=np.zeros((N, M, P, 3)),
        segment=np.zeros(N, np.int64),
        route=np.concatenate([p[[0, -1], [0, -1]], quaternion[[0, -1], [0, -1]]], axis=1),
        energy=np.array([3.0, 1.0]),
        energy_segment=np.zeros(2, np.int64),
        support_names=world.scene.carriers,
        agent_names=tuple(agent.name for agent in world.agents),
        joint_names=tuple(world.model.joint(int(i)).name for agent in world.agents for i in agent.joints),
        scene=world.scene.model_dump(mode="json"),
        xml=world.xml,
        assets=world.assets,
        seed=0,
        settings={},
        versions={},
        feasible=True,
    )
