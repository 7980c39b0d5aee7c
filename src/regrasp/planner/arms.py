"""Arms that carry hands: where their palms and bodies are, and how they go with the object.

The fingers of a hand on an arm share the arm's joints. These are planned before anything else on an arc: the palm follows the
object as far as the arm can, and the fingers are planned in the palm's frame.
"""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.chains import forward
from regrasp.kernels.inverse import inverse
from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import multiply, rotate
from regrasp.kernels.stack import stack
from regrasp.kernels.wrist import NONE, solve_near
from regrasp.planner.collision import closer, place
from regrasp.planner.hand import Hand
from regrasp.planner.turns import from_rotvec, rotvec

Array = NDArray[np.float64]

SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)
"""Parts of the object's turn that a palm takes part in, tried in this order; it takes part in its whole way."""
REACHED = 1e-7  # m and rad, of the palm's pose
SPURT = 0.03  # rad or m that a joint goes from one sample to the next at most: more is a singularity
STILL = 1e-9  # rad and m: less is no motion


@kernel
def place_arms(hand: Hand, arm_q: Array, R_WP: Array, p_WP: Array, R_WG: Array, p_WG: Array) -> None:
    """Palms, in rows 1 … of R_WP (B, count, …), and bodies R_WG (count, G, …) of the arms at joints arm_q (count, nq_a)."""
    arms = hand.arms
    most = 0
    for c in range(len(arms.free)):
        most = max(most, arms.start[c + 1] - arms.start[c])
    R_WL, p_WL = stack((most + 1, 3, 3)), stack((most + 1, 3))
    for s in range(len(arm_q)):
        for c in range(len(arms.free)):
            n = arms.start[c + 1] - arms.start[c]
            forward(arms, c, arm_q[s, arms.start[c] : arms.start[c + 1]], R_WL, p_WL)
            R_WP[c + 1, s], p_WP[c + 1, s] = R_WL[n], p_WL[n]
            first, last = hand.arm_start[c], hand.arm_start[c + 1]
            place(
                hand, hand.arm_geom + first, hand.arm_geom + last, R_WL, p_WL, R_WG[s, first:last], p_WG[s, first:last]
            )


def poses_of(hand: Hand, arm_q: Array) -> tuple[Array, Array, Array, Array]:
    """R_WP (B, count, …), p_WP: all bases, the world first; R_WG (count, G, …), p_WG: the arms' bodies; at joints arm_q."""
    bases, count, bodies = len(hand.arms.free) + 1, len(arm_q), int(hand.arm_start[-1])
    R_WP, p_WP = np.tile(np.eye(3), (bases, count, 1, 1)), np.zeros((bases, count, 3))
    R_WG, p_WG = np.empty((count, bodies, 3, 3)), np.empty((count, bodies, 3))
    if bases > 1:
        place_arms(hand, np.ascontiguousarray(arm_q), R_WP, p_WP, R_WG, p_WG)
    return R_WP, p_WP, R_WG, p_WG


@kernel
def follow_palm(hand: Hand, c: int, R_WP: Array, p_WP: Array, q: Array) -> bool:
    """Joints q (count, n) of arm c that bring its palm to the poses (count, …), from row 0 on; whether all are reached."""
    n = q.shape[1]
    R_WL, p_WL = stack((n + 1, 3, 3)), stack((n + 1, 3))
    for s in range(1, len(q)):
        q[s] = q[s - 1]
        if hand.palms.kind[c] != NONE:
            if not solve_near(hand.arms, hand.palms, c, R_WP[s], p_WP[s], q[s]):
                return False
        else:
            residual, _ = inverse(hand.arms, c, R_WP[s], p_WP[s], q[s], R_WL, p_WL)
            if residual > REACHED:
                return False
        for a in range(n):
            if abs(q[s, a] - q[s - 1, a]) > SPURT:
                return False
    return True


@kernel
def arms_hit(hand: Hand, R_WG: Array, p_WG: Array, R_WO: Array, p_WO: Array, clearance: float) -> int:
    """The first sample at which an arm comes too close to a static body, to the object or to an arm, or −1.

    R_WG, p_WG (count, G, …): the arms' bodies; R_WO, p_WO: the object. Bodies of one arm only may not touch.
    """
    R, p, geoms = stack((2, 3, 3)), stack((2, 3)), hand.geoms
    for s in range(len(R_WG)):
        for n in range(len(hand.arm_pairs)):
            for e in range(2):
                g = hand.arm_pairs[n, e]
                if g >= hand.object_geom:
                    multiply(R_WO[s], geoms.R_LG[g], R[e])
                    rotate(R_WO[s], geoms.p_LG[g], p[e])
                    for a in range(3):
                        p[e, a] += p_WO[s, a]
                elif g >= hand.arm_geom:
                    R[e], p[e] = R_WG[s, g - hand.arm_geom], p_WG[s, g - hand.arm_geom]
                else:
                    R[e], p[e] = geoms.R_LG[g], geoms.p_LG[g]
            g, h = hand.arm_pairs[n, 0], hand.arm_pairs[n, 1]
            if closer(hand, g, R[0], p[0], h, R[1], p[1], 0.0 if hand.arm_own[n] else clearance):
                return s
    return -1


def ways(hand: Hand, R_WO: Array, p_WO: Array, arm_q: Array, clearance: float) -> list[Array]:
    """Joints (count, nq_a) of the arms, from arm_q (nq_a,), along poses of the object, as far as they are clear of everything.

    First the one on which the palms go with the object most: in its place all the way, and turning by as large a part of its
    turn as each of SHARES that the arms can reach. Last the arms at rest. One way without joints where there are no arms.
    """
    still = np.tile(arm_q, (len(R_WO), 1))
    if len(arm_q) == 0:
        return [still]
    turns = rotvec(R_WO @ R_WO[0].T)
    found = []
    if np.max(np.abs(turns)) > STILL or np.max(np.abs(p_WO - p_WO[0])) > STILL:
        for share in SHARES if np.max(np.abs(turns)) > STILL else SHARES[:1]:
            q = carried(hand, from_rotvec(share * turns), p_WO, arm_q)
            if q is not None:
                found.append(q)
    return [q for q in (*found, still) if clear(hand, R_WO, p_WO, q, clearance)]


def carried(hand: Hand, turns: Array, p_WO: Array, arm_q: Array) -> Array | None:
    """Joints with which the palms go with the object's place p_WO (count, 3) and turn about it by `turns` (count, 3, 3)."""
    q = np.tile(arm_q, (len(p_WO), 1))
    R_WP, p_WP, _, _ = poses_of(hand, arm_q[None])
    for c in range(len(hand.arms.free)):
        mine = slice(hand.arms.start[c], hand.arms.start[c + 1])
        own = q[:, mine].copy()
        places = p_WO + turns @ (p_WP[c + 1, 0] - p_WO[0])
        if not follow_palm(hand, c, turns @ R_WP[c + 1, 0], places, own):
            return None
        q[:, mine] = own
    return q


def clear(hand: Hand, R_WO: Array, p_WO: Array, q: Array, clearance: float) -> bool:
    """Whether arms at joints q (count, nq_a) are clear of all but fingers; without a clearance where they begin without."""
    _, _, R_WG, p_WG = poses_of(hand, q)
    if arms_hit(hand, R_WG[:1], p_WG[:1], R_WO[:1], p_WO[:1], clearance) >= 0:
        clearance = 0.0
    return bool(arms_hit(hand, R_WG, p_WG, R_WO, p_WO, clearance) < 0)
