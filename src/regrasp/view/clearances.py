"""How far from one another bodies keep that must not touch, by MuJoCo's distances."""

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.plan import RELOCATE, Plan
from regrasp.scene.world import World
from regrasp.view.frames import Instant, put

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

KINDS = ("agent–agent", "agent–object", "agent–surroundings", "object–surroundings")
"""Agents with themselves and one another; with the object away from the contact; with what stands still; the object with
what stands still and does not carry it."""


def clearances(plan: Plan, world: World, far: float) -> Mapping[str, Array]:
    """Kind → least distance (N, M) at the plan's samples, m, negative where bodies overlap; more than `far` counts as far.

    Kinds of which there are no bodies are left out.
    """
    model, (N, M) = world.model, plan.time.shape
    data = mujoco.MjData(model)
    pairs, kinds = world.collision_pairs, _kinds(world)
    present = sorted({*kinds.tolist()})
    least = np.full((len(KINDS), N, M), far)
    for j in range(N):
        free = [g for agent, code in zip(world.agents, plan.V[j], strict=True) if code >= RELOCATE
                for g in agent.tip_geoms]  # fmt: skip
        tips = np.array([(tip, g) for tip in free for g in world.object_geoms], np.int64).reshape(-1, 2)
        judged, of = np.concatenate([pairs, tips]), np.concatenate([kinds, np.full(len(tips), 1)])
        for m in range(M):
            put(world, plan, Instant(j, m), data)
            for (a, b), kind, below in zip(judged, of, _below(model, data, judged), strict=True):
                # The bounding spheres' distance is no more than the bodies': most pairs need no more than that.
                if below < least[kind, j, m]:
                    distance = mujoco.mj_geomDistance(model, data, a, b, far, None)
                    least[kind, j, m] = min(least[kind, j, m], distance)
    return {KINDS[kind]: least[kind] for kind in present}


def _kinds(world: World) -> Ids:
    """Index in KINDS of every collision pair."""
    part = np.full(world.model.ngeom, 2)
    part[world.object_geoms] = 1
    for agent in world.agents:
        part[agent.geoms] = 0
    low, high = np.sort(part[world.collision_pairs], axis=1).T
    return np.where(low == 0, high, 3)


def _below(model: mujoco.MjModel, data: mujoco.MjData, pairs: Ids) -> Array:
    """Distances of the bounding spheres (n,), m; −∞ where one is a plane."""
    a, b = pairs.T
    apart = np.linalg.norm(data.geom_xpos[a] - data.geom_xpos[b], axis=1) - model.geom_rbound[a] - model.geom_rbound[b]
    plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    return np.where(plane[a] | plane[b], -np.inf, apart)
