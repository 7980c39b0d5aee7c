"""The plan as a table in time: what the controller follows, one row per control period.

Before the plan's first instant the fingers come from a standoff along the contact normals and load up; after its last
one they hold. Inside, joints and object follow the plan's splines (see `regrasp.plan`); forces are linear between samples.
"""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from regrasp.control.freedoms import free_motions
from regrasp.plan import FIRST_SLIDE, RELOCATE, Plan
from regrasp.scene.world import World
from regrasp.settings import demand

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Phases:
    """What is added to the plan's own time.

    standoff: m, distance along the normal from which the fingers come. approach: s, until they touch. load: s, in which
    the forces of the first instant build up. settle: s, held before the plan begins, and hold: after it has ended.
    """

    standoff: float = 0.008
    approach: float = 0.4
    load: float = 0.25
    settle: float = 0.2
    hold: float = 0.5

    def __post_init__(self) -> None:
        demand(self, from_zero=("standoff", "approach", "load", "settle", "hold"))


NEARER = 4
"""Times at most that the standoff is halved."""


@dataclass(frozen=True)
class Reference:
    """T rows, one per control period; k agents, nq joints (agent after agent).

    period: s. begin: s, the plan's time at its first instant. touch, start, end: rows at which the approach ends, the plan
    begins and the plan ends. interval (T,): the plan's, −1 before it. q, qd (T, nq): rad or m, and their rates.
    p_WO (T, 3), R_WO (T, 3, 3). bears, slides (T, k): who is in contact, who slides in it. force_W (T, k, 3): of the
    agents on the object, N. p_WC, n_W (T, k, 3): where they act, and the object's outward normal there. free (T, 6, 6):
    projection of displacements onto those that supports leave free.
    """

    period: float
    begin: float
    touch: int
    start: int
    end: int
    interval: NDArray[np.int64]
    q: Array
    qd: Array
    p_WO: Array
    R_WO: Array
    bears: NDArray[np.bool_]
    slides: NDArray[np.bool_]
    force_W: Array
    p_WC: Array
    n_W: Array
    free: Array

    def __len__(self) -> int:
        return len(self.q)

    def time(self, row: int) -> float:
        """Time of a row on the plan's clock, s; less than `begin` before the plan begins."""
        return self.begin + (row - self.start) * self.period


def taken_over(plan: Plan, period: float, phases: Phases, force: Array) -> Reference:
    """The table of a plan that begins where the fingers already hold the object, with forces (k, 3) on it.

    In `phases.load` the forces pass over to the plan's; there is neither approach nor settling.
    """
    body = _sampled(plan, period)
    count = len(body.q)
    load, hold = (max(1, round(seconds / period)) for seconds in (phases.load, phases.hold))
    rows = np.concatenate([np.zeros(load, int), np.arange(count), np.full(hold, count - 1)])
    still = (np.arange(len(rows)) < load) | (np.arange(len(rows)) >= load + count)
    table = {name: getattr(body, name)[rows] for name in ("interval", "q", "qd", "p_WO", "R_WO", "free", *CONTACT)}
    table["qd"][still], table["slides"][still], table["interval"][:load] = 0.0, False, -1
    u = (np.arange(load)[:, None, None] + 1) / load
    table["force_W"][:load] = np.where(table["bears"][:load, :, None], (1 - u) * force + u * body.force_W[0], 0.0)
    return Reference(period, body.begin, 0, load, load + count - 1, **table)


CONTACT = ("bears", "slides", "force_W", "p_WC", "n_W")
"""What a row says of each agent's contact."""


def reference(plan: Plan, world: World, period: float, phases: Phases) -> Reference:
    """The table of a plan at the given control period, s."""
    body = _sampled(plan, period)
    count = len(body.q)
    approach, load, settle, hold = (
        max(1, round(seconds / period)) for seconds in (phases.approach, phases.load, phases.settle, phases.hold)
    )
    lead, tail = approach + load + settle, hold
    rows = np.concatenate([np.zeros(lead, int), np.arange(count), np.full(tail, count - 1)])
    q, qd = body.q[rows].copy(), body.qd[rows].copy()
    q[:approach], qd[:approach] = _approach(plan, world, period, phases.standoff, approach)
    qd[approach:lead], qd[lead + count :] = 0.0, 0.0
    force, bears = body.force_W[rows].copy(), body.bears[rows].copy()
    slides = body.slides[rows]
    slides[:lead], slides[lead + count :] = False, False
    force[:approach], bears[:approach] = 0.0, False
    force[approach : approach + load] *= ((np.arange(load) + 1) / load)[:, None, None]
    interval = body.interval[rows].copy()
    interval[:lead] = -1
    return Reference(
        period, body.begin, approach, lead, lead + count - 1, interval, q, qd, body.p_WO[rows], body.R_WO[rows], bears,
        slides, force, body.p_WC[rows], body.n_W[rows], body.free[rows],
    )  # fmt: skip


def delayed(reference: Reference, joints: tuple[slice, ...], delay: float, rng: np.random.Generator) -> Reference:
    """The table with the contact changes of every agent off their time by up to ±delay, s, uniformly, each on its own.

    Between its changes of contact an agent's clock passes linearly from one error to the next; at both ends of the table
    it is right. joints: each agent's columns of q.
    """
    T, k = reference.bears.shape
    rows = np.arange(T)
    out = replace(
        reference,
        **{name: getattr(reference, name).copy() for name in ("q", "qd", *CONTACT)},
    )
    for i in range(k):
        changes = np.flatnonzero(np.diff(reference.bears[:, i])) + 1
        errors = rng.uniform(-delay, delay, len(changes)) / reference.period
        shift = np.interp(rows, np.concatenate([[0], changes, [T - 1]]), np.concatenate([[0.0], errors, [0.0]]))
        source = np.clip(np.round(rows - shift).astype(int), 0, T - 1)
        out.q[:, joints[i]], out.qd[:, joints[i]] = reference.q[source, joints[i]], reference.qd[source, joints[i]]
        for name in CONTACT:
            getattr(out, name)[:, i] = getattr(reference, name)[source, i]
    return out


def _sampled(plan: Plan, period: float) -> Reference:
    """The plan alone, from its first to its last instant."""
    N, M, k, _ = plan.p_OC_O.shape
    begin, end = plan.time[0, 0], plan.time[-1, -1]
    count = max(1, round((end - begin) / period)) + 1
    t = np.linspace(begin, end, count)
    interval = np.clip(np.searchsorted(plan.time[:, 0], t, side="right") - 1, 0, N - 1)
    q, qd = np.empty((count, plan.joints.shape[2])), np.empty((count, plan.joints.shape[2]))
    p_WO, R_WO = np.empty((count, 3)), np.empty((count, 3, 3))
    force, p_WC, n_W = (np.zeros((count, k, 3)) for _ in range(3))
    free, leaves = np.empty((count, 6, 6)), free_motions(plan)
    bears = np.isfinite(plan.p_OC_O[:, 0, :, 0])[interval]
    slides = ((plan.V >= FIRST_SLIDE) & (plan.V < RELOCATE))[interval]
    for j in range(N):
        rows = interval == j
        if not rows.any():
            continue
        knots, at = plan.time[j], t[rows]
        joints = CubicSpline(knots, plan.joints[j])
        q[rows], qd[rows] = joints(at), joints(at, 1)
        p_WO[rows] = CubicSpline(knots, plan.object_position[j])(at)
        turns = Slerp(knots, Rotation.from_quat(plan.object_quaternion[j], scalar_first=True))
        R_WO[rows] = turns(np.clip(at, knots[0], knots[-1])).as_matrix()
        s = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, M - 2)
        u = ((at - knots[s]) / (knots[s + 1] - knots[s]))[:, None, None]
        free[rows] = leaves[j, s]
        force[rows] = (1 - u) * plan.force_W[j, s] + u * plan.force_W[j, s + 1]
        p_OC = np.nan_to_num((1 - u) * plan.p_OC_O[j, s] + u * plan.p_OC_O[j, s + 1])
        p_WC[rows] = p_WO[rows, None] + np.einsum("tab,tkb->tka", R_WO[rows], p_OC)
        n_W[rows] = np.einsum(
            "tab,tkb->tka", R_WO[rows], np.nan_to_num((1 - u) * plan.n_O[j, s] + u * plan.n_O[j, s + 1])
        )
    # The table's period is the controller's; the plan is stretched to a whole number of periods.
    return Reference(
        period, float(begin), 0, 0, count - 1, interval, q, qd, p_WO, R_WO, bears, slides, force, p_WC, n_W, free
    )  # fmt: skip


def _approach(plan: Plan, world: World, period: float, standoff: float, rows: int) -> tuple[Array, Array]:
    """Joints and their rates (rows, nq) from the standoff to the first contact, at rest at both ends.

    The standoff is smaller where a finger would have to reach into something for it.
    """
    goal = plan.joints[0, 0]
    begin = _standing_off(plan, world, standoff)
    for _ in range(NEARER):
        if not _collides(world, begin):
            break
        standoff *= 0.5
        begin = _standing_off(plan, world, standoff)
    u = np.arange(rows)[:, None] / rows
    way = goal - begin
    return begin + (3 * u**2 - 2 * u**3) * way, 6 * u * (1 - u) * way / (rows * period)


def _standing_off(plan: Plan, world: World, standoff: float) -> Array:
    """Joints (nq,) with every tip that first holds the object so far from it, along the normal."""
    goal = plan.joints[0, 0]
    begin = goal.copy()
    R_WO = Rotation.from_quat(plan.object_quaternion[0, 0], scalar_first=True).as_matrix()
    model = world.model
    data = mujoco.MjData(model)
    data.qpos[:] = world.start
    addresses = world.joint_qpos
    first = 0
    for i, agent in enumerate(world.agents):
        mine = slice(first, first + len(agent.qpos))
        first += len(agent.qpos)
        if not np.isfinite(plan.n_O[0, 0, i]).all():
            continue
        data.qpos[addresses] = goal
        step = np.concatenate([standoff * (R_WO @ plan.n_O[0, 0, i]), np.zeros(3)])
        begin[mine] += moved_tip(model, data, world, i, step)
    return begin


def _collides(world: World, joints: Array) -> bool:
    """Whether bodies that must not touch do with the agents at joints (nq,) and the object at its start."""
    model = world.model
    data = mujoco.MjData(model)
    data.qpos[:] = world.start
    data.qpos[world.joint_qpos] = joints
    mujoco.mj_fwdPosition(model, data)
    apart = {(int(a), int(b)) for a, b in world.collision_pairs}
    return any(
        contact.dist < 0.0 and (min(contact.geom1, contact.geom2), max(contact.geom1, contact.geom2)) in apart
        for contact in data.contact
    )


def moved_tip(model: mujoco.MjModel, data: mujoco.MjData, world: World, i: int, step: Array) -> Array:
    """Joint change (n_a,) that moves agent i's tip by step (6,): shift m and small turn rad in W, at data.qpos.

    Damped least squares. An agent of fewer than six joints keeps the shift and gives up of the turn what it must: turns
    count with the tip's radius.
    """
    agent = world.agents[i]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    J = np.empty((6, model.nv))
    mujoco.mj_jac(model, data, J[:3], J[3:], data.geom_xpos[agent.tip_geom], agent.tip_body)
    C = agent.coupling.matrix
    return np.asarray(C @ solve_step(J[:, agent.dofs] @ C, step, model.geom_rbound[agent.tip_geom]))


DAMPING = 1e-4
"""Of the least squares, relative to the largest squared lever."""


def solve_step(J: Array, step: Array, radius: float) -> Array:
    """Change (n,) of one tip's free joints: Jacobian J (6, n), wanted displacement (6,); see `solve_steps`."""
    return solve_steps(
        J[None], step[None], weights(np.array([J.shape[1]]), np.array([radius])), np.zeros(len(J.T), int)
    )


def weights(freedoms: NDArray[np.int64], radius: Array) -> Array:
    """(k, 6, 1): how much each component of a displacement counts for agents with so many free joints and such tips."""
    turn = np.where(freedoms >= 6, 1.0, 0.1) * radius
    return np.concatenate([np.ones((len(turn), 3)), np.repeat(turn[:, None], 3, axis=1)], axis=1)[..., None]


def solve_steps(J: Array, steps: Array, weight: Array, owner: NDArray[np.int64]) -> Array:
    """argmin Σ_k |weight (J_k δq − δx_k)|² + damping over all agents' joints (nq,).

    J (k, 6, nq), zero where a joint is another agent's; steps δx (k, 6); weight (k, 6, 1); owner (nq,): whose each joint is.
    """
    A = (J * weight).reshape(-1, J.shape[2])
    H = A.T @ A
    diagonal = H.diagonal()
    mean = np.bincount(owner, diagonal) / np.bincount(owner)
    H.flat[:: len(H) + 1] += DAMPING * mean[owner]
    return np.asarray(np.linalg.solve(H, A.T @ (steps * weight[..., 0]).ravel()))
