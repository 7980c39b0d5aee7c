"""From where a page looks at a plan: the size of the scene, and the direction in which least stands before its tips.

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
    """What object, goal and tips need in these states (qpos) of the whole model; a planar scene is seen along y.

    In space that direction of `camera.candidates` is taken in which most can be seen: the share of each tip, that of the
    tip seen worst most, the share of the object, and how far from the side contacts are seen: sines of the angles between
    the line of sight and the lines from tips to the object, along which forces go.
    """
    flat = set(world.scene.freedoms) <= {"x", "z", "ry"}
    model = copy.copy(world.model)
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    model.geom_group[:] = np.where(solid, STANDS, PASSED)
    for agent in world.agents:
        model.geom_group[agent.tip_geoms] = PASSED  # rays that leave a tip from inside must not end on it
    towards = np.array([[0.0, -1.0, 0.0]]) if flat else -np.array(candidates())
    data, score, size = mujoco.MjData(model), -FRONT * len(states) * towards[:, 1], object_radius(world)
    places, radii = [np.array(world.scene.goal.pose.p)], [size]
    for qpos in states:
        put_all(world, qpos, data)
        shares, sines, thing = [], [], data.xpos[world.object_body].copy()
        for agent in world.agents:
            place, radius = data.geom_xpos[agent.tip_geom].copy(), float(model.geom_rbound[agent.tip_geom])
            shares.append(_seen(model, data, place + radius * AROUND, towards, -1))
            sines.append(np.linalg.norm(np.cross(towards, thing - place), axis=1) / np.linalg.norm(thing - place))
            places.append(place)
            radii.append(radius)
        places.append(thing)
        radii.append(size)
        score += 1.5 * np.min(shares, axis=0) + np.mean(shares, axis=0) + np.mean(sines, axis=0)
        score += _seen(model, data, thing + 0.7 * size * AROUND, towards, world.object_body)
    points, reach = np.array(places), np.array(radii)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return Outlook(
        towards[int(np.argmax(score))], centre, float((np.linalg.norm(points - centre, axis=1) + reach).max())
    )


def _seen(model: mujoco.MjModel, data: mujoco.MjData, points: Array, towards: Array, body: int) -> Array:
    """Share of the points (n, 3) between which and an eye far off nothing but a body stands, for each direction (d, 3)."""
    groups, geom = np.arange(6) == STANDS, np.zeros(1, np.int32)
    rays = [
        [mujoco.mj_ray(model, data, p, d, groups.astype(np.uint8), 1, body, geom) < 0.0 for p in points]
        for d in towards
    ]
    return np.mean(rays, axis=1)
