"""How near a tip can come to the object: sampled postures, the nearest of them improved."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.world import Agent, World

Array = NDArray[np.float64]

SAMPLES, BEST, STEPS = 400, 6, 60
"""Random postures of an agent, how many of the nearest are improved, and in how many steps."""
DAMPING = 1e-3
"""Of the steps' least squares, m per rad or m."""
FAR = 10.0
"""Distances beyond this, m, are all alike."""
TOUCHING = 1e-4
"""A tip this near, m, touches."""


def nearest(world: World, agent: Agent, position: Array, quaternion: Array) -> float:
    """Least distance, m, found between an agent's tip and the object in this pose; 0 where they can touch.

    Joint ranges hold (an unlimited hinge turns once, an unlimited slide goes 1 m either way), collisions do not count.
    """
    model, data = world.model, mujoco.MjData(world.model)
    data.qpos[:] = world.start
    data.qpos[world.object_qpos : world.object_qpos + 7] = [*position, *quaternion]
    hinge = model.jnt_type[agent.joints] == int(mujoco.mjtJoint.mjJNT_HINGE)
    wide = np.where(hinge, np.pi, 1.0)
    lower, upper = agent.coupling.narrowed(agent.lower, agent.upper)
    lower, upper = np.where(np.isfinite(lower), lower, -wide), np.where(np.isfinite(upper), upper, wide)
    rng = np.random.default_rng(0)
    postures = agent.coupling.expand(np.vstack([agent.home, rng.uniform(lower, upper, (SAMPLES, len(lower)))]))
    distances = [_distance(world, agent, data, q)[0] for q in postures]
    found = FAR
    for i in np.argsort(distances)[:BEST]:
        found = min(found, _improved(world, agent, data, postures[i], lower, upper))
        if found <= TOUCHING:
            return 0.0
    return found


def _improved(world: World, agent: Agent, data: mujoco.MjData, q: Array, lower: Array, upper: Array) -> float:
    """Least distance on the way of damped least-squares steps that take the tip's nearest point to the object's."""
    model = world.model
    J = np.zeros((3, model.nv))
    least = FAR
    for _ in range(STEPS):
        distance, on_tip, on_object = _distance(world, agent, data, q)
        least = min(least, distance)
        if least <= TOUCHING:
            break
        mujoco.mj_comPos(model, data)
        mujoco.mj_jac(model, data, J, None, on_tip, agent.tip_body)
        mine = agent.coupling.reduce(J[:, agent.dofs])
        step = mine.T @ np.linalg.solve(mine @ mine.T + DAMPING * np.eye(3), on_object - on_tip)
        q = agent.coupling.expand(np.clip(q + step, lower, upper))
    return least


def _distance(world: World, agent: Agent, data: mujoco.MjData, q: Array) -> tuple[float, Array, Array]:
    """Distance of tip and object with the agent's joints at q, and the nearest points on both; 0 where they overlap."""
    data.qpos[agent.qpos] = q
    mujoco.mj_kinematics(world.model, data)
    least, points, fromto = FAR, np.zeros(6), np.zeros(6)
    for geom in world.object_geoms:
        distance = mujoco.mj_geomDistance(world.model, data, agent.tip_geom, int(geom), FAR, fromto)
        if distance < least:
            least, points = distance, fromto.copy()
    return max(least, 0.0), points[:3], points[3:]
