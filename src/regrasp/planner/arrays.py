"""From a MuJoCo model to kernel arrays: the agents' serial chains and the collision geometries on their links.

Bodies fixed to one another are merged: a chain's link is everything between two of its joints.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np
from mujoco import mjtGeom, mjtJoint, mjtObj
from numpy.typing import NDArray

from regrasp.errors import InputError
from regrasp.kernels.chains import HINGE, SLIDE, Chains
from regrasp.kernels.cores import BOX, CYLINDER, ELLIPSOID, HULL, PLANE, POINT, SEGMENT
from regrasp.kernels.distances import OBJECT, STATIC, Geoms
from regrasp.kernels.rotations import Array
from regrasp.planner.hulls import hull_core, widened
from regrasp.scene import collisions
from regrasp.scene.couplings import coupling
from regrasp.scene.fits import Primitive
from regrasp.scene.links import Part

Pose = tuple[Array, Array]
Core = tuple[int, tuple[float, float, float], float]
Shapes = Mapping[int, tuple[Primitive, ...]]


def name_of(model: mujoco.MjModel, kind: mjtObj, index: int) -> str:
    """What to call an element in a message: its name, or its number where it has none."""
    word = {mjtObj.mjOBJ_BODY: "body", mjtObj.mjOBJ_JOINT: "joint", mjtObj.mjOBJ_GEOM: "geom"}[kind]
    return f"{word} {mujoco.mj_id2name(model, kind, index) or index}"


def chains_from(
    model: mujoco.MjModel, joints: Sequence[Sequence[int]], tips: Sequence[int], margin: float = 0.0,
    roots: Sequence[int] | None = None,
) -> Chains:  # fmt: skip
    """Chains of the agents: agent a moves joints[a] (ids, base to tip) and ends in the frame of geom tips[a].

    It begins at body roots[a], in whose frame its base stands; at the world without roots.

    A chain's joint values come in the order of its ids. MuJoCo's `ref` is honoured: a value is a qpos. margin: rad or m kept
    from the joint limits. A joint that follows another has no limits of its own: they narrow its master's. Raises
    InputError, naming the joint, for ball and free joints, for a joint on the way from the tip to the world that is
    not listed, and for a listed one that is not on it or out of order.
    """
    rows = [
        _chain(
            model, list(ids), name_of(model, mjtObj.mjOBJ_GEOM, tip), int(model.geom_bodyid[tip]),
            _pose(model.geom_pos[tip], model.geom_quat[tip]), root,
        )
        for ids, tip, root in zip(joints, tips, roots or [0] * len(tips), strict=True)
    ]  # fmt: skip
    return _chains(model, joints, rows, margin)


def arms_from(
    model: mujoco.MjModel, joints: Sequence[Sequence[int]], palms: Sequence[int], margin: float = 0.0
) -> Chains:
    """Chains of arms that carry hands: arm c moves joints[c] (ids) and ends in the frame of body palms[c]."""
    rows = [
        _chain(model, list(ids), name_of(model, mjtObj.mjOBJ_BODY, palm), palm, (np.eye(3), np.zeros(3)), 0)
        for ids, palm in zip(joints, palms, strict=True)
    ]
    return _chains(model, joints, rows, margin)


def _chains(
    model: mujoco.MjModel, joints: Sequence[Sequence[int]], rows: list[tuple[list[Pose], Pose, Pose]], margin: float
) -> Chains:
    ids = np.array([j for row in joints for j in row], dtype=np.int64)
    limited = model.jnt_limited[ids].astype(bool)
    lower = np.where(limited, model.jnt_range[ids, 0] + margin, -np.inf)
    upper = np.where(limited, model.jnt_range[ids, 1] - margin, np.inf)
    couplings = [coupling(model, np.array(row, np.int64)) for row in joints]
    first = 0
    for each in couplings:
        mine = slice(first, first + len(each.master))
        first = mine.stop
        # What a master passes its limits by, a follower of a larger gain passes its own by more: it keeps as much more margin.
        more = margin * np.maximum(0.0, np.abs(each.gain) - 1.0)
        lower[mine], upper[mine] = each.narrowed(lower[mine] + more, upper[mine] - more)
    return Chains(
        start=np.cumsum([0, *(len(row) for row in joints)], dtype=np.int64),
        kind=np.where(model.jnt_type[ids] == mjtJoint.mjJNT_HINGE, HINGE, SLIDE).astype(np.int64),
        R_PJ=np.array([R for frames, _, _ in rows for R, _ in frames]).reshape(-1, 3, 3),
        p_PJ=np.array([p for frames, _, _ in rows for _, p in frames]).reshape(-1, 3),
        axis=np.array(model.jnt_axis[ids]).reshape(-1, 3),
        lower=lower,
        upper=upper,
        R_WB=np.array([R for _, (R, _), _ in rows]).reshape(-1, 3, 3),
        p_WB=np.array([p for _, (_, p), _ in rows]).reshape(-1, 3),
        R_LT=np.array([R for _, _, (R, _) in rows]).reshape(-1, 3, 3),
        p_LT=np.array([p for _, _, (_, p) in rows]).reshape(-1, 3),
        free=np.array([np.count_nonzero(each.free) for each in couplings], dtype=np.int64),
        master=np.concatenate([np.zeros(0, np.int64), *(each.master for each in couplings)]),
        gain=np.concatenate([np.zeros(0), *(each.gain for each in couplings)]),
        offset=np.concatenate([np.zeros(0), *(each.offset for each in couplings)]),
    )


def _chain(
    model: mujoco.MjModel, joints: list[int], tip: str, body: int, X_BT: Pose, root: int
) -> tuple[list[Pose], Pose, Pose]:
    """Joint frames in the previous links, base in the frame of body `root` and tip frame in the last link of one chain.

    tip: what to call the frame X_BT of `body`, the chain's end.
    """
    bodies = _bodies_to(model, body, root)
    found = [j for b in bodies for j in _joints_of(model, b)]
    for j in found:
        _require_single(model, j)
        if j not in joints:
            raise InputError(
                name_of(model, mjtObj.mjOBJ_JOINT, j),
                f"lies between the world and the tip {tip} but isn't the agent's",
                "list every joint of the chain",
            )
    for j in joints:
        if j not in found:
            raise InputError(
                name_of(model, mjtObj.mjOBJ_JOINT, j),
                f"doesn't move the tip {tip}",
                "an agent is one serial chain from the world to its tip",
            )
    if found != joints:
        raise InputError(tip, "joints are not in the order of the chain", "list them base to tip")
    base: Pose = (np.eye(3), np.zeros(3))
    X: Pose = (np.eye(3), np.zeros(3))  # current body in the last link (in the world before the first joint)
    frames: list[Pose] = []
    for b in bodies:
        X = _compose(X, _pose(model.body_pos[b], model.body_quat[b]))
        for j in _joints_of(model, b):
            if not frames:
                base, X = X, (np.eye(3), np.zeros(3))
            frames.append(_compose(X, _at_zero(model, j)))
            X = (np.eye(3), -model.jnt_pos[j])
    tip_frame = _compose(X, X_BT)
    if not frames:
        base = (np.eye(3), np.zeros(3))
    return frames, base, tip_frame


def geoms_from(
    model: mujoco.MjModel, parts: Sequence[Part], joints: Sequence[Sequence[int]], object_body: int, shapes: Shapes,
    arms: Sequence[Sequence[int]] = (),
) -> Geoms:  # fmt: skip
    """Collision geometries of geoms as convex cores with a radius, each in the frame of what carries it.

    parts: geom id and, for a geom that `shapes` has, which of the primitives that stand for it; else 0. A mesh without such is
    its convex hull.

    A geom belongs to the agent whose joints[a] move it, with the link that `forward` writes for the last of them; to
    the object if it is on object_body or fixed to it; everything else is static and in the world frame, but for what the
    joints of `arms` move: it counts as static, and is in the frame of its link. Raises
    InputError naming the geom if its type has no kernel, or the joint if one moves the geom that no agent owns.
    """
    owner = {j: (a, i) for a, row in enumerate(joints) for i, j in enumerate(row)}
    owner |= {j: (STATIC, i) for row in arms for i, j in enumerate(row)}
    count = len(parts)
    out = Geoms(
        kind=np.zeros(count, dtype=np.int64),
        core=np.zeros((count, 0)),
        radius=np.zeros(count),
        R_LG=np.zeros((count, 3, 3)),
        p_LG=np.zeros((count, 3)),
        bound=np.zeros(count),
        agent=np.zeros(count, dtype=np.int64),
        link=np.zeros(count, dtype=np.int64),
    )
    cores = []
    for g, (geom, i) in enumerate(parts):
        X_BG = _pose(model.geom_pos[geom], model.geom_quat[geom])
        if geom in shapes:
            shape = shapes[geom][i]
            out.kind[g], core, out.radius[g] = CORES[shape.kind](*(float(x) for x in shape.size))
            X_BG = _compose(X_BG, (shape.R, shape.p))
        elif model.geom_type[geom] == mjtGeom.mjGEOM_MESH:
            vertices = collisions.vertices(model, geom)
            middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
            out.kind[g], core = HULL, tuple(hull_core(vertices - middle))
            X_BG = _compose(X_BG, (np.eye(3), middle))
        else:
            out.kind[g], core, out.radius[g] = _core(model, geom)
        cores.append(np.array(core))
        out.bound[g] = _bound(int(out.kind[g]), cores[g][:3], float(out.radius[g]))
        out.agent[g], out.link[g], X = _carrier(model, int(model.geom_bodyid[geom]), owner, object_body)
        out.R_LG[g], out.p_LG[g] = _compose(X, X_BG)
    return replace(out, core=widened(cores))


def _carrier(
    model: mujoco.MjModel, body: int, owner: dict[int, tuple[int, int]], object_body: int
) -> tuple[int, int, Pose]:
    """Agent and link that carry a body, and the body's pose in that link (in the object, in the world)."""
    X: Pose = (np.eye(3), np.zeros(3))
    while body != 0:
        if body == object_body:
            return OBJECT, 0, X
        moving = _joints_of(model, body)
        if moving:
            j = moving[-1]
            if j not in owner:
                raise InputError(
                    name_of(model, mjtObj.mjOBJ_JOINT, j),
                    f"moves {name_of(model, mjtObj.mjOBJ_BODY, body)} but belongs to no agent",
                    "list it as a joint of an agent or remove it from the model",
                )
            agent, link = owner[j]
            return agent, link, _compose((np.eye(3), -model.jnt_pos[j]), X)
        X = _compose(_pose(model.body_pos[body], model.body_quat[body]), X)
        body = int(model.body_parentid[body])
    return STATIC, 0, X


CORES: dict[str, Callable[[float, float, float], Core]] = {
    "sphere": lambda r, *_: (POINT, (0.0, 0.0, 0.0), r),
    "capsule": lambda r, half, _: (SEGMENT, (0.0, 0.0, half), r),
    "cylinder": lambda r, half, _: (CYLINDER, (r, r, half), 0.0),
    "box": lambda x, y, z: (BOX, (x, y, z), 0.0),
}
"""Core of a primitive of `scene.fits` from its size."""


def _core(model: mujoco.MjModel, geom: int) -> Core:
    """Kind, core half extents and radius of a MuJoCo geom."""
    s = [float(x) for x in model.geom_size[geom]]
    match mjtGeom(int(model.geom_type[geom])):
        case mjtGeom.mjGEOM_SPHERE:
            return POINT, (0.0, 0.0, 0.0), s[0]
        case mjtGeom.mjGEOM_CAPSULE:
            return SEGMENT, (0.0, 0.0, s[1]), s[0]
        case mjtGeom.mjGEOM_BOX:
            return BOX, (s[0], s[1], s[2]), 0.0
        case mjtGeom.mjGEOM_CYLINDER:
            return CYLINDER, (s[0], s[0], s[1]), 0.0
        case mjtGeom.mjGEOM_ELLIPSOID:
            return ELLIPSOID, (s[0], s[1], s[2]), 0.0
        case mjtGeom.mjGEOM_PLANE:
            return PLANE, (0.0, 0.0, 0.0), 0.0
        case other:
            raise InputError(
                name_of(model, mjtObj.mjOBJ_GEOM, geom),
                f"collision geometry of type {other.name.removeprefix('mjGEOM_').lower()}",
                "sphere, capsule, cylinder, box, ellipsoid or plane",
            )


def _bound(kind: int, core: Array, radius: float) -> float:
    """Radius of the ball around the geom's origin that holds it."""
    if kind == PLANE:
        return np.inf
    if kind == ELLIPSOID:
        return float(core.max()) + radius
    if kind == CYLINDER:
        return float(np.hypot(core[0], core[2])) + radius
    return float(np.linalg.norm(core)) + radius


def _bodies_to(model: mujoco.MjModel, body: int, root: int) -> list[int]:
    """The bodies from the child of `root` down to body."""
    path = []
    while body != root:
        path.append(body)
        body = int(model.body_parentid[body])
    return path[::-1]


def _joints_of(model: mujoco.MjModel, body: int) -> list[int]:
    first = int(model.body_jntadr[body])
    return list(range(first, first + int(model.body_jntnum[body])))


def _require_single(model: mujoco.MjModel, j: int) -> None:
    kind = mjtJoint(int(model.jnt_type[j]))
    if kind not in (mjtJoint.mjJNT_HINGE, mjtJoint.mjJNT_SLIDE):
        raise InputError(
            name_of(model, mjtObj.mjOBJ_JOINT, j),
            f"type {kind.name.removeprefix('mjJNT_').lower()} can't be part of a chain",
            "hinge or slide",
        )


def _at_zero(model: mujoco.MjModel, j: int) -> Pose:
    """Joint frame at qpos 0 in the body's frame before the joint: MuJoCo turns or shifts by qpos − ref."""
    ref = float(model.qpos0[model.jnt_qposadr[j]])
    axis, anchor = model.jnt_axis[j], model.jnt_pos[j]
    if model.jnt_type[j] == mjtJoint.mjJNT_SLIDE:
        return np.eye(3), anchor - ref * axis
    quat = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quat, axis, -ref)
    return _pose(anchor, quat)


def _pose(position: NDArray[np.float64], quat: NDArray[np.float64]) -> Pose:
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, quat)
    return R.reshape(3, 3), np.array(position)


def _compose(X_AB: Pose, X_BC: Pose) -> Pose:
    return X_AB[0] @ X_BC[0], X_AB[0] @ X_BC[1] + X_AB[1]
