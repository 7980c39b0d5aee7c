"""Inverse kinematics in closed form of six-joint arms with a spherical wrist, found from the model, not from its name.

With h_i the joints' axes at zero, E_i = exp([h_i] θ_i) and c the wrist centre, in which axes 4, 5 and 6 meet,

    c = o + E_1 (l_12 + E_2 (l_23 + E_3 l_3c)),        E_1 … E_6 = M = R_WT R_WT(0)ᵀ,

where the l lead from the point o of axis 1 to axis 2, to axis 3 and to c, at zero. Both fall apart into subproblems,
numbered as in `subproblems`. Position with axes 2 and 3 parallel: h_2ᵀ E_1ᵀ (c − o) is constant (4, θ_1), the length of
E_1ᵀ (c − o) − l_12 across h_2 gives θ_3 (3), the rest θ_2 (1). With axes 1 and 2 meeting in o, l_12 = 0: |c − o| gives
θ_3 (3), then h_2ᵀ E_1ᵀ (c − o) = h_2ᵀ (l_23 + E_3 l_3c) is 4 again (θ_1), then θ_2 (1). Wrist, N = (E_1 E_2 E_3)ᵀ M:
h_4ᵀ N h_6 gives θ_5 (4), N h_6 then θ_4 (1) and a vector across h_6 θ_6 (1).

Where a subproblem leaves an angle free, the seed's is kept: θ_1 with c on axis 1, θ_2 with c on axis 2, θ_4 with axes 4
and 6 in line. (A wrist that cannot take every orientation may miss the pose at that θ_1 or θ_2 and not at others.)
Inside, vectors are triples.
"""

import math

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.chains import HINGE, Chains, forward
from regrasp.kernels.native import kernel
from regrasp.kernels.records import Record
from regrasp.kernels.rotations import Array, Triple, cross, dot, minus, norm, plus, triple
from regrasp.kernels.stack import stack
from regrasp.kernels.subproblems import FREE, NO_ROOTS, Roots, about, beyond, roots, take, turned, turned_back

NONE, PARALLEL, INTERSECTING = 0, 1, 2

# Of the arm's length, and rad: an arm whose axes miss being parallel or meeting by more has no closed form. It would
# miss its poses by about as much; `inverse`, the method of all other arms, comes within 1e-10.
EXACT = 1e-11
# Sine of the angle between axes, and lever in arm lengths, below which an arm's subproblems are badly posed everywhere.
DEGENERATE = 1e-6
REACH = 1e-10  # m and rad by which a pose may be out of reach, or an angle beyond its limit, and be met on the boundary
SINGULAR = 1e-12  # rad, and arm lengths, from an axis within which the angle about it is kept
FOLD = 1e-7  # roots of a subproblem that are nearer to each other than 2e-7 rad are one


class Wrists(Record):
    """What the closed form needs of each of k chains; nothing but its kind of a chain that has none. In W, at zero."""

    kind: NDArray[np.int64]  # (k,) NONE, PARALLEL or INTERSECTING
    axis: Array  # (k, 6, 3) h_i
    origin: Array  # (k, 3) o
    link: Array  # (k, 3, 3) l_12, l_23, l_3c
    across: Array  # (k, 3) unit vector u normal to h_6
    sine: Array  # (k,) |h_1 × h_2|
    offset: Array  # (k,) h_2ᵀ (l_12 + l_23 + l_3c), m
    elbow: Array  # (k, 4) x, y, z and √(x² + y²), m²: r² / 2 = x sin θ_3 + y cos θ_3 + z
    reach: Array  # (k, 2) least and largest r = |l_23 + E_3 l_3c|, m; what is across h_2 of it if PARALLEL
    swing: Array  # (k, 4) x, y, z and √(x² + y²): h_4ᵀ E_5 h_6 = x sin θ_5 + y cos θ_5 + z
    gap: Array  # (k,) (|h_4ᵀ h_5| − |h_5ᵀ h_6|)²
    p_TC: Array  # (k, 3) wrist centre in T
    h_T: Array  # (k, 3) h_6 in T
    u_T: Array  # (k, 3) u in T


def wrists_of(chains: Chains) -> Wrists:
    """The closed forms of `chains`, whose bases must stay where they are.

    A chain has one if it is six hinges of which none follows another, axes 4, 5 and 6 meet in one point and either axes 2
    and 3 are parallel (PARALLEL, taken where both hold) or axes 1 and 2 meet (INTERSECTING), all to EXACT; NONE otherwise.
    """
    k = len(chains.start) - 1
    shapes = {"axis": (6, 3), "origin": (3,), "link": (3, 3), "across": (3,), "sine": (), "offset": (), "elbow": (4,)}
    shapes |= {"reach": (2,), "swing": (4,), "gap": (), "p_TC": (3,), "h_T": (3,), "u_T": (3,)}
    wrists = Wrists(kind=np.full(k, NONE), **{name: np.zeros((k, *shape)) for name, shape in shapes.items()})
    for a in range(k):
        joints = slice(chains.start[a], chains.start[a + 1])
        if joints.stop - joints.start == 6 == chains.free[a] and (chains.kind[joints] == HINGE).all():
            _study(chains, a, joints, wrists)
    return wrists


def _study(chains: Chains, a: int, joints: slice, wrists: Wrists) -> None:
    """Row a of `wrists`, for six hinges."""
    R, p = np.empty((7, 3, 3)), np.empty((7, 3))
    forward(chains, a, np.zeros(6), R, p)
    h = np.einsum("irc,ic->ir", R[:6], chains.axis[joints])
    h /= np.linalg.norm(h, axis=1)[:, None]
    length = float(np.linalg.norm(np.diff(p[:6], axis=0), axis=1).sum())
    c, miss = _meet(h[3:], p[3:6])
    sines = np.linalg.norm(np.cross(h[[0, 3, 4]], h[[1, 4, 5]]), axis=1)
    if miss > EXACT * length or sines.min() < DEGENERATE:
        return
    o, miss = _meet(h[:2], p[:2])
    if np.linalg.norm(np.cross(h[1], h[2])) < EXACT:
        kind, o, shoulder = PARALLEL, p[0], p[1]
    elif miss < EXACT * length:
        kind, shoulder = INTERSECTING, o
    else:
        return
    l_12, l_23, l_3c = shoulder - o, p[2] - shoulder, c - p[2]
    # Only what is across axis 3 turns. What is along it and along axis 2 too is taken out of the distance: an elbow bent
    # right back would lose its digits in it.
    rise = h[2] @ (l_23 + l_3c) if kind == INTERSECTING else 0.0
    foot, lever = np.cross(h[2], l_23), np.cross(h[2], l_3c)
    r, s = np.linalg.norm(foot), np.linalg.norm(lever)
    if min(r, s) < DEGENERATE * length:
        return
    across = np.cross(h[5], np.eye(3)[np.argmin(abs(h[5]))])
    wrists.kind[a], wrists.axis[a], wrists.origin[a], wrists.link[a] = kind, h, o, (l_12, l_23, l_3c)
    wrists.across[a] = across / np.linalg.norm(across)
    wrists.sine[a], wrists.offset[a] = sines[0], h[1] @ (l_12 + l_23 + l_3c)
    wrists.elbow[a] = l_23 @ lever, foot @ lever, (rise**2 + r**2 + s**2) / 2, r * s
    wrists.reach[a] = np.hypot(rise, r - s), np.hypot(rise, r + s)
    across_4, across_6, a_4, a_6 = np.cross(h[4], h[3]), np.cross(h[4], h[5]), h[3] @ h[4], h[4] @ h[5]
    wrists.swing[a] = h[3] @ across_6, across_4 @ across_6, a_4 * a_6, sines[1] * sines[2]
    wrists.gap[a] = (abs(a_4) - abs(a_6)) ** 2
    wrists.p_TC[a], wrists.h_T[a], wrists.u_T[a] = R[6].T @ (c - p[6]), R[6].T @ h[5], R[6].T @ wrists.across[a]


def _meet(h: Array, p: Array) -> tuple[Array, float]:
    """(point nearest to the lines p_i + t h_i, its largest distance from one of them)."""
    across = np.eye(3) - h[:, :, None] * h[:, None]
    x = np.linalg.lstsq(across.reshape(-1, 3), np.einsum("irc,ic->ir", across, p).ravel(), rcond=None)[0]
    return x, float(np.linalg.norm(np.cross(h, x - p), axis=1).max())


@kernel
def _shoulder(wrists: Wrists, a: int, d: Triple, height: float, seed: Triple) -> Roots:
    """Turns of joint 1 with h_2ᵀ E_1ᵀ d = height."""
    h_1, h_2 = triple(wrists.axis[a, 0]), triple(wrists.axis[a, 1])
    h_12, k = cross(h_1, h_2), dot(h_1, h_2)
    w = dot(h_1, d)
    x, y, b = dot(d, h_12), dot(d, h_2) - k * w, height - k * w
    lever = math.sqrt(x * x + y * y)
    if abs(b) > lever + REACH * wrists.sine[a]:
        return NO_ROOTS
    if lever <= SINGULAR * wrists.reach[a, 1]:
        return FREE
    return roots(x, y, lever, b, (lever - b) * (lever + b), FOLD * lever, seed)


@kernel
def _elbow(wrists: Wrists, a: int, distance: float, seed: Triple) -> Roots:
    """Turns of joint 3 with |l_23 + E_3 l_3c| = distance, what is across h_2 of both if PARALLEL (subproblem 3)."""
    if distance < wrists.reach[a, 0] - REACH or distance > wrists.reach[a, 1] + REACH:
        return NO_ROOTS
    x, y, z, lever = wrists.elbow[a, 0], wrists.elbow[a, 1], wrists.elbow[a, 2], wrists.elbow[a, 3]
    b = 0.5 * distance * distance - z
    return roots(x, y, lever, b, (lever - b) * (lever + b), FOLD * lever, seed)


@kernel
def _swing(wrists: Wrists, a: int, v: Triple, seed: Triple) -> Roots:
    """Turns of joint 5 with h_4ᵀ E_5 h_6 = h_4ᵀ v."""
    x, y, z, lever = wrists.swing[a, 0], wrists.swing[a, 1], wrists.swing[a, 2], wrists.swing[a, 3]
    h_4 = triple(wrists.axis[a, 3])
    r = norm(cross(h_4, v))
    # x² + y² − b² is the Gram determinant of h_4, h_5 and E_5 h_6. In this form it keeps its digits as the wrist nears
    # its singularity; from h_4ᵀ v they would be lost, as an arc cosine's are.
    w = minus(v, h_4) if z >= 0.0 else plus(v, 1.0, h_4)
    square = r * r - wrists.gap[a] - abs(z) * dot(w, w)
    if square < -2.0 * REACH * lever * (r + REACH):
        return NO_ROOTS
    return roots(x, y, lever, dot(h_4, v) - z, square, max(FOLD * lever * r, SINGULAR * lever), seed)


@kernel
def _search(wrists: Wrists, a: int, R_WT: Array, p_WT: Array, seed: Array, near: bool, Q: Array) -> int:
    """Solutions at the turns nearest to the seed (6,) behind one another into Q, and how many were found.

    Near: only the nearest of all, Q (6,), which may be the seed's array; else all, Q (48,). Nearest is by max |Δq|;
    branches that one of their angles puts farther away than the best so far aren't followed.
    """
    h_1, h_2, h_3 = triple(wrists.axis[a, 0]), triple(wrists.axis[a, 1]), triple(wrists.axis[a, 2])
    h_4, h_5, h_6 = triple(wrists.axis[a, 3]), triple(wrists.axis[a, 4]), triple(wrists.axis[a, 5])
    l_12, l_23, l_3c = triple(wrists.link[a, 0]), triple(wrists.link[a, 1]), triple(wrists.link[a, 2])
    u_6, R_0, R_1, R_2 = triple(wrists.across[a]), triple(R_WT[0]), triple(R_WT[1]), triple(R_WT[2])
    h_T, u_T, p_TC = triple(wrists.h_T[a]), triple(wrists.u_T[a]), triple(wrists.p_TC[a])
    v_W, u_W = (dot(R_0, h_T), dot(R_1, h_T), dot(R_2, h_T)), (dot(R_0, u_T), dot(R_1, u_T), dot(R_2, u_T))
    d = plus((dot(R_0, p_TC), dot(R_1, p_TC), dot(R_2, p_TC)), 1.0, minus(p_WT, wrists.origin[a]))
    q_1, q_2, q_3, q_4, q_5, q_6 = seed[0], seed[1], seed[2], seed[3], seed[4], seed[5]
    seed_1 = e_1 = (0.0, math.cos(q_1), math.sin(q_1))
    seed_3 = e_3 = (0.0, math.cos(q_3), math.sin(q_3))
    seed_5 = (0.0, math.cos(q_5), math.sin(q_5))
    lever = SINGULAR * wrists.reach[a, 1]
    parallel = wrists.kind[a] == PARALLEL
    count, best, least = 0, math.inf, -2.0  # least = cos(best), the cosines of nearer angles are larger
    f = w = d
    first = _shoulder(wrists, a, d, wrists.offset[a], seed_1) if parallel else _elbow(wrists, a, norm(d), seed_3)
    for i in range(first[0]):
        if beyond(first, i, least):
            break
        if parallel:
            e_1 = take(first, i, seed_1)
            f = minus(turned_back(h_1, e_1, d), l_12)
            second = _elbow(wrists, a, norm(cross(h_2, f)), seed_3)
        else:
            e_3 = take(first, i, seed_3)
            w = plus(turned(h_3, e_3, l_3c), 1.0, l_23)
            second = _shoulder(wrists, a, d, dot(h_2, w), seed_1)
        for j in range(second[0]):
            if beyond(second, j, least):
                break
            if parallel:
                e_3 = take(second, j, seed_3)
                w = plus(turned(h_3, e_3, l_3c), 1.0, l_23)
            else:
                e_1 = take(second, j, seed_1)
                f = turned_back(h_1, e_1, d)
            e_2 = about(h_2, w, f, lever, q_2)
            far = max(abs(e_1[0]), abs(e_2[0]), abs(e_3[0]))
            if near and far >= best:
                continue
            v = turned_back(h_3, e_3, turned_back(h_2, e_2, turned_back(h_1, e_1, v_W)))
            u = turned_back(h_3, e_3, turned_back(h_2, e_2, turned_back(h_1, e_1, u_W)))
            third = _swing(wrists, a, v, seed_5)
            for k in range(third[0]):
                if beyond(third, k, least):
                    break
                e_5 = take(third, k, seed_5)
                e_4 = about(h_4, turned(h_5, e_5, h_6), v, SINGULAR, q_4)
                # θ_6 after the θ_4 that was taken, from the vector u: near the singularity, where θ_4 is loose, their sum
                # must not be.
                e_6 = about(h_6, u_6, turned_back(h_5, e_5, turned_back(h_4, e_4, u)), SINGULAR, q_6)
                farthest = max(far, abs(e_4[0]), abs(e_5[0]), abs(e_6[0]))
                if near and farthest >= best:
                    continue
                at = 0 if near else 6 * count
                Q[at], Q[at + 1], Q[at + 2] = q_1 + e_1[0], q_2 + e_2[0], q_3 + e_3[0]
                Q[at + 3], Q[at + 4], Q[at + 5] = q_4 + e_4[0], q_5 + e_5[0], q_6 + e_6[0]
                count += 1
                if near:
                    best, least = farthest, math.cos(farthest)
    return count


@kernel
def _hold(q: Array, lower: Array, upper: Array) -> bool:
    """Whether q (6,) is within the limits; round-off beyond them is taken off it."""
    for i in range(6):
        if q[i] < lower[i] - REACH or q[i] > upper[i] + REACH:
            return False
        q[i] = min(max(q[i], lower[i]), upper[i])
    return True


@kernel
def solve_all(chains: Chains, wrists: Wrists, a: int, R_WT: Array, p_WT: Array, Q: Array) -> int:
    """All joints of chain a, within its limits, that bring its tip frame to (R_WT, p_WT): rows of Q (8, 6), their number.

    Each angle is at the turn nearest to the middle of its limits (to 0 without any, to half a turn past the only one).
    Where an angle is free, it is in the middle, and one solution stands for all; solutions nearer to each other than
    FOLD are one. 0 for a chain without a closed form. The rows past the number are overwritten too.
    """
    if wrists.kind[a] == NONE:
        return 0
    first = chains.start[a]
    lower, upper, middle = chains.lower[first : first + 6], chains.upper[first : first + 6], stack(6)
    for i in range(6):
        if lower[i] > -math.inf:
            middle[i] = 0.5 * (lower[i] + upper[i]) if upper[i] < math.inf else lower[i] + math.pi
        else:
            middle[i] = upper[i] - math.pi if upper[i] < math.inf else 0.0
    count = 0
    for k in range(_search(wrists, a, R_WT, p_WT, middle, False, Q.reshape(48))):
        if _hold(Q[k], lower, upper):
            Q[count] = Q[k]
            count += 1
    return count


@kernel
def solve_near(chains: Chains, wrists: Wrists, a: int, R_WT: Array, p_WT: Array, q: Array) -> bool:
    """Joints of chain a that bring its tip frame to (R_WT, p_WT), of all solutions the nearest to q (6,), in place.

    Nearest by max |Δq|, each angle at its turn nearest to the seed's, however large the step: a caller that follows a
    path looks at it. Exact to round-off; a free angle keeps the seed's. False, and q as it was, where the pose is out of
    reach, the nearest solution beyond a limit, or no closed form: the branch is not left for one that fits.
    """
    if wrists.kind[a] == NONE:
        return False
    first = chains.start[a]
    q_1, q_2, q_3, q_4, q_5, q_6 = q[0], q[1], q[2], q[3], q[4], q[5]
    if _search(wrists, a, R_WT, p_WT, q, True, q) > 0:
        if _hold(q, chains.lower[first : first + 6], chains.upper[first : first + 6]):
            return True
        q[0], q[1], q[2], q[3], q[4], q[5] = q_1, q_2, q_3, q_4, q_5, q_6
    return False
