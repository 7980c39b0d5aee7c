"""The scan of the object's surface for contacts (paper §3): where an agent can stand, and for how long it could stay there."""

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.chains import forward
from regrasp.kernels.grids import Grids
from regrasp.kernels.inverse import inverse_point, turn_towards
from regrasp.kernels.native import kernel
from regrasp.kernels.records import Record
from regrasp.kernels.rotations import dot, exp, multiply, multiply_back, norm, rotate, rotate_back
from regrasp.kernels.sampling import sample
from regrasp.kernels.stack import stack
from regrasp.kernels.surfaces import SPHERE, project
from regrasp.kernels.wrist import NONE, solve_all, solve_near
from regrasp.planner.collision import place_agent, stands_clear
from regrasp.planner.follow import JUMP, REACHED, is_agile, is_full, leap, reach_pose, tip_target
from regrasp.planner.hand import Hand
from regrasp.planner.motions import whole
from regrasp.planner.path import Path, base_at, pose_at
from regrasp.planner.rolling import roll_within
from regrasp.planner.tips import over, touches_in_a_point, under

Array = NDArray[np.float64]
UNKNOWN, BARRED = 0, -1
AGREEING = 12  # attitudes of a tip and places for them, until they agree
NEARER = 6  # steps towards a point of the surface that a short chain can touch
SPINS = 6  # orientations about the tool's axis that an arm tries
DIRECTIONS = 3
LEAN = math.radians(75.0)  # from the normal, at which a tool's shaft still stands clear of a flat surface
LOOKS = 4  # poses on the coming way at which a candidate is tried
STRIDE = 5  # intervals that an agent of few joints is looked ahead at once when it may relocate


@dataclass(frozen=True)
class Relocation:
    """How relocations are scanned and travelled.

    candidates: points of the object's surface that are scanned. lift: height a tip rises above the surface, in parts of
    the object's radius. sample: candidates that one proposal compares. outlook: weight of losing reach on the coming way
    and of agents that cannot be relocated next, against the sum of forces in weights.
    """

    candidates: int = 120
    lift: float = 0.35
    sample: int = 4
    outlook: float = 3.0


class Scan(Record):
    """Candidates c = 0 … C − 1 on the object: p_O, n_O (C, 3); what each agent can do there, filled in when first asked.

    Each point stands DIRECTIONS times, with as many directions of the tool: against the normal, half-way from there to its
    direction at rest, and as at rest, but by LEAN from the normal at most.
    row (k, n + 1, C): for each agent and configuration UNKNOWN, BARRED, or, where the candidate is reachable with nothing fixed
    in the way, its row ≥ 1 in what follows, in the order in which they were found; used (1,): the first row not taken.
    p, n: the candidate, moved to where an agent of fewer than six joints can touch; q: joints there; kept: part of the coming
    way on which the contact can be kept, −1 unknown.
    rest_P (k, 3): where the tip points at rest, in its base. R_WL, p_WL, of one chain, R_WG, p_WG, of its geoms: scratch.
    """

    p_O: Array
    n_O: Array
    row: NDArray[np.int32]
    used: NDArray[np.int64]
    p: Array
    n: Array
    q: Array
    kept: Array
    rest_P: Array
    R_WL: Array
    p_WL: Array
    R_WG: Array
    p_WG: Array


@functools.lru_cache(maxsize=8)
def points(kind: int, size: tuple[float, ...], grids: Grids, count: int) -> tuple[Array, Array]:
    """`sample` of an object's surface, made once: every annealing run of every arc scans the same points."""
    p_O, n_O = sample(kind, np.array(size), grids, count)
    p_O.setflags(write=False)
    n_O.setflags(write=False)
    return p_O, n_O


def new_scan(hand: Hand, path: Path, settings: Relocation) -> Scan:
    """The candidates on a near-uniform sampling of the object's surface, nothing known of them yet."""
    p_O, n_O = points(hand.kind_O, tuple(hand.size_O.tolist()), hand.grids, settings.candidates)
    k, n = len(hand.tip_geom), len(path.R_WO)
    joints, geoms = int(np.max(np.diff(hand.chains.start))), int(np.max(np.diff(hand.geom_start)))
    shape = (k, n + 1, DIRECTIONS * len(p_O))
    R_WL, p_WL, rest_P = np.zeros((joints + 1, 3, 3)), np.zeros((joints + 1, 3)), np.zeros((k, 3))
    for i in range(k):
        first, last = hand.chains.start[i], hand.chains.start[i + 1]
        forward(hand.chains, i, hand.home[first:last], R_WL, p_WL)
        rest_P[i] = R_WL[last - first] @ hand.axis_T[i]
    rows = 1 + math.prod(shape)  # memory that is not written to is not taken
    return Scan(
        np.tile(p_O, (DIRECTIONS, 1)), np.tile(n_O, (DIRECTIONS, 1)), np.zeros(shape, np.int32), np.ones(1, np.int64),
        np.empty((rows, 3)), np.empty((rows, 3)), np.empty((rows, joints)), np.empty(rows),
        rest_P, R_WL, p_WL, np.zeros((geoms, 3, 3)), np.zeros((geoms, 3)),
    )  # fmt: skip


@kernel
def aim(
    hand: Hand, i: int, R_WO: Array, p_WO: Array, p_O: Array, n_O: Array, height: float, a_O: Array,
    q: Array, R_WL: Array, p_WL: Array,
) -> bool:  # fmt: skip
    """`touch_down` of an arm in closed form, the tip pointing along a_O exactly: of all solutions the nearest to the seed.

    The tip turns from the seed's orientation by the shortest way, or where no solution is within the limits, then about a_O in
    SPINS steps. Returns whether there is one.
    """
    Q, d, a, p, w = stack((8, 6)), stack(3), stack(3), stack(3), stack(3)
    E, R, R_WT = stack((3, 3)), stack((3, 3)), stack((3, 3))
    rotate(R_WO, a_O, a)
    forward(hand.chains, i, q, R_WL, p_WL)
    turn_towards(R_WL[6], hand.axis_T[i], a, d, w)
    exp(w, E)
    multiply(E, R_WL[6], R)
    # About the last joint's own axis a spin is that joint's turn, which has been tried if it can turn all the way.
    last = hand.chains.start[i + 1] - 1
    along = abs(dot(hand.axis_T[i], hand.wrists.h_T[i])) > 1.0 - 1e-12
    spins = 1 if along and hand.chains.upper[last] - hand.chains.lower[last] >= 2.0 * np.pi else SPINS
    for spin in range(spins):
        for x in range(3):
            w[x] = 2.0 * np.pi / SPINS * spin * a[x]
        exp(w, E)
        multiply(E, R, R_WT)
        over(hand, i, R_WO, p_WO, p_O, n_O, height, R_WT, p)
        # The nearest of all, where it is within the limits, needs not be looked for among all.
        found = solve_near(hand.chains, hand.wrists, i, R_WT, p, q)
        if not found:
            best, least = -1, np.inf
            for s in range(solve_all(hand.chains, hand.wrists, i, R_WT, p, Q)):
                far = 0.0
                for x in range(6):
                    far = max(far, abs(Q[s, x] - q[x]))
                if far < least:
                    best, least = s, far
            if best >= 0:
                found = True
                q[:] = Q[best]
        if found:
            forward(hand.chains, i, q, R_WL, p_WL)
            return True
    return False


@kernel
def touch_down(
    hand: Hand, i: int, R_WO: Array, p_WO: Array, p_O: Array, n_O: Array, height: float, a_O: Array,
    q: Array, R_WL: Array, p_WL: Array,
) -> bool:  # fmt: skip
    """Joint angles q (in: seed) that put agent i's tip over the point p_O, `height` above the surface.

    The tip points along a_O (O), exactly where the arm has a closed form, else as well as it can. Returns whether the position
    is reached.
    """
    if hand.wrists.kind[i] != NONE:
        return aim(hand, i, R_WO, p_WO, p_O, n_O, height, a_O, q, R_WL, p_WL)
    return lower(hand, i, R_WO, p_WO, p_O, n_O, height, a_O, q, R_WL, p_WL)


@kernel
def lower(
    hand: Hand, i: int, R_WO: Array, p_WO: Array, p_O: Array, n_O: Array, height: float, a_O: Array,
    q: Array, R_WL: Array, p_WL: Array,
) -> bool:  # fmt: skip
    """`touch_down` of any chain, the tip pointing along a_O as well as it can.

    Which point of the tip is over p_O depends on how the tip is turned, and that on the joints: the tip's place is found anew
    for the attitude it has got, until both agree. A ball's place does not depend on it.
    """
    n_a = hand.chains.start[i + 1] - hand.chains.start[i]
    p, a = stack(3), stack(3)
    rotate(R_WO, a_O, a)
    forward(hand.chains, i, q, R_WL, p_WL)
    over(hand, i, R_WO, p_WO, p_O, n_O, height, R_WL[n_a], p)
    for _ in range(AGREEING):
        residual, _ = inverse_point(hand.chains, i, p, hand.axis_T[i], a, q, R_WL, p_WL)
        if residual >= REACHED or hand.kind_T[i] == SPHERE:
            return residual < REACHED
        over(hand, i, R_WO, p_WO, p_O, n_O, height, R_WL[n_a], p)
        if abs(p[0] - p_WL[n_a, 0]) + abs(p[1] - p_WL[n_a, 1]) + abs(p[2] - p_WL[n_a, 2]) < REACHED:
            return True
    return False


@kernel
def tool_direction(hand: Hand, i: int, R_WO: Array, R_WL: Array, a_O: Array) -> None:
    """a_O = where the tip points, in O."""
    n_a = hand.chains.start[i + 1] - hand.chains.start[i]
    rotate(R_WL[n_a], hand.axis_T[i], a_O)
    rotate_back(R_WO, a_O, a_O)


@kernel
def candidate_free(
    hand: Hand, path: Path, scan: Scan, R_B: Array, p_B: Array, j: int, i: int, c: int, clearance: float
) -> int:
    """The row of candidate c for agent i in configuration j, if it can stand there, else 0. Remembered.

    It can with the point within reach and clear of its own links, of static bodies and the object. R_B, p_B: poses of the
    static bodies, then the object's, in configuration j.
    """
    known = scan.row[i, j, c]
    if known != UNKNOWN:
        return max(whole(known), 0)
    scan.row[i, j, c] = BARRED
    b = hand.base[i]
    R_WO, p_WO = pose_at(path, b, j)
    first, last = hand.chains.start[i], hand.chains.start[i + 1]
    p, a_O = stack(3), stack(3)
    rotate(R_WO, scan.p_O[c], p)
    far = 0.0
    for x in range(3):
        p[x] += p_WO[x]
        far += (p[x] - hand.chains.p_WB[i, x]) ** 2
    if far > hand.reach[i] ** 2:
        return 0
    # In the next free row, which is taken if the agent can stand there.
    row = scan.used[0]
    q, R_WL, p_WL = scan.q[row, : last - first], scan.R_WL, scan.p_WL
    for a in range(last - first):
        q[a] = hand.home[first + a]
    for x in range(3):
        a_O[x] = -scan.n_O[c, x]
    lean = DIRECTIONS * c // len(scan.p_O)
    if lean > 0:
        # By `lean` halves of the way from −n to the direction at rest.
        rotate_back(R_WO, scan.rest_P[i], p)
        along = -dot(p, scan.n_O[c])
        for x in range(3):
            p[x] += along * scan.n_O[c, x]
        across = norm(p)
        if across < 0.1:
            return 0
        turn = min(0.5 * lean * np.arctan2(across, along), LEAN)
        for x in range(3):
            a_O[x] = np.cos(turn) * a_O[x] + np.sin(turn) * p[x] / across
    point, normal = scan.p[row], scan.n[row]
    for x in range(3):
        point[x], normal[x] = scan.p_O[c, x], scan.n_O[c, x]
    reached = touch_down(hand, i, R_WO, p_WO, point, normal, 0.0, a_O, q, R_WL, p_WL)
    if not is_full(hand, i):
        # A planar finger reaches a curve of the surface only: go on to the point under where its tip got to.
        for _ in range(NEARER):
            if reached:
                break
            for x in range(3):
                p[x] = p_WL[last - first, x] - p_WO[x]
            rotate_back(R_WO, p, p)
            project(hand.kind_O, hand.size_O, hand.grids, p, point, normal)
            reached = touch_down(hand, i, R_WO, p_WO, point, normal, 0.0, a_O, q, R_WL, p_WL)
    if not reached or not is_agile(hand, i, R_WL, p_WL):
        return 0
    p_TC, R_OT = stack(3), stack((3, 3))
    multiply_back(R_WO, R_WL[last - first], R_OT)
    under(hand, i, R_OT, normal, p_TC)
    if not touches_in_a_point(hand, i, point, p_TC, R_OT):
        return 0
    R_WP, p_WP = base_at(path, b, j)
    place_agent(hand, i, R_WP, p_WP, R_WL, p_WL, scan.R_WG, scan.p_WG)
    if not stands_clear(hand, i, scan.R_WG, scan.p_WG, R_B, p_B, clearance):
        return 0
    scan.row[i, j, c], scan.used[0], scan.kept[row] = row, row + 1, -1.0
    return row


@kernel
def look_ahead(n: int, j: int, look: int) -> int:
    """Configuration of look 1 … LOOKS on the way from configuration j to n."""
    return j + (look * (n - j) + LOOKS - 1) // LOOKS


@kernel
def hold_on(
    hand: Hand, path: Path, commands: Array, j: int, i: int, p_OC: Array, p_TC: Array, R_OT: Array, stride: int,
    q: Array, p: Array, n_O: Array,
) -> int:  # fmt: skip
    """How many looks ahead from configuration j agent i can keep a contact.

    q (LOOKS + 1, n_a): row 0 the joints at j in, the joints at each look out; p, n_O (LOOKS + 1, 3): the contact point and its
    normal there, likewise. An agent of fewer than six joints rolls as in `roll_within`, in steps of at most `stride` intervals;
    p_OC, p_TC, R_OT are scratch for it.
    """
    n, n_a = path.R_WO.shape[0], q.shape[1]
    R_WL, p_WL, R_WT, p_WT = stack((n_a + 1, 3, 3)), stack((n_a + 1, 3)), stack((3, 3)), stack(3)
    for look in range(1, LOOKS + 1):
        first, last = look_ahead(n, j, look - 1), look_ahead(n, j, look)
        q[look], p[look], n_O[look] = q[look - 1], p[look - 1], n_O[look - 1]
        if is_full(hand, i):
            R_WO, p_WO = pose_at(path, hand.base[i], last)
            tip_target(R_WO, p_WO, p_OC, p_TC, R_OT, R_WT, p_WT)
            residual = reach_pose(hand, i, R_WT, p_WT, q[look], R_WL, p_WL)
            if residual > REACHED or leap(q[look], q[look - 1]) > JUMP * max(1, last - first):
                return look - 1
        else:
            for at in range(first, last, stride):
                to = min(at + stride, last)
                if roll_within(hand, path, commands, at, to, i, p_OC, p_TC, R_OT, q[look], R_WL, p_WL) < 0:
                    return look - 1
            project(hand.kind_O, hand.size_O, hand.grids, p_OC, p[look], n_O[look])
    return LOOKS


@kernel
def outlook_of(
    hand: Hand, path: Path, scan: Scan, R_WB: Array, p_WB: Array, j: int, i: int, c: int, clearance: float,
    commands: Array,
) -> float:  # fmt: skip
    """Part of the coming way on which agent i can keep standing on candidate c, clear of fixed bodies and the object.

    It can stand there in configuration j. R_WB, p_WB (n + 1, B, …): poses of the static bodies, then the object's. Remembered.
    """
    n, row = path.R_WO.shape[0], scan.row[i, j, c]
    if scan.kept[row] >= 0.0:
        return scan.kept[row]
    n_a = hand.chains.start[i + 1] - hand.chains.start[i]
    q, p, n_O = stack((LOOKS + 1, n_a)), stack((LOOKS + 1, 3)), stack((LOOKS + 1, 3))
    kept = 1.0
    if j < n:
        reached = stay_on(hand, path, scan, commands, j, i, c, whole(STRIDE), q, p, n_O)
        kept = clear_on(hand, path, scan, R_WB, p_WB, j, i, reached, q, clearance) / LOOKS
    scan.kept[row] = kept
    return kept


@kernel
def clear_on(
    hand: Hand,
    path: Path,
    scan: Scan,
    R_WB: Array,
    p_WB: Array,
    j: int,
    i: int,
    reached: int,
    q: Array,
    clearance: float,
) -> int:
    """At how many of the looks reached agent i, its joints q (LOOKS + 1, n_a), is clear of fixed bodies and the object."""
    for look in range(1, reached + 1):
        forward(hand.chains, i, q[look], scan.R_WL, scan.p_WL)
        at = look_ahead(path.R_WO.shape[0], j, look)
        R_WP, p_WP = base_at(path, hand.base[i], at)
        place_agent(hand, i, R_WP, p_WP, scan.R_WL, scan.p_WL, scan.R_WG, scan.p_WG)
        if not stands_clear(hand, i, scan.R_WG, scan.p_WG, R_WB[at], p_WB[at], clearance):
            return look - 1
    return reached


@kernel
def stay_on(
    hand: Hand,
    path: Path,
    scan: Scan,
    commands: Array,
    j: int,
    i: int,
    c: int,
    stride: int,
    q: Array,
    p: Array,
    n_O: Array,
) -> int:
    """`hold_on` of agent i on candidate c in configuration j; q, p, n_O out."""
    p_OC, p_TC, R_OT = stack(3), stack(3), stack((3, 3))
    row = scan.row[i, j, c]
    q[0] = scan.q[row, : q.shape[1]]
    p[0], n_O[0] = scan.p[row], scan.n[row]
    p_OC[:] = p[0]
    touch(hand, path, scan, j, i, c, p_TC, R_OT)
    return hold_on(hand, path, commands, j, i, p_OC, p_TC, R_OT, stride, q, p, n_O)


@kernel
def touch(hand: Hand, path: Path, scan: Scan, j: int, i: int, c: int, p_TC: Array, R_OT: Array) -> None:
    """Contact point on the tip and orientation of the tip of agent i standing on candidate c in configuration j."""
    n_a = hand.chains.start[i + 1] - hand.chains.start[i]
    R_WO, _ = pose_at(path, hand.base[i], j)
    row = scan.row[i, j, c]
    forward(hand.chains, i, scan.q[row, :n_a], scan.R_WL, scan.p_WL)
    multiply_back(R_WO, scan.R_WL[n_a], R_OT)
    under(hand, i, R_OT, scan.n[row], p_TC)
