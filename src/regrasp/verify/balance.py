"""Forces: friction cones, Coulomb's law at sliding contacts, limits, and equilibrium at and between samples."""

import math
from dataclasses import dataclass

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from regrasp.plan import FIRST_SLIDE, NONE, SLIDE, Plan
from regrasp.scene.world import World
from regrasp.verify.contacts import Contacts, touching
from regrasp.verify.findings import Finding, worst
from regrasp.verify.motion import Motion, fine, unit
from regrasp.verify.slip import direction, relative_steps, support_steps, tangential

Array = NDArray[np.float64]

RESIDUAL = 1e-6
"""Wrench residual, cone and limit violations, in object weights (torque: weight times radius)."""
ALONG = 0.02
"""Angle between a sliding contact's tangential force and the measured slip it must follow or oppose, rad."""
CORRECTION = 0.1
"""Largest correction of a linearly interpolated contact force to balance exactly between samples, in object weights."""
LIMITLESS = 1e6
"""Normal force of a support in object weights: it has no limit of its own."""
PENALTY = 1e3
"""Cost of a residual against a correction of the same size: large enough that a residual stays only where it must."""


@dataclass(frozen=True)
class Grasp:
    """What pushes on the object at a set of instants (N, I): C = k + P contacts, agents first, then supports."""

    p_W: Array
    """(N, I, C, 3) contact points relative to the object's centre of mass."""
    inward: Array
    """(N, I, C, 3) unit normal into the object: the direction of a force without friction."""
    slip: Array
    """(N, I, C, 3) unit direction of the friction force where the contact slides."""
    force: Array
    """(N, I, C, 3), N."""


@dataclass(frozen=True)
class Load:
    """The object's weight and size, and the contacts' friction and limits."""

    gravity: Array
    """(3,) weight as a force in W, N."""
    weight: float
    """Scale of forces, N."""
    radius: float
    """Scale of lever arms, m: radius of a sphere about O that holds the object."""
    centre_O: Array
    """Centre of mass in O."""
    friction: Array
    """(C,) μ."""
    limit: Array
    """(C,) largest normal force, N."""


def load(plan: Plan, world: World) -> Load:
    """What the object weighs and what each contact may bear."""
    model, body = world.model, world.object_body
    mass = float(model.body_mass[body])
    gravity = mass * np.array(model.opt.gravity)
    # without gravity the unit of force is what the object would weigh on Earth
    weight = float(np.linalg.norm(gravity)) or 9.81 * mass
    radius = max(float(np.linalg.norm(model.geom_pos[g]) + model.geom_rbound[g]) for g in world.object_geoms)
    of_support = dict(zip(world.support_names, world.support_friction, strict=True))
    friction = [agent.friction for agent in world.agents] + [of_support[name] for name in plan.support_names]
    limit = [agent.max_force for agent in world.agents] + [LIMITLESS * weight] * len(plan.support_names)
    return Load(gravity, weight, radius, np.array(model.body_ipos[body]), np.array(friction), np.array(limit))


def force_findings(plan: Plan, world: World, motion: Motion, contacts: Contacts) -> list[Finding]:
    """Every finding about forces, at the plan's samples and between them."""
    what = load(plan, world)
    k = len(world.agents)
    bears = np.concatenate([touching(plan), plan.support_mode != NONE], axis=1)
    slides = np.concatenate([touching(plan) & (plan.V >= FIRST_SLIDE), plan.support_mode == SLIDE], axis=1)
    between = _grasp(plan, motion, contacts, what.centre_O, bears)
    at = _stated(plan, motion, between, what.centre_O, bears)
    who = (*plan.agent_names, *plan.support_names)
    eps, time = RESIDUAL * what.weight, plan.time
    normal = np.sum(at.force * at.inward, axis=-1)
    sideways = tangential(at.force, at.inward)
    size = np.linalg.norm(sideways, axis=-1)
    excess = size - what.friction * normal
    lag = np.linalg.norm(unit(sideways) - at.slip, axis=-1)
    sticks, slips, free = (bears & ~slides)[:, None], slides[:, None], ~bears[:, None]
    findings = [
        worst("normal force", "normal force of a contact", normal, what.limit + eps, "N",
              "jsx", time, who, bears[:, None] & (np.arange(len(who)) < k)),
        worst("pull", "force of a contact away from the object", -normal, eps, "N", "jsx", time, who, bears[:, None]),
        worst("friction cone", "tangential force beyond μ times the normal force", excess, eps, "N",
              "jsx", time, who, sticks),
        worst("sliding force", "tangential force of a sliding contact less μ times its normal force",
              np.abs(excess), eps, "N", "jsx", time, who, slips),
        worst("sliding direction", "tangential force of a sliding contact against the measured slip", lag, ALONG, "rad",
              "jsx", time, who, slips & (normal > eps)),
        worst("free of force", "force of an agent or support that is not in contact", np.linalg.norm(at.force, axis=-1),
              1e-6 * eps, "N", "jsx", time, who, free),
        worst("balance", "wrench residual at the plan's samples, of the weight", _residual(at, what), RESIDUAL, "",
              "js", time),
    ]  # fmt: skip
    residual, correction = _balance_between(motion, between, what, bears, slides)
    inner = np.arange(motion.time.shape[1]) % motion.K != 0
    return [
        *findings,
        worst("balance between samples", "least wrench residual between samples, of the weight", residual, RESIDUAL, "",
              "js", motion.time, where=inner),
        worst("force correction", "correction of interpolated forces to balance between samples, of the weight",
              correction, CORRECTION, "", "js", motion.time, where=inner),
    ]  # fmt: skip


def _rotate(R: Array, vectors: Array) -> Array:
    return np.asarray((R[:, :, None] @ vectors[..., None])[..., 0])


def _grasp(plan: Plan, motion: Motion, contacts: Contacts, centre_O: Array, bears: NDArray[np.bool_]) -> Grasp:
    """The contacts at every instant: measured ones of the agents, stated ones of the supports, forces interpolated."""
    R, K = motion.R_WO, motion.K
    points = np.concatenate([contacts.p_O, fine(plan.support_p_O, K)], axis=2) - centre_O
    inward = np.concatenate([_rotate(R, -contacts.n_O), unit(fine(plan.support_n_W, K))], axis=2)
    with_tip = _rotate(R, direction(relative_steps(plan, motion, contacts).slip))
    slip = np.concatenate([with_tip, -direction(support_steps(plan, motion))], axis=2)
    force = np.concatenate([fine(plan.force_W, K), fine(plan.support_force_W, K)], axis=2)
    absent = ~bears[:, None, :, None]
    p_W, inward, slip = (np.where(absent, 0.0, part) for part in (_rotate(R, points), inward, slip))
    return Grasp(p_W, inward, slip, force)


def _stated(plan: Plan, motion: Motion, grasp: Grasp, centre_O: Array, bears: NDArray[np.bool_]) -> Grasp:
    """The contacts as the plan states them, at its samples; the direction of slip is the measured one."""
    R = motion.R_WO[:, :: motion.K]
    points = np.concatenate([plan.p_OC_O, plan.support_p_O], axis=2) - centre_O
    inward = np.concatenate([_rotate(R, -plan.n_O), plan.support_n_W], axis=2)
    absent = ~bears[:, None, :, None]
    force = np.concatenate([plan.force_W, plan.support_force_W], axis=2)
    p_W, inward = (np.where(absent, 0.0, part) for part in (_rotate(R, points), inward))
    return Grasp(p_W, inward, grasp.slip[:, :: motion.K], force)


def _residual(grasp: Grasp, what: Load) -> Array:
    """(N, I): length of the wrench residual: force in weights, torque about the centre of mass in weights × radius."""
    force = (grasp.force.sum(axis=2) + what.gravity) / what.weight
    torque = np.cross(grasp.p_W, grasp.force).sum(axis=2) / (what.weight * what.radius)
    return np.asarray(np.hypot(np.linalg.norm(force, axis=-1), np.linalg.norm(torque, axis=-1)))


def _balance_between(
    motion: Motion, grasp: Grasp, what: Load, bears: NDArray[np.bool_], slides: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Least residual and largest correction (N, S) at the instants between samples."""
    N, S = motion.time.shape
    residual, correction = np.zeros((N, S)), np.zeros((N, S))
    inner = np.flatnonzero(np.arange(S) % motion.K != 0)
    for j in range(N):
        residual[j, inner], correction[j, inner] = _correct(grasp, j, inner, what, bears[j], slides[j])
    return residual, correction


def _correct(
    grasp: Grasp, j: int, instants: NDArray[np.int_], what: Load, bears: NDArray[np.bool_], slides: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Residual and correction at the instants of interval j, from one second-order cone program with a block each.

    Variables of a block, in weights: three force components per sticking contact, the normal force λ of each sliding
    one (f = λ (inward + μ slip)), the largest correction t, the residual u. Minimise t + PENALTY u subject to
    |wrench| ≤ u, |f − f̄| ≤ t, |f_t| ≤ μ f_n, 0 ≤ f_n ≤ limit.
    """
    contacts = np.flatnonzero(bears)
    B, columns, row, cones = len(instants), 0, 0, []
    width = int(np.sum(np.where(slides[contacts], 1, 3))) + 2
    height = 7 + sum(6 if slides[c] else 9 for c in contacts) + 1
    A, b = np.zeros((B, height, width)), np.zeros((B, height))
    t, u = width - 2, width - 1
    A[:, 0, u] = -1.0
    b[:, 1:4] = what.gravity / what.weight
    cones.append(clarabel.SecondOrderConeT(7))
    row = 7
    for c in contacts:
        p, inward = grasp.p_W[j, instants, c] / what.radius, grasp.inward[j, instants, c]
        ray = inward + what.friction[c] * grasp.slip[j, instants, c]
        basis = ray[:, None] if slides[c] else np.broadcast_to(np.eye(3), (B, 3, 3))
        n = basis.shape[1]
        at = slice(columns, columns + n)
        A[:, 1:4, at] = -np.swapaxes(basis, 1, 2)
        A[:, 4:7, at] = -np.swapaxes(np.cross(p[:, None], basis), 1, 2)
        A[:, row, t] = -1.0
        A[:, row + 1 : row + 4, at] = -np.swapaxes(basis, 1, 2)
        b[:, row + 1 : row + 4] = -grasp.force[j, instants, c] / what.weight
        cones.append(clarabel.SecondOrderConeT(4))
        row += 4
        normal = np.ones((B, 1)) if slides[c] else inward
        if not slides[c]:
            A[:, row, at] = -what.friction[c] * inward
            A[:, row + 1 : row + 3, at] = -_tangents(inward)
            cones.append(clarabel.SecondOrderConeT(3))
            row += 3
        A[:, row, at], A[:, row + 1, at] = normal, -normal
        b[:, row] = what.limit[c] / what.weight
        cones.append(clarabel.NonnegativeConeT(2))
        row += 2
        columns += n
    A[:, row, t] = -1.0
    cones.append(clarabel.NonnegativeConeT(1))
    matrix = sparse.bsr_matrix((A, np.arange(B), np.arange(B + 1)), shape=(B * height, B * width)).tocsc()
    matrix.eliminate_zeros()
    cost = np.zeros((B, width))
    cost[:, t], cost[:, u] = 1.0, PENALTY
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    zero = sparse.csc_matrix((B * width, B * width))
    solution = clarabel.DefaultSolver(zero, cost.ravel(), matrix, b.ravel(), cones * B, settings).solve()
    if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        return np.full(B, math.inf), np.full(B, math.inf)
    x = np.array(solution.x).reshape(B, width)
    return x[:, u], x[:, t]


def _tangents(n: Array) -> Array:
    """(B, 2, 3): two orthonormal vectors in the plane of each unit normal."""
    a = np.eye(3)[np.argmin(np.abs(n), axis=1)]
    x = unit(np.cross(n, a))
    return np.stack([x, np.cross(n, x)], axis=1)
