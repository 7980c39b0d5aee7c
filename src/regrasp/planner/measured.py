"""A measured state as the start of a plan: what touches what, and what room the bodies and the forces have there."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.basis import program
from regrasp.kernels.chains import forward
from regrasp.kernels.forces import EDGES
from regrasp.plan import RELOCATE, Plan
from regrasp.planner.assemble import pose_row
from regrasp.planner.balance import balance
from regrasp.planner.collision import hits, object_row, place_agent, tip_hits
from regrasp.planner.configurations import Grasp, bodies_along, normal_at
from regrasp.planner.grasp import build_grasp
from regrasp.planner.hand import Hand
from regrasp.planner.motions import STAY
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Path, Pose, nominal_path
from regrasp.planner.scan import touch_down
from regrasp.planner.supports import gap, moved_onto
from regrasp.planner.task import Task
from regrasp.planner.terms import Energy
from regrasp.planner.tips import tip_gap
from regrasp.scene.load import validate
from regrasp.scene.schema import Scene

Array = NDArray[np.float64]

SHARES = (1.0, 0.7, 0.4, 0.2, 0.0)
"""Parts of a margin that are tried where a measured state does not have all of it."""


def settled(task: Task, plan: Plan, j: int, X_WO: Pose, touch: float) -> Pose:
    """The pose put exactly onto the supports that carry the object in interval j, where it is measured near them."""
    carry = {plan.support_names[p] for p in np.flatnonzero(plan.support_mode[j])}
    for support in task.supports:
        if support.name in carry and abs(gap(task.hand, support, *X_WO)) <= touch:
            X_WO = X_WO[0], moved_onto(task.hand, support, *X_WO)
    return X_WO


def measured_grasp(
    task: Task, X_WO: Pose, q: Array, bears: NDArray[np.bool_], touch: float, clearance: float
) -> Grasp | Failure:
    """The grasp of joints q (nq,) with the object at X_WO.

    An agent touches whose tip is within `touch` of the object's surface; one that the plan has in the air (bears (k,)) only
    within the clearance, so that it is not pulled into contact on its way. The contact is the point of the surface nearest to
    the tip; the agent's joints are corrected until it is exact. All other agents are where they are.
    """
    hand = task.hand
    q = task.world.coupling.expand(q)
    contacts: dict[int, tuple[Array, Array, Array]] = {}
    arm_q = np.tile(q[len(hand.home) :], (2, 1))
    R, p = (np.array([part, part]) for part in X_WO)
    path = nominal_path(R, p, 1, 1, np.zeros(3), hand, (), arm_q)
    for i, name in enumerate(task.names):
        R_PO, p_PO = path.R_PO[hand.base[i], 0, 0], path.p_PO[hand.base[i], 0, 0]
        mine = q[hand.chains.start[i] : hand.chains.start[i + 1]].copy()
        R_WL, p_WL = np.empty((len(mine) + 1, 3, 3)), np.empty((len(mine) + 1, 3))
        foot, n = np.empty(3), np.empty(3)
        forward(hand.chains, i, mine, R_WL, p_WL)
        centre = R_PO.T @ (p_WL[-1] - p_PO)
        high = tip_gap(hand, i, R_PO.T @ R_WL[-1], centre, foot, n)
        if high < -touch:
            return Failure(
                "collision", "start", name, f"its tip is {-1e3 * high:.1f} mm inside the object", "a better measurement"
            )
        if high > (touch if bears[i] else min(touch, clearance)):
            continue
        direction = R_PO.T @ R_WL[-1] @ hand.axis_T[i]
        if not touch_down(hand, i, R_PO, p_PO, foot, n, 0.0, direction, mine, R_WL, p_WL):
            return Failure("reach", "start", name, "cannot hold its contact within its joints' range", "bring it back")
        contacts[i] = (mine, foot, n)
    grasp = build_grasp(hand, path, contacts)
    off = np.repeat(grasp.holds == 0, np.diff(hand.chains.start))
    return replace(grasp, q=np.where(off, q[: len(off)], grasp.q))


def in_contact(plan: Plan, j: int) -> NDArray[np.bool_]:
    """Who is in contact in interval j of a plan, (k,)."""
    return np.asarray(plan.V[j] < RELOCATE)


def roomy(hand: Hand, path: Path, grasp: Grasp, energy: Energy) -> Energy | Failure:
    """The margins of the planner, reduced to what the grasp at the path's start has of them.

    Clearance between bodies; friction, grip and disturbance together, in the parts SHARES.
    """
    clearance = next((s * energy.clearance for s in SHARES if not tight(hand, path, grasp, s * energy.clearance)), None)
    if clearance is None:
        return Failure("collision", "start", "", "bodies that may not touch do", "take them apart")
    for share in SHARES:
        left = replace(
            energy, clearance=clearance, friction_margin=share * energy.friction_margin, grip=share * energy.grip,
            disturbance=share * energy.disturbance,
        )  # fmt: skip
        if held(hand, path, grasp, left):
            return left
    return Failure("equilibrium", "start", "object", "no contact forces hold the object as measured", "grasp it again")


def tight(hand: Hand, path: Path, grasp: Grasp, clearance: float) -> bool:
    """Whether any bodies come closer than the clearance in the grasp at the path's start."""
    k, geoms = len(hand.tip_geom), int(np.max(np.diff(hand.geom_start)))
    R_WB, p_WB = bodies_along(hand, path)
    R_B, p_B, row = R_WB[0], p_WB[0], object_row(hand)
    R_G, p_G = np.empty((k, geoms, 3, 3)), np.empty((k, geoms, 3))
    for i in range(k):
        q = grasp.q[hand.chains.start[i] : hand.chains.start[i + 1]]
        R_WL, p_WL = np.empty((len(q) + 1, 3, 3)), np.empty((len(q) + 1, 3))
        forward(hand.chains, i, q, R_WL, p_WL)
        place_agent(hand, i, path.R_WP[hand.base[i], 0, 0], path.p_WP[hand.base[i], 0, 0], R_WL, p_WL, R_G[i], p_G[i])
        if (
            hits(hand, i, k, R_G[i], p_G[i], R_B, p_B, clearance)
            or hits(hand, i, k + 1, R_G[i], p_G[i], R_B[row:], p_B[row:], clearance)
            or (not grasp.holds[i] and tip_hits(hand, i, R_G[i], p_G[i], R_B[row:], p_B[row:], clearance))
            or any(hits(hand, a, i, R_G[a], p_G[a], R_G[i], p_G[i], clearance) for a in range(i))
        ):
            return True
    return False


def held(hand: Hand, path: Path, grasp: Grasp, energy: Energy) -> bool:
    """Whether forces hold the object in the grasp at the path's start, all contacts at rest, with the margins left unused."""
    k = len(hand.tip_geom)
    lp = program(EDGES * (k + path.support_mode.shape[1]), k)
    p, n = grasp.p_OC.copy(), np.zeros((k, 3))
    for i in np.flatnonzero(grasp.holds):
        normal_at(hand, p[i], n[i])
    found, _, _ = balance(
        hand, path, 0, 0, grasp.holds, np.full(k, STAY, np.int16), p, n, np.zeros((k, 3)), energy.margins, False, lp
    )
    return bool(found)


def started(plan: Plan, X_WO: Pose, goal: Pose) -> Scene:
    """The plan's scene from another start, whatever the grasp, to another goal.

    Raises InputError where its freedoms forbid it.
    """

    def placed(pose: Pose) -> dict[str, list[float]]:
        row = pose_row(pose)
        return {"position": row[:3].tolist(), "quaternion": row[3:].tolist()}

    goals = {**plan.scene["goal"], "pose": placed(goal)}
    return validate({**plan.scene, "start": {"pose": placed(X_WO)}, "goal": goals})
