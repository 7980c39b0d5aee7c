"""The direction from which a scene is best seen: the one in which least stands before the fingertips and the object."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.world import World
from regrasp.view.camera import candidates
from regrasp.view.frames import State, put_all
from regrasp.view.shading import DRAWN, OBJECT, Stage, hits

Array = NDArray[np.float64]

AROUND = np.concatenate([np.zeros((1, 3)), 0.7 * np.eye(3), -0.7 * np.eye(3)])
"""Points of a body that are looked at, in its radii from its centre."""


def viewpoint(stage: Stage, world: World, states: Sequence[State]) -> Array:
    """The viewing direction (3,) in W, of `camera.candidates`, that hides least in these states of a world.

    What counts is the share of each tip that can be seen, that of the tip seen worst most, and the share of the object.
    """
    forward = np.array(candidates())
    data = mujoco.MjData(stage.model)
    size = 0.8 * stage.model.geom_rbound[world.object_geoms].max()
    score = np.zeros(len(forward))
    for state in states:
        put_all(world, state.qpos, data)
        shares = []
        for agent in world.agents:
            points = data.geom_xpos[agent.tip_geom] + stage.model.geom_rbound[agent.tip_geom] * AROUND
            shares.append(_free(stage, data, points, forward, (DRAWN, OBJECT)))
        thing = _free(stage, data, data.xpos[world.object_body] + size * AROUND, forward, (DRAWN,))
        score += 1.5 * np.min(shares, axis=0) + np.mean(shares, axis=0) + thing
    return forward[int(np.argmax(score))]


def _free(stage: Stage, data: mujoco.MjData, points: Array, forward: Array, groups: tuple[int, ...]) -> Array:
    """Share of the points (n, 3) between which and an eye far off nothing stands, for each direction (d, 3): (d,).

    A point inside a body does not see that body.
    """
    return np.mean([hits(stage, data, point, -forward, groups)[0] < 0 for point in points], axis=0)
