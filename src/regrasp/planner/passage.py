"""The free motion of a relocation (paper §3): off the object, over it and down again, clear of everything on the way."""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.chains import forward
from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import multiply_back, norm, rotate_back
from regrasp.kernels.stack import stack
from regrasp.kernels.surfaces import project
from regrasp.planner.collision import hits, moving_row, object_row, place_agent, stands_clear, tip_hits
from regrasp.planner.configurations import Configurations
from regrasp.planner.follow import REACHED, is_full, reach_pose, tip_target
from regrasp.planner.hand import Hand
from regrasp.planner.memory import Memory, remember, slot_of
from regrasp.planner.motions import whole
from regrasp.planner.path import Path
from regrasp.planner.scan import tool_direction, touch_down
from regrasp.planner.tips import under

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
LEAP = 0.15  # m that a body goes between two samples at most
WIDE = 0.35  # rad or m that joints go between two samples without a look at how far the bodies do
LOW = 0.25  # of the lift height that a tip keeps off the object between its lifts
NEAR = 0.1  # rad or m that joints go between two looks for collisions
WAYS = 4  # direct, over the object at one and at two lift heights, by the rest posture
ROUND = 6  # further ways where the object stands still: along the axes of W, beside it, over it and under it


@kernel
def lift_height(m: int, s: int, high: float) -> float:
    """Height after s of the m // 4 steps of a lift: quadratic, so that the tip leaves and meets the surface at rest."""
    part = s / (m // 4)
    return high * part * part


@kernel
def way_point(hand: Hand, a: Array, b: Array, p: Array, n: Array) -> None:
    """A point p of the object with its normal n to pass over on the way from surface point a to b (O).

    Half-way between a and b; for opposite points, whose middle has no side, the side is that of a fixed direction.
    """
    middle, size = stack(3), norm(a)
    for x in range(3):
        middle[x] = 0.5 * (a[x] + b[x])
    length = norm(middle)
    if length < 0.2 * size:
        middle[:] = 0.0
        middle[2 if abs(a[2]) < 0.8 * size else 0] = size
    else:
        for x in range(3):
            middle[x] *= 2.0 * hand.radius / length
    project(hand.kind_O, hand.size_O, hand.grids, middle, p, n)


@kernel
def hover(
    hand: Hand, i: int, R_WO: Array, p_WO: Array, p_O: Array, n_O: Array, height: float, R_OT: Array, a_O: Array,
    q: Array, R_WL: Array, p_WL: Array,
) -> bool:  # fmt: skip
    """Joint angles q (in: seed) that put agent i's tip over the point p_O as it stood there, `height` above the surface.

    A six-joint agent keeps its tip's orientation R_OT, one of fewer its tool's direction a_O as well as it can.
    """
    if not is_full(hand, i):
        return touch_down(hand, i, R_WO, p_WO, p_O, n_O, height, a_O, q, R_WL, p_WL)
    R_WT, p_WT, p_TC, p = stack((3, 3)), stack(3), stack(3), stack(3)
    under(hand, i, R_OT, n_O, p_TC)
    for x in range(3):
        p[x] = p_O[x] + height * n_O[x]
    tip_target(R_WO, p_WO, p, p_TC, R_OT, R_WT, p_WT)
    return reach_pose(hand, i, R_WT, p_WT, q, R_WL, p_WL) < REACHED


@kernel
def raise_tip(
    hand: Hand, path: Path, found: Configurations, j: int, i: int, here: int, first: int, step: int, high: float,
    q: Array,
) -> bool:  # fmt: skip
    """The quarter of the way next to a contact: rows first + step, first + 2 step, … of q (m + 1, n_a), from row `first`.

    here: the configuration in contact. The tip rises along the normal (step 1), or comes down on it (step −1, from the end).
    """
    m, b = path.R_WO.shape[1] - 1, hand.base[i]
    n_a = q.shape[1]
    R_WL, p_WL, a_O, R_OT = found.R_WL, found.p_WL, stack(3), stack((3, 3))
    forward(hand.chains, i, q[first], R_WL, p_WL)
    tool_direction(hand, i, path.R_PO[b, j, first], R_WL, a_O)
    multiply_back(path.R_PO[b, j, first], R_WL[n_a], R_OT)
    s = first
    for count in range(1, m // 4 + 1):
        s += step
        q[s] = q[s - step]
        if not hover(
            hand, i, path.R_PO[b, j, s], path.p_PO[b, j, s], found.p_OC[here], found.n_O[here],
            lift_height(m, count, high), R_OT, a_O, q[s], R_WL, p_WL,
        ):  # fmt: skip
            return False
    return True


@kernel
def travel(
    hand: Hand, path: Path, found: Configurations, j: int, i: int, here: int, there: int, way: int, high: float,
    q: Array,
) -> bool:  # fmt: skip
    """Rows m // 4 … m − m // 4 of q (m + 1, n_a): in joint space from the one lift to the other, by the way point.

    Returns whether there is a way point and all stay within the joint limits.
    """
    m, n_a, b = path.R_WO.shape[1] - 1, q.shape[1], hand.base[i]
    R_PO, p_PO = path.R_PO[b, j, m // 2], path.p_PO[b, j, m // 2]
    lifts, lands = found.holds[here] == 1, found.holds[there] == 1
    first = hand.chains.start[i]
    start, end = m // 4 if lifts else 0, m - m // 4 if lands else m
    middle = stack(n_a)
    for a in range(n_a):
        middle[a] = hand.home[first + a] if way == WAYS - 1 else 0.5 * (q[start, a] + q[end, a])
    if way >= WAYS:
        a_O, n, p = stack(3), stack(3), stack(3)
        for a in range(n_a):
            middle[a] = hand.home[first + a]
        forward(hand.chains, i, middle, found.R_WL, found.p_WL)
        tool_direction(hand, i, R_PO, found.R_WL, a_O)
        for a in range(3):
            n[a] = 0.0
        n[(way - WAYS) // 2] = 1.0 - 2.0 * ((way - WAYS) % 2)
        rotate_back(R_PO, n, n)
        for a in range(3):
            p[a] = hand.radius * n[a]
        if not touch_down(hand, i, R_PO, p_PO, p, n, high, a_O, middle, found.R_WL, found.p_WL):
            return False
    elif 0 < way < WAYS - 1:
        if not (lifts and lands):
            return False
        p, n, a_O = stack(3), stack(3), stack(3)
        way_point(hand, found.p_OC[here], found.p_OC[there], p, n)
        for a in range(3):
            a_O[a] = -n[a]
        if not touch_down(hand, i, R_PO, p_PO, p, n, high * way, a_O, middle, found.R_WL, found.p_WL):
            return False
    for s in range(start + 1, end):
        u = (s - start) / (end - start)
        u = u * u * (3.0 - 2.0 * u)
        # The parabola through both ends and the middle.
        for a in range(n_a):
            q[s, a] = (
                (1.0 - u) * (1.0 - 2.0 * u) * q[start, a]
                + 4.0 * u * (1.0 - u) * middle[a]
                + u * (2.0 * u - 1.0) * q[end, a]
            )
            if q[s, a] < hand.chains.lower[first + a] or q[s, a] > hand.chains.upper[first + a]:
                return False
    return True


@kernel
def blend(A_R: Array, A_p: Array, B_R: Array, B_p: Array, u: float, R: Array, p: Array, count: int) -> None:
    """Poses of bodies at part u between two configurations, straight in every entry.

    For the few degrees of an interval this is off by less than 1e-3 of a body's size, which the clearance covers.
    """
    for g in range(count):
        for a in range(3):
            p[g, a] = (1.0 - u) * A_p[g, a] + u * B_p[g, a]
            for b in range(3):
                R[g, a, b] = (1.0 - u) * A_R[g, a, b] + u * B_R[g, a, b]


@kernel
def leaps(hand: Hand, path: Path, j: int, i: int, q: Array, R_WL: Array, p_WL: Array, R_G: Array, p_G: Array) -> bool:
    """Whether a body of agent i goes farther than LEAP between two rows of q in interval j; the others: scratch."""
    before = stack((len(p_G), 3))
    for s in range(len(q)):
        forward(hand.chains, i, q[s], R_WL, p_WL)
        place_agent(
            hand, i, path.R_WP[hand.base[i], j, s], path.p_WP[hand.base[i], j, s], R_WL, p_WL, R_G, p_G
        )  # fmt: skip
        for g in range(hand.geom_start[i + 1] - hand.geom_start[i]):
            far = 0.0
            for a in range(3):
                far += (p_G[g, a] - before[g, a]) ** 2
                before[g, a] = p_G[g, a]
            if s > 0 and far > LEAP * LEAP:
                return True
    return False


@kernel
def obstacle(
    hand: Hand, path: Path, found: Configurations, j: int, i: int, at: Ints, to: Ints, high: float, clearance: float,
    ask: Array, q: Array,
) -> int:  # fmt: skip
    """What agent i with joints q (m + 1, n_a) meets in interval j as all move from `at` to `to`: an agent's number, or −1.

    Its own number stands for itself and all that is not an agent. ask (k,): 1 for what is looked for. Looked for at every
    sample and half-way between samples, where the joints go far more often. A way on which a body leaps meets something
    unknown: between samples nobody would see it.
    """
    m, k, n_a = path.R_WO.shape[1] - 1, len(hand.tip_geom), q.shape[1]
    rise = m // 4
    lifts, lands = found.holds[at[i]] == 1, found.holds[to[i]] == 1
    geoms, moving, last, base = found.p_WG.shape[1], moving_row(hand), object_row(hand), hand.base[i]
    R_P, p_P = stack((1, 3, 3)), stack((1, 3))
    R_WL, p_WL, here = found.R_WL, found.p_WL, stack(n_a)
    R_G, p_G = stack((geoms, 3, 3)), stack((geoms, 3))
    R_C, p_C = stack((geoms, 3, 3)), stack((geoms, 3))
    R_B, p_B = stack((len(found.p_WB[j]), 3, 3)), stack((len(found.p_WB[j]), 3))
    R_B[:], p_B[:] = found.R_WB[j], found.p_WB[j]
    R_A, R_Z, p_A, p_Z = (
        found.R_WB[j, moving:], found.R_WB[j + 1, moving:], found.p_WB[j, moving:], found.p_WB[j + 1, moving:]
    )  # fmt: skip
    widest = 0.0
    for s in range(m):
        for a in range(n_a):
            widest = max(widest, abs(q[s + 1, a] - q[s, a]))
    if ask[i] and widest > WIDE and leaps(hand, path, j, i, q, R_WL, p_WL, R_G, p_G):
        return i
    low = high * LOW
    if ask[i] and not lifts:
        forward(hand.chains, i, q[0], R_WL, p_WL)
        place_agent(hand, i, path.R_WP[base, j, 0], path.p_WP[base, j, 0], R_WL, p_WL, R_G, p_G)
        if tip_hits(hand, i, R_G, p_G, R_B[last:], p_B[last:], low):
            low = clearance  # a tip that is nearer has to get away
    looks = max(2, whole(np.ceil(widest / NEAR)))
    half = looks * m // 2
    for turn in range(1, looks * m):
        # From the middle, where most bodies are in the way, to both ends.
        look = half + (turn // 2 if turn % 2 else -(turn // 2))
        s, part, u = look // looks, (look % looks) / looks, look / (looks * m)
        for a in range(n_a):
            here[a] = q[s, a] if part == 0.0 else (1.0 - part) * q[s, a] + part * q[s + 1, a]
        forward(hand.chains, i, here, R_WL, p_WL)
        if base > 0:
            blend(
                path.R_WP[base, j, s : s + 1], path.p_WP[base, j, s : s + 1], path.R_WP[base, j, s + 1 : s + 2],
                path.p_WP[base, j, s + 1 : s + 2], part, R_P, p_P, 1,
            )  # fmt: skip
        place_agent(hand, i, R_P[0], p_P[0], R_WL, p_WL, R_G, p_G)
        if ask[i]:
            blend(R_A, p_A, R_Z, p_Z, u, R_B[moving:], p_B[moving:], len(R_A))
            if not stands_clear(hand, i, R_G, p_G, R_B, p_B, clearance):
                return i
            rising = (lifts and look <= looks * rise) or (lands and look >= looks * (m - rise))
            least = low if look <= looks * rise else LOW * high
            if not rising and tip_hits(hand, i, R_G, p_G, R_B[last:], p_B[last:], least):
                return i
        for b in range(k):
            if b == i or not ask[b]:
                continue
            blend(
                found.R_WG[at[b]], found.p_WG[at[b]], found.R_WG[to[b]], found.p_WG[to[b]], u, R_C, p_C,
                hand.geom_start[b + 1] - hand.geom_start[b],
            )  # fmt: skip
            if (b > i and hits(hand, i, b, R_G, p_G, R_C, p_C, clearance)) or (
                b < i and hits(hand, b, i, R_C, p_C, R_G, p_G, clearance)
            ):
                return b
    return -1


@kernel
def lift(
    hand: Hand, path: Path, found: Configurations, j: int, i: int, here: int, there: int, high: float, q: Array
) -> bool:
    """The ends of agent i's way q (m + 1, n_a) from configuration `here` to `there`, off the object and down on it."""
    m = path.R_WO.shape[1] - 1
    for a in range(q.shape[1]):
        q[0, a], q[m, a] = found.q[here, a], found.q[there, a]
    if found.holds[here] and not raise_tip(hand, path, found, j, i, here, whole(0), whole(1), high, q):
        return False
    return not found.holds[there] or raise_tip(hand, path, found, j, i, there, m, whole(-1), high, q)


@kernel
def ways_through(hand: Hand, path: Path, j: int, i: int) -> int:
    """How many ways a free motion of agent i in interval j may take: more where the object stands still in the agent's base."""
    m, base = path.R_WO.shape[1] - 1, hand.base[i]
    for a in range(3):
        if path.p_PO[base, j, 0, a] != path.p_PO[base, j, m, a]:
            return WAYS
        for b in range(3):
            if path.R_PO[base, j, 0, a, b] != path.R_PO[base, j, m, a, b]:
                return WAYS
    return WAYS + ROUND


@kernel
def name(key: Ints, j: int, i: int, way: int, b: int, at: Ints, to: Ints) -> None:
    """key (3,): a way of agent i through interval j, and what could be in it: the motion of agent b, or if b = i all else."""
    key[0] = ((j * len(at) + i) * len(at) + b) * (WAYS + ROUND) + way
    key[1] = at[i] << 32 | to[i]
    key[2] = at[b] << 32 | to[b]


@kernel
def free_motion(
    hand: Hand, path: Path, found: Configurations, ways: Memory, key: Ints, remembers: bool, j: int, i: int,
    at: Ints, to: Ints, high: float, clearance: float, q: Array,
) -> tuple[int, bool]:  # fmt: skip
    """(the first way of agent i through interval j off the object that is clear, or −1; whether it was known).

    at, to (k,): all agents' configurations at its two ends. The tip lifts off along the normal from its contact (or starts at
    rest), travels in joint space, by a way point if way > 0, and touches down on its new contact (or comes to rest).
    A way does not depend on the other agents: what it meets is remembered of each of them apart. q (m + 1, n_a), key (3,):
    scratch.
    """
    k, raised, known = len(at), whole(-1), True
    ask = stack(k)
    for way in range(ways_through(hand, path, j, i)):
        met, asked = False, False
        for b in range(k):
            ask[b] = 1.0
            if remembers:
                name(key, j, i, way, b, at, to)
                slot = slot_of(ways, key)
                if ways.taken[slot]:
                    ask[b] = 0.0
                    met = met or ways.values[slot] > 0.0
            asked = asked or ask[b] > 0.0
        if met:
            continue
        if not asked:
            return way, known
        known = False
        if raised < 0:
            raised = 1 if lift(hand, path, found, j, i, at[i], to[i], high, q) else 0
        hit = whole(i)
        if raised and travel(hand, path, found, j, i, at[i], to[i], whole(way), high, q):
            hit = obstacle(hand, path, found, j, i, at, to, high, clearance, ask, q)
        for b in range(k):
            if remembers and (b == hit or (hit < 0 and ask[b])):
                name(key, j, i, way, b, at, to)
                remember(ways, slot_of(ways, key), key, 1.0 if b == hit else 0.0)
        if hit < 0:
            return way, known
    return -1, known


@kernel
def along(
    hand: Hand, path: Path, found: Configurations, j: int, i: int, here: int, there: int, way: int, high: float,
    q: Array,
) -> bool:  # fmt: skip
    """Agent i's joints q (m + 1, n_a) through interval j on a way of `free_motion`; whether it goes there."""
    return lift(hand, path, found, j, i, here, there, high, q) and travel(
        hand, path, found, j, i, here, there, way, high, q
    )
