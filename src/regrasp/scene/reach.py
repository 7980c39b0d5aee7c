"""How near a tip can come to the object: sampled postures, the nearest of them improved."""

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.couplings import Coupling, coupling
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


class Chain(NamedTuple):
    """The joints (ids) between the world and a tip, which of them follow others, and their ranges."""

    joints: NDArray[np.int64]
    coupling: Coupling
    lower: Array
    upper: Array


def nearest(world: World, agent: Agent, position: Array, quaternion: Array) -> float:
    """Least distance, m, found between an agent's tip and the object in this pose; 0 where they can touch.

    Joint ranges hold (an unlimited hinge turns once, an unlimited slide goes 1 m either way), collisions do not count. An arm
    that carries the agent takes part.
    """
    model, data = world.model, mujoco.MjData(world.model)
    limbs = (agent,) if agent.arm < 0 else (world.arms[agent.arm], agent)
    joints, home = (np.concatenate([getattr(limb, key) for limb in limbs]) for key in ("joints", "home"))
    lower, upper = (np.concatenate([getattr(limb, key) for limb in limbs]) for key in ("lower", "upper"))
    coupled = coupling(model, joints)
    data.qpos[:] = world.start
    data.qpos[world.object_qpos : world.object_qpos + 7] = [*position, *quaternion]
    hinge = model.jnt_type[joints] == int(mujoco.mjtJoint.mjJNT_HINGE)
    wide = np.where(hinge, np.pi, 1.0)
    lower, upper = coupled.narrowed(lower, upper)
    lower, upper = np.where(np.isfinite(lower), lower, -wide), np.where(np.isfinite(upper), upper, wide)
    rng = np.random.default_rng(0)
    postures = coupled.expand(np.vstack([home, rng.uniform(lower, upper, (SAMPLES, len(lower)))]))
    chain = Chain(joints, coupled, lower, upper)
    distances = [_distance(world, agent, chain, data, q)[0] for q in postures]
    found = FAR
    for i in np.argsort(distances)[:BEST]:
        found = min(found, _improved(world, agent, chain, data, postures[i]))
        if found <= TOUCHING:
            return 0.0
    return found


def _improved(world: World, agent: Agent, chain: Chain, data: mujoco.MjData, q: Array) -> float:
    """Least distance on the way of damped least-squares steps that take the tip's nearest point to the object's."""
    model = world.model
    J = np.zeros((3, model.nv))
    least = FAR
    for _ in range(STEPS):
        distance, on_tip, on_object = _distance(world, agent, chain, data, q)
        least = min(least, distance)
        if least <= TOUCHING:
            break
        mujoco.mj_comPos(model, data)
        mujoco.mj_jac(model, data, J, None, on_tip, agent.tip_body)
        mine = chain.coupling.reduce(J[:, model.jnt_dofadr[chain.joints]])
        step = mine.T @ np.linalg.solve(mine @ mine.T + DAMPING * np.eye(3), on_object - on_tip)
        q = chain.coupling.expand(np.clip(q + step, chain.lower, chain.upper))
    return least


def _distance(world: World, agent: Agent, chain: Chain, data: mujoco.MjData, q: Array) -> tuple[float, Array, Array]:
    """Distance of tip and object with the chain's joints at q, and the nearest points on both; 0 where they overlap."""
    data.qpos[world.model.jnt_qposadr[chain.joints]] = q
    mujoco.mj_kinematics(world.model, data)
    least, points, fromto = FAR, np.zeros(6), np.zeros(6)
    for geom in world.object_geoms:
        distance = mujoco.mj_geomDistance(world.model, data, agent.tip_geom, int(geom), FAR, fromto)
        if distance < least:
            least, points = distance, fromto.copy()
    return max(least, 0.0), points[:3], points[3:]
