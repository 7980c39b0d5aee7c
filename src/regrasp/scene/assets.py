"""The files a robot's model names, read into memory; meshes in formats that MuJoCo does not read become STL."""

import struct
from collections.abc import Callable
from pathlib import Path

import mujoco

from regrasp.errors import InputError

MOST = 200000
"""Triangles of a mesh that MuJoCo reads at most."""
READ = (".stl", ".obj", ".msh")
"""What MuJoCo reads; STL in its binary form only."""

Find = Callable[[str, str], Path | None]
"""Name of a file in the model and subfolder it counts from → the file, None if there is none."""
Called = Callable[[str], str]
"""Name of a file in the model → what its author calls it."""


def beside(robot: mujoco.MjSpec) -> Find:
    """Finds files as MuJoCo does, from the folder of the model's file."""
    folder = Path(robot.modelfiledir)

    def find(name: str, subfolder: str) -> Path | None:
        path = folder / subfolder / name
        return path if path.is_file() else None

    return find


def embed(robot: mujoco.MjSpec, find: Find, called: Called = str) -> list[str]:
    """Puts every mesh, texture and height field file into `robot.assets`, renamed to a plain unique name.

    A mesh that is missing or unreadable is dropped with its geoms where these are only for the eye. Tells each
    conversion and each drop in a sentence. Raises InputError for a missing file that cannot be done without.
    """
    said: list[str] = []
    files: dict[str, bytes] = {}
    for mesh in list(robot.meshes):
        if not mesh.file:
            continue
        content, suffix, fault = _mesh(find(mesh.file, robot.meshdir))
        if fault.startswith("is ") and content:
            said.append(f"mesh {called(mesh.file)!r} {fault}")
        if content:
            mesh.file = f"{len(files)}-{Path(mesh.file).stem}{suffix}"
            files[mesh.file] = content
            continue
        geoms = [geom for geom in robot.geoms if geom.meshname == mesh.name]
        if any(geom.contype or geom.conaffinity for geom in geoms):
            hint = "package://NAME is looked for above the file, along ROS_PACKAGE_PATH and in model.packages"
            raise InputError("model.file", f"collision mesh {called(mesh.file)!r} {fault}", hint)
        said.append(f"mesh {called(mesh.file)!r} {fault}: left out, it is for the eye only")
        for geom in geoms:
            robot.delete(geom)
        robot.delete(mesh)
    for elements, subfolder in ((robot.hfields, robot.meshdir), (robot.textures, robot.texturedir)):
        for element in elements:
            if element.file:
                source = find(element.file, subfolder)
                if source is None:
                    raise InputError("model.file", f"no file {element.file!r}", "a path counts from the model's file")
                element.file = f"{len(files)}-{source.name}"
                files[element.file] = source.read_bytes()
    robot.meshdir = robot.texturedir = ""
    robot.assets = files
    return said


def _mesh(path: Path | None) -> tuple[bytes, str, str]:
    """Content of a mesh file in a format MuJoCo reads, its suffix, and what was wrong with it."""
    if path is None:
        return b"", "", "is not found"
    content, suffix = path.read_bytes(), path.suffix.lower()
    binary = suffix == ".stl" and not _is_text(content)
    if (binary and _count(content) <= MOST) or suffix in READ[1:]:
        return content, suffix, ""
    import trimesh

    try:
        scene = trimesh.load_scene(path)
        if scene.units:
            scene = scene.convert_units("meters")
        mesh = scene.to_mesh()
        if len(mesh.faces) > MOST:
            return (
                mesh.convex_hull.export(file_type="stl"),
                ".stl",
                f"is of more than {MOST} triangles: its hull is taken",
            )
        stl = mesh.export(file_type="stl")
    except Exception as error:  # whatever a reader of foreign files may raise
        return b"", "", f"cannot be read: {' '.join(str(error).split()) or type(error).__name__}"
    kind = "a text" if suffix == ".stl" else f"a {suffix.removeprefix('.')} file"
    return stl, ".stl", f"is {kind}, which MuJoCo does not read: made binary STL"


def _is_text(stl: bytes) -> bool:
    """Whether an STL file is of the text kind: a binary one has the length that its count of triangles asks for."""
    return len(stl) < 84 or len(stl) != 84 + 50 * _count(stl)


def _count(stl: bytes) -> int:
    """The number of triangles that a binary STL file states."""
    return int(struct.unpack_from("<I", stl, 80)[0])
