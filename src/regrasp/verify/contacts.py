"""Contacts and clearances measured with MuJoCo's distances."""

import copy
import itertools
import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.plan import NONE, RELOCATE, Plan
from regrasp.scene import solids
from regrasp.scene.matter import Part
from regrasp.scene.world import World
from regrasp.verify.findings import Finding, worst
from regrasp.verify.motion import Motion, fine, unit
from regrasp.verify.skin import Surface, Tip

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

TOUCH = 1e-4
"""Contact gap, penetration and distance of a stated contact point from the measured one, m."""
NORMAL = math.radians(1.0)
"""Angle between a stated and the measured normal, rad."""
BACKOFF = 1e-3
"""Between touching surfaces nearest points are ill-defined (0.2 mm off for flat ones). Moving one body away by so much
(m) along the common normal leaves the nearest points of convex bodies where they are and makes them sharp (5 µm)."""
RIM = (7e-4, math.radians(2.0))
"""More of both for a tip that is no ball on a cylinder's rounded rim, which the model makes of straight capsules, m and rad:
they keep within 0.02 mm of the round rim, but nearest point and normal jump from one to the next, and to the sharp edges
that end inside of it the cylinders for its side and faces."""
SEAM = 3e-5
"""m: so near to the rim's seams with side and faces a point counts as on it, with the error of its capsules."""
BALL = solids.KINDS.index("sphere")
FAR = 1e-2
"""Distances beyond this (m) are not told apart."""


@dataclass(frozen=True)
class Contacts:
    """Measured contacts of the tips with the object; NaN where an agent is off or relocating."""

    gap: Array
    """(N, S, k) signed distance tip–object, m."""
    p_O: Array
    """(N, S, k, 3) nearest point on the object, in O."""
    n_O: Array
    """(N, S, k, 3) outward normal of the object there, in O."""
    rim: NDArray[np.bool_]
    """(N, S, k): whether the contact is on a cylinder's rim, which the model has of capsules, and taken from there."""
    off: Array
    """(N, S, k): how far p_O is off the tip, or along it off the point with the surface's normal, m."""
    turn: Array
    """(N, S, k): angle between the object's and the tip's normal at p_O, rad."""


def touching(plan: Plan) -> NDArray[np.bool_]:
    """(N, k): whether V has the agent in contact over the interval."""
    return np.asarray(plan.V < RELOCATE)


def measure(plan: Plan, world: World, motion: Motion) -> Contacts:
    """The contact of every agent that V has in contact, at every instant."""
    N, S = motion.time.shape
    k = len(world.agents)
    gap, p_O, n_O = (np.full((N, S, k, *shape), np.nan) for shape in ((), (3,), (3,)))
    contacts = Contacts(gap, p_O, n_O, np.zeros((N, S, k), dtype=bool), np.zeros((N, S, k)), np.zeros((N, S, k)))
    if world.matter.skin is not None and world.object_grid is not None:
        _on_skin(plan, world, motion, Surface(world.matter.skin, world.object_grid), contacts)
        return contacts
    round_edged = [part for part in world.matter.parts if part.kind == solids.KINDS.index("cylinder")]
    rims = {float(part.size[3]) for part in round_edged}
    data = mujoco.MjData(world.model)
    n_stated = unit(fine(plan.n_O, motion.K))
    for j in range(N):
        agents = [(a, world.agents[a].tip_geoms) for a in np.flatnonzero(touching(plan)[j])]
        for s in range(S):
            data.geom_xpos[:], data.geom_xmat[:] = motion.geom_xpos[j, s], motion.geom_xmat[j, s]
            R_WO, p_WO = motion.R_WO[j, s], motion.p_WO[j, s]
            for a, tip in agents:
                contacts.gap[j, s, a] = _nearest(world.model, data, world.object_geoms, tip)[0]
                data.geom_xpos[tip] += BACKOFF * (R_WO @ n_stated[j, s, a])
                _, p_W, n_W, geom = _nearest(world.model, data, world.object_geoms, tip)
                data.geom_xpos[tip] = motion.geom_xpos[j, s, tip]
                contacts.p_O[j, s, a], contacts.n_O[j, s, a] = R_WO.T @ (p_W - p_WO), R_WO.T @ n_W
                ring = world.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE and (
                    float(world.model.geom_size[geom, 0]) in rims
                )
                # The ring's capsules stand out over side and faces a little, so that a ball beside the rim meets them first.
                on = _of_ring if ring else _on_rim
                rim = next((part for part in round_edged if on(part, contacts.p_O[j, s, a])), None)
                if rim is not None and world.agents[a].tip_kind == BALL:
                    contacts.p_O[j, s, a], contacts.n_O[j, s, a] = _under(rim, motion.p_OT[j, s, a])
                else:
                    contacts.rim[j, s, a] = rim is not None or ring
    return contacts


def _on_skin(plan: Plan, world: World, motion: Motion, surface: Surface, contacts: Contacts) -> None:
    """`measure` where the object is a mesh: at the point of its surface nearest to the stated one (`beside`).

    A tip touches there if both have this point, their normals oppose, and they overlap nowhere. The nearest
    points of tip and surface say less: in a hollow that is little wider than the tip all points are about as near to it (0.4 µm
    apart within 0.2 mm), and moved away from there it is nearer to others.
    """
    stated, normal = fine(plan.p_OC_O, motion.K), unit(fine(plan.n_O, motion.K))
    for j, a in np.argwhere(touching(plan)):
        agent = world.agents[a]
        for s in range(motion.time.shape[1]):
            tip = Tip(agent.tip_kind, agent.tip_size, motion.R_OT[j, s, a], motion.p_OT[j, s, a])
            contacts.gap[j, s, a] = surface.nearest(tip)[0]
            measured = beside(surface, tip, stated[j, s, a], normal[j, s, a])
            contacts.p_O[j, s, a], contacts.n_O[j, s, a], contacts.off[j, s, a], contacts.turn[j, s, a] = measured


def beside(surface: Surface, tip: Tip, p_O: Array, n_O: Array) -> tuple[Array, Array, float, float]:
    """A contact that is stated at p_O with the normal n_O: the surface's point there, the tip's normal, how far off, its turn.

    How far off the tip is the point, or along it, m, from where its normal is the surface's: on a flat face that is where it is
    nearest. Turn: between the surface's normal and the other two, rad.
    """
    foot, normal = surface.foot(p_O)
    n_T = tip.normal(foot)
    angle = float(_angle(n_T, normal))
    way = float(np.min(tip.size[tip.size > 0.0])) * angle
    return foot, n_T, max(abs(float(tip.distance(foot[None])[0])), way), max(angle, float(_angle(n_O, normal)))


def _under(cylinder: Part, p_O: Array) -> tuple[Array, Array]:
    """Nearest point of a cylinder with rounded edges to a point outside it, and the normal there, in O.

    The cylinder is one without the rounding, swept by a ball of it: from the nearest point of that one on towards p_O.
    """
    radius, half, _, rounding = cylinder.size
    p = cylinder.R_OP.T @ (p_O - cylinder.p_OP)
    away = np.hypot(p[0], p[1])
    core = p.copy()
    core[:2] *= min(1.0, (radius - rounding) / away)
    core[2] = np.clip(p[2], rounding - half, half - rounding)
    n = (p - core) / np.linalg.norm(p - core)
    return cylinder.R_OP @ (core + rounding * n) + cylinder.p_OP, cylinder.R_OP @ n


def _on_rim(part: Part, p_O: Array) -> bool:
    """Whether a point of a cylinder's surface is on its rounded rim or on an edge that ends there."""
    radius, half, _, rounding = part.size
    x, y, z = part.R_OP.T @ (p_O - part.p_OP)
    return bool(np.hypot(x, y) >= radius - rounding - SEAM and abs(z) >= half - rounding - SEAM)


def _of_ring(part: Part, p_O: Array) -> bool:
    """Whether a point lies on a cylinder's surface, as far as the capsules of its rim keep to that."""
    return abs(float(solids.distance(part.kind, part.size, (p_O - part.p_OP)[None] @ part.R_OP)[0])) <= SEAM


def contact_findings(plan: Plan, motion: Motion, contacts: Contacts) -> list[Finding]:
    """Contact gap over whole intervals; stated contact points and normals at the plan's samples."""
    who, touch = plan.agent_names, touching(plan)[:, None]
    at = slice(None, None, motion.K)
    offset = np.maximum(np.linalg.norm(contacts.p_O[:, at] - plan.p_OC_O, axis=-1), contacts.off[:, at])
    angle = np.maximum(_angle(contacts.n_O[:, at], plan.n_O), contacts.turn[:, at])
    length = np.abs(np.linalg.norm(plan.n_O, axis=-1) - 1.0)
    rim = contacts.rim[:, at]
    return [
        worst("contact gap", "distance between tip and object while in contact", np.abs(contacts.gap), TOUCH, "m",
              "jsx", motion.time, who, touch),
        worst("contact point", "stated contact point against the one measured", offset,
              TOUCH + RIM[0] * rim, "m",
              "jsx", plan.time, who, touch),
        worst("contact normal", "stated normal against the one measured", angle, NORMAL + RIM[1] * rim, "rad",
              "jsx", plan.time, who, touch),
        worst("normal length", "length of the stated normal less 1", length, 1e-6, "", "jsx", plan.time, who, touch),
    ]  # fmt: skip


def support_findings(plan: Plan, world: World, motion: Motion) -> list[Finding]:
    """Stated support contacts lie on both surfaces with the stated normal, wherever an interval uses them."""
    if not plan.support_names:
        return []
    N, S = motion.time.shape
    P = len(plan.support_names)
    offset, angle = np.zeros((N, S, P, 2)), np.zeros((N, S, P, 2))
    model, probe = _with_probe(world)
    data = mujoco.MjData(model)
    points, normals = fine(plan.support_p_O, motion.K), unit(fine(plan.support_n_W, motion.K))
    used = plan.support_mode != NONE
    for j, p in zip(*np.nonzero(used), strict=True):
        at = world.support_names.index(plan.support_names[p])
        bodies = (world.support_geoms[at : at + 1], world.object_geoms)
        for s in range(S):
            data.geom_xpos[:], data.geom_xmat[:] = motion.geom_xpos[j, s], motion.geom_xmat[j, s]
            p_W = motion.p_WO[j, s] + motion.R_WO[j, s] @ points[j, s, p]
            for side, outward in enumerate((normals[j, s, p], -normals[j, s, p])):
                data.geom_xpos[probe] = p_W + BACKOFF * outward
                _, nearest, n_W, _ = _nearest(model, data, bodies[side], np.array([probe]))
                offset[j, s, p, side] = np.linalg.norm(nearest - p_W)
                angle[j, s, p, side] = _angle(n_W, outward)
    length = np.abs(np.linalg.norm(plan.support_n_W, axis=-1) - 1.0)
    who, where = plan.support_names, used[:, None]
    return [
        worst("support point", "stated support contact against the support's and the object's surface",
              offset.max(axis=-1), TOUCH, "m", "jsx", motion.time, who, where),
        worst("support normal", "stated support normal against both surfaces", angle.max(axis=-1), NORMAL, "rad",
              "jsx", motion.time, who, where),
        worst("support normal length", "length of the stated normal less 1", length, 1e-6, "",
              "jsx", plan.time, who, where),
    ]  # fmt: skip


def collision_findings(plan: Plan, world: World, motion: Motion) -> list[Finding]:
    """Penetration of pairs that must not touch, of tips not in contact with the object, of object and supports."""
    model = world.model
    data = mujoco.MjData(model)
    supports = [(g, s) for g in world.object_geoms for s in world.support_geoms]
    always = np.array([*world.collision_pairs, *supports], dtype=np.int64).reshape(-1, 2)
    depth, pair, when = 0.0, (-1, -1), (0, 0)
    for j in range(motion.time.shape[0]):
        free = [g for agent, touch in zip(world.agents, touching(plan)[j], strict=True) if not touch
                for g in agent.tip_geoms]  # fmt: skip
        pairs = np.array([*always, *((tip, g) for tip in free for g in world.object_geoms)], dtype=np.int64).reshape(
            -1, 2
        )
        near = _near(model, motion.geom_xpos[j], motion.geom_xmat[j], pairs)
        for s in np.flatnonzero(near.any(axis=1)):
            data.geom_xpos[:], data.geom_xmat[:] = motion.geom_xpos[j, s], motion.geom_xmat[j, s]
            for a, b in pairs[near[s]]:
                deep = -mujoco.mj_geomDistance(model, data, a, b, FAR, None)
                if deep > depth or np.isnan(deep):
                    depth, pair, when = np.nan_to_num(deep, nan=np.inf), (a, b), (j, int(s))
    where = (when[0], float(motion.time[when]), " and ".join(_name(model, g) for g in pair)) if pair[0] >= 0 else ()
    return [Finding("penetration", "depth of any two bodies that must not touch", depth, TOUCH, "m", *where)]


def _nearest(model: mujoco.MjModel, data: mujoco.MjData, geoms: Ids, tip: Ids) -> tuple[float, Array, Array, int]:
    """Distance of the union `tip` from the union `geoms`, nearest point on that, direction from there to the tip, its geom."""
    least, fromto, best, nearest = FAR, np.zeros(6), np.full(6, np.nan), -1
    for geom, piece in itertools.product(geoms, tip):
        distance = mujoco.mj_geomDistance(model, data, geom, piece, FAR, fromto)
        if distance < least:
            least, best, nearest = distance, fromto.copy(), geom
    return least, best[:3], unit(best[3:] - best[:3]), nearest


def _angle(a: Array, b: Array) -> Array:
    """Angle between vectors (..., 3), rad; accurate for small ones."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def _with_probe(world: World) -> tuple[mujoco.MjModel, int]:
    """A copy of the model in which the first tip is a sphere, small enough to find the distance of single points."""
    model, probe = copy.copy(world.model), world.agents[0].tip_geom
    model.geom_type[probe] = mujoco.mjtGeom.mjGEOM_SPHERE
    model.geom_size[probe] = (BACKOFF / 2, 0.0, 0.0)
    model.geom_rbound[probe] = BACKOFF / 2
    return model, probe


def _near(model: mujoco.MjModel, xpos: Array, xmat: Array, pairs: Ids) -> NDArray[np.bool_]:
    """(S, pairs): whether the bodies may touch: each one's bounding sphere meets the other's, and its box.

    Where one is a plane: whether the other's sphere reaches below it.
    """
    a, b = pairs.T
    bound = model.geom_rbound
    plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    apart = xpos[:, a] - xpos[:, b]
    near = np.einsum("spi,spi->sp", apart, apart) <= (bound[a] + bound[b]) ** 2
    for one, other, centre in ((a, b, -apart), (b, a, apart)):
        middle, half = model.geom_aabb[one, :3], model.geom_aabb[one, 3:]
        local = np.einsum("spi,spij->spj", centre, xmat[:, one].reshape(*centre.shape, 3))
        beyond = np.maximum(np.abs(local - middle) - half, 0.0)
        near &= np.einsum("spi,spi->sp", beyond, beyond) <= bound[other] ** 2
    for p in np.flatnonzero(plane[a] | plane[b]):
        surface, other = (a[p], b[p]) if plane[a[p]] else (b[p], a[p])
        height = np.einsum("si,si->s", xpos[:, other] - xpos[:, surface], xmat[:, surface, 2::3])
        near[:, p] = height <= bound[other]
    return np.asarray(near)


def _name(model: mujoco.MjModel, geom: int) -> str:
    named = model.geom(geom).name
    return str(named) if named else f"{model.body(model.geom_bodyid[geom]).name} (geom {geom})"
