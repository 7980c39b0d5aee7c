"""Where an agent can be at the ends of the intervals: configurations that are computed once on an arc and then kept.

An agent's configuration at the end of an interval follows from the one at its start and the agent's contact motion alone;
on a candidate of the scan, and at rest, it does not even depend on that. So the columns of V are ways through a forest of
configurations, and a V is evaluated by looking up what is known and adding what is not.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.chains import forward
from regrasp.kernels.native import kernel
from regrasp.kernels.records import Record
from regrasp.kernels.rotations import cross, multiply_back, triple, unit
from regrasp.kernels.stack import stack
from regrasp.kernels.surfaces import field as surface
from regrasp.kernels.surfaces import frame
from regrasp.planner.collision import hits, object_row, place_agent, tip_hits
from regrasp.planner.follow import follow
from regrasp.planner.hand import Hand
from regrasp.planner.motions import MOTION_COUNT, OFF, ONTO, STAY, is_sliding, slide_direction, whole
from regrasp.planner.path import Path, base_at, pose_at
from regrasp.planner.scan import Scan, candidate_free
from regrasp.planner.tips import under

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.uint8]

SPARE = 1024  # configurations that are kept beyond four times those of a V: few enough to stay in a processor's cache
UNKNOWN = 255


class Configurations(Record):
    """Configurations c = 1 … used[0] − 1, of agents with up to n_max joints and g_max geoms; the first k are the start's.

    q (N, n_max); holds (N,): in contact; p_OC, p_TC (N, 3), R_OT (N, 3, 3): the contact on the object and on the tip, the tip's
    orientation; n_O (N, 3): the object's outward normal there; t_O (N, 2, 3): slip direction at start and end of the interval
    that led here, if it slid; R_WG, p_WG (N, g_max, …): poses of the agent's geoms. lost (N,): the workspace condition broke on
    the way here; own (N,): blocks of the agent's bodies that collide with each other, with static bodies, with the object.
    Most configurations are looked at for lost ones and forces only: where own is UNKNOWN, the geoms may not be posed yet.

    after (N, MOTION_COUNT): where the contact motions lead, 0 unknown. standing (rows of the scan,): on that candidate;
    stood (1,): the last of these rows that is known; resting (k, n + 1): at rest. R_WB, p_WB (n + 1, B, …): static bodies, then
    the object's. number (N,); R_WL, p_WL, of one chain: scratch.
    """

    used: Ints
    q: Array
    holds: Flags
    p_OC: Array
    p_TC: Array
    R_OT: Array
    n_O: Array
    t_O: Array
    R_WG: Array
    p_WG: Array
    lost: Flags
    own: Flags
    after: Ints
    standing: NDArray[np.int32]
    stood: Ints
    resting: Ints
    number: Ints
    R_WB: Array
    p_WB: Array
    R_WL: Array
    p_WL: Array


@dataclass(frozen=True)
class Grasp:
    """Contacts and joints at one object pose.

    q (nq,); holds (k,); p_OC, p_TC (k, 3); R_OT (k, 3, 3); arm_q (nq_a,): joints of the arms that carry hands.
    """

    q: Array
    holds: Flags
    p_OC: Array
    p_TC: Array
    R_OT: Array
    arm_q: Array = field(default_factory=lambda: np.zeros(0))


def bodies_along(hand: Hand, path: Path) -> tuple[Array, Array]:
    """R_WB (n + 1, B, …), p_WB: static bodies, then the arms' and the object's, at the ends of all intervals."""
    n = len(path.R_WO)
    static = slice(hand.geom_start[-1], hand.arm_geom)
    own = slice(hand.object_geom, len(hand.geoms.kind))
    count, first = len(hand.geoms.kind) - hand.geom_start[-1], hand.object_geom - hand.geom_start[-1]
    R_WB, p_WB = np.empty((n + 1, count, 3, 3)), np.empty((n + 1, count, 3))
    moving = hand.arm_geom - hand.geom_start[-1]
    R_WB[:, :moving], p_WB[:, :moving] = hand.geoms.R_LG[static], hand.geoms.p_LG[static]
    R_WB[:, moving:first] = np.concatenate([path.R_WG[:, 0], path.R_WG[-1:, -1]])
    p_WB[:, moving:first] = np.concatenate([path.p_WG[:, 0], path.p_WG[-1:, -1]])
    R_WO = np.concatenate([path.R_WO[:, 0], path.R_WO[-1:, -1]])
    p_WO = np.concatenate([path.p_WO[:, 0], path.p_WO[-1:, -1]])
    R_WB[:, first:] = R_WO[:, None] @ hand.geoms.R_LG[own]
    p_WB[:, first:] = (R_WO[:, None] @ hand.geoms.p_LG[own, :, None])[..., 0] + p_WO[:, None]
    return R_WB, p_WB


def new_configurations(hand: Hand, path: Path, scan: Scan, start: Grasp) -> Configurations:
    """Nothing known but the start."""
    k, n = len(hand.tip_geom), len(path.R_WO)
    N = SPARE + 4 * (k + 1) * (n + 1)
    joints, geoms = int(np.max(np.diff(hand.chains.start))), int(np.max(np.diff(hand.geom_start)))
    R_WB, p_WB = bodies_along(hand, path)
    found = Configurations(
        used=np.array([k + 1]),
        q=np.zeros((N, joints)),
        holds=np.zeros(N, np.uint8),
        p_OC=np.zeros((N, 3)),
        p_TC=np.zeros((N, 3)),
        R_OT=np.zeros((N, 3, 3)),
        n_O=np.zeros((N, 3)),
        t_O=np.zeros((N, 2, 3)),
        R_WG=np.zeros((N, geoms, 3, 3)),
        p_WG=np.zeros((N, geoms, 3)),
        lost=np.zeros(N, np.uint8),
        own=np.zeros(N, np.uint8),
        after=np.zeros((N, MOTION_COUNT), np.int64),
        standing=np.zeros(len(scan.kept), np.int32),
        stood=np.zeros(1, np.int64),
        resting=np.zeros((k, n + 1), np.int64),
        number=np.zeros(N, np.int64),
        R_WB=R_WB,
        p_WB=p_WB,
        R_WL=np.zeros((joints + 1, 3, 3)),
        p_WL=np.zeros((joints + 1, 3)),
    )
    for i in range(k):
        first, last = hand.chains.start[i], hand.chains.start[i + 1]
        found.q[1 + i, : last - first] = start.q[first:last]
        found.holds[1 + i] = start.holds[i]
        found.p_OC[1 + i], found.p_TC[1 + i], found.R_OT[1 + i] = start.p_OC[i], start.p_TC[i], start.R_OT[i]
        found.own[1 + i] = UNKNOWN
        pose_bodies(hand, path, found, 0, i, 1 + i)
        if start.holds[i]:
            normal_at(hand, found.p_OC[1 + i], found.n_O[1 + i])
    return found


@kernel
def keep_only(found: Configurations, at: Ints) -> None:
    """Forget all configurations but the start's and those in `at` (n + 1, k), which get other numbers, as `at` then says."""
    k, new = at.shape[1], found.number
    for c in range(found.used[0]):
        new[c] = 0
    for j in range(at.shape[0]):
        for i in range(k):
            new[at[j, i]] = 1
    count = 0
    for c in range(found.used[0]):
        if c <= k or new[c]:
            new[c] = count
            if count < c:
                copy_configuration(found, c, count)
            found.after[count] = 0
            count += 1
    found.used[0] = count
    for j in range(at.shape[0]):
        for i in range(k):
            at[j, i] = new[at[j, i]]
    found.standing[: found.stood[0] + 1] = 0
    found.stood[0] = 0
    found.resting[:] = 0


@kernel
def copy_configuration(found: Configurations, source: int, target: int) -> None:
    """All that is known of a configuration but where it leads."""
    found.q[target] = found.q[source]
    found.holds[target], found.lost[target], found.own[target] = (
        found.holds[source],
        found.lost[source],
        found.own[source],
    )
    found.p_OC[target], found.p_TC[target], found.R_OT[target] = (
        found.p_OC[source],
        found.p_TC[source],
        found.R_OT[source],
    )
    found.n_O[target], found.t_O[target] = found.n_O[source], found.t_O[source]
    found.R_WG[target], found.p_WG[target] = found.R_WG[source], found.p_WG[source]


@kernel
def add(found: Configurations) -> int:
    """A new configuration, nothing known of it yet."""
    c = found.used[0]
    found.used[0] = c + 1
    found.after[c] = 0
    found.lost[c] = 0
    found.own[c] = UNKNOWN
    return c


@kernel
def pose_bodies(hand: Hand, path: Path, found: Configurations, j: int, i: int, c: int) -> None:
    """Agent i's bodies from the joints of its configuration c at j."""
    forward(hand.chains, i, found.q[c], found.R_WL, found.p_WL)
    R_WP, p_WP = base_at(path, hand.base[i], j)
    place_agent(hand, i, R_WP, p_WP, found.R_WL, found.p_WL, found.R_WG[c], found.p_WG[c])


@kernel
def standing(
    hand: Hand, path: Path, scan: Scan, found: Configurations, j: int, i: int, candidate: int, clearance: float
) -> int:
    """Agent i on a candidate at the end of interval j − 1; 0 where it cannot stand there."""
    row = candidate_free(hand, path, scan, found.R_WB[j], found.p_WB[j], j, i, candidate, clearance)
    if row == 0:
        return 0
    c = whole(found.standing[row])
    if c > 0:
        return c
    c = add(found)
    n_a = hand.chains.start[i + 1] - hand.chains.start[i]
    R_WO, _ = pose_at(path, hand.base[i], j)
    found.q[c] = scan.q[row]
    forward(hand.chains, i, found.q[c], found.R_WL, found.p_WL)
    found.p_OC[c], found.n_O[c] = scan.p[row], scan.n[row]
    multiply_back(R_WO, found.R_WL[n_a], found.R_OT[c])
    under(hand, i, found.R_OT[c], found.n_O[c], found.p_TC[c])
    found.holds[c] = 1
    found.standing[row] = c
    found.stood[0] = max(found.stood[0], row)
    return c


@kernel
def resting(hand: Hand, path: Path, found: Configurations, j: int, i: int) -> int:
    """Agent i in its rest posture at the end of interval j − 1."""
    c = found.resting[i, j]
    if c == 0:
        c = add(found)
        first, last = hand.chains.start[i], hand.chains.start[i + 1]
        found.q[c, : last - first] = hand.home[first:last]
        found.holds[c] = 0
        found.resting[i, j] = c
    return c


@kernel
def normal_at(hand: Hand, p_O: Array, n_O: Array) -> None:
    """n_O = the object's outward normal at the point p_O of its surface."""
    _, slope = surface(hand.kind_O, hand.size_O, hand.grids, p_O)
    n_O[0], n_O[1], n_O[2] = unit(slope)


@kernel
def follow_contact(
    hand: Hand, path: Path, command: Array, found: Configurations, j: int, i: int, here: int, code: int
) -> int:
    """Agent i in contact through interval j: contact motion, joint angles, bodies, normals at its end."""
    n_a = hand.chains.start[i + 1] - hand.chains.start[i]
    there = add(found)
    found.holds[there] = 1
    q, n_end, x = found.q[there], found.n_O[there], stack(3)
    for a in range(n_a):
        q[a] = found.q[here, a]
    for a in range(3):
        found.p_OC[there, a], found.p_TC[there, a] = found.p_OC[here, a], found.p_TC[here, a]
        for b in range(3):
            found.R_OT[there, a, b] = found.R_OT[here, a, b]
    (x[0], x[1], x[2]), y = frame(triple(found.n_O[here]))
    slides = is_sliding(code)
    if slides:
        slide_direction(code, x, y, found.t_O[there, 0])
    fine = follow(
        hand, path, command, j, i, found.q[here, :n_a], found.p_OC[there], found.p_TC[there], found.R_OT[there], x, q[:n_a],
        found.R_WL[: n_a + 1], found.p_WL[: n_a + 1],
    )  # fmt: skip
    found.lost[there] = 0 if fine else 1
    normal_at(hand, found.p_OC[there], n_end)
    if slides:
        slide_direction(code, x, cross(n_end, x), found.t_O[there, 1])
    return there


@kernel
def keep_still(found: Configurations, here: int) -> int:
    """An agent off the object keeps its posture through an interval, and is taken along by its base."""
    there = add(found)
    found.q[there] = found.q[here]
    found.holds[there] = 0
    return there


@kernel
def onward(
    hand: Hand, path: Path, scan: Scan, commands: Array, clearance: float, found: Configurations, j: int, i: int,
    here: int, code: int, known: bool,
) -> tuple[int, bool]:  # fmt: skip
    """(configuration of agent i at the end of interval j, whether it had to stay behind), from `here` by a contact motion.

    An agent stays behind where it cannot stand on the candidate that it should relocate to. Off the object every contact
    motion means to stay off. known: take what has been computed before.
    """
    behind = False
    if code >= ONTO:
        there = standing(hand, path, scan, found, j + 1, i, code - ONTO, clearance)
        if there > 0:
            return there, False
        code, behind = whole(STAY), True
    elif code == OFF and found.holds[here]:
        return resting(hand, path, found, j + 1, i), False
    if not found.holds[here]:
        code = whole(OFF)
    there = found.after[here, code]
    if there == 0 or not known:
        if found.holds[here]:
            there = follow_contact(hand, path, commands[code], found, j, i, here, code)
        else:
            there = keep_still(found, here)
        found.after[here, code] = there
    return there, behind


@kernel
def own_hits(hand: Hand, path: Path, found: Configurations, j: int, i: int, c: int, clearance: float) -> int:
    """How many blocks of agent i's own bodies collide in its configuration c at the end of interval j − 1."""
    if found.own[c] == UNKNOWN:
        pose_bodies(hand, path, found, j, i, c)
        k, last = len(hand.tip_geom), object_row(hand)
        R_G, p_G, R_B, p_B = found.R_WG[c], found.p_WG[c], found.R_WB[j], found.p_WB[j]
        count = 0
        if hits(hand, i, i, R_G, p_G, R_G, p_G, 0.0):
            count += 1
        if hits(hand, i, k, R_G, p_G, R_B, p_B, clearance):
            count += 1
        if hits(hand, i, k + 1, R_G, p_G, R_B[last:], p_B[last:], clearance) or (
            not found.holds[c] and tip_hits(hand, i, R_G, p_G, R_B[last:], p_B[last:], clearance)
        ):
            count += 1
        found.own[c] = count
    return found.own[c]


def grasp_of(hand: Hand, path: Path, found: Configurations, at: Ints, j: int) -> Grasp:
    """The grasp of the agents' configurations at (k,) at j."""
    joints = np.diff(hand.chains.start)
    q = np.concatenate([found.q[c, :n_a] for c, n_a in zip(at, joints, strict=True)])
    arm_q = path.arm_q[j, 0] if j < len(path.arm_q) else path.arm_q[-1, -1]
    return Grasp(q, found.holds[at], found.p_OC[at], found.p_TC[at], found.R_OT[at], arm_q.copy())
