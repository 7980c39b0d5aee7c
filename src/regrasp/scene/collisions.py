"""Which pairs of geoms must never touch: every pair MuJoCo would collide, but for the contacts the task is made of."""

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
