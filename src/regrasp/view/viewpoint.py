"""From where pictures and pages look at a plan: the size of the scene, and the direction that shows most of its contacts.

Rays are MuJoCo's: nothing has to be compiled or loaded before a page is there.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.world import World
from regrasp.view.camera import candidates
from regrasp.view.frames import put_all

Array = NDArray[np.float64]

LONGEST = 1.1
"""Length of the arrow of the largest force, in the object's bounding radii."""
AROUND = np.concatenate([np.zeros((1, 3)), 0.7 * np.eye(3), -0.7 * np.eye(3)])
"""Points of a body that are looked at, in its radii from its centre."""
FRONT = 0.1
"""What it counts that the eye is where y is negative: x then points to the right, as in a planar scene."""
STANDS, PASSED = 0, 5
"""Geom groups of what hides something, and of what does not."""


@dataclass(frozen=True)
class Outlook:
    """towards (3,): unit direction to the eye; centre (3,) and radius of what matters, m; all in W."""

    towards: Array
    centre: Array
    radius: float


def object_radius(world: World) -> float:
    """Of the object about its origin, m."""
    geoms = world.object_geoms
    return float((np.linalg.norm(world.model.geom_pos[geoms], axis=1) + world.model.geom_rbound[geoms]).max())


def outlook(world: World, states: Sequence[Array]) -> Outlook:
    """What object, goal and tips need in these states (qpos) of the whole model, and from where they are seen best."""
    data, size = mujoco.MjData(world.model), object_radius(world)
    places, radii = [np.array(world.scene.goal.pose.p)], [size]
    for qpos in states:
        put_all(world, qpos, data)
        places.append(data.xpos[world.object_body].copy())
        radii.append(size)
        for agent in world.agents:
            places.append(data.geom_xpos[agent.tip_geom].copy())
            radii.append(float(world.model.geom_rbound[agent.tip_geom]))
    points, reach = np.array(places), np.array(radii)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return Outlook(towards(world, states), centre, float((np.linalg.norm(points - centre, axis=1) + reach).max()))


def towards(world: World, states: Sequence[Array]) -> Array:
    """Unit direction (3,) in W to the eye that sees most in these states (qpos); a planar scene is seen along y.

    In space it is that one of `camera.candidates` in which most can be seen: the share of each tip, that of the tip seen
    worst most, the share of the object, and how far from the side contacts are seen: sines of the angles between the line
    of sight and the lines from tips to the object, along which forces go.
    """
    if set(world.scene.freedoms) <= {"x", "z", "ry"}:
        return np.array([0.0, -1.0, 0.0])
    model = copy.copy(world.model)
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    model.geom_group[:] = np.where(solid, STANDS, PASSED)
    for agent in world.agents:
        model.geom_group[agent.tip_geoms] = PASSED  # rays that leave a tip from inside must not end on it
    directions = -np.array(candidates())
    data, size = mujoco.MjData(model), object_radius(world)
    score = -FRONT * len(states) * directions[:, 1]
    for qpos in states:
        put_all(world, qpos, data)
        shares, sines, thing = [], [], data.xpos[world.object_body].copy()
        for agent in world.agents:
            place, radius = data.geom_xpos[agent.tip_geom], model.geom_rbound[agent.tip_geom]
            shares.append(_seen(model, data, place + radius * AROUND, directions, -1))
            sines.append(np.linalg.norm(np.cross(directions, thing - place), axis=1) / np.linalg.norm(thing - place))
        score += 1.5 * np.min(shares, axis=0) + np.mean(shares, axis=0) + np.mean(sines, axis=0)
        score += _seen(model, data, thing + 0.7 * size * AROUND, directions, world.object_body)
    return np.asarray(directions[int(np.argmax(score))])


def _seen(model: mujoco.MjModel, data: mujoco.MjData, points: Array, directions: Array, body: int) -> Array:
    """Share of the points (n, 3) between which and an eye far off nothing but a body stands, for each direction (d, 3)."""
    groups, geom = np.arange(6) == STANDS, np.zeros(1, np.int32)
    rays = [
        [mujoco.mj_ray(model, data, p, d, groups.astype(np.uint8), 1, body, geom) < 0.0 for p in points]
        for d in directions
    ]
    return np.mean(rays, axis=1)
