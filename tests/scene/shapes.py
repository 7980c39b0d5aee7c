"""Meshes made by formula, for tests."""

from pathlib import Path

import numpy as np
import trimesh


def box(*extents: float) -> trimesh.Trimesh:
    return trimesh.creation.box(extents)


def bracket(arm: float = 0.06, thick: float = 0.02, wide: float = 0.03) -> trimesh.Trimesh:
    """An L of two arms, its inner corner at the origin's side, extruded along y."""
    corners = np.array([[0, 0], [arm, 0], [arm, thick], [thick, thick], [thick, arm], [0, arm]])
    n = len(corners)
    low = np.insert(corners, 1, -wide / 2, axis=1)
    high = np.insert(corners, 1, wide / 2, axis=1)
    cap = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    k = np.arange(n)
    sides = np.concatenate(
        [np.stack([k, k + n, (k + 1) % n], axis=1), np.stack([(k + 1) % n, k + n, (k + 1) % n + n], axis=1)]
    )
    mesh = trimesh.Trimesh(np.vstack([low, high]), np.vstack([cap, cap[:, ::-1] + n, sides]), process=False)
    trimesh.repair.fix_normals(mesh)
    return mesh


def file(folder: Path, mesh: trimesh.Trimesh, name: str = "mesh.stl") -> str:
    """The mesh written to a file in the folder; returns its path."""
    path = folder / name
    mesh.export(path)
    return str(path)
