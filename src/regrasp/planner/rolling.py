"""How agents of few joints keep a contact: a finger's bend is its own choice, and it rolls where a joint nears its limit.

With fewer than six joints the tip turns as the object's motion makes it turn. What freedom is left is used by rolling
motions; while no joint is near its limit, none is.
"""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import kernel
from regrasp.kernels.stack import stack
from regrasp.kernels.surfaces import project, tangents
from regrasp.planner.follow import short_step, wanders
from regrasp.planner.hand import Hand
from regrasp.planner.motions import ROLL_MINUS_Y, STAY, whole
from regrasp.planner.path import Path, pose_at

Array = NDArray[np.float64]

ROOM = 0.25  # rad or m to its limits that every joint shall have after an interval


@kernel
def cramped(hand: Hand, i: int, q: Array) -> float:
    """Σ of the squares of what agent i's joints q (n_a,) lack of ROOM to their limits."""
    first, total = hand.chains.start[i], 0.0
    for a in range(len(q)):
        left = min(q[a] - hand.chains.lower[first + a], hand.chains.upper[first + a] - q[a])
        total += max(0.0, ROOM - left) ** 2
    return total


@kernel
def roll_within(
    hand: Hand, path: Path, commands: Array, first: int, last: int, i: int, p_OC: Array, p_TC: Array, R_OT: Array,
    q: Array, R_WL: Array, p_WL: Array,
) -> int:  # fmt: skip
    """The contact motion that takes agent i, of fewer than six joints, from one configuration to a later one, or −1 for none.

    Staying, unless the tip wanders, joints have less than ROOM left after it and a roll leaves them more. The contact p_OC,
    p_TC, R_OT and the joints q (n_a,) are those at the start in, at the end out, in one step instead of the intervals' samples.
    """
    R_A, p_A = pose_at(path, hand.base[i], first)
    R_Z, p_Z = pose_at(path, hand.base[i], last)
    steps = (path.R_WO.shape[1] - 1.0) * (last - first)
    foot, n, x, y = stack(3), stack(3), stack(3), stack(3)
    p, c, R, p_best, c_best, R_best = stack(3), stack(3), stack((3, 3)), stack(3), stack(3), stack((3, 3))
    joints, q_best = stack(len(q)), stack(len(q))
    project(hand.kind_O, hand.size_O, hand.grids, p_OC, foot, n)
    best, least = whole(-1), np.inf
    for code in range(STAY, (ROLL_MINUS_Y if wanders(hand, i) else STAY) + 1):
        tangents(n, x, y)
        p[:], c[:], R[:], joints[:] = p_OC, p_TC, R_OT, q
        if not short_step(hand, R_A, p_A, R_Z, p_Z, i, commands[code], steps, p, c, R, x, joints, R_WL, p_WL):
            continue
        value = cramped(hand, i, joints)
        if value < least:
            best, least = whole(code), value
            p_best[:], c_best[:], R_best[:], q_best[:] = p, c, R, joints
        if value == 0.0:
            break
    if best >= 0:
        p_OC[:], p_TC[:], R_OT[:], q[:] = p_best, c_best, R_best, q_best
    return best
