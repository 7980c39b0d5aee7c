"""The end of a chain: the geom that is an agent's tip, found by its name or that of its body."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.errors import InputError

Array = NDArray[np.float64]


def prepare(robot: mujoco.MjSpec, field: str, name: str) -> list[str]:
    """Makes sure that the tip `name` is a geom of that name, and tells what was done for it.

    A body may stand for its only colliding geom; of several, or where it has none of those fixed to it, the one whose
    bounding box reaches furthest from the chain's last joint. Raises InputError naming the `field` where there is none.
    """
    if robot.geom(name) is not None:
        return []
    body = robot.body(name)
    if body is None:
        names = [geom.name for geom in robot.geoms if geom.name] or [b.name for b in robot.bodies[1:] if b.name]
        raise InputError(field, f"no geom or body {name!r} in the model", f"legal: {', '.join(names)}")
    model = robot.compile()
    weld = model.body_weldid
    candidates = [geom for geom in robot.geoms if geom.contype or geom.conaffinity]
    own = [geom for geom in candidates if geom.parent.id == body.id]
    found = own or [geom for geom in candidates if weld[geom.parent.id] == weld[body.id]]
    if not found:
        raise InputError(field, f"body {name!r} has no colliding geom", "name the geom or body that touches the object")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    reach = [_reach(model, data, geom.id) for geom in found]
    tip = found[int(np.argmax(reach))]
    said = []
    if len(found) > 1 or not own:
        called = repr(tip.name) if tip.name else f"of body {tip.parent.name!r}"
        said.append(f"tip {name!r} is the geom {called}, which reaches furthest of {len(found)}")
    for pair in robot.pairs:  # the geom goes by the tip's name from here on
        for key in ("geomname1", "geomname2"):
            if tip.name and getattr(pair, key) == tip.name:
                setattr(pair, key, name)
    tip.name = name
    return said


def _reach(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Distance of the furthest corner of a geom's bounding box from the anchor of the last joint that moves it, m."""
    moved = int(model.body_weldid[model.geom_bodyid[geom]])
    count = int(model.body_jntnum[moved])
    anchor = data.xanchor[model.body_jntadr[moved] + count - 1] if count else data.xpos[moved]
    middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    corners = [middle + half * [x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    R = data.geom_xmat[geom].reshape(3, 3)
    return max(float(np.linalg.norm(R @ corner + data.geom_xpos[geom] - anchor)) for corner in corners)
