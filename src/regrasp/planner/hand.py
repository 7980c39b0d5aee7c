"""The model of the planner: agents, object and surroundings as kernel arrays, read from a World once."""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.chains import SLIDE, Chains
from regrasp.kernels.cores import BOX, CYLINDER, ELLIPSOID, HULL, POINT, SEGMENT
from regrasp.kernels.distances import OBJECT, STATIC, Geoms
from regrasp.kernels.grids import Grids, grids_of
from regrasp.kernels.records import Record
from regrasp.kernels.surfaces import BOX as BOX_SURFACE
from regrasp.kernels.surfaces import CAPSULE, MESH, SPHERE
from regrasp.kernels.surfaces import CYLINDER as CYLINDER_SURFACE
from regrasp.kernels.surfaces import ELLIPSOID as ELLIPSOID_SURFACE
from regrasp.kernels.wrist import Wrists, wrists_of
from regrasp.planner.arrays import arms_from, chains_from, geoms_from
from regrasp.planner.hulls import hull_core, widened
from regrasp.scene import matter
from regrasp.scene.links import Part
from regrasp.scene.schema import FREEDOMS
from regrasp.scene.world import Agent, World

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

RANGE_MARGIN = 0.015  # rad or m that plans keep from the joint limits


class Hand(Record):
    """Agents i = 0 … k − 1 (fingers or arms), the object and the static bodies. Forces in weights, lengths in metres.

    chains: the agents' serial chains; wrists: their inverse kinematics in closed form, where there is one; geoms: every body,
    agents first, then static, those of arms that carry hands, the convex parts of the object last.
    geom_start (k + 1,): geoms of agent i are geom_start[i] … geom_start[i + 1] − 1.
    pairs (n, 2): geoms that may not touch, sorted by block; block (k + 1, k + 3): pairs of agent a (or, in row k, of the
    object) with agent c, with the static bodies (c = k), with the object (c = k + 1) are block[a, c] … block[a, c + 1] − 1.
    tip_geom (k,), object_geom: indices into geoms, of the tips and the object's first part.
    kind_O, size_O; kind_T (k,), size_T (k, 4): surfaces of the object and of the tips (`kernels.surfaces`), meshes among them
    on the grids.
    needed: contacts that must stick for the object's pose to be determined. shifts, turns (3,): 1 for the axes of W along
    and about which disturbances act, 0 for those that would lead out of the scene's plane.
    mu (k,): friction; cap (k,): largest normal force in units of the object's weight.
    home (nq,): rest posture; axis_T (k, 3): pointing direction of the tip in T; reach (k,): length of the stretched chain.
    p_OM_O (3,): the object's centre of mass; radius: of its bounding sphere; weight: N.

    base (k,): what an agent stands on and its chain begins at, 0 the world, c + 1 the palm of arm c. origin (k, 3), span (k,):
    how far from where an agent gets, its arm's way included. arms, palms: chains of the arms to their palms, and closed forms;
    arm_home (nq_a,): their rest; arm_geom: the first of their geoms, arm_start (c + 1,): where those of each begin, from there;
    arm_pairs (n, 2): geoms that may not touch of which one at least is an arm's, and none an agent's; arm_own (n,): whether
    both are one arm's.
    """

    chains: Chains
    wrists: Wrists
    geoms: Geoms
    geom_start: Ints
    pairs: Ints
    block: Ints
    tip_geom: Ints
    object_geom: int
    kind_O: int
    size_O: Array
    kind_T: Ints
    size_T: Array
    grids: Grids
    needed: int
    shifts: Array
    turns: Array
    mu: Array
    cap: Array
    home: Array
    axis_T: Array
    reach: Array
    p_OM_O: Array
    radius: float
    weight: float
    base: Ints
    origin: Array
    span: Array
    arms: Chains
    palms: Wrists
    arm_home: Array
    arm_geom: int
    arm_start: Ints
    arm_pairs: Ints
    arm_own: NDArray[np.uint8]


def parts_of(world: World, geoms: Ints) -> list[Part]:
    """The convex bodies that geoms (ids) are in Hand.geoms: one, or the primitives that stand for a mesh."""
    return [(int(g), i) for g in geoms for i in range(len(world.links.shapes.get(int(g), (None,))))]


def geom_index(world: World) -> dict[int, list[int]]:
    """Where the bodies of each colliding geom of the model stand in Hand.geoms; all geoms of a tip are one
    there, those of the object its convex parts together."""
    index: dict[int, list[int]] = {}
    for row, (geom, _) in enumerate(parts_of(world, solids(world))):
        index.setdefault(geom, []).append(row)
    last = sum(map(len, index.values()))
    tips = {int(g): index[agent.tip_geom] for agent in world.agents for g in agent.tip_geoms}
    parts = list(range(last, last + len(world.matter.parts)))
    return index | tips | {int(g): parts for g in world.object_geoms}


def solids(world: World) -> Ints:
    """All geoms in the order of Hand.geoms, but for the object's."""
    return np.concatenate([*map(solids_of, world.agents), world.static_geoms, *(arm.geoms for arm in world.arms)])


def solids_of(agent: Agent) -> Ints:
    """The geoms of an agent, its tip counted once, however many it is made of."""
    return np.setdiff1d(agent.geoms, agent.tip_geoms[1:])


def hand_of(world: World) -> Hand:
    """The kernel arrays of a world.

    Raises InputError where a body has no kernel, as `arrays` says.
    """
    model, agents = world.model, world.agents
    joints = [agent.joints.tolist() for agent in agents]
    index = geom_index(world)
    parts = parts_of(world, solids(world))
    palms, shared = [arm.body for arm in world.arms], [arm.joints.tolist() for arm in world.arms]
    roots = [0 if agent.arm < 0 else palms[agent.arm] for agent in agents]
    # Between two samples a plan's spline passes their joint values by a little.
    chains = chains_from(model, joints, [agent.tip_geom for agent in agents], RANGE_MARGIN, roots)
    arms = arms_from(model, shared, palms, RANGE_MARGIN)
    bodies = geoms_from(model, parts, joints, world.object_body, world.links.shapes, shared)
    tips = [index[agent.tip_geom][0] for agent in agents]
    for row, agent in zip(tips, agents, strict=True):
        bodies.kind[row], bodies.core[row, :3], bodies.radius[row] = core_of(agent.tip_kind, agent.tip_size)
        bodies.bound[row] = bounding_radius(agent.tip_kind, agent.tip_size)
    geoms = with_object(bodies, world.matter.parts)
    starts = np.cumsum([0, *(len(parts_of(world, solids_of(agent))) for agent in agents)])
    spared = {(index[g][i], index[h][j]) for (g, i), (h, j) in world.links.spared}
    apart = {(a, b) for g, h in world.collision_pairs for a in index[int(g)] for b in index[int(h)]} - spared
    arm_start = np.cumsum([0, *(len(parts_of(world, arm.geoms)) for arm in world.arms)])
    arm_geom = len(parts) - int(arm_start[-1])
    of_arms = sorted(
        pair for pair in apart if min(pair) >= starts[-1] and carried_by(pair, arm_start, arm_geom) != (-1, -1)
    )
    pairs, block = blocks(sorted(apart - set(of_arms)), geoms.agent, len(agents))
    own = [a == b for a, b in (carried_by(pair, arm_start, arm_geom) for pair in of_arms)]
    mass = float(model.body_mass[world.object_body])
    g = float(np.linalg.norm(model.opt.gravity))
    weight = mass * g if g > 0.0 else 1.0  # without gravity forces are counted in newtons
    # A tip on its last joint points nowhere: a zero axis asks the inverse kinematics for the position alone.
    axis = [R.T @ p / (np.linalg.norm(p) or 1.0) for R, p in zip(chains.R_LT, chains.p_LT, strict=True)]
    reach = [stretched(chains, i) for i in range(len(agents))]
    far = [stretched(arms, c) for c in range(len(palms))]
    plane = plane_of(world.scene.freedoms)
    # Three points that stick determine a pose; two leave the turn about their line, which leads out of every plane with it.
    needed = 3 if plane is None else 2
    free = plane or FREEDOMS
    grid = world.object_grid
    return Hand(
        chains=chains,
        wrists=wrists_of(chains),
        geoms=geoms,
        geom_start=starts.astype(np.int64),
        pairs=pairs,
        block=block,
        tip_geom=np.array(tips, np.int64),
        object_geom=len(parts),
        kind_O=world.object_kind,
        size_O=world.object_size,
        kind_T=np.array([agent.tip_kind for agent in agents], np.int64),
        size_T=np.array([agent.tip_size for agent in agents]),
        grids=grids_of([] if grid is None else [(grid.origin, grid.spacing, grid.values)]),
        needed=needed,
        shifts=np.array([float(axis in free) for axis in ("x", "y", "z")]),
        turns=np.array([float(axis in free) for axis in ("rx", "ry", "rz")]),
        mu=np.array([agent.friction for agent in agents]),
        cap=np.array([agent.max_force / weight for agent in agents]),
        home=np.concatenate([agent.home for agent in agents]).astype(float),
        axis_T=np.array(axis),
        reach=np.array(reach),
        p_OM_O=np.array(model.body_ipos[world.object_body]),
        radius=float(np.max(geoms.bound[len(parts) :] + np.linalg.norm(geoms.p_LG[len(parts) :], axis=1))),
        weight=weight,
        base=np.array([agent.arm + 1 for agent in agents], np.int64),
        origin=np.array([chains.p_WB[i] if a.arm < 0 else arms.p_WB[a.arm] for i, a in enumerate(agents)]),
        span=np.array([
            reach[i] + (0.0 if a.arm < 0 else far[a.arm] + np.linalg.norm(chains.p_WB[i])) for i, a in enumerate(agents)
        ]),
        arms=arms,
        palms=wrists_of(arms),
        arm_home=np.concatenate([np.zeros(0), *(arm.home for arm in world.arms)]),
        arm_geom=arm_geom,
        arm_start=arm_start.astype(np.int64),
        arm_pairs=np.array(of_arms, np.int64).reshape(-1, 2),
        arm_own=np.array(own, np.uint8),
    )  # fmt: skip


def carried_by(pair: tuple[int, int], arm_start: Ints, arm_geom: int) -> tuple[int, int]:
    """Which arm's each of two geoms is, −1 for one of none."""
    first, second = (
        int(np.searchsorted(arm_start, g - arm_geom, side="right")) - 1 if 0 <= g - arm_geom < arm_start[-1] else -1
        for g in pair
    )
    return first, second


def stretched(chains: Chains, i: int) -> float:
    """How far agent i's tip gets from its base at most, m: all links in a line, all slides at their ends."""
    mine = slice(chains.start[i], chains.start[i + 1])
    slides, masters = chains.kind[mine] == SLIDE, chains.start[i] + chains.master[mine]
    ends = chains.offset[mine] + chains.gain[mine] * np.array([chains.lower[masters], chains.upper[masters]])
    travel = np.max(np.abs(ends), axis=0)[slides]
    links = np.linalg.norm(chains.p_PJ[mine], axis=1)
    return float(np.sum(links) + np.sum(travel) + np.linalg.norm(chains.p_LT[i]))


PLANES = (frozenset({"x", "y", "rz"}), frozenset({"x", "z", "ry"}), frozenset({"y", "z", "rx"}))
"""The freedoms of a body that moves in a plane, for each of the three planes."""


def plane_of(freedoms: tuple[str, ...]) -> frozenset[str] | None:
    """The freedoms of the plane that these freedoms do not leave, if there is one."""
    return next((plane for plane in PLANES if set(freedoms) <= plane), None)


def blocks(pairs: list[tuple[int, int]], owner: Ints, k: int) -> tuple[Ints, Ints]:
    """Pairs sorted by block, and where each block starts (see `Hand`)."""

    def column(g: int) -> int:
        return {STATIC: k, OBJECT: k + 1}.get(int(owner[g]), int(owner[g]))

    sorted_pairs: dict[tuple[int, int], set[tuple[int, int]]] = {}
    for a, b in pairs:
        if column(b) < k <= column(a) or (column(a) < k and column(b) < k and column(b) < column(a)):
            a, b = b, a
        row, other = column(a), column(b)
        if row >= k:  # the object with a static body
            row, other = k, k
        sorted_pairs.setdefault((row, other), set()).add((a, b))
    block = np.zeros((k + 1, k + 3), np.int64)
    flat: list[tuple[int, int]] = []
    for row in range(k + 1):
        for other in range(k + 2):
            block[row, other] = len(flat)
            flat += sorted(sorted_pairs.get((row, other), ()))
        block[row, k + 2] = len(flat)
    return np.array(flat, np.int64).reshape(-1, 2), block


def core_of(kind: int, size: Array) -> tuple[int, Array, float]:
    """Kind, half extents and radius (its rounding) of the convex core of a surface."""
    edge = size[3]
    core, radius = {
        SPHERE: (np.zeros(3), size[0]),
        ELLIPSOID_SURFACE: (size[:3], 0.0),
        CAPSULE: (np.array([0.0, 0.0, size[1]]), size[0]),
        CYLINDER_SURFACE: (np.array([size[0] - edge, size[0] - edge, size[1] - edge]), edge),
        BOX_SURFACE: (size[:3] - edge, edge),
    }[kind]
    code = {
        SPHERE: POINT, ELLIPSOID_SURFACE: ELLIPSOID, CAPSULE: SEGMENT, CYLINDER_SURFACE: CYLINDER, BOX_SURFACE: BOX,
    }[kind]  # fmt: skip
    return code, core, float(radius)


def with_object(geoms: Geoms, parts: tuple[matter.Part, ...]) -> Geoms:
    """The geoms with the object's parts appended, each a convex core with a radius."""
    cores = [hull_core(part.vertices) if part.kind == MESH else core_of(part.kind, part.size)[1] for part in parts]
    kinds = [HULL if part.kind == MESH else core_of(part.kind, part.size)[0] for part in parts]
    radii = [float(part.size[3]) if part.kind == MESH else core_of(part.kind, part.size)[2] for part in parts]
    bounds = [
        float(np.max(np.linalg.norm(part.vertices, axis=1)) + part.size[3]) if part.kind == MESH
        else bounding_radius(part.kind, part.size) for part in parts
    ]  # fmt: skip
    return Geoms(
        kind=np.append(geoms.kind, kinds),
        core=widened([*geoms.core, *cores]),
        radius=np.append(geoms.radius, radii),
        R_LG=np.concatenate([geoms.R_LG, *(part.R_OP[None] for part in parts)]),
        p_LG=np.vstack([geoms.p_LG, *(part.p_OP for part in parts)]),
        bound=np.append(geoms.bound, bounds),
        agent=np.append(geoms.agent, [OBJECT] * len(parts)),
        link=np.append(geoms.link, [0] * len(parts)),
    )


def bounding_radius(kind: int, size: Array) -> float:
    """Radius of the ball about the origin of a surface that holds it, m."""
    edge = float(size[3])
    if kind == BOX_SURFACE:
        return float(np.linalg.norm(size[:3] - edge)) + edge
    if kind == CYLINDER_SURFACE:
        return float(np.hypot(size[0] - edge, size[1] - edge)) + edge
    if kind == CAPSULE:
        return float(size[0] + size[1])
    if kind == ELLIPSOID_SURFACE:
        return float(np.max(size[:3]))
    return float(size[0])
