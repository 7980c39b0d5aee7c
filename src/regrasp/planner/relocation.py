"""Relocation (paper §3): the scan of the object's surface for a new contact, and the free motion that leads there."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from regrasp.kernels.basis import Program
from regrasp.kernels.chains import forward
from regrasp.kernels.inverse import inverse, inverse_point
from regrasp.kernels.records import Record
from regrasp.kernels.rotations import multiply_back, rotate, rotate_back
from regrasp.kernels.sampling import sample
from regrasp.kernels.surfaces import project
from regrasp.planner.balance import balance
from regrasp.planner.collision import block_hit, place, tip_hit
from regrasp.planner.follow import JUMP, REACHED, is_agile, is_full, tip_target
from regrasp.planner.hand import Hand
from regrasp.planner.motions import STAY, whole
from regrasp.planner.path import Path
from regrasp.planner.reserve import Margins
from regrasp.planner.state import State

Array = NDArray[np.float64]
UNKNOWN, FREE, BARRED = 0, 1, 2
NEARER = 6  # steps towards a point of the surface that a short chain can touch
LOOKS = 4  # poses on the coming way at which a candidate is tried
WAYS = 4  # direct, over the object at one and at two lift heights, by the rest posture


@dataclass(frozen=True)
class Relocation:
    """How relocations are scanned and travelled.

    candidates: points of the object's surface that are scanned. lift: height a tip rises above the surface, in parts of
    the object's radius. tries: free motions that are tried, in the order of the scan's objective. outlook: weight of
    losing reach on the coming way and of agents that cannot be relocated next, against the sum of forces in weights.
    """

    candidates: int = 120
    lift: float = 0.35
    tries: int = 3
    outlook: float = 3.0


class Scan(Record):
    """Candidates c = 0 … C − 1 on the object: p_O, n_O (C, 3); what each agent can do there, filled in when first asked.

    Each point stands twice, with two directions of the tool: against the normal, and half-way from there to its direction
    at rest. For each agent and configuration (k, n + 1, C, …): status UNKNOWN, FREE (reachable, nothing fixed in the way)
    or BARRED; p, n: the candidate, moved to where an agent of fewer than six joints can touch; q: joints there; kept: part
    of the coming way on which the contact can be kept, −1 unknown.
    """

    p_O: Array
    n_O: Array
    status: NDArray[np.int8]
    p: Array
    n: Array
    q: Array
    kept: Array


def new_scan(hand: Hand, path: Path, settings: Relocation) -> Scan:
    """The candidates on a near-uniform sampling of the object's surface, nothing known of them yet."""
    p_O, n_O = sample(hand.kind_O, hand.size_O, settings.candidates)
    k, n = len(hand.tip_geom), len(path.R_WO)
    joints = int(np.max(np.diff(hand.chains.start)))
    shape = (k, n + 1, 2 * len(p_O))
    return Scan(
        np.vstack([p_O, p_O]), np.vstack([n_O, n_O]), np.zeros(shape, np.int8), np.zeros((*shape, 3)),
        np.zeros((*shape, 3)), np.zeros((*shape, joints)), np.full(shape, -1.0),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def pose_at(path: Path, j: int) -> tuple[Array, Array]:
    """Object pose of configuration j = 0 … n."""
    n, samples = path.R_WO.shape[0], path.R_WO.shape[1]
    if j < n:
        return path.R_WO[j, 0], path.p_WO[j, 0]
    return path.R_WO[n - 1, samples - 1], path.p_WO[n - 1, samples - 1]


@njit(cache=True, nogil=True)
def touch_down(
    hand: Hand, i: int, R_WO: Array, p_WO: Array, p_O: Array, n_O: Array, height: float, a_O: Array,
    q: Array, R_WL: Array, p_WL: Array,
) -> bool:  # fmt: skip
    """Joint angles q (in: seed) that put agent i's spherical tip over the point p_O, `height` above the surface.

    The tip points along a_O (O) as well as it can. Returns whether the position is reached.
    """
    p, a = np.empty(3), np.empty(3)
    r = hand.size_T[i, 0] + height
    for x in range(3):
        p[x] = p_O[x] + r * n_O[x]
    rotate(R_WO, p, p)
    for x in range(3):
        p[x] += p_WO[x]
    rotate(R_WO, a_O, a)
    residual, _ = inverse_point(hand.chains, i, p, hand.axis_T[i], a, q, R_WL, p_WL)
    return residual < REACHED


@njit(cache=True, nogil=True)
def candidate_free(hand: Hand, path: Path, scan: Scan, state: State, j: int, i: int, c: int, clearance: float) -> bool:
    """Whether agent i can stand on candidate c in configuration j: reach, own links, static bodies, object. Remembered."""
    known = scan.status[i, j, c]
    if known != UNKNOWN:
        return known == FREE
    scan.status[i, j, c] = BARRED
    R_WO, p_WO = pose_at(path, j)
    k = len(hand.tip_geom)
    first, last = hand.chains.start[i], hand.chains.start[i + 1]
    p = np.empty(3)
    rotate(R_WO, scan.p_O[c], p)
    far = 0.0
    for x in range(3):
        p[x] += p_WO[x]
        far += (p[x] - hand.chains.p_WB[i, x]) ** 2
    if far > hand.reach[i] ** 2:
        return False
    q = hand.home[first:last].copy()
    R_WL, p_WL = np.empty((last - first + 1, 3, 3)), np.empty((last - first + 1, 3))
    a_O = -scan.n_O[c]
    if 2 * c >= len(scan.p_O):
        forward(hand.chains, i, q, R_WL, p_WL)
        tool_direction(hand, i, R_WO, R_WL, p)
        for x in range(3):
            a_O[x] += p[x]
        length = np.sqrt(np.sum(a_O * a_O))
        if length < 0.5:
            return False
        a_O /= length
    point, normal = scan.p[i, j, c], scan.n[i, j, c]
    point[:], normal[:] = scan.p_O[c], scan.n_O[c]
    reached = touch_down(hand, i, R_WO, p_WO, point, normal, 0.0, a_O, q, R_WL, p_WL)
    if not is_full(hand, i):
        # A planar finger reaches a curve of the surface only: go on to the point under where its tip got to.
        for _ in range(NEARER):
            if reached:
                break
            for x in range(3):
                p[x] = p_WL[last - first, x] - p_WO[x]
            rotate_back(R_WO, p, p)
            project(hand.kind_O, hand.size_O, p, point, normal)
            reached = touch_down(hand, i, R_WO, p_WO, point, normal, 0.0, a_O, q, R_WL, p_WL)
    if not reached:
        return False
    if not is_agile(hand, i, R_WL, p_WL):
        return False
    R_WG, p_WG = state.R_WG[j].copy(), state.p_WG[j].copy()
    place(hand, hand.geom_start[i], hand.geom_start[i + 1], R_WL, p_WL, R_WG, p_WG)
    if (
        block_hit(hand, i, i, R_WG, p_WG, 0.0)
        or block_hit(hand, i, k, R_WG, p_WG, clearance)
        or block_hit(hand, i, k + 1, R_WG, p_WG, clearance)
    ):
        return False
    scan.status[i, j, c] = FREE
    scan.q[i, j, c, : last - first] = q
    return True


@njit(cache=True, nogil=True)
def look_ahead(n: int, j: int, look: int) -> int:
    """Configuration of look 1 … LOOKS on the way from configuration j to n."""
    return j + (look * (n - j) + LOOKS - 1) // LOOKS


@njit(cache=True, nogil=True)
def hold_on(hand: Hand, path: Path, j: int, i: int, p_OC: Array, p_TC: Array, R_OT: Array, q: Array) -> int:
    """How many looks ahead from configuration j agent i can keep a contact without moving it.

    q (LOOKS + 1, n_a): row 0 the joints at j in, the joints at each look out. An agent of fewer than six joints keeps the
    point only; its tip turns as it must.
    """
    n = path.R_WO.shape[0]
    n_a = q.shape[1]
    R_WL, p_WL, R_WT = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3)), np.empty((3, 3))
    p_WT, a = np.empty(3), np.empty(3)
    for look in range(1, LOOKS + 1):
        R_WO, p_WO = pose_at(path, look_ahead(n, j, look))
        tip_target(R_WO, p_WO, p_OC, p_TC, R_OT, R_WT, p_WT)
        q[look] = q[look - 1]
        if is_full(hand, i):
            residual, _ = inverse(hand.chains, i, R_WT, p_WT, q[look], R_WL, p_WL)
        else:
            rotate(R_WT, hand.axis_T[i], a)
            residual, _ = inverse_point(hand.chains, i, p_WT, hand.axis_T[i], a, q[look], R_WL, p_WL)
        intervals = max(1, look_ahead(n, j, look) - look_ahead(n, j, look - 1))
        if residual > REACHED or np.max(np.abs(q[look] - q[look - 1])) > JUMP * intervals:
            return look - 1
    return LOOKS


@njit(cache=True, nogil=True)
def outlook_of(hand: Hand, path: Path, scan: Scan, state: State, j: int, i: int, c: int, clearance: float) -> float:
    """Part of the coming way on which agent i can keep standing on candidate c, clear of fixed bodies and the object."""
    n, k = path.R_WO.shape[0], len(hand.tip_geom)
    if scan.kept[i, j, c] >= 0.0:
        return scan.kept[i, j, c]
    n_a = hand.chains.start[i + 1] - hand.chains.start[i]
    q = np.zeros((LOOKS + 1, n_a))
    q[0] = scan.q[i, j, c, :n_a]
    R_WL, p_WL = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3))
    R_WG, p_WG = state.R_WG[j].copy(), state.p_WG[j].copy()
    p_TC, R_OT = np.empty(3), np.empty((3, 3))
    touch(hand, path, scan, j, i, c, p_TC, R_OT)
    kept = 0 if j < n else LOOKS
    if j < n:
        reached = hold_on(hand, path, j, i, scan.p[i, j, c], p_TC, R_OT, q)
        while kept < reached:
            forward(hand.chains, i, q[kept + 1], R_WL, p_WL)
            place(hand, hand.geom_start[i], hand.geom_start[i + 1], R_WL, p_WL, R_WG, p_WG)
            ahead = look_ahead(n, j, kept + 1)
            R_WG[hand.object_geom], p_WG[hand.object_geom] = (
                state.R_WG[ahead, hand.object_geom],
                state.p_WG[ahead, hand.object_geom],
            )
            if (
                block_hit(hand, i, i, R_WG, p_WG, 0.0)
                or block_hit(hand, i, k, R_WG, p_WG, clearance)
                or block_hit(hand, i, k + 1, R_WG, p_WG, clearance)
            ):
                break
            kept += 1
    scan.kept[i, j, c] = kept / LOOKS
    return kept / LOOKS


@njit(cache=True, nogil=True)
def touch(hand: Hand, path: Path, scan: Scan, j: int, i: int, c: int, p_TC: Array, R_OT: Array) -> None:
    """Contact point on the tip and orientation of the tip of agent i standing on candidate c in configuration j."""
    n_a = hand.chains.start[i + 1] - hand.chains.start[i]
    R_WL, p_WL = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3))
    R_WO, _ = pose_at(path, j)
    forward(hand.chains, i, scan.q[i, j, c, :n_a], R_WL, p_WL)
    multiply_back(R_WO, R_WL[n_a], R_OT)
    rotate_back(R_OT, scan.n[i, j, c], p_TC)
    for a in range(3):
        p_TC[a] *= -hand.size_T[i, 0]


@njit(cache=True, nogil=True)
def indispensable(
    hand: Hand, path: Path, j: int, s: int, bears: NDArray[np.uint8], p: Array, n: Array, margins: Margins,
    lp: Program,
) -> float:  # fmt: skip
    """Part of the agents that bear without any one of which the others, at rest, don't hold the object (`balance`)."""
    codes, t = np.full(len(bears), STAY, np.int8), np.zeros((len(bears), 3))
    left = bears.copy()
    count, lost = 0, 0
    for a in range(len(bears)):
        if bears[a] == 0:
            continue
        count += 1
        left[a] = 0
        held, _, _ = balance(hand, path, j, s, left, codes, p, n, t, margins, lp)
        left[a] = 1
        if not held:
            lost += 1
    return lost / max(count, 1)


@njit(cache=True, nogil=True)
def contacts_at_end(state: State, j: int) -> tuple[Array, Array]:
    """Contact points and normals (k, 3) of all agents at the end of interval j, to be written into."""
    return state.p_OC[j + 1].copy(), state.n_O[j, 1].copy()


@njit(cache=True, nogil=True)
def scan_contacts(
    hand: Hand, path: Path, scan: Scan, state: State, j: int, i: int, bears: NDArray[np.uint8],
    clearance: float, margins: Margins, lp: Program, score: Array,
) -> None:  # fmt: skip
    """The paper's objective of every candidate for agent i at the end of interval j; inf where the object isn't held.

    It is the sum of the contact forces as if the agent stood there, the others as they are. Whether the agent can stand
    there is asked of those that promise most only (`relocate`); what is known already is not asked again.
    """
    k, m = len(hand.tip_geom), path.R_WO.shape[1] - 1
    codes = np.zeros(k, np.int8)
    p, n = contacts_at_end(state, j)
    t = np.empty((k, 3))
    stands = np.zeros(k, np.uint8)
    for a in range(k):
        codes[a] = state.V[j, a]
        stands[a] = bears[a]
        t[a] = state.t_O[j, 1, a]
    stands[i] = 1
    codes[i] = STAY
    half = len(scan.p_O) // 2
    full = is_full(hand, i)
    for c in range(len(scan.p_O)):
        score[c] = np.inf
        if scan.status[i, j + 1, c] == BARRED:
            continue
        if full and c >= half and scan.status[i, j + 1, c - half] != BARRED:
            score[c] = score[c - half]  # the same point
            continue
        if not full and not candidate_free(hand, path, scan, state, j + 1, i, c, clearance):
            continue  # a short chain moves its candidate, so it must be known before the forces
        p[i] = scan.p_O[c] if full else scan.p[i, j + 1, c]
        n[i] = scan.n_O[c] if full else scan.n[i, j + 1, c]
        held, value, _ = balance(hand, path, j, m, stands, codes, p, n, t, margins, lp)
        if held:
            score[c] = value


@njit(cache=True, nogil=True)
def blend_geoms(hand: Hand, state: State, j: int, i: int, u: float, R_WG: Array, p_WG: Array) -> None:
    """Bodies of the other agents and the object at part u of interval j, blended between its ends.

    The blend is straight in every entry: for the few degrees of an interval it is off by less than 1e-3 of a body's size,
    which the clearance covers.
    """
    for g in range(hand.object_geom + 1):
        if hand.geom_start[i] <= g < hand.geom_start[i + 1]:
            continue
        for a in range(3):
            p_WG[g, a] = (1.0 - u) * state.p_WG[j, g, a] + u * state.p_WG[j + 1, g, a]
            for b in range(3):
                R_WG[g, a, b] = (1.0 - u) * state.R_WG[j, g, a, b] + u * state.R_WG[j + 1, g, a, b]


@njit(cache=True, nogil=True)
def lift_height(m: int, s: int, high: float) -> float:
    """Height after s of the m // 4 steps of a lift: quadratic, so that the tip leaves and meets the surface at rest."""
    part = s / (m // 4)
    return high * part * part


@njit(cache=True, nogil=True)
def way_point(hand: Hand, way: int, a: Array, b: Array, high: float, p: Array, n: Array) -> None:
    """A point p of the object with its normal n to pass over on the way from surface point a to b (O).

    Half-way between a and b; for opposite points, whose middle has no side, the side is chosen by the longest half axis
    of the cross product with a fixed direction.
    """
    middle = 0.5 * (a + b)
    if np.sum(middle * middle) < 0.04 * np.sum(a * a):
        d = np.array([0.0, 0.0, 1.0]) if abs(a[2]) < 0.8 * np.sqrt(np.sum(a * a)) else np.array([1.0, 0.0, 0.0])
        middle = d * np.sqrt(np.sum(a * a))
    else:
        middle = middle * (2.0 * hand.radius / np.sqrt(np.sum(middle * middle)))
    project(hand.kind_O, hand.size_O, middle, p, n)


@njit(cache=True, nogil=True)
def tool_direction(hand: Hand, i: int, R_WO: Array, R_WL: Array, a_O: Array) -> None:
    """a_O = where the tip points, in O."""
    n_a = hand.chains.start[i + 1] - hand.chains.start[i]
    rotate(R_WL[n_a], hand.axis_T[i], a_O)
    rotate_back(R_WO, a_O, a_O)


@njit(cache=True, nogil=True)
def free_motion(
    hand: Hand, path: Path, state: State, j: int, i: int, lifts: bool, lands: bool, goal_p: Array, goal_n: Array,
    goal_q: Array, way: int, high: float, clearance: float, q: Array,
) -> bool:  # fmt: skip
    """Agent i's whole way through interval j off the object, q (m + 1, n_a) out; whether it is clear of everything.

    Lifts off along the normal from its contact (or starts at rest), travels in joint space, by way point if way > 0, and
    touches down on goal_p, goal_n (O) with joints goal_q (or comes to rest at goal_q). Checked at every sample and half-way
    between samples, against all others as they move.
    """
    m, k = path.R_WO.shape[1] - 1, len(hand.tip_geom)
    rise = m // 4
    first, last = hand.chains.start[i], hand.chains.start[i + 1]
    n_a = last - first
    R_WL, p_WL = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3))
    a_O, p, n = np.empty(3), np.empty(3), np.empty(3)
    q[0] = state.q[j, first:last]
    q[m] = goal_q
    start, end = 0, m
    if lifts:
        forward(hand.chains, i, q[0], R_WL, p_WL)
        tool_direction(hand, i, path.R_WO[j, 0], R_WL, a_O)
        project(hand.kind_O, hand.size_O, state.p_OC[j, i], p, n)
        for s in range(1, rise + 1):
            q[s] = q[s - 1]
            if not touch_down(
                hand, i, path.R_WO[j, s], path.p_WO[j, s], p, n, lift_height(m, s, high), a_O, q[s], R_WL, p_WL
            ):
                return False
        start = rise
    if lands:
        forward(hand.chains, i, q[m], R_WL, p_WL)
        tool_direction(hand, i, path.R_WO[j, m], R_WL, a_O)
        for s in range(1, rise + 1):
            q[m - s] = q[m - s + 1]
            if not touch_down(
                hand, i, path.R_WO[j, m - s], path.p_WO[j, m - s], goal_p, goal_n, lift_height(m, s, high), a_O, q[m - s],
                R_WL, p_WL,
            ):  # fmt: skip
                return False
        end = m - rise
    middle = 0.5 * (q[start] + q[end])
    if way == 3:
        middle = hand.home[first:last].copy()
    elif way > 0:
        here, there = state.p_OC[j, i].copy(), goal_p.copy()
        if not (lifts and lands):
            return False
        way_point(hand, way, here, there, high, p, n)
        if not touch_down(
            hand, i, path.R_WO[j, m // 2], path.p_WO[j, m // 2], p, n, high * way, -n, middle, R_WL, p_WL
        ):
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
    R_WG, p_WG = state.R_WG[j].copy(), state.p_WG[j].copy()
    here = np.empty(n_a)
    for half in range(1, 2 * m):
        s = half // 2
        here[:] = q[s] if half % 2 == 0 else 0.5 * (q[s] + q[s + 1])
        forward(hand.chains, i, here, R_WL, p_WL)
        place(hand, hand.geom_start[i], hand.geom_start[i + 1], R_WL, p_WL, R_WG, p_WG)
        blend_geoms(hand, state, j, i, 0.5 * half / m, R_WG, p_WG)
        if block_hit(hand, i, i, R_WG, p_WG, 0.0) or block_hit(hand, i, k, R_WG, p_WG, clearance):
            return False
        if block_hit(hand, i, k + 1, R_WG, p_WG, clearance):
            return False
        for b in range(k):
            low, up = min(i, b), max(i, b)
            if b != i and block_hit(hand, low, up, R_WG, p_WG, clearance):
                return False
        rising = (lifts and half <= 2 * rise) or (lands and half >= 2 * (m - rise))
        if not rising and tip_hit(hand, i, R_WG, p_WG, 0.25 * high):
            return False
    return True


@njit(cache=True, nogil=True)
def relocate(
    hand: Hand, path: Path, scan: Scan, state: State, j: int, i: int, bears: NDArray[np.uint8], clearance: float,
    margins: Margins, outlook: float, tries: int, high: float, lp: Program, score: Array, q: Array,
) -> tuple[int, int]:  # fmt: skip
    """The paper's relocation: the best candidate of the scan that a free motion reaches. (candidate, way) or (−1, 0).

    Deviation: to the sum of forces are added, times `outlook`, the part of the coming way on which the contact can't be
    kept, and the part of the agents that could not be relocated from there; a contact that is about to leave the agent's
    reach would have to be relocated again at once, and others wait for their turn. As this only adds, candidates are
    taken in the order of the sum of forces and are looked at closely when their turn comes.
    """
    scan_contacts(hand, path, scan, state, j, i, bears, clearance, margins, lp, score)
    m = path.R_WO.shape[1] - 1
    p, n = contacts_at_end(state, j)
    stands = bears.copy()
    stands[i] = 1
    seen = np.zeros(len(score), np.uint8)
    n_a = hand.chains.start[i + 1] - hand.chains.start[i]
    lands = tries > 0
    left = tries
    while left > 0:
        c = whole(np.argmin(score))  # type: ignore[arg-type]
        if score[c] == np.inf:
            break
        if seen[c] == 0:
            seen[c] = 1
            if candidate_free(hand, path, scan, state, j + 1, i, c, clearance):
                p[i], n[i] = scan.p[i, j + 1, c], scan.n[i, j + 1, c]
                stuck = indispensable(hand, path, j, m, stands, p, n, margins, lp)
                score[c] += outlook * (stuck + 1.0 - outlook_of(hand, path, scan, state, j + 1, i, c, clearance))
            else:
                score[c] = np.inf
            continue
        score[c] = np.inf
        left -= 1
        for way in range(WAYS):
            if free_motion(
                hand, path, state, j, i, state.holds[j, i] == 1, lands, scan.p[i, j + 1, c], scan.n[i, j + 1, c],
                scan.q[i, j + 1, c, :n_a], way, high, clearance, q,
            ):  # fmt: skip
                return c, way
    return -1, 0


@njit(cache=True, nogil=True)
def stand_on(hand: Hand, path: Path, scan: Scan, state: State, j: int, i: int, c: int) -> None:
    """Put agent i onto candidate c in configuration j of the state."""
    first, last = hand.chains.start[i], hand.chains.start[i + 1]
    R_WL, p_WL = np.empty((last - first + 1, 3, 3)), np.empty((last - first + 1, 3))
    for a in range(first, last):
        state.q[j, a] = scan.q[i, j, c, a - first]
    forward(hand.chains, i, state.q[j, first:last], R_WL, p_WL)
    place(hand, hand.geom_start[i], hand.geom_start[i + 1], R_WL, p_WL, state.R_WG[j], state.p_WG[j])
    touch(hand, path, scan, j, i, c, state.p_TC[j, i], state.R_OT[j, i])
    state.p_OC[j, i] = scan.p[i, j, c]
    state.holds[j, i] = 1
