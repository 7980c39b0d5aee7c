"""Maintaining contact (paper §2): an agent keeps touching the moving object while its contact rolls, slides or stays."""

from typing import cast

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.chains import couple, forward, jacobian
from regrasp.kernels.contact import OK, advance, settle
from regrasp.kernels.inverse import inverse, inverse_point
from regrasp.kernels.native import kernel
from regrasp.kernels.rates import rates
from regrasp.kernels.rotations import minus, multiply, multiply_back, norm, rotate, rotate_back
from regrasp.kernels.stack import stack
from regrasp.kernels.surfaces import SPHERE, project
from regrasp.kernels.wrist import NONE, solve_near
from regrasp.planner.hand import Hand
from regrasp.planner.motions import whole
from regrasp.planner.path import Path
from regrasp.planner.tips import fits, plain, under

Array = NDArray[np.float64]

REACHED = 1e-7  # m and rad: an inverse-kinematics residual below this is round-off
SUBSTEPS = cast(
    int, np.int64(1)
)  # of the contact equations in one interval for a ball on a smooth object: good to 1 µm on a way of some millimetres
SPURT = 0.08  # rad: a joint of a short chain that moves further in one sample is at a singularity
SETTLE = 3e-4  # rad: by so much at most the joints of a short chain are corrected in one sample
AGREEING = 12  # places and attitudes of a short chain's tip that is no ball, until they agree
AGILE = 4.0  # rad per rad
JUMP = 0.27  # rad: a joint that moves further in one interval is at a singularity or changes its branch


@kernel
def tip_target(R_WO: Array, p_WO: Array, p_OC: Array, p_TC: Array, R_OT: Array, R_WT: Array, p_WT: Array) -> None:
    """Pose of the tip that puts its point p_TC onto the object's point p_OC: X_WT = X_WO (R_OT, p_OC − R_OT p_TC)."""
    multiply(R_WO, R_OT, R_WT)
    for a in range(3):
        p_WT[a] = p_WO[a]
        for b in range(3):
            p_WT[a] += R_WO[a, b] * p_OC[b] - R_WT[a, b] * p_TC[b]


@kernel
def is_full(hand: Hand, i: int) -> bool:
    """Whether agent i has the six free joints that realise any relative velocity."""
    return hand.chains.free[i] >= 6


@kernel
def wanders(hand: Hand, i: int) -> bool:
    """Whether agent i's contacts may move though nothing asks them to: its tip turns as its few joints make it."""
    return not is_full(hand, i)


@kernel
def leap(q: Array, before: Array) -> float:
    """How far the joint that goes furthest goes."""
    far = 0.0
    for a in range(len(q)):
        far = max(far, abs(q[a] - before[a]))
    return far


@kernel
def is_agile(hand: Hand, i: int, R_WL: Array, p_WL: Array) -> bool:
    """Whether a six-joint agent is far enough from its singularities to follow the object.

    Turning the tip by 1 rad about any axis, or moving it by the object's radius along any, may take no joint more than
    AGILE rad. Fewer joints have directions they never move in; for them this always holds.
    """
    if not is_full(hand, i):
        return True
    n_a = hand.chains.start[i + 1] - hand.chains.start[i]
    if n_a == 6:
        J6 = stack((6, 6))
        jacobian(hand.chains, i, R_WL, p_WL, p_WL[n_a], J6)
        for a in range(3):
            for b in range(6):
                J6[a, b] /= hand.radius
        return turns_little(J6)
    J, qd = stack((6, n_a)), stack(n_a)
    jacobian(hand.chains, i, R_WL, p_WL, p_WL[n_a], J)
    v, w, got, still = stack(3), stack(3), stack(3), stack(n_a)
    v[:] = 0.0
    w[:] = 0.0
    still[:] = 0.0
    for a in range(3):
        v[a] = hand.radius
        if rates(J, v, w, qd, got) > 1e-6 or leap(qd, still) > AGILE:
            return False
        v[a] = 0.0
        w[a] = 1.0
        rates(J, v, w, qd, got)
        if abs(got[a] - 1.0) > 1e-6 or leap(qd, still) > AGILE:
            return False
        w[a] = 0.0
    return True


@kernel
def turns_little(J: Array) -> bool:
    """Whether no entry of J⁻¹ (6, 6) is larger than AGILE; J is inverted in place, but for the order of its columns."""
    for a in range(6):
        row = a
        for b in range(a + 1, 6):
            if abs(J[b, a]) > abs(J[row, a]):
                row = b
        if abs(J[row, a]) < 1e-9:
            return False
        for c in range(6):
            J[a, c], J[row, c] = J[row, c], J[a, c]
        s = 1.0 / J[a, a]
        J[a, a] = 1.0
        for c in range(6):
            J[a, c] *= s
        for b in range(6):
            if b != a:
                t = J[b, a]
                J[b, a] = 0.0
                for c in range(6):
                    J[b, c] -= t * J[a, c]
    for a in range(6):
        for c in range(6):
            if abs(J[a, c]) > AGILE:
                return False
    return True


@kernel
def reach_pose(hand: Hand, i: int, R_WT: Array, p_WT: Array, q: Array, R_WL: Array, p_WL: Array) -> float:
    """Joint angles q (in: seed, near which they stay) of a six-joint agent whose tip is at X_WT; returns what is left of it.

    In closed form where the arm has one; q is as it was where that has no solution within the limits, and inf is returned.
    R_WL, p_WL, of one chain: scratch.
    """
    if hand.wrists.kind[i] != NONE:
        return 0.0 if solve_near(hand.chains, hand.wrists, i, R_WT, p_WT, q) else np.inf
    residual, _ = inverse(hand.chains, i, R_WT, p_WT, q, R_WL, p_WL)
    return residual


@kernel
def reach_tip(
    hand: Hand, path: Path, j: int, s: int, i: int, before: Array,
    p_OC: Array, p_TC: Array, R_OT: Array, q: Array, R_WL: Array, p_WL: Array,
) -> bool:  # fmt: skip
    """Joint angles q (in: seed) of a six-joint agent that hold the contact at sample s of interval j.

    Returns whether they are reached without a jump from the joints `before`.
    """
    R_WT, p_WT, b = stack((3, 3)), stack(3), hand.base[i]
    tip_target(path.R_PO[b, j, s], path.p_PO[b, j, s], p_OC, p_TC, R_OT, R_WT, p_WT)
    if reach_pose(hand, i, R_WT, p_WT, q, R_WL, p_WL) > REACHED:
        return False
    return leap(q, before) < JUMP


@kernel
def roll(
    hand: Hand, i: int, command: Array, steps: int, p_OC: Array, p_TC: Array, R_OT: Array, x_O: Array
) -> bool:  # fmt: skip
    """Move agent i's contact by a command (ω_x, ω_y, v_x, v_y) in so many steps; whether it can, and stays the only one."""
    status = advance(
        hand.kind_O, hand.size_O, hand.kind_T[i], hand.size_T[i], hand.grids, command, steps, p_OC, p_TC, R_OT, x_O
    )
    return status == OK and fits(hand, i, p_OC, p_TC, R_OT)


@kernel
def short_step(
    hand: Hand, R_A: Array, p_A: Array, R_Z: Array, p_Z: Array, i: int, command: Array, steps: float,
    p_OC: Array, p_TC: Array, R_OT: Array, x_O: Array, q: Array, R_WL: Array, p_WL: Array,
) -> bool:  # fmt: skip
    """One step of an agent of fewer than six joints, as the object goes from the pose A to Z.

    The relative linear velocity is a hard constraint; the commanded relative angular velocity is met in the least-squares
    sense, and the contact evolves by the relative angular velocity actually achieved. Midpoint rule in the joints, then
    the tip's position is settled exactly; where that turns a tip that is no ball, its contact rolls on as it turns.
    command: ω_x, ω_y, v_x, v_y over this step, in C. steps: samples that it goes.
    """
    n_a = hand.chains.start[i + 1] - hand.chains.start[i]
    J = stack((6, n_a))
    n, x, y, foot = stack(3), stack(3), stack(3), stack(3)
    v, w, r, w_O, dq, got = stack(3), stack(3), stack(3), stack(3), stack(n_a), stack(3)
    turn, shift, p_TM, R_OM = stack(3), stack(3), stack(3), stack((3, 3))
    step, R_WO, p_W = stack(4), stack((3, 3)), stack(3)
    object_step(R_A, p_A, R_Z, p_Z, turn, shift)
    middle = stack(n_a)
    middle[:] = q
    defect = 0.0
    foot[:], x[:], p_TM[:], R_OM[:] = p_OC, x_O, p_TC, R_OT
    for stage in range(2):
        # Object and tip velocity at the contact; stage 0 at the start of the step, stage 1 at its middle.
        forward(hand.chains, i, middle, R_WL, p_WL)
        project(hand.kind_O, hand.size_O, hand.grids, foot, foot, n)
        u = 0.5 * stage
        for a in range(3):
            y[a] = n[(a + 1) % 3] * x[(a + 2) % 3] - n[(a + 2) % 3] * x[(a + 1) % 3]
            for b in range(3):
                R_WO[a, b] = (1.0 - u) * R_A[a, b] + u * R_Z[a, b]
            p_W[a] = p_A[a] + u * shift[a]
        rotate(R_WO, foot, r)
        for a in range(3):
            w_O[a] = command[0] * x[a] + command[1] * y[a]
            v[a] = command[2] * x[a] + command[3] * y[a]
        rotate(R_WO, v, v)
        rotate(R_WO, w_O, w)
        for a in range(3):
            v[a] += shift[a] + turn[(a + 1) % 3] * r[(a + 2) % 3] - turn[(a + 2) % 3] * r[(a + 1) % 3]
            w[a] += turn[a]
            p_W[a] += r[a]
        jacobian(hand.chains, i, R_WL, p_WL, p_W, J)
        defect = rates(J, v, w, dq, got)
        for a in range(3):
            got[a] -= turn[a]
        rotate_back(R_WO, got, w_O)
        part = 1.0 - 0.5 * (1 - stage)
        step[0] = part * (w_O[0] * x[0] + w_O[1] * x[1] + w_O[2] * x[2])
        step[1] = part * (w_O[0] * y[0] + w_O[1] * y[1] + w_O[2] * y[2])
        step[2], step[3] = part * command[2], part * command[3]
        if stage == 0:
            # Where the tip spins and the surface bends, ω has other parts in the tangents half-way.
            advance(
                hand.kind_O,
                hand.size_O,
                hand.kind_T[i],
                hand.size_T[i],
                hand.grids,
                step,
                whole(1),
                foot,
                p_TM,
                R_OM,
                x,
            )
            for a in range(n_a):
                middle[a] = q[a] + 0.5 * dq[a]
            couple(hand.chains, i, middle)
    kept = roll(hand, i, step, whole(1), p_OC, p_TC, R_OT, x_O)
    quickest, beyond, first = 0.0, 0.0, hand.chains.start[i]
    for a in range(n_a):
        middle[a] = q[a] = q[a] + dq[a]
        quickest = max(quickest, abs(dq[a]))
        beyond = max(beyond, q[a] - hand.chains.upper[first + a], hand.chains.lower[first + a] - q[a])
    couple(hand.chains, i, middle)
    couple(hand.chains, i, q)
    R_WT, p_WT = stack((3, 3)), stack(3)
    tip_target(R_Z, p_Z, p_OC, p_TC, R_OT, R_WT, p_WT)
    # The position alone, in the shortest way: the turn is what the rates made of it.
    for a in range(3):
        w[a] = 0.0
    residual, _ = inverse_point(hand.chains, i, p_WT, w, w, q, R_WL, p_WL)
    # The tip's orientation is what the joints give, and the touching point follows from it.
    multiply_back(R_Z, R_WL[n_a], R_OT)
    if hand.kind_T[i] == SPHERE:
        project(hand.kind_O, hand.size_O, hand.grids, p_OC, foot, n)
        under(hand, i, R_OT, n, p_TC)
    else:
        agree = False
        for _ in range(AGREEING):
            status, _ = settle(hand.kind_O, hand.size_O, hand.kind_T[i], hand.size_T[i], hand.grids, p_OC, p_TC, R_OT)
            tip_target(R_Z, p_Z, p_OC, p_TC, R_OT, R_WT, p_WT)
            agree = status == OK and norm(minus(p_WT, p_WL[n_a])) < REACHED
            if status != OK or agree:
                break
            residual, _ = inverse_point(hand.chains, i, p_WT, w, w, q, R_WL, p_WL)
            multiply_back(R_Z, R_WL[n_a], R_OT)
        kept = kept and agree
        # Settling moved the contact a little; its frame goes along.
        project(hand.kind_O, hand.size_O, hand.grids, p_OC, foot, n)
        along, length = n[0] * x_O[0] + n[1] * x_O[1] + n[2] * x_O[2], 0.0
        for a in range(3):
            x_O[a] -= along * n[a]
            length += x_O[a] ** 2
        for a in range(3):
            x_O[a] /= np.sqrt(length)
    settled = 0.0
    for a in range(n_a):
        settled = max(settled, abs(q[a] - middle[a]))
    # Near a singularity or a joint limit the rates can't be met, and settling would slip or turn the tip instead.
    met = defect < REACHED * steps and quickest < SPURT * steps and settled < SETTLE * steps * steps
    return kept and met and residual < REACHED and beyond < SETTLE


@kernel
def object_step(R_A: Array, p_A: Array, R_Z: Array, p_Z: Array, turn: Array, shift: Array) -> None:
    """Rotation vector (W) and displacement of the object from the pose A to Z."""
    # For the small steps between samples the skew part of Z Aᵀ is sin θ along the axis.
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        skew = 0.0
        for x in range(3):
            skew += R_Z[c, x] * R_A[b, x] - R_Z[b, x] * R_A[c, x]
        turn[a] = 0.5 * skew
        shift[a] = p_Z[a] - p_A[a]
    sine = np.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    if sine > 1e-12:
        scale = np.arcsin(min(1.0, sine)) / sine
        for a in range(3):
            turn[a] *= scale


@kernel
def follow(
    hand: Hand, path: Path, command: Array, j: int, i: int, before: Array,
    p_OC: Array, p_TC: Array, R_OT: Array, x_O: Array, q: Array, R_WL: Array, p_WL: Array,
) -> bool:  # fmt: skip
    """Take agent i in contact through interval j with one contact motion; all arrays after `before` in and out.

    command (4,): ω_x, ω_y, v_x, v_y over the interval in C, whose x axis is x_O (`tangents`) at the start; before: the joints
    there, as q is. Returns whether the workspace condition holds: the end is reached within the joint limits and without a
    jump. The contact moves on even where the joints can't follow.
    """
    m = path.R_WO.shape[1] - 1
    if is_full(hand, i):
        kept = roll(hand, i, command, SUBSTEPS if plain(hand, i) else m, p_OC, p_TC, R_OT, x_O)
        return reach_tip(hand, path, j, m, i, before, p_OC, p_TC, R_OT, q, R_WL, p_WL) and kept
    fine, b, step = True, hand.base[i], stack(4)
    for a in range(4):
        step[a] = command[a] / m
    for s in range(m):
        if not short_step(
            hand, path.R_PO[b, j, s], path.p_PO[b, j, s], path.R_PO[b, j, s + 1], path.p_PO[b, j, s + 1], i, step, 1.0,
            p_OC, p_TC, R_OT, x_O, q, R_WL, p_WL,
        ):  # fmt: skip
            fine = False
    return fine
