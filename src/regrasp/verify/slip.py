"""Relative motion at the contacts by central differences: slip, spin, and what V and the stated twist say about them.

From one instant to the next the tip's motion relative to the object is the rotation vector δθ (from the two rotations)
and the displacement δp of its origin. The material point of the tip that is at the contact c half-way moves by
δ = δp + δθ × (c − p), the midpoint rule of v + ω × r; its part in the tangent plane is the slip.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from regrasp.plan import FIRST_ROLL, FIRST_SLIDE, RELOCATE, SLIDE, STICK, Plan
from regrasp.scene.world import World
from regrasp.verify.contacts import Contacts, touching
from regrasp.verify.findings import Finding, worst
from regrasp.verify.motion import Motion, fine, rotation_vector, unit

Array = NDArray[np.float64]

FRACTION = 0.01
"""What may go astray, as a fraction of the interval's motion."""
SLIP_FLOOR = 1e-6
"""… and besides, m: round-off of inverse kinematics where nothing moves."""
TURN_FLOOR = 1e-3
"""… and besides, rad. Also the least rotation that counts as a roll."""
SLIDE_FLOOR = 1e-5
"""Error of a stated sliding distance, m. Also the least distance that counts as a slide."""
FRAME = 1e-2
"""Angle between the stated x axis and the one parallel-transported along the stated normals, rad."""


@dataclass(frozen=True)
class Steps:
    """Motion of each tip relative to the object between consecutive instants, in O."""

    turn: Array
    """(N, S−1, k, 3) δθ, rad."""
    slip: Array
    """(N, S−1, k, 3) tangential displacement of the tip's material point at the contact, m."""
    n: Array
    """(N, S−1, k, 3) normal half-way."""
    x: Array
    """(N, S−1, k, 3) stated x axis half-way, in the tangent plane."""


def middle(values: Array) -> Array:
    """Mean of neighbouring instants, (N, S, ...) → (N, S−1, ...)."""
    return 0.5 * (values[:, 1:] + values[:, :-1])


def tangential(vectors: Array, n: Array) -> Array:
    """(I − nnᵀ) applied to vectors (..., 3)."""
    return np.asarray(vectors - np.sum(vectors * n, axis=-1, keepdims=True) * n)


def direction(steps: Array) -> Array:
    """Unit direction of the motion at each instant, (N, S, ..., 3), from the steps before and after it."""
    ends = np.concatenate([steps[:, :1], steps, steps[:, -1:]], axis=1)
    return unit(ends[:, 1:] + ends[:, :-1])


def relative_steps(plan: Plan, motion: Motion, contacts: Contacts) -> Steps:
    """The steps of every agent, NaN where it is off or relocating."""
    turn = rotation_vector(motion.R_OT[:, :-1], motion.R_OT[:, 1:])
    n = unit(middle(contacts.n_O))
    point = middle(contacts.p_O) - middle(motion.p_OT)
    moved = np.diff(motion.p_OT, axis=1) + np.cross(turn, point)
    return Steps(turn, tangential(moved, n), n, unit(tangential(middle(fine(plan.x_O, motion.K)), n)))


def support_steps(plan: Plan, motion: Motion) -> Array:
    """(N, S−1, P, 3): tangential displacement, in W, of the object's material point at each stated support contact."""
    turn = rotation_vector(motion.R_WO[:, :-1], motion.R_WO[:, 1:])[:, :, None]
    arm = (motion.R_WO[:, :, None] @ fine(plan.support_p_O, motion.K)[..., None])[..., 0]
    moved = np.diff(motion.p_WO, axis=1)[:, :, None] + np.cross(turn, middle(arm))
    return tangential(moved, unit(middle(fine(plan.support_n_W, motion.K))))


def travel(plan: Plan, p_O: Array) -> Array:
    """(N, ·): way of the stated contact points p_O (N, M, ·, 3) on the object plus their way in the world, m."""
    R = _matrices(plan.object_quaternion)
    p_W = plan.object_position[:, :, None] + (R[:, :, None] @ p_O[..., None])[..., 0]
    return _total(np.diff(p_O, axis=1)) + _total(np.diff(p_W, axis=1))


def motion_findings(plan: Plan, world: World, motion: Motion, contacts: Contacts) -> list[Finding]:
    """Slip, spin, agreement with V and with the stated twist, and the stated contact frame."""
    steps = relative_steps(plan, motion, contacts)
    touch, rolls = touching(plan), plan.V < FIRST_SLIDE
    slides = touch & ~rolls
    x, y = steps.x, np.cross(steps.n, steps.x)
    axis = _commanded(plan, x, y)
    moved = np.sum(_dot(steps.slip, axis), axis=1)
    free = _freedom(world, motion, contacts, touch)
    turn, able = _apply(free, steps.turn), _apply(free, axis)
    power = np.sum(able**2, axis=-1)
    turned = np.where(power > 1e-6, _dot(turn, able) / np.maximum(power, 1e-6), 0.0)
    amount = np.sum(turned, axis=1)
    rolled = turn - np.where(rolls[:, None], np.maximum(turned, 0.0), 0.0)[..., None] * able
    strayed = steps.slip - np.maximum(_dot(steps.slip, axis), 0.0)[..., None] * axis
    capable = (plan.V >= FIRST_ROLL) & rolls & (power.mean(axis=1) > 1e-2)
    way, whole = travel(plan, plan.p_OC_O), _total(steps.turn)
    full = np.array([agent.freedom >= 6 for agent in world.agents])
    twist = np.stack([np.sum(_dot(steps.turn, x), axis=1), np.sum(_dot(steps.turn, y), axis=1),
                      np.sum(_dot(steps.slip, x), axis=1), np.sum(_dot(steps.slip, y), axis=1)], axis=-1)  # fmt: skip
    astray = np.abs(twist - plan.twist)
    who = plan.agent_names
    allowed_turn, allowed_slip = FRACTION * whole + TURN_FLOOR, FRACTION * way + SLIP_FLOOR
    return [
        worst("slip", "way the tip slips on the object while it rolls or stays", _total(steps.slip), allowed_slip, "m",
              "jx", None, who, rolls),
        worst("spin", "rotation about the normal (agents of six joints and more)",
              np.sum(np.abs(_dot(steps.turn, steps.n)), axis=1), allowed_turn, "rad", "jx", None, who, touch & full),
        worst("rotation by V", "rotation, as far as the agent can choose it, that V's code does not name",
              _total(rolled), allowed_turn, "rad", "jx", None, who, touch),
        worst("slide by V", "sliding across the direction that V's code names", _total(strayed), allowed_slip, "m",
              "jx", None, who, slides),
        worst("roll happens", "least rotation of a roll over the rotation measured",
              TURN_FLOOR / np.maximum(amount, 1e-12), 1.0, "", "jx", None, who, capable),
        worst("slide happens", "least way of a slide over the way measured",
              SLIDE_FLOOR / np.maximum(moved, 1e-12), 1.0, "", "jx", None, who, slides),
        worst("stated rotation", "stated relative rotation against the one measured", astray[..., :2].max(axis=-1),
              FRACTION * np.linalg.norm(plan.twist[..., :2], axis=-1) + TURN_FLOOR, "rad", "jx", None, who, touch),
        worst("stated slide", "stated relative displacement against the one measured", astray[..., 2:].max(axis=-1),
              FRACTION * np.linalg.norm(plan.twist[..., 2:], axis=-1) + SLIDE_FLOOR, "m", "jx", None, who, touch),
        *_frame_findings(plan, touch),
    ]  # fmt: skip


def support_motion_findings(plan: Plan, motion: Motion) -> list[Finding]:
    """Supports: where the object sticks it does not slip, where it slides it does."""
    if not plan.support_names:
        return []
    slip = _total(support_steps(plan, motion))
    allowed = FRACTION * travel(plan, plan.support_p_O) + SLIP_FLOOR
    return [
        worst("support stick", "way the object slips on a support it is said to stick to", slip, allowed, "m",
              "jx", None, plan.support_names, plan.support_mode == STICK),
        worst("support slide", "least way of a slide over the way the object slips on a support it is said to slide on",
              SLIP_FLOOR / np.maximum(slip, 1e-12), 1.0, "",
              "jx", None, plan.support_names, plan.support_mode == SLIDE),
    ]  # fmt: skip


def _frame_findings(plan: Plan, touch: NDArray[np.bool_]) -> list[Finding]:
    x, n = plan.x_O, plan.n_O
    skew = np.maximum(np.abs(np.linalg.norm(x, axis=-1) - 1.0), np.abs(_dot(x, n)))
    carried = x[:, 0]
    error = np.zeros(x.shape[:3])
    for m in range(1, x.shape[1]):
        # the smallest rotation from normal to normal is parallel transport along the great arc between them
        a, b = n[:, m - 1], n[:, m]
        carried = carried - _dot(b, carried)[..., None] / (1.0 + _dot(a, b)[..., None]) * (a + b)
        error[:, m] = np.linalg.norm(unit(carried) - x[:, m], axis=-1)
    who = plan.agent_names
    return [
        worst("contact frame", "stated x axis: length less 1, product with the normal", skew, 1e-6, "",
              "jsx", plan.time, who, touch[:, None]),
        worst("frame transport", "stated x axis against the one transported along the contact's path", error,
              FRAME, "rad", "jsx", plan.time, who, touch[:, None]),
    ]  # fmt: skip


def _commanded(plan: Plan, x: Array, y: Array) -> Array:
    """(N, S−1, k, 3): unit axis that V's code names, zero for stay."""
    V = plan.V[:, None, :, None]
    code = np.where(V >= FIRST_SLIDE, V - FIRST_SLIDE, V - FIRST_ROLL)
    named = (V >= FIRST_ROLL) & (V < RELOCATE)
    return np.where(named, np.where(code % 2 == 0, 1.0, -1.0) * np.where(code // 2 == 0, x, y), 0.0)


def _freedom(world: World, motion: Motion, contacts: Contacts, touch: NDArray[np.bool_]) -> Array:
    """(N, S−1, k, 3, 3): projector, in O, on the angular velocities an agent can choose for its tip without slip.

    With q̇ in the null space of the contact point's Jacobian the tip turns by J_ω q̇. An agent of fewer than six free joints
    meets a commanded angular velocity in the least-squares sense, that is exactly within this space; with six joints
    and more the space is all of R³.
    """
    free = np.tile(np.eye(3), (*motion.time.shape, len(world.agents), 1, 1))
    model = world.model
    data = mujoco.MjData(model)
    jacobian = np.empty((6, model.nv))
    addresses = world.joint_qpos
    for a, agent in enumerate(world.agents):
        if agent.freedom >= 6:
            continue
        for j in np.flatnonzero(touch[:, a]):
            for s in np.flatnonzero(np.isfinite(contacts.p_O[j, :, a]).all(axis=-1)):
                data.qpos[addresses] = motion.joints[j, s]
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                R_WO = motion.R_WO[j, s]
                p_W = motion.p_WO[j, s] + R_WO @ contacts.p_O[j, s, a]
                mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], p_W, agent.tip_body)
                J = jacobian[:, agent.dofs] @ agent.coupling.matrix
                turns = R_WO.T @ J[3:] @ _null(J[:3])
                free[j, s, a] = turns @ np.linalg.pinv(turns, rcond=1e-6)
    return middle(free)


def _null(J: Array) -> Array:
    _, sizes, Vt = np.linalg.svd(J)
    rank = int(np.sum(sizes > 1e-6 * sizes[0])) if sizes[0] > 0.0 else 0
    return np.asarray(Vt[rank:].T)


def _apply(matrices: Array, vectors: Array) -> Array:
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.sum(a * b, axis=-1))


def _total(steps: Array) -> Array:
    """Length of the way along axis 1."""
    return np.asarray(np.linalg.norm(steps, axis=-1).sum(axis=1))


def _matrices(quaternion: Array) -> Array:
    matrices = Rotation.from_quat(quaternion.reshape(-1, 4), scalar_first=True).as_matrix()
    return np.asarray(matrices).reshape(*quaternion.shape[:-1], 3, 3)
