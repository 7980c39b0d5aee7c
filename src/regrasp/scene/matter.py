"""What the object is made of: its surface, its convex parts, its mass; and what of it a plan must carry with it."""

import functools
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.errors import InputError
from regrasp.scene import hulls, meshes, solids
from regrasp.scene.cache import Arrays, kept
from regrasp.scene.grids import Grid, Skin, nodes, skin_of, spacing_for
from regrasp.scene.openings import opened
from regrasp.scene.schema import AnyObject, MeshObject, Object, UnionObject
from regrasp.scene.triangles import Triangles, moments

Array = NDArray[np.float64]
Assets = Mapping[str, bytes]

MESH = 6  # the surface's code where a grid describes it
ASSET = "object.npz"
INPUTS = ("vertices", "faces", "rounding", "spacing", "ball")
"""What the mesh's surface is made from."""
BALL = 1.5
"""Of the tips' smallest radius: the ball that fills hollows. In one as wide as the tip itself a contact would have no place of
its own, in what a far larger ball fills the tip would rest on the rims no more."""


@dataclass(frozen=True)
class Part:
    """One convex part, its frame at R_OP (3, 3), p_OP (3,) in O.

    A solid (`solids.kind`: kind, size (4,)); or, with the kind MESH, the hull of vertices (V, 3) swept by a ball of the
    radius size[3].
    """

    kind: int
    size: Array
    R_OP: Array
    p_OP: Array
    vertices: Array


@dataclass(frozen=True)
class Matter:
    """What the object is made of.

    kind, size: its surface's code and size; parts: they make up its solid; mass, kg, centre: of mass, (3,) in O, m, and
    inertia (3, 3) about it in O's axes, kg m².
    Where it is a mesh: the mesh; skin: its surface, opened, filled and triangulated; resolution: m between its grid's nodes;
    error: m by which the skin differs from the mesh opened, at most, which is in creases; ball: m, of the ball that filled
    hollows.
    """

    kind: int
    size: Array
    parts: tuple[Part, ...]
    mass: float
    centre: Array
    inertia: Array
    skin: Skin | None = None
    resolution: float = 0.0
    error: float = 0.0
    mesh: meshes.Mesh | None = None
    ball: float = 0.0


def assets_of(shape: AnyObject, tip: float) -> dict[str, bytes]:
    """The files that describe the object from now on, made from those that the scene names, and kept.

    tip: m, the smallest radius of curvature of the tips.
    """
    if not isinstance(shape, MeshObject):
        return {}
    source = {
        "file": np.frombuffer(Path(meshes.checked(shape.file, "object")).read_bytes(), np.uint8),
        "format": np.array(Path(shape.file).suffix.lower()),
        "numbers": np.array([shape.scale, shape.rounding, shape.resolution or 0.0, BALL * tip]),
    }
    packed = kept("object-2", source, lambda: {"packed": np.frombuffer(_packed(shape, BALL * tip), np.uint8)})["packed"]
    return {ASSET: packed.tobytes()}


def _packed(shape: MeshObject, ball: float) -> bytes:
    """The mesh, its parts and its skin as one file; ball: m, see `openings.opened`."""
    mesh = meshes.read(shape.file, shape.scale, "object")
    spacing = shape.resolution or spacing_for(np.ptp(mesh.vertices, axis=0), shape.rounding)
    arrays = {
        "vertices": mesh.vertices,
        "faces": mesh.faces,
        "rounding": np.array(shape.rounding),
        "spacing": np.array(spacing),
        "ball": np.array(ball),
    }
    made = _opened(arrays)
    parts = hulls.parts_of(made["core_vertices"], made["core_faces"])
    file = io.BytesIO()
    np.savez_compressed(
        file, allow_pickle=False, **arrays,
        **{name: made[name] for name in ("skin_vertices", "skin_normals", "skin_faces", "error")},
        parts=np.concatenate([points for points, _ in parts]), counts=np.array([len(points) for points, _ in parts]),
        excess=np.array([excess for _, excess in parts]), remarks=np.array(mesh.remarks, dtype=np.str_),
    )  # fmt: skip
    return file.getvalue()


def matter_of(shape: AnyObject, assets: Assets) -> Matter:
    """The object of a scene, with the files that `assets_of` made."""
    if isinstance(shape, Object):
        kind, size = solids.kind(shape)
        mass = _mass(shape, solids.volume(shape))
        inertia = np.diag(mass * solids.inertia(shape))
        part = Part(kind, size, np.eye(3), np.zeros(3), np.zeros((0, 3)))
        return Matter(kind, size, (part,), mass, np.zeros(3), inertia)
    if isinstance(shape, UnionObject):
        parts = tuple(Part(*solids.kind(piece), piece.pose.R, piece.pose.p, np.zeros((0, 3))) for piece in shape.parts)
        skin = skin_of(_united(shape))
        rounding = min(solids.least_radius(piece) for piece in shape.parts)
        return Matter(MESH, np.array([0.0, 0.0, 0.0, rounding]), parts, *_weighed(shape, skin.vertices, skin.faces))
    stored = _stored(assets)
    pieces = np.split(stored["parts"], np.cumsum(stored["counts"])[:-1])
    radii = shape.rounding + stored["excess"]
    mesh = meshes.Mesh(stored["vertices"], stored["faces"], tuple(str(remark) for remark in stored["remarks"]))
    skin = Skin(
        stored["skin_vertices"].astype(float), stored["skin_normals"].astype(float), stored["skin_faces"].astype(int)
    )
    return Matter(
        MESH, np.array([0.0, 0.0, 0.0, shape.rounding]),
        tuple(_hull(points, float(radius)) for points, radius in zip(pieces, radii, strict=True)),
        *_weighed(shape, mesh.vertices, mesh.faces), skin=skin, resolution=float(stored["spacing"]),
        error=float(stored["error"]), mesh=mesh,
        ball=float(stored["ball"]),
    )  # fmt: skip


def grid_of(shape: AnyObject, assets: Assets) -> Grid | None:
    """The signed distance to the object's surface, where no closed form gives it."""
    if isinstance(shape, UnionObject):
        return _united(shape)
    if isinstance(shape, MeshObject):
        made = _opened({name: _stored(assets)[name] for name in INPUTS})
        return Grid(made["origin"], float(made["grid_spacing"]), made["values"])
    return None


def _stored(assets: Assets) -> Arrays:
    if ASSET not in assets:
        raise InputError("assets", f"no {ASSET}", "plan it again")
    return _unpacked(assets[ASSET])


@functools.lru_cache(maxsize=2)
def _unpacked(packed: bytes) -> Arrays:
    """The arrays of an npz file, read only: a world asks for them several times."""
    with np.load(io.BytesIO(packed)) as archive:
        arrays = dict(archive)
    for array in arrays.values():
        array.setflags(write=False)
    return arrays


def _hull(points: Array, radius: float) -> Part:
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return Part(MESH, np.array([0.0, 0.0, 0.0, radius]), np.eye(3), middle, points - middle)


def _opened(arrays: Arrays) -> Arrays:
    """`openings.opened` of the arrays, kept."""

    def make() -> Arrays:
        spacing = float(arrays["spacing"])
        mesh = Triangles(arrays["vertices"], arrays["faces"], spacing)
        found = opened(mesh, float(arrays["rounding"]), spacing, float(arrays["ball"]))
        return {
            "core_vertices": found.core.vertices, "core_faces": found.core.faces,
            "origin": found.grid.origin, "grid_spacing": np.array(found.grid.spacing), "values": found.grid.values,
            "skin_vertices": found.skin.vertices.astype(np.float32), "skin_normals": found.skin.normals.astype(np.float32),
            "skin_faces": found.skin.faces.astype(np.int32), "error": np.array(found.error),
        }  # fmt: skip

    return kept("opening-3", arrays, make)


def _united(shape: UnionObject) -> Grid:
    """The least of the parts' distances: exact outside, and a bound on the depth inside."""
    reach = [np.abs(piece.pose.R) @ solids.extents(piece) for piece in shape.parts]
    low = np.min([piece.pose.p - r for piece, r in zip(shape.parts, reach, strict=True)], axis=0)
    high = np.max([piece.pose.p + r for piece, r in zip(shape.parts, reach, strict=True)], axis=0)
    radius = min(solids.least_radius(piece) for piece in shape.parts)
    spacing = shape.resolution or spacing_for(high - low, radius)
    origin, count = nodes(low, high, spacing)
    points = origin + spacing * np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), axis=-1).reshape(-1, 3)
    values = np.min(
        [solids.distance(*solids.kind(piece), (points - piece.pose.p) @ piece.pose.R) for piece in shape.parts], axis=0
    )
    return Grid(origin, spacing, values.reshape(count))


def _mass(shape: AnyObject, volume: float) -> float:
    if shape.mass is not None:
        return shape.mass
    assert shape.density is not None
    return shape.density * volume


def _weighed(shape: AnyObject, vertices: Array, faces: NDArray[np.integer]) -> tuple[float, Array, Array]:
    """Mass, centre of mass and inertia about it of what the faces enclose, of uniform density."""
    volume, centre, second = moments(vertices, np.asarray(faces, np.int64))
    mass = _mass(shape, volume)
    return mass, centre, mass / volume * (np.trace(second) * np.eye(3) - second)


def add_to(spec: mujoco.MjSpec, body: mujoco.MjsBody, shape: AnyObject, matter: Matter) -> None:
    """Adds the object's geoms object/0, object/1, … and its own mass properties to the body."""
    body.explicitinertial = True
    body.mass, body.ipos = matter.mass, matter.centre
    moments_of_inertia, axes = np.linalg.eigh(matter.inertia)
    if np.count_nonzero(matter.inertia - np.diag(np.diag(matter.inertia))) == 0:
        moments_of_inertia, axes = np.diag(matter.inertia), np.eye(3)
    elif np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    body.iquat, body.inertia = quaternion, moments_of_inertia
    if isinstance(shape, Object):
        solids.add_geoms(body, shape)
    elif isinstance(shape, UnionObject):
        for piece in shape.parts:
            solids.add_geoms(body, piece, (piece.pose.R, piece.pose.p))
    else:
        for i, part in enumerate(matter.parts):
            points = hulls.swept(part.vertices + part.p_OP, float(part.size[3]))
            add_hull(spec, body, f"object/{i}", points, solids.COLOUR)


def add_hull(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, points: Array, colour: tuple[float, float, float, float]
) -> mujoco.MjsGeom:
    """Adds the convex hull of points (V, 3) in the body's frame as a mesh geom."""
    mesh = spec.add_mesh(name=name, uservert=points.ravel())
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    return body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, rgba=colour)
