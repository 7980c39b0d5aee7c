"""Fingertips: their shapes as surfaces, and those that a scene gives in place of what its robot has."""

from collections.abc import Callable, Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.errors import InputError
from regrasp.scene import ends, solids
from regrasp.scene.parts import TIP_COLOUR
from regrasp.scene.pose import multiply
from regrasp.scene.schema import Object, Tip

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

DENSITY = 1000.0
"""Of a tip that a scene gives, kg/m³: water's."""
ROUNDING = 0.002
"""m, of the edges of a box for which a scene gives none: contacts roll on smooth surfaces only."""
PIECES = 15
"""Geoms of a box with rounded edges, see `solids`: the first three are boxes, the others capsules."""
SURFACES = {
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
}


def names(tip: str, has: Callable[[str], bool]) -> tuple[str, ...]:
    """The geoms that the tip called `tip` is made of, the first of which has its frame; has: whether there is such a geom."""
    others = tuple(f"{tip}/{i}" for i in range(1, PIECES))
    return (tip, *others) if all(map(has, others)) else (tip,)


def surface(model: mujoco.MjModel, geoms: Ids, field: str) -> tuple[int, Array]:
    """The surface's code and its four sizes, see `solids.kind`, of a tip made of these geoms.

    Raises InputError naming the `field` for a geom on which no contact can roll.
    """
    first = mujoco.mjtGeom(int(model.geom_type[geoms[0]]))
    if len(geoms) == PIECES:
        outer, rounding = model.geom_size[geoms[:3]].max(axis=0), float(model.geom_size[geoms[3], 0])
        return solids.KINDS.index("box"), np.append(outer, rounding)
    if first not in SURFACES:
        shape = first.name.removeprefix("mjGEOM_").lower()
        raise InputError(field, f"is a {shape}", "legal: sphere, ellipsoid, capsule, box")
    count = {"sphere": 1, "ellipsoid": 3, "capsule": 2}[SURFACES[first]]
    size = np.zeros(4)
    size[:count] = model.geom_size[geoms[0], :count]
    return solids.KINDS.index(SURFACES[first]), size


def sharpest(spec: mujoco.MjSpec, tips: Iterable[str]) -> float:
    """The smallest radius of curvature of these tips, m; 0 where there is none: no contact can roll on other shapes."""
    radii = []
    for tip in tips:
        pieces = names(tip, {geom.name for geom in spec.geoms}.__contains__)
        size = spec.geom(pieces[0]).size
        if len(pieces) == PIECES:
            radii.append(spec.geom(pieces[3]).size[0])
        elif (kind := spec.geom(tip).type) == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            radii.append(np.min(size) ** 2 / np.max(size))
        elif kind in SURFACES:
            radii.append(size[0])
    return float(min(radii, default=0.0))


def reshape(spec: mujoco.MjSpec, name: str, tip: Tip) -> None:
    """Puts the shape of `tip` in the place of the geom `name`, which is gone; its pose counts from that geom's frame."""
    placed = spec.compile().geom(name)
    old, turned = spec.geom(name), np.empty(3)
    mujoco.mju_rotVecQuat(turned, tip.pose.p, placed.quat)
    body = old.parent
    solid = {"contype": old.contype, "conaffinity": old.conaffinity, "friction": old.friction}
    spec.delete(old)
    _add(body, name, tip.solid, placed.pos + turned, multiply(placed.quat, tip.pose.wxyz), solid)


def give(robot: mujoco.MjSpec, field: str, name: str, tip: Tip) -> list[str]:
    """Gives a robot of one's own the tip `name`: a shape on a body of it, or a box of it with rounded edges.

    Returns what was done in words. Raises InputError naming the `field` where the robot has no such body or box.
    """
    if tip.geom is None:
        body = robot.body(tip.body)
        if body is None:
            legal = ", ".join(body.name for body in robot.bodies[1:] if body.name)
            raise InputError(f"{field}.body", f"no body {tip.body!r} in the model", f"legal: {legal}")
        _add(body, name, tip.solid, tip.pose.p, tip.pose.wxyz, {})
        return [f"tip {name!r} is the {tip.shape} that the scene gives body {tip.body!r}"]
    said = ends.prepare(robot, f"{field}.geom", tip.geom)
    box = robot.geom(tip.geom)
    if box.type != mujoco.mjtGeom.mjGEOM_BOX:
        raise InputError(f"{field}.geom", f"{tip.geom!r} is not a box", "only a box has edges to round")
    if tip.rounding >= min(box.size):
        raise InputError(
            f"{field}.rounding", f"{tip.rounding:g} m is too large for {tip.geom!r}", f"legal: < {min(box.size):g} m"
        )
    reshape(robot, tip.geom, Tip(shape="box", size=tuple(box.size.tolist()), rounding=tip.rounding))
    return [*said, f"tip {tip.geom!r} has its edges rounded by {1e3 * tip.rounding:g} mm"]


def smooth(robot: mujoco.MjSpec, field: str, name: str) -> list[str]:
    """Rounds the edges of the tip `name` of a robot of one's own where it is a box; what was done in words."""
    box = robot.geom(name)
    if box.type != mujoco.mjtGeom.mjGEOM_BOX:
        return []
    return give(robot, field, name, Tip(geom=name, rounding=min(ROUNDING, 0.25 * min(box.size))))


def _add(
    body: mujoco.MjsBody, name: str, solid: Object, p: Array, quat: Array, collision: dict[str, object]
) -> None:  # fmt: skip
    """Adds the geoms of a solid, whose frame stands at (p, quat) in the body's, to the body, as `names` calls them."""
    scratch = mujoco.MjSpec()
    solids.add_geoms(scratch.worldbody.add_body(name="object"), solid)
    pieces = scratch.compile()
    box = 8.0 * float(np.prod(solid.size)) * DENSITY
    for i in range(pieces.ngeom):
        moved = np.empty(3)
        mujoco.mju_rotVecQuat(moved, pieces.geom_pos[i], quat)
        geom = body.add_geom(
            name=f"{name}/{i}" if i else name, type=mujoco.mjtGeom(int(pieces.geom_type[i])), size=pieces.geom_size[i],
            pos=p + moved, quat=multiply(quat, pieces.geom_quat[i]), rgba=TIP_COLOUR, density=DENSITY, **collision,
        )  # fmt: skip
        if pieces.ngeom > 1:  # which overlap: the first weighs as much as all
            geom.mass = 0.0 if i else box
