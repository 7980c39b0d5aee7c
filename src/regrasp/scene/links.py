"""The links of a robot that are meshes, enclosed by primitives: what planning keeps clear, where physics has the hull."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene import cache, collisions, fits
from regrasp.scene.fits import KINDS, Primitive

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
Part = tuple[int, int]
"""Geom id and which of its primitives."""

CLOSE = 3e-3
"""Primitives nearer than this at rest, m, could never keep the clearance that planning asks for."""


@dataclass(frozen=True)
class Links:
    """shapes: geom id of a colliding mesh → the primitives that enclose it together, in the geom's frame.

    spared: pairs of primitives that planning does not keep apart, because they overlap at rest though the hulls do not, and
    their bodies are neighbours, or neighbours but one. `check` judges the hulls themselves. said: each such pair of bodies
    in a sentence; crowded: those which are no neighbours, and so are kept apart all the same.
    """

    shapes: Mapping[int, tuple[Primitive, ...]]
    spared: frozenset[tuple[Part, Part]]
    said: tuple[str, ...]
    crowded: tuple[str, ...]


def links(model: mujoco.MjModel, rest: Array, pairs: Ids, convex: Ids) -> Links:
    """The mesh links of a world at rest, `rest` its qpos; pairs (n, 2): geoms that must never touch.

    convex: geoms that are what they are, meshes or not.
    """
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    meshes = np.flatnonzero(solid & (model.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH)))
    shapes = {int(g): enclosing(collisions.vertices(model, int(g))) for g in meshes if g not in convex}
    if not shapes:
        return Links({}, frozenset(), (), ())
    data = mujoco.MjData(model)
    data.qpos[:] = rest
    mujoco.mj_kinematics(model, data)
    stage, index = _stage(model, data, shapes)
    placed = mujoco.MjData(stage)
    mujoco.mj_kinematics(stage, placed)
    spared: set[tuple[Part, Part]] = set()
    said: list[str] = []
    crowded: list[str] = []
    for g, h in pairs:
        if not {int(g), int(h)} & shapes.keys() or {int(g), int(h)} & {int(o) for o in convex}:
            continue
        close = [
            (a, b)
            for a in index[int(g)]
            for b in index[int(h)]
            if mujoco.mj_geomDistance(stage, placed, index[int(g)][a], index[int(h)][b], 2 * CLOSE, None) < CLOSE
        ]
        if not close or mujoco.mj_geomDistance(model, data, int(g), int(h), 2 * CLOSE, None) <= 0.0:
            continue
        bodies = [int(model.geom_bodyid[i]) for i in (g, h)]
        who = " and ".join(repr(model.body(body).name) for body in bodies)
        if collisions.apart(model, *bodies) <= collisions.NEIGHBOURS:
            spared |= set(close)
            said.append(f"the shapes about links {who}, neighbours, meet at rest: planning leaves them to `check`")
        else:
            crowded.append(f"the shapes about links {who} meet at rest, though their meshes do not")
    return Links(shapes, frozenset(spared), tuple(said), tuple(crowded))


def enclosing(vertices: Array) -> tuple[Primitive, ...]:
    """`fits.enclosing`, kept on disk."""

    def make() -> dict[str, NDArray[np.generic]]:
        found = fits.enclosing(vertices)
        return {
            "kind": np.array([KINDS.index(each.kind) for each in found]),
            "size": np.array([each.size for each in found]),
            "R": np.array([each.R for each in found]),
            "p": np.array([each.p for each in found]),
        }

    found = cache.kept("link", {"vertices": vertices}, make)
    rows = zip(*(found[key] for key in ("kind", "size", "R", "p")), strict=True)
    return tuple(Primitive(KINDS[int(kind)], size, R, p) for kind, size, R, p in rows)


def _stage(
    model: mujoco.MjModel, data: mujoco.MjData, shapes: Mapping[int, tuple[Primitive, ...]]
) -> tuple[mujoco.MjModel, dict[int, dict[Part, int]]]:
    """A model of all geoms where `data` has them, meshes as their primitives; geom id → part → id in it."""
    spec = mujoco.MjSpec()
    index: dict[int, dict[Part, int]] = {}
    count = 0
    quaternion = np.empty(4)
    for g in range(model.ngeom):
        R, p = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g]
        if g in shapes:
            rows = [
                (getattr(mujoco.mjtGeom, f"mjGEOM_{s.kind.upper()}"), s.size, R @ s.R, R @ s.p + p) for s in shapes[g]
            ]
        elif model.geom_dataid[g] < 0:
            rows = [(mujoco.mjtGeom(int(model.geom_type[g])), model.geom_size[g], R, p)]
        else:
            continue
        index[g] = {}
        for i, (kind, size, turn, place) in enumerate(rows):
            mujoco.mju_mat2Quat(quaternion, turn.ravel())
            size = np.maximum(size, 1e-9) if kind == mujoco.mjtGeom.mjGEOM_PLANE else size
            spec.worldbody.add_geom(type=kind, size=size, pos=place, quat=quaternion.copy())
            index[g][g, i] = count
            count += 1
    return spec.compile(), index
