"""The bodies of a world as a page draws them: shapes in the frames of moving bodies, meshes, and the bodies' poses."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.world import World
from regrasp.view.frames import put_all

Array = NDArray[np.float64]

KINDS = {0: "plane", 2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder", 6: "box", 7: "mesh"}
"""MuJoCo's codes of geom types that a page can draw."""
VISIBLE = 2
"""Geom groups up to this one are those that MuJoCo's own viewers show."""


@dataclass(frozen=True)
class Shape:
    """What is drawn rigidly attached to a body.

    body: row of the poses, −1 what stands still; pose (7,): in its frame (or W), position and quaternion w x y z. kind,
    size: MuJoCo's, m; mesh: index of the mesh. role: 'object', 'agent', 'static'; agent: whose, −1 nobody's;
    tip: whether contacts are made with it; shell: whether it is not to be seen but stands for something in planning.
    """

    body: int
    kind: str
    size: tuple[float, ...]
    pose: tuple[float, ...]
    role: str
    agent: int = -1
    tip: bool = False
    shell: bool = False
    mesh: int = -1


@dataclass(frozen=True)
class Mesh:
    """Triangles: vertices (v, 3), m, faces (f, 3); normals (v, 3), none where they follow from the faces."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]
    normals: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))


@dataclass(frozen=True)
class Bodies:
    """ids: of the moving bodies in the model, in the order of the poses; shapes, meshes: what they look like."""

    ids: NDArray[np.int64]
    shapes: tuple[Shape, ...]
    meshes: tuple[Mesh, ...]


def bodies(world: World) -> Bodies:
    """What is to be drawn of a world, and as shells what planning keeps clear where that is something else."""
    model = world.model
    data = mujoco.MjData(model)
    put_all(world, world.start, data)
    geoms = np.flatnonzero(np.isin(model.geom_type, list(KINDS)))
    ids = np.array(sorted({int(b) for b in model.geom_bodyid[geoms] if model.body_weldid[b]}), np.int64)
    row = {int(body): i for i, body in enumerate(ids)}
    owner = {int(body): i for i, agent in enumerate(world.agents) for body in agent.bodies}
    tips = {int(g) for agent in world.agents for g in agent.tip_geoms}
    seen, skin = _seen(world), world.matter.skin
    used: dict[int, int] = {}
    shapes: list[Shape] = []
    for g in map(int, geoms):
        body = int(model.geom_bodyid[g])
        role = "object" if body == world.object_body else "static" if g in world.fixture_geoms else "agent"
        if role == "object" and skin is not None:
            continue
        who, place = owner.get(body, -1), row.get(body, -1)
        pose = (*model.geom_pos[g], *model.geom_quat[g]) if place >= 0 else _pose(data.geom_xpos[g], data.geom_xmat[g])
        kind, size = KINDS[int(model.geom_type[g])], model.geom_size[g]
        if seen[g] or model.geom_contype[g] or model.geom_conaffinity[g]:
            mesh = used.setdefault(int(model.geom_dataid[g]), len(used)) if kind == "mesh" else -1
            shapes.append(_shape(place, kind, size, pose, role, who, g in tips, not seen[g], mesh))
        for each in world.links.shapes.get(g, ()):
            R, p = _matrix(pose[3:]), np.array(pose[:3])
            inner = _pose(R @ each.p + p, R @ each.R)
            shapes.append(_shape(place, each.kind, each.size, inner, role, who, False, True, -1))
    meshes = [_mesh(model, each) for each in used]
    if skin is not None:
        still = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        shapes.append(_shape(row[world.object_body], "mesh", (), still, "object", -1, False, False, len(meshes)))
        meshes.append(
            Mesh(skin.vertices.astype(np.float32), skin.faces.astype(np.uint32), skin.normals.astype(np.float32))
        )
    return Bodies(ids, tuple(shapes), tuple(meshes))


def poses(world: World, ids: NDArray[np.int64], states: Iterable[Array]) -> NDArray[np.float32]:
    """Poses (S, B, 7) in W, position and quaternion w x y z, of bodies in states of the whole model (qpos)."""
    data = mujoco.MjData(world.model)
    rows = []
    for qpos in states:
        put_all(world, qpos, data)
        rows.append(np.concatenate([data.xpos[ids], data.xquat[ids]], axis=1))
    return np.array(rows, np.float32).reshape(-1, len(ids), 7)


def _seen(world: World) -> NDArray[np.bool_]:
    """Which geoms are drawn: tips and object; of other bodies what is made to be seen, else what collides."""
    model = world.model
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    visible = model.geom_group <= VISIBLE
    seen = np.zeros(model.ngeom, bool)
    for body in range(model.nbody):
        mine = model.geom_bodyid == body
        for choice in (visible & ~solid, visible, solid):
            if np.any(mine & choice):
                seen |= mine & choice
                break
    seen[world.object_geoms] = seen[world.fixture_geoms] = True
    for agent in world.agents:
        seen[agent.tip_geoms] = True
    return seen


def _shape(
    body: int, kind: str, size: Iterable[float], pose: Iterable[float], role: str, agent: int, tip: bool, shell: bool,
    mesh: int,
) -> Shape:  # fmt: skip
    sizes, placed = (tuple(round(float(x), 6) for x in row) for row in (size, pose))
    return Shape(body, kind, sizes, placed, role, agent, tip, shell, mesh)


def _mesh(model: mujoco.MjModel, mesh: int) -> Mesh:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
    return Mesh(model.mesh_vert[first : first + count].astype(np.float32), faces.astype(np.uint32))


def _matrix(quaternion: Iterable[float]) -> Array:
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, np.array(list(quaternion), float))
    return R.reshape(3, 3)


def _pose(p: Array, R: Array) -> tuple[float, ...]:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.asarray(R, float).ravel())
    return (*map(float, p), *map(float, quaternion))
