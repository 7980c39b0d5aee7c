"""Serial chains (fingers, arms, arms on mobile bases): forward kinematics, Jacobian, inverse kinematics and joint rates.

Link i of a chain is the frame that moves with its joint i: origin on the joint's anchor. The tip frame T is fixed in the
last link. Every pose is X_AB = (R_AB, p_AB). All inverse problems start from the joints handed in and stay on their
branch: they are continuations along a path, not searches.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from regrasp.kernels.rotations import Array, cross, dot, log, multiply, multiply_back, norm, rotate

HINGE, SLIDE = 0, 1

ITERATIONS = 30  # steps of one inverse problem; neighbouring poses need two or three
TOLERANCE = 1e-10  # m and rad: ten times finer than the 1e-9 that contacts are held to
STEP = 0.25  # rad or m, the longest move of one joint in one step: longer ones could cross to another branch
ANGLE = 1e-7  # rad, where turning towards a direction ends: its optimum is flat
STALLED = 0.99  # a step that leaves more of the error than this says that the pose is out of reach
SINGULAR = 1e-2  # pivot ratio below which a task direction counts as nearly singular and is damped
VANISHED = 1e-9  # pivot ratio below which it is not there at all


class Chains(NamedTuple):
    """k serial chains behind one another: the joints of chain a are start[a] … start[a + 1] − 1 (n_a of nq in all)."""

    start: NDArray[np.int64]  # (k + 1,)
    kind: NDArray[np.int64]  # (nq,) HINGE or SLIDE
    R_PJ: Array  # (nq, 3, 3) joint frame at zero in the previous link (in the base for the first)
    p_PJ: Array  # (nq, 3)
    axis: Array  # (nq, 3) unit axis in the joint frame
    lower: Array  # (nq,) joint limits, rad or m; ±inf where there is none
    upper: Array  # (nq,)
    R_WB: Array  # (k, 3, 3) base in the world
    p_WB: Array  # (k, 3)
    R_LT: Array  # (k, 3, 3) tip frame in the last link
    p_LT: Array  # (k, 3)


@njit(cache=True, nogil=True)
def forward(chains: Chains, a: int, q: Array, R_WL: Array, p_WL: Array) -> None:
    """Poses of chain a's links, [0 … n_a − 1], and of its tip frame T, [n_a], at its joints q (n_a,).

    R_WL (n_a + 1, 3, 3), p_WL (n_a + 1, 3) are written.
    """
    first = chains.start[a]
    n = chains.start[a + 1] - first
    R, p = chains.R_WB[a], chains.p_WB[a]
    for i in range(n):
        P, o, u = chains.R_PJ[first + i], chains.p_PJ[first + i], chains.axis[first + i]
        L, x = R_WL[i], p_WL[i]
        for r in range(3):
            x[r] = p[r] + R[r, 0] * o[0] + R[r, 1] * o[1] + R[r, 2] * o[2]
        if chains.kind[first + i] == HINGE:
            # exp([u] q) in registers (Rodrigues): it doesn't wait for the links before, so the processor overlaps it.
            s, c = math.sin(q[i]), math.cos(q[i])
            v, u0, u1, u2 = 1.0 - c, u[0], u[1], u[2]
            E00, E11, E22 = c + v * u0 * u0, c + v * u1 * u1, c + v * u2 * u2
            E01, E10 = v * u0 * u1 - s * u2, v * u0 * u1 + s * u2
            E20, E02 = v * u0 * u2 - s * u1, v * u0 * u2 + s * u1
            E12, E21 = v * u1 * u2 - s * u0, v * u1 * u2 + s * u0
            for r in range(3):
                h0 = R[r, 0] * P[0, 0] + R[r, 1] * P[1, 0] + R[r, 2] * P[2, 0]
                h1 = R[r, 0] * P[0, 1] + R[r, 1] * P[1, 1] + R[r, 2] * P[2, 1]
                h2 = R[r, 0] * P[0, 2] + R[r, 1] * P[1, 2] + R[r, 2] * P[2, 2]
                L[r, 0] = h0 * E00 + h1 * E10 + h2 * E20
                L[r, 1] = h0 * E01 + h1 * E11 + h2 * E21
                L[r, 2] = h0 * E02 + h1 * E12 + h2 * E22
        else:
            multiply(R, P, L)
            for r in range(3):
                x[r] += q[i] * (L[r, 0] * u[0] + L[r, 1] * u[1] + L[r, 2] * u[2])
        R, p = L, x
    multiply(R, chains.R_LT[a], R_WL[n])
    o = chains.p_LT[a]
    for r in range(3):
        p_WL[n, r] = p[r] + R[r, 0] * o[0] + R[r, 1] * o[1] + R[r, 2] * o[2]


@njit(cache=True, nogil=True)
def jacobian(chains: Chains, a: int, R_WL: Array, p_WL: Array, p_W: Array, J: Array) -> None:
    """Geometric Jacobian J (6, n_a) of the point p_W of chain a's last link, from the poses that `forward` wrote.

    Rows 0–2: velocity of the point; rows 3–5: angular velocity of the last link; both in W.
    """
    first = chains.start[a]
    for i in range(chains.start[a + 1] - first):
        R, u = R_WL[i], chains.axis[first + i]
        x = R[0, 0] * u[0] + R[0, 1] * u[1] + R[0, 2] * u[2]
        y = R[1, 0] * u[0] + R[1, 1] * u[1] + R[1, 2] * u[2]
        z = R[2, 0] * u[0] + R[2, 1] * u[1] + R[2, 2] * u[2]
        if chains.kind[first + i] == HINGE:
            dx, dy, dz = p_W[0] - p_WL[i, 0], p_W[1] - p_WL[i, 1], p_W[2] - p_WL[i, 2]
            J[0, i], J[1, i], J[2, i] = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
            J[3, i], J[4, i], J[5, i] = x, y, z
        else:
            J[0, i], J[1, i], J[2, i] = x, y, z
            J[3, i], J[4, i], J[5, i] = 0.0, 0.0, 0.0


@njit(cache=True, nogil=True)
def _solve(K: Array, m: int, y: Array) -> None:
    """y ← K⁻¹ y for the leading m×m block of a symmetric positive definite K (lower triangle read, overwritten)."""
    for j in range(m):
        d = K[j, j]
        for k in range(j):
            d -= K[j, k] * K[j, k]
        d = 1.0 / math.sqrt(max(d, 1e-300))
        K[j, j] = d
        t = y[j]
        for k in range(j):
            t -= K[j, k] * y[k]
        y[j] = t * d
        for i in range(j + 1, m):
            t = K[i, j]
            for k in range(j):
                t -= K[i, k] * K[j, k]
            K[i, j] = t * d
    for j in range(m - 1, -1, -1):
        t = y[j]
        for i in range(j + 1, m):
            t -= K[i, j] * y[i]
        y[j] = t * K[j, j]


@njit(cache=True, nogil=True)
def _damped_step(
    J: Array, m: int, e: Array, damping: float, q: Array, lower: Array, upper: Array, K: Array, y: Array, step: Array
) -> bool:
    """Levenberg step J_fᵀ (J_f J_fᵀ + damping)⁻¹ (e − J_h step_h) on the first m rows of J, within the joint limits.

    Joints that would leave their limits are held (h) on them and the free ones (f) take over what they leave undone.
    The step is shortened as a whole to STEP. Returns whether a joint is held.
    """
    n = q.shape[0]
    held = 0
    while True:
        for r in range(m):
            y[r] = e[r]
            for c in range(r + 1):
                K[r, c] = 0.0
        for i in range(n):
            if held >> i & 1:
                for r in range(m):
                    y[r] -= J[r, i] * step[i]
            else:
                for r in range(m):
                    for c in range(r + 1):
                        K[r, c] += J[r, i] * J[c, i]
        trace = 0.0
        for r in range(m):
            trace += K[r, r]
        for r in range(m):
            K[r, r] += damping + 1e-13 * trace
        _solve(K, m, y)
        before = held
        longest = 0.0
        for i in range(n):
            if not held >> i & 1:
                t = 0.0
                for r in range(m):
                    t += J[r, i] * y[r]
                if q[i] + t > upper[i] or q[i] + t < lower[i]:
                    held |= 1 << i
                    t = (upper[i] if t > 0.0 else lower[i]) - q[i]
                step[i] = t
            longest = max(longest, abs(step[i]))
        if held == before:
            break
    if longest > STEP:
        for i in range(n):
            step[i] *= STEP / longest
    return held != 0


@njit(cache=True, nogil=True)
def _error(R_WT: Array, p_WT: Array, m: int, R: Array, p: Array, E: Array, e: Array) -> float:
    """e (m,): translation, and for m = 6 the rotation vector, in W, from the pose (R, p) to X_WT; returns |e|."""
    s = 0.0
    for r in range(3):
        e[r] = p_WT[r] - p[r]
        s += e[r] * e[r]
    if m == 6:
        multiply_back(R, R_WT, E)
        w = e[3:6]
        log(E, w)
        rotate(R, w, w)
        s += w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    return math.sqrt(s)


@njit(cache=True, nogil=True)
def _converge(
    chains: Chains, a: int, R_WT: Array, p_WT: Array, m: int, q: Array, R_WL: Array, p_WL: Array, J: Array
) -> tuple[float, bool]:
    """Levenberg–Marquardt from q in place to the point p_WT (m = 3) or the pose (m = 6): |error|, and no joint held.

    Damping ½|e|² after Sugihara 2011, "Solvability-unconcerned inverse kinematics by the Levenberg–Marquardt method":
    it vanishes with the error, so that convergence is quadratic at regular poses and the step is defined at all others.
    """
    first = chains.start[a]
    n = chains.start[a + 1] - first
    lower, upper = chains.lower[first : first + n], chains.upper[first : first + n]
    K, E, V, S = np.empty((6, 6)), np.empty((3, 3)), np.empty((3, 6)), np.empty((2, n))
    e, e_new, y, step, old = V[0], V[1], V[2], S[0], S[1]
    for i in range(n):
        q[i] = min(max(q[i], lower[i]), upper[i])
    forward(chains, a, q, R_WL, p_WL)
    error = _error(R_WT, p_WT, m, R_WL[n], p_WL[n], E, e)
    held, factor, current = False, 1.0, True
    for _ in range(ITERATIONS):
        if error < TOLERANCE:
            break
        if current:
            jacobian(chains, a, R_WL, p_WL, p_WL[n], J)
        held = _damped_step(J, m, e, 0.5 * factor * error * error, q, lower, upper, K, y, step)
        for i in range(n):
            old[i] = q[i]
            q[i] = min(max(q[i] + step[i], lower[i]), upper[i])
        forward(chains, a, q, R_WL, p_WL)
        error_new = _error(R_WT, p_WT, m, R_WL[n], p_WL[n], E, e_new)
        current = error_new < error
        if current:
            stalled = error_new > STALLED * error
            error = error_new
            e[:m] = e_new[:m]
            factor = max(0.25 * factor, 1.0)
            if stalled and error > TOLERANCE:
                break
        else:
            q[:] = old
            factor *= 16.0
    if not current:
        forward(chains, a, q, R_WL, p_WL)
    return error, not held


@njit(cache=True, nogil=True)
def inverse(
    chains: Chains, a: int, R_WT: Array, p_WT: Array, q: Array, R_WL: Array, p_WL: Array
) -> tuple[float, bool]:
    """Joints of chain a that bring its tip frame to the pose (R_WT, p_WT), from q (n_a,) in place; n_a ≥ 6 in general.

    Returns (residual, inside): residual = √(|Δp|² + |Δφ|²) with Δp in m and the rotation vector Δφ in rad, < 1e-10
    where the pose is reached; what remains where it is out of reach is a local least-squares error, not a failure of
    the method. q is always within the joint limits; inside is False when a joint had to be held on its limit in the
    last step. R_WL, p_WL are left as `forward` writes them for the q found.
    """
    J = np.empty((6, q.shape[0]))
    return _converge(chains, a, R_WT, p_WT, 6, q, R_WL, p_WL, J)


@njit(cache=True, nogil=True)
def _remove(G: Array, u: Array) -> None:
    """Take the part along the unit row u out of every row of G."""
    for r in range(G.shape[0]):
        s = 0.0
        for i in range(u.shape[0]):
            s += G[r, i] * u[i]
        for i in range(u.shape[0]):
            G[r, i] -= s * u[i]


@njit(cache=True, nogil=True)
def _task(J: Array, row: int, target: Array, damping: float, used: int, W: Array, out: Array) -> int:
    """out += the step that meets J[row : row + 3] out = target in the least-squares sense without moving along W[:used].

    W[:used] holds orthonormal rows that span the tasks done so far; those of this task are appended (Gram–Schmidt with
    row pivoting); returns how many there are now. Damping after Nakamura & Hanafusa 1986 grows from zero where the
    last pivot falls below SINGULAR of the task's scale. The rows W[6:13] (≥ 3 long) are scratch.
    """
    n = J.shape[1]
    G = W[6:9, :n]
    scale = 0.0
    for r in range(3):
        s = 0.0
        for i in range(n):
            G[r, i] = J[row + r, i]
            s += G[r, i] * G[r, i]
        scale = max(scale, s)
    scale = math.sqrt(scale)
    for k in range(used):
        _remove(G, W[k, :n])
    rank, pivot = 0, 0.0
    while rank < 3:
        best, longest = 0, -1.0
        for r in range(3):
            s = 0.0
            for i in range(n):
                s += G[r, i] * G[r, i]
            if s > longest:
                best, longest = r, s
        longest = math.sqrt(longest)
        if longest <= VANISHED * scale:
            break
        pivot = longest
        row_new = W[used + rank : used + rank + 1, :n]
        for i in range(n):
            row_new[0, i] = G[best, i] / longest
        for k in range(used + rank):  # once more: a short remainder has lost its orthogonality to round-off
            _remove(row_new, W[k, :n])
        _remove(G, row_new[0])
        rank += 1
    if rank == 0:
        return used
    ratio = pivot / (SINGULAR * scale)
    if ratio < 1.0:
        damping += (SINGULAR * scale) ** 2 * (1.0 - ratio * ratio)
    # In the coordinates y along the new rows Q: B = J Qᵀ, (BᵀB + damping) y = Bᵀ (target − J out), out += Qᵀ y.
    B, K, y = W[9:12], W[6:9], W[12]
    for r in range(3):
        for k in range(rank):
            s = 0.0
            for i in range(n):
                s += J[row + r, i] * W[used + k, i]
            B[r, k] = s
    for k in range(rank):
        y[k] = 0.0
        for j in range(k + 1):
            K[k, j] = B[0, k] * B[0, j] + B[1, k] * B[1, j] + B[2, k] * B[2, j]
        K[k, k] += damping
    for r in range(3):
        s = target[r]
        for i in range(n):
            s -= J[row + r, i] * out[i]
        for k in range(rank):
            y[k] += B[r, k] * s
    _solve(K, rank, y)
    for k in range(rank):
        for i in range(n):
            out[i] += W[used + k, i] * y[k]
    return used + rank


@njit(cache=True, nogil=True)
def rates(J: Array, v: Array, w: Array, qd: Array, w_achieved: Array) -> float:
    """Joint rates qd (n,) with J[:3] qd = v exactly and J[3:] qd = w in the least-squares sense, from `jacobian`'s J.

    Any number of joints: six realise w exactly away from singularities, fewer what they can (Siciliano & Slotine 1991,
    task priority); near a singularity of either task the rates are damped. v, w in W. Writes the angular velocity
    achieved, w_achieved = J[3:] qd, and returns |J[:3] qd − v|, zero to round-off unless J[:3] is nearly singular.
    """
    n = J.shape[1]
    W = np.empty((13, max(n, 3)))
    qd[:] = 0.0
    used = _task(J, 0, v, 0.0, 0, W, qd)
    _task(J, 3, w, 0.0, used, W, qd)
    defect = 0.0
    for r in range(3):
        s, t = 0.0, 0.0
        for i in range(n):
            s += J[r, i] * qd[i]
            t += J[3 + r, i] * qd[i]
        w_achieved[r] = t
        defect += (s - v[r]) ** 2
    return math.sqrt(defect)


@njit(cache=True, nogil=True)
def _turn(R: Array, axis_T: Array, axis_W: Array, d: Array, e: Array) -> float:
    """d = R axis_T, e = the shortest rotation vector that brings d onto axis_W; returns its angle in [0, π]."""
    rotate(R, axis_T, d)
    cross(d, axis_W, e)
    s = norm(e)
    angle = math.atan2(s, dot(d, axis_W))
    if s > 1e-12:
        for r in range(3):
            e[r] *= angle / s
    elif angle > 1.0:  # opposed: any perpendicular axis is a shortest way
        k = 0
        for r in range(1, 3):
            if abs(d[r]) < abs(d[k]):
                k = r
        e[:] = 0.0
        e[k] = 1.0
        s = d[k]
        t = angle / math.sqrt(1.0 - s * s)
        for r in range(3):
            e[r] = t * (e[r] - s * d[r])
    return angle


@njit(cache=True, nogil=True)
def _null_step(
    J: Array, still: Array, e: Array, damping: float, q: Array, lower: Array, upper: Array, W: Array, step: Array
) -> float:
    """Step that turns by e without moving the point; returns the share of it, in (0, 1], that the limits allow.

    Joints on their limit that would be pushed beyond it are locked: their columns of J are cleared.
    """
    n = q.shape[0]
    while True:
        step[:] = 0.0
        used = _task(J, 0, still, 0.0, 0, W, step)
        _task(J, 3, e, damping, used, W, step)
        share, locked = 1.0, False
        for i in range(n):
            room = upper[i] - q[i] if step[i] > 0.0 else q[i] - lower[i]
            if abs(step[i]) > share * room:
                if room > ANGLE:
                    share = room / abs(step[i])
                elif abs(step[i]) > ANGLE:
                    J[:, i] = 0.0
                    locked = True
        if not locked:
            return share


@njit(cache=True, nogil=True)
def inverse_point(
    chains: Chains, a: int, p_WT: Array, axis_T: Array, axis_W: Array, q: Array, R_WL: Array, p_WL: Array
) -> tuple[float, float]:
    """Joints of chain a that bring the origin of its tip frame to p_WT and turn axis_T towards axis_W, from q in place.

    The point comes first: the direction R_WT axis_T ≈ axis_W (unit vectors) is improved only along motions that keep
    the point, each followed by a return to it, so that the angle never grows and the point is never traded for it.
    Any number of joints; within the joint limits. Returns (residual, angle): |Δp| in m, < 1e-10 where the point
    is reached, and the angle in rad left between R_WT axis_T and axis_W, a local minimum.
    R_WL, p_WL are left as `forward` writes them for the q found.
    """
    first = chains.start[a]
    n = chains.start[a + 1] - first
    lower, upper = chains.lower[first : first + n], chains.upper[first : first + n]
    J, W, S, V = np.empty((6, n)), np.empty((13, max(n, 3))), np.empty((2, n)), np.zeros((3, 3))
    step, best, d, e, still = S[0], S[1], V[0], V[1], V[2]
    residual, _ = _converge(chains, a, R_WL[n], p_WT, 3, q, R_WL, p_WL, J)
    angle = _turn(R_WL[n], axis_T, axis_W, d, e)
    damping = 0.0
    for _ in range(ITERATIONS):
        if residual > TOLERANCE or angle < ANGLE:
            break
        jacobian(chains, a, R_WL, p_WL, p_WL[n], J)
        for i in range(n):  # turning about d itself is free
            s = J[3, i] * d[0] + J[4, i] * d[1] + J[5, i] * d[2]
            for r in range(3):
                J[3 + r, i] -= s * d[r]
        share = _null_step(J, still, e, damping, q, lower, upper, W, step)
        longest = 0.0
        for i in range(n):
            longest = max(longest, abs(step[i]))
        if longest < ANGLE:
            break
        share = min(share, STEP / longest)
        for i in range(n):
            best[i] = q[i]
            q[i] += share * step[i]
        residual_new, _ = _converge(chains, a, R_WL[n], p_WT, 3, q, R_WL, p_WL, J)
        angle_new = _turn(R_WL[n], axis_T, axis_W, d, e)
        if residual_new < TOLERANCE and angle_new < angle:
            gain = angle - angle_new
            residual, angle = residual_new, angle_new
            damping *= 0.1
            if gain < ANGLE and share == 1.0:
                break
        else:
            q[:] = best
            forward(chains, a, q, R_WL, p_WL)
            _turn(R_WL[n], axis_T, axis_W, d, e)
            damping = max(4.0 * damping, 0.1)
    return residual, angle
