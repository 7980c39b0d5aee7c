"""Mesh files read, and mended where they do not enclose a solid."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regrasp.errors import InputError

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

FORMATS = (".stl", ".obj", ".glb")
LARGEST, SMALLEST = 5.0, 0.002  # m: a mesh larger or smaller has been given in another unit
HOLE = 0.25  # of the mesh's extent: a wider opening is not a hole but says that the surface encloses nothing


@dataclass(frozen=True)
class Mesh:
    """A closed surface: vertices (V, 3), m; faces (F, 3), anticlockwise seen from outside; what was mended, in words."""

    vertices: Array
    faces: Ints
    remarks: tuple[str, ...] = ()


def read(path: str, scale: float, field: str) -> Mesh:
    """The mesh in an STL, OBJ or glb file times `scale`; `field` is what the scene calls it.

    Raises InputError where there is no mesh, where it cannot be mended, and where its size is that of another unit.
    """
    import trimesh  # takes a second to import

    file = checked(path, field)
    try:
        loaded = trimesh.load_scene(file).to_mesh()
    except Exception as error:  # the readers raise what they like
        raise InputError(
            f"{field}.file", f"cannot be read: {' '.join(str(error).split())}", "an STL, OBJ or glb file"
        ) from None
    if len(loaded.faces) == 0:
        raise InputError(f"{field}.file", "holds no triangles", "a surface, not points or lines")
    extent = scale * float(np.max(loaded.extents))
    if extent > LARGEST:
        raise InputError(
            f"{field}.scale", f"the mesh is {extent:.3g} m long", f"in millimetres? scale: {0.001 * scale:g}"
        )
    if extent < SMALLEST:
        raise InputError(f"{field}.scale", f"the mesh is {extent:.3g} m long", f"in metres? scale: {1000.0 * scale:g}")
    return mended(loaded, scale, f"{field}.file")


def checked(path: str, field: str) -> Path:
    """The path of a mesh file. Raises InputError where it is none."""
    file = Path(path)
    if file.suffix.lower() not in FORMATS:
        raise InputError(f"{field}.file", f"{file.name} is no mesh file", f"legal: {', '.join(FORMATS)}")
    if not file.is_file():
        raise InputError(f"{field}.file", f"no file {path}", "a path counts from the scene file's directory")
    return file


def mended(loaded: Any, scale: float, field: str) -> Mesh:
    """The trimesh mesh, times `scale`, as a closed surface that faces outwards. Raises InputError where that fails."""
    import trimesh

    remarks = []
    loaded.merge_vertices(merge_tex=True, merge_norm=True)
    before = len(loaded.faces)
    loaded.update_faces(loaded.unique_faces() & loaded.nondegenerate_faces(height=1e-12))
    if dropped := before - len(loaded.faces):
        remarks.append(f"{dropped} faces without area or given twice left out")
    if not closed(loaded.faces) and not loaded.is_winding_consistent:
        trimesh.repair.fix_winding(loaded)  # type: ignore[no-untyped-call]
        remarks.append("faces turned to the same side as their neighbours")
    if not closed(loaded.faces):
        vertices, faces, holes = filled(np.array(loaded.vertices), np.array(loaded.faces), field)
        loaded = trimesh.Trimesh(vertices, faces, process=False)
        remarks.append(f"{holes} holes filled")
    if not closed(loaded.faces):
        raise InputError(
            field,
            "the surface has edges at which its sides are not told apart",
            "mend it in a mesh editor: manifold, watertight",
        )
    bodies = loaded.split(only_watertight=False) if loaded.body_count > 1 else [loaded]
    if loaded.volume < 0.0:
        loaded.invert()
        remarks.append("faces turned outwards")
    elif len(bodies) > 1 and all(closed(body.faces) and body.volume > 0.0 for body in bodies):
        loaded = trimesh.boolean.union(bodies, engine="manifold")
        remarks.append(f"{len(bodies)} bodies made one")
    return Mesh(scale * np.array(loaded.vertices), np.array(loaded.faces, dtype=np.int64), tuple(remarks))


def filled(vertices: Array, faces: Ints, field: str) -> tuple[Array, Ints, int]:
    """The mesh with its holes closed by fans about their centres, and how many there were.

    Raises InputError for openings too wide to be holes.
    """
    wide = HOLE * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    added_vertices: list[Array] = []
    added_faces: list[tuple[int, int, int]] = []
    for rim in rims(faces):
        across = float(np.linalg.norm(np.ptp(vertices[rim], axis=0)))
        if across > wide:
            raise InputError(
                field,
                f"the surface has an opening as wide as {across / wide * HOLE:.0%} of it",
                "a solid has walls of some thickness",
            )
        centre = len(vertices) + len(added_vertices)
        added_vertices.append(vertices[rim].mean(axis=0))
        added_faces += [(rim[k], rim[k - 1], centre) for k in range(len(rim))]
    return np.vstack([vertices, *added_vertices]), np.vstack([faces, *added_faces]), len(added_vertices)


def closed(faces: Ints) -> bool:
    """Whether as many faces take each edge in one direction as in the other: the surface may meet itself, but has two sides."""
    return not any(open_edges(faces).values())


def open_edges(faces: Ints) -> Counter[tuple[int, int]]:
    """Edges a b in the faces' direction and how many of them no other face takes from b to a."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there = Counter(map(tuple, edges.tolist()))
    return there - Counter((b, a) for a, b in there.elements())


def rims(faces: Ints) -> Iterator[list[int]]:
    """The closed ways along edges that are open, in the faces' direction."""
    after: dict[int, list[int]] = {}
    for a, b in open_edges(faces).elements():
        after.setdefault(a, []).append(b)
    while after:
        start = next(iter(after))
        rim, at = [], start
        while at in after:
            rim.append(at)
            to = after[at].pop()
            if not after[at]:
                del after[at]
            at = to
            if at == start:
                break
        if len(rim) > 2 and at == start:
            yield rim
