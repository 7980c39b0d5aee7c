"""Which pairs of geoms must never touch: every pair MuJoCo would collide, but for the contacts the task is made of."""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

Ids = NDArray[np.int64]


def pairs(model: mujoco.MjModel, tips: Ids, object_geoms: Ids, supports: Ids) -> Ids:
    """Pairs of geom ids, lower first, (n, 2), that a plan must keep apart.

    These are the pairs MuJoCo itself would collide (contype and conaffinity, excludes, bodies welded together or parent
    and child), without tip-object and object-support, where contact is wanted, and without pairs that cannot move.
    """
    geoms = np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    a, b = (geoms[index] for index in np.triu_indices(len(geoms), 1))
    meet = (model.geom_contype[a] & model.geom_conaffinity[b]) | (model.geom_contype[b] & model.geom_conaffinity[a])
    body_a, body_b = model.geom_bodyid[a], model.geom_bodyid[b]
    weld_a, weld_b = model.body_weldid[body_a], model.body_weldid[body_b]
    parent = model.body_weldid[model.body_parentid]
    # As in MuJoCo, the child of a static body still collides with it: only an exclude says that they overlap by design.
    kin = (weld_a != 0) & (weld_b != 0) & ((weld_a == parent[weld_b]) | (weld_b == parent[weld_a]))
    low, high = np.minimum(body_a, body_b), np.maximum(body_a, body_b)
    excluded = np.isin((low << 16) + high, _signatures(model))
    wanted = np.zeros(len(a), dtype=bool)
    for others in (tips, supports):
        wanted |= (np.isin(a, object_geoms) & np.isin(b, others)) | (np.isin(b, object_geoms) & np.isin(a, others))
    keep = (meet != 0) & (weld_a != weld_b) & ~kin & ~excluded & ~wanted
    return np.stack([a[keep], b[keep]], axis=1).astype(np.int64)


def _signatures(model: mujoco.MjModel) -> Ids:
    first, second = model.exclude_signature >> 16, model.exclude_signature & 0xFFFF
    return (np.minimum(first, second) << 16) + np.maximum(first, second)


NEIGHBOURS = 2
"""So many joints apart, bodies of a chain are neighbours, or neighbours but one."""
REACH = 1e-2
"""Bodies farther apart than this, m, are not told apart."""


def overlaps(model: mujoco.MjModel, data: mujoco.MjData) -> list[tuple[int, int, float]]:
    """Bodies of a robot that overlap though they must not, with their depth, m; `data` after mj_kinematics."""
    none = np.zeros(0, dtype=np.int64)
    deepest: dict[tuple[int, int], float] = {}
    for a, b in pairs(model, none, none, none):
        depth = -mujoco.mj_geomDistance(model, data, int(a), int(b), REACH, None)
        bodies = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
        if depth > 0.0:
            deepest[bodies] = max(depth, deepest.get(bodies, 0.0))
    return [(a, b, depth) for (a, b), depth in deepest.items()]


def apart(model: mujoco.MjModel, a: int, b: int) -> float:
    """How many moving bodies' joints lie between two bodies of which one carries the other; inf where neither does."""
    ways = []
    for body in (a, b):
        way = [int(model.body_weldid[body])]
        while way[-1]:
            way.append(int(model.body_weldid[model.body_parentid[way[-1]]]))
        ways.append(way)
    first, second = ways
    if first[0] in second:
        return second.index(first[0])
    return first.index(second[0]) if second[0] in first else math.inf


def vertices(model: mujoco.MjModel, geom: int) -> NDArray[np.float64]:
    """Vertices of a geom's mesh in the geom's frame, (n, 3), m: what collides is their convex hull."""
    mesh = int(model.geom_dataid[geom])
    first = int(model.mesh_vertadr[mesh])
    return np.array(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])], dtype=np.float64)
