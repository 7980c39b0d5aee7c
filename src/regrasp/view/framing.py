"""What a picture must show, and how large it has to be for that."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.world import World
from regrasp.view.camera import Camera, fit, proportion
from regrasp.view.frames import State, put_all, put_object

Array = NDArray[np.float64]

LOWEST, HIGHEST = 0.5, 0.875
"""Height of a picture over its width, at least and at most: as what it shows needs."""
ROOM = 0.6
"""Around what a picture shows, for the words beside the tips, in radii of tips."""


def interest(world: World, states: Sequence[State], data: mujoco.MjData, scale: float) -> tuple[Array, Array]:
    """Spheres in W (centres (n, 3), radii (n,)) a picture must show: the object's way, its goal, tips, arrows.

    The object counts as the corners of its geoms' boxes, so that a flat one leaves no room empty; of the robots only
    the tips count, as most of a large one is far from what happens.
    """
    goal = world.scene.goal.pose
    tips = np.concatenate([agent.tip_geoms for agent in world.agents])
    sizes = world.model.geom_rbound[tips]
    room = ROOM * float(sizes.max())
    seen: list[tuple[Array, Array | float]] = []
    for state in states:
        put_all(world, state.qpos, data)
        seen += [(_corners(world, data), room), (data.geom_xpos[tips].copy(), sizes + room)]
        seen += [((arrow.head - scale * arrow.force)[None], room / 2) for arrow in state.arrows]
    put_object(world, np.concatenate([goal.p, goal.wxyz]), data)
    seen.append((_corners(world, data), room))
    return np.concatenate([p for p, _ in seen]), np.concatenate([np.broadcast_to(r, len(p)) for p, r in seen])


def _corners(world: World, data: mujoco.MjData) -> Array:
    """Corners (n, 3) of the boxes about the object's geoms, W."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    boxes = world.model.geom_aabb[world.object_geoms]
    poses = zip(data.geom_xpos[world.object_geoms], data.geom_xmat[world.object_geoms].reshape(-1, 3, 3), strict=True)
    corners = [p + (box[:3] + signs * box[3:]) @ R.T for box, (p, R) in zip(boxes, poses, strict=True)]
    return np.concatenate(corners)


def framed(forward: Array, centres: Array, radii: Array, width: int) -> Camera:
    """The camera along `forward` whose image is as high as it needs to be; an even number of px, as films want it."""
    part = min(max(proportion(forward, centres, radii), LOWEST), HIGHEST)
    return fit(forward, centres, radii, width, 2 * round(part * width / 2))
