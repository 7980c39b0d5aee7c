"""Convex parts of a mesh, for collision and physics."""

import sys

import numpy as np
from numpy.typing import NDArray

from regrasp.scene.cache import Arrays, kept
from regrasp.scene.triangles import moments

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

CONCAVITY = 0.05  # CoACD's threshold: how far, in halves of the longest side, parts may cover what the mesh does not
CONVEX = 0.98  # of its hull's volume that a mesh fills which is taken for its hull
SEARCH = {"mcts_iterations": 60, "mcts_max_depth": 2, "resolution": 1000}
"""CoACD's least: its default takes many times as long."""
CORNERS = 256  # vertices of a part at most
EXACT = 1e-5  # m that leaving out a vertex may cost
ROUND = 2e-5  # m that the ball which a rounded part is swept by may lack
SIMPLER = 2e-4  # m by which the mesh may be coarsened for it
SEED = 0


def parts_of(vertices: Array, faces: Ints) -> list[tuple[Array, float]]:
    """Convex sets that cover the mesh: their vertices (V, 3), V ≤ CORNERS, and by how much, m, they may lack what they cover.

    The hull is enough for a mesh that fills it, but for hollows no deeper than the parts may cover. Others are cut by CoACD
    (Wei, Liu, Ling & Su, SIGGRAPH 2022), which may take minutes; what it found is kept.
    """
    from scipy.spatial import ConvexHull

    hull = ConvexHull(vertices)
    if moments(vertices, faces)[0] >= CONVEX * hull.volume:
        most = CONCAVITY * 0.5 * float(np.max(np.ptp(vertices, axis=0)))
        part = reduced(vertices[hull.vertices])
        if hollow(vertices, part[0]) <= most:
            return [part]
    return [reduced(part) for part in _cut(vertices, faces)]


def _cut(vertices: Array, faces: Ints) -> list[Array]:
    def cut() -> Arrays:
        import coacd
        import manifold3d

        # CoACD takes a manifold as it is; it would make anything else anew, without its flat faces.
        solid = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64))).simplify(SIMPLER)
        points, triangles = vertices, faces
        if solid.num_tri() > 0:
            points, triangles = solid.to_mesh64().vert_properties[:, :3], solid.to_mesh64().tri_verts.astype(np.int64)
        print("cutting the mesh into convex parts; this takes a minute or two, once", file=sys.stderr, flush=True)
        coacd.set_log_level("error")
        found = coacd.run_coacd(
            coacd.Mesh(points, triangles), threshold=CONCAVITY, max_ch_vertex=CORNERS, seed=SEED, **SEARCH
        )
        print(f"{len(found)} convex parts", file=sys.stderr, flush=True)
        return {
            "points": np.concatenate([np.array(points) for points, _ in found]),
            "count": np.array([len(points) for points, _ in found]),
        }

    arrays = kept(
        "parts",
        {"vertices": vertices, "faces": faces, "settings": np.array([CONCAVITY, SIMPLER, SEED, *SEARCH.values()])},
        cut,
    )
    return np.split(np.asarray(arrays["points"], float), np.cumsum(arrays["count"])[:-1])


def hollow(vertices: Array, corners: Array) -> float:
    """How deep a vertex of the mesh lies below the hull of the corners, m, at most."""
    from scipy.spatial import ConvexHull

    above = np.full(len(vertices), -np.inf)
    for plane in ConvexHull(corners).equations:
        np.maximum(above, vertices @ plane[:3] + plane[3], out=above)
    return float(-above.min())


def reduced(points: Array) -> tuple[Array, float]:
    """Vertices of the points' hull, those first that reach farthest beyond the others', and how far the rest reaches, m.

    The rest is left out where it reaches no farther than EXACT, or from CORNERS vertices on.
    """
    from scipy.spatial import ConvexHull

    points = points[ConvexHull(points).vertices]
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle)[2]
    chosen = list(dict.fromkeys(int(i) for axis in axes for i in (np.argmax(points @ axis), np.argmin(points @ axis))))
    while len(chosen) < 4:  # a square's corners are extreme along the same axes
        chosen += [i for i in range(len(points)) if i not in chosen][:1]
    chosen = _spanning(points, chosen)
    hull = ConvexHull(points[chosen], incremental=True)
    while True:
        beyond = np.max(points @ hull.equations[:, :3].T + hull.equations[:, 3], axis=1)
        farthest = int(np.argmax(beyond))
        if beyond[farthest] <= EXACT or len(chosen) == CORNERS:
            return points[chosen], max(float(beyond[farthest]), 0.0)
        chosen.append(farthest)
        hull.add_points(points[farthest : farthest + 1])


def _spanning(points: Array, chosen: list[int]) -> list[int]:
    """The chosen points, and others if these lie in a plane."""
    base = points[chosen] - points[chosen[0]]
    normal = np.linalg.svd(base)[2][-1]
    far = np.abs((points - points[chosen[0]]) @ normal)
    return chosen if np.max(far[chosen]) > 0.1 * np.max(far) else [*chosen, int(np.argmax(far))]


def swept(vertices: Array, radius: float) -> Array:
    """Vertices of the convex set swept by a ball: its flat faces are exact, its edges and corners lack ROUND at most, m."""
    from scipy.spatial import ConvexHull

    if radius == 0.0:
        return vertices
    hull = ConvexHull(vertices)
    angle = np.sqrt(2.0 * ROUND / radius)
    count = max(24, int(np.ceil((2.2 / angle) ** 2)))
    k = np.arange(count) + 0.5
    z, phi = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    ball = np.stack([np.sqrt(1.0 - z * z) * np.cos(phi), np.sqrt(1.0 - z * z) * np.sin(phi), z], axis=1)
    faced = vertices[hull.simplices] + radius * hull.equations[:, None, :3]
    points = np.concatenate([(vertices[:, None] + radius * ball).reshape(-1, 3), faced.reshape(-1, 3)])
    return points[ConvexHull(points).vertices]
