"""What can be said of a plan's numbers before anything moves, and where its motion begins, ends and may not go."""

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from regrasp.plan import MOTIONS, OFF, RELOCATE, SUPPORT_MODES, Plan
from regrasp.scene import fixtures
from regrasp.scene.collisions import vertices
from regrasp.scene.matter import Matter, add_to, matter_of
from regrasp.scene.world import World
from regrasp.verify.contacts import TOUCH, Contacts, touching
from regrasp.verify.findings import Finding, worst
from regrasp.verify.motion import STRIDE, Motion

Array = NDArray[np.float64]

LARGEST = 1e6
"""No length, angle, time or force in a plan is larger than this (SI): what is, is garbage."""
UNIT = 1e-6
"""Length of a stated unit vector or quaternion less 1."""
SAME = 1e-9
"""Difference between what should be the same number twice (m, rad, s), relative or absolute."""
START = 1e-6
"""Difference of the start pose or of given start joints from the scene's, m and rad."""
PASSED = (1e-4, 1e-3)
"""Distance at which the object passes the route's subgoals, m and rad."""
LIMIT = 1e-4
"""How far a joint may pass its range between samples, rad or m."""
COUPLED = 1e-6
"""By so much a joint that follows another may be off what that asks for, rad or m."""
SPEED = 1.01
"""Joint speed over its limit; the motion's exact derivative may exceed a difference quotient a little."""

CONTACT_ARRAYS = ("p_OC_O", "n_O", "x_O")
FORCE_FREE = ("time", "object_position", "object_quaternion", "joints", "twist", "force_W", "support_p_O",
              "support_n_W", "support_force_W", "route")  # fmt: skip


def number_findings(plan: Plan) -> list[Finding]:
    """Every number finite, NaN exactly where there is no contact, codes legal, times increasing."""
    wild = sum(int(np.sum(~(np.abs(getattr(plan, name)) <= LARGEST))) for name in FORCE_FREE)
    wild += int(np.sum(~np.isfinite(plan.energy)))
    held = np.broadcast_to(touching(plan)[:, None, :, None], plan.p_OC_O.shape)
    misplaced = sum(
        int(np.sum(np.where(held, ~(np.abs(array) <= LARGEST), ~np.isnan(array))))
        for array in (getattr(plan, name) for name in CONTACT_ARRAYS)
    )
    arcs = plan.route.shape[0] - 1
    illegal = int(np.sum(~np.isin(plan.V, range(len(MOTIONS)))))
    illegal += int(np.sum(~np.isin(plan.support_mode, range(len(SUPPORT_MODES)))))
    order = np.diff(plan.segment, prepend=-1, append=arcs)
    illegal += int(np.sum(order[1:-1] // 2 != 0)) + int(order[0] != 1) + int(order[-1] != 1)
    illegal += int(np.sum((plan.energy_segment < 0) | (plan.energy_segment >= arcs)))
    idle = int(np.sum(~touching(plan)[..., None] & (np.abs(plan.twist) > 0.0)))
    quaternions = np.concatenate([plan.object_quaternion.reshape(-1, 4), plan.route[:, 3:]])
    length = np.abs(np.linalg.norm(quaternions, axis=-1) - 1.0)
    backwards = int(np.sum(~(np.diff(plan.time, axis=1) > 0.0)))
    return [
        Finding("finite", f"numbers that are not finite or beyond {LARGEST:g}", wild, 0.0, ""),
        Finding("contact arrays", "numbers missing in contact, or present where V has none", misplaced, 0.0, ""),
        Finding("codes", "codes that mean nothing, segments out of order", illegal, 0.0, ""),
        Finding("idle twist", "stated relative motion of agents that are off or relocating", idle, 0.0, ""),
        Finding("time order", "samples not later than the one before", backwards, 0.0, ""),
        worst("quaternions", "length of a quaternion less 1", length, UNIT, "", "x", who=[""] * len(length)),
    ]


def name_findings(plan: Plan, world: World) -> list[Finding]:
    """The agents, joints and supports are the world's."""
    agents = tuple(agent.name for agent in world.agents)
    joints = tuple(world.model.joint(int(i)).name for limb in world.limbs for i in limb.joints)
    unknown = [name for name in plan.support_names if name not in world.support_names]
    differ = int(plan.agent_names != agents) + int(plan.joint_names != joints) + len(unknown)
    return [Finding("names", "agents, joints or supports that are not the model's", differ, 0.0, "")]


def model_findings(plan: Plan, world: World) -> list[Finding]:
    """The stored model says of object, surroundings, friction and gravity what the stored scene says.

    The robot itself is what the stored model says.
    """
    scene, model = world.scene, world.model
    stored = [model.geom_friction[g, 0] for agent in world.agents for g in agent.tip_geoms]
    stored += [*model.geom_friction[world.support_geoms, 0], *model.opt.gravity]
    stored += [model.body_mass[world.object_body], *model.body_ipos[world.object_body]]
    said = [agent.friction for agent in world.agents for _ in agent.tip_geoms]
    matter = matter_of(scene.object, world.assets)
    said += [*world.support_friction, *scene.gravity, matter.mass, *matter.centre]
    differences = [np.abs(np.subtract(stored, said)).max()]
    for ours, theirs in ((world.object_geoms, _object(world, matter)), (world.fixture_geoms, _environment(world))):
        for name in ("geom_type", "geom_size", "geom_pos", "geom_quat"):
            a, b = getattr(model, name)[ours], getattr(theirs, name)
            if name == "geom_size" and len(a) == len(b):
                solid = theirs.geom_type != mujoco.mjtGeom.mjGEOM_PLANE  # a plane's size is for display
                a, b = a[solid], b[solid]
            differences.append(_difference(a, b))
        meshes = np.flatnonzero(theirs.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
        for g, h in zip(np.asarray(ours)[meshes] if len(ours) == theirs.ngeom else (), meshes, strict=False):
            differences.append(_difference(vertices(model, int(g)), vertices(theirs, int(h))))
    text = "difference between stored model and stored scene in object, surroundings, friction or gravity"
    other = 0.0 if plan.xml == world.xml and dict(plan.assets) == dict(world.assets) else np.inf
    return [
        Finding("model and scene", text, float(max(differences)), SAME, ""),
        Finding(
            "model and world", "difference between the stored model and the world the plan is judged in", other, 0.0, ""
        ),
    ]


def motion_findings(plan: Plan, world: World, motion: Motion) -> list[Finding]:
    """Continuity, joint range and speed, and whether the judged instants are close enough to each other."""
    turns = _angle(plan.object_quaternion[1:, 0], plan.object_quaternion[:-1, -1])
    jumps = [
        np.abs(plan.time[1:, 0] - plan.time[:-1, -1]),
        np.abs(plan.joints[1:, 0] - plan.joints[:-1, -1]).max(axis=1),
        np.linalg.norm(plan.object_position[1:, 0] - plan.object_position[:-1, -1], axis=1),
        turns,
    ]
    lower, upper, speed = (np.concatenate([getattr(limb, key) for limb in world.limbs])
                           for key in ("lower", "upper", "speed"))  # fmt: skip
    beyond = np.maximum(0.0, np.maximum(lower - motion.joints, motion.joints - upper))
    stride = np.linalg.norm(np.diff(motion.geom_xpos, axis=1), axis=-1).max(axis=-1)
    who = plan.joint_names
    return [
        worst("continuity", "jump of time, joints or object from one interval to the next", np.max(jumps, axis=0), SAME,
              "s, rad or m", "j"),
        worst("joint range", "joint beyond its range", beyond, LIMIT, "rad or m", "jsx", motion.time, who),
        worst("joint speed", "joint speed", np.abs(motion.joint_speed), SPEED * speed, "rad/s or m/s",
              "jsx", motion.time, who),
        *_coupling_findings(plan, world, motion),
        worst("resolution", "way of a body between two judged instants", stride, 2 * STRIDE, "m", "js", motion.time),
    ]  # fmt: skip


def _coupling_findings(plan: Plan, world: World, motion: Motion) -> list[Finding]:
    """Joints that the model ties to others by equality constraints: y − y_0 = Σ_i a_i (x − x_0)^i."""
    model = world.model
    column = {int(address): i for i, address in enumerate(world.joint_qpos)}
    ties = []
    for e in np.flatnonzero((model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)) & (model.eq_active0 != 0)):
        ends = [int(model.jnt_qposadr[j]) for j in (model.eq_obj1id[e], model.eq_obj2id[e])]
        if ends[0] in column:
            moved = motion.joints[..., column[ends[1]]] - model.qpos0[ends[1]] if model.eq_obj2id[e] >= 0 else 0.0
            asked = model.qpos0[ends[0]] + np.polynomial.polynomial.polyval(moved, model.eq_data[e, :5])
            ties.append((plan.joint_names[column[ends[0]]], np.abs(motion.joints[..., column[ends[0]]] - asked)))
    if not ties:
        return []
    return [
        worst("coupled joints", "joint off what the one that it follows asks for",
              np.stack([off for _, off in ties], axis=-1), COUPLED, "rad or m", "jsx", motion.time, [who for who, _ in ties]),
    ]  # fmt: skip


def pose_findings(plan: Plan, world: World) -> list[Finding]:
    """The object starts where the scene says, passes the route's subgoals and ends at the goal."""
    start, goal = world.scene.start.pose, world.scene.goal
    p, q = plan.object_position, plan.object_quaternion
    last = np.append(np.flatnonzero(np.diff(plan.segment)), len(plan.segment) - 1)
    poses_p = np.vstack([p[:1, 0], p[last, -1]])
    poses_q = np.vstack([q[:1, 0], q[last, -1]])
    missed_p = np.linalg.norm(poses_p - plan.route[:, :3], axis=1)
    missed_q = _angle(poses_q, plan.route[:, 3:])
    passed = np.maximum(missed_p / PASSED[0], missed_q / PASSED[1])
    return [
        worst("start position", "object's position against the scene's start", np.linalg.norm(p[0, 0] - start.p),
              START, "m"),
        worst("start rotation", "object's rotation against the scene's start", _angle(q[0, 0], start.wxyz),
              START, "rad"),
        worst("goal position", "object's last position against the goal", np.linalg.norm(p[-1, -1] - goal.pose.p),
              goal.tolerance.position, "m"),
        worst("goal rotation", "object's last rotation against the goal", _angle(q[-1, -1], goal.pose.wxyz),
              goal.tolerance.rotation, "rad"),
        worst("route", f"object past a subgoal, in units of {PASSED[0]:g} m and {PASSED[1]:g} rad", passed, 1.0, "",
              "x", who=[f"subgoal {i}" for i in range(len(passed))]),
    ]  # fmt: skip


def grasp_findings(plan: Plan, world: World, contacts: Contacts) -> list[Finding]:
    """The agents start as the scene's `start` says: off, with given joints, or at given points of the object."""
    start, names = world.scene.start, list(plan.agent_names)
    wrong = sum(int(plan.V[0, names.index(name)] not in (RELOCATE, OFF)) for name in start.off)
    joints, points, held = [0.0], [0.0], () if start.grasp == "auto" else start.grasp
    first = np.cumsum([0, *(len(agent.qpos) for agent in world.agents)])
    for contact in held:
        a = names.index(contact.agent)
        wrong += int(plan.V[0, a] >= RELOCATE)
        if contact.joints is not None:
            joints.append(float(np.abs(plan.joints[0, 0, first[a] : first[a + 1]] - contact.joints).max()))
        else:
            points.append(float(np.linalg.norm(contacts.p_O[0, 0, a] - contact.point)))
    return [
        Finding("start modes", "agents in contact or off against the scene's start", wrong, 0.0, ""),
        worst("start joints", "joints against those the scene gives", max(joints), START, "rad or m"),
        worst("start points", "contact points against those the scene gives", max(points), TOUCH, "m"),
    ]


def _difference(a: Array, b: Array) -> float:
    return float(np.abs(a - b).max(initial=0.0)) if a.shape == b.shape else np.inf


def _angle(a: Array, b: Array) -> Array:
    """Angle between the rotations of quaternions (..., 4), rad."""
    a, b = (np.array(quaternion) for quaternion in np.broadcast_arrays(a, b))  # scipy refuses read-only arrays
    turn = Rotation.from_quat(a.reshape(-1, 4), scalar_first=True).inv() * Rotation.from_quat(
        b.reshape(-1, 4), scalar_first=True
    )
    return np.asarray(turn.magnitude()).reshape(a.shape[:-1])


def _object(world: World, matter: Matter) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    add_to(spec, spec.worldbody.add_body(name="object"), world.scene.object, matter)
    return spec.compile()


def _environment(world: World) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    for body in world.scene.environment:
        fixtures.add(spec, body, world.assets)
    return spec.compile()
