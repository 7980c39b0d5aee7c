"""The fixed bodies of the environment as MuJoCo geoms."""

import io
from collections.abc import Iterable, Mapping, Sequence

import mujoco
import numpy as np

from regrasp.scene import hulls, meshes
from regrasp.scene.matter import add_hull
from regrasp.scene.schema import Environment

COLOUR = (0.45, 0.52, 0.45, 1.0)


def asset(name: str) -> str:
    """What the file is called that describes the mesh body of this name."""
    return f"environment-{name}.npz"


def assets_of(environment: Iterable[Environment]) -> dict[str, bytes]:
    """The convex parts of the bodies that are meshes, in their own frames."""
    files = {}
    for i, body in enumerate(environment):
        if body.file is None:
            continue
        mesh = meshes.read(body.file, body.scale, f"environment.{i}")
        pieces = [points for points, _ in hulls.parts_of(mesh.vertices, mesh.faces)]
        file = io.BytesIO()
        np.savez_compressed(file, points=np.concatenate(pieces), counts=np.array([len(points) for points in pieces]))
        files[asset(body.name)] = file.getvalue()
    return files


def add(spec: mujoco.MjSpec, body: Environment, assets: Mapping[str, bytes]) -> None:
    """Adds the body's geom of its name; the further convex parts of a mesh are called name/1, name/2, …"""
    world = spec.worldbody
    if body.file is None:
        kind = getattr(mujoco.mjtGeom, f"mjGEOM_{body.shape.upper()}")
        size = [1.0, 1.0, 0.05] if body.shape == "plane" else [*body.size, 0.0, 0.0][:3]
        world.add_geom(name=body.name, type=kind, size=size, pos=body.pose.p, quat=body.pose.wxyz, rgba=COLOUR)
        return
    with np.load(io.BytesIO(assets[asset(body.name)])) as stored:
        pieces = np.split(stored["points"], np.cumsum(stored["counts"])[:-1])
    for i, points in enumerate(pieces):
        geom = add_hull(spec, world, f"{body.name}/{i}" if i else body.name, points, COLOUR)
        geom.pos, geom.quat = body.pose.p, body.pose.wxyz


def parts(name: str, geoms: Sequence[str]) -> list[str]:
    """Of the geoms' names those of the body's parts."""
    return [geom for geom in geoms if geom == name or (geom.startswith(f"{name}/") and geom[len(name) + 1 :].isdigit())]
