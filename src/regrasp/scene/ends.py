"""The end of a chain: the geom that is an agent's tip, found by its name or that of its body."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.errors import InputError
from regrasp.scene import collisions, fits

Array = NDArray[np.float64]

FURTHEST = 0.98
"""Corners so far from the last joint, as a part of the furthest's distance, show where a mesh's outer end is."""
ROUGH = 0.2
"""Part of its radius by which a sphere may miss the end that it stands for."""
CUT = 0.3
"""Radii behind the tip sphere's centre from which on the rest of its mesh is a body of its own: contacts on the sphere's
front half have room beside it."""


def prepare(robot: mujoco.MjSpec, field: str, name: str) -> list[str]:
    """Makes sure that the tip `name` is a geom of that name, and tells what was done for it.

    A body may stand for its only colliding geom; of several, or where it has none of those fixed to it, the one whose
    bounding box reaches furthest from the chain's last joint. Raises InputError naming the `field` where there is none.
    """
    if (tip := robot.geom(name)) is not None:
        return _rounded(robot, tip) if tip.type == mujoco.mjtGeom.mjGEOM_MESH else []
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
    return said + (_rounded(robot, tip) if tip.type == mujoco.mjtGeom.mjGEOM_MESH else [])


def _rounded(robot: mujoco.MjSpec, tip: mujoco.MjsGeom) -> list[str]:
    """Puts the sphere that a mesh's outer end is (`fits.end_sphere`) into its place and name as the tip.

    What the sphere has not replaced, the hull from CUT radii behind the sphere's centre on, still collides; the mesh itself
    is for the eye from here on. The body keeps its mass.
    """
    if not (tip.contype or tip.conaffinity):
        return []
    model = robot.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    body, name = tip.parent, tip.name
    corners = fits.hull(collisions.vertices(model, tip.id))
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, model.geom_quat[tip.id])
    corners = corners @ R.reshape(3, 3).T + model.geom_pos[tip.id]
    anchor = data.xmat[body.id].reshape(3, 3).T @ (_anchor(model, data, tip.id) - data.xpos[body.id])
    away = np.linalg.norm(corners - anchor, axis=1)
    outward = corners[away > FURTHEST * away.max()].mean(axis=0) - anchor
    outward /= np.linalg.norm(outward)
    centre, radius, error = fits.end_sphere(corners, outward)
    body.explicitinertial, body.fullinertia = True, [np.nan, 0, 0, 0, 0, 0]
    body.mass, body.inertia = model.body_mass[body.id], model.body_inertia[body.id]
    body.ipos, body.iquat = model.body_ipos[body.id], model.body_iquat[body.id]
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    solid = {"contype": tip.contype, "conaffinity": tip.conaffinity, "friction": tip.friction}
    rest = fits.between(corners, outward, -np.inf, float(centre @ outward) - CUT * radius)
    if len(rest) > 3:
        mesh = robot.add_mesh(name=f"{name}/rest", uservert=rest.ravel())
        body.add_geom(name=f"{name}/rest", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, **solid)
    tip.name, tip.contype, tip.conaffinity = f"{name}/mesh", 0, 0
    body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=centre, **solid)
    said = f"tip {name!r} is a mesh: its end counts as a sphere of radius {1e3 * radius:.1f} mm"
    rough = "; better give its shape in the scene" if error > ROUGH * radius else ""
    return [f"{said}, from which it is {1e3 * error:.2g} mm at most{rough}"]


def _reach(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Distance of the furthest corner of a geom's bounding box from the anchor of the last joint that moves it, m."""
    anchor = _anchor(model, data, geom)
    middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    corners = [middle + half * [x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    R = data.geom_xmat[geom].reshape(3, 3)
    return max(float(np.linalg.norm(R @ corner + data.geom_xpos[geom] - anchor)) for corner in corners)


def _anchor(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Array:
    """Where the last joint that moves a geom is, in W; where nothing moves it, the origin of what it stands on."""
    moved = int(model.body_weldid[model.geom_bodyid[geom]])
    count = int(model.body_jntnum[moved])
    return np.array(data.xanchor[model.body_jntadr[moved] + count - 1] if count else data.xpos[moved])
