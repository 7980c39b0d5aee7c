"""Inverse kinematics of serial chains: a pose (inverse), or a point and as much of a direction as it leaves free.

Both start from the joints handed in and stay on their branch: continuations along a path, not searches.
"""

import math

from regrasp.kernels.chains import Chains, couple, forward, jacobian
from regrasp.kernels.native import kernel
from regrasp.kernels.rates import meet_task, solve
from regrasp.kernels.rotations import Array, cross, dot, log, multiply_back, norm, rotate
from regrasp.kernels.stack import stack

ITERATIONS = 30  # steps of one inverse problem; neighbouring poses need two or three
TOLERANCE = 1e-10  # m and rad: ten times finer than the 1e-9 that contacts are held to
ANGLE = 1e-7  # rad, where turning towards a direction ends: its optimum is flat
DAMPING = 1e-2  # of the squared error; a step that makes the error grow is taken back and damped 16 times more
STALLED = 0.99  # a step that leaves more of the error than this says that the pose is out of reach
STEP = 0.25  # rad or m, the longest move of one joint in one step: longer ones could cross to another branch


@kernel
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
        solve(K, m, y)
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


@kernel
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


@kernel
def _converge(
    chains: Chains, a: int, R_WT: Array, p_WT: Array, m: int, q: Array, R_WL: Array, p_WL: Array, J: Array
) -> tuple[float, bool]:
    """Levenberg–Marquardt from q in place to the point p_WT (m = 3) or the pose (m = 6): |error|, and no joint held.

    Damping ∝ |e|² after Sugihara 2011, "Solvability-unconcerned inverse kinematics by the Levenberg–Marquardt method":
    it vanishes with the error, so that convergence is quadratic at regular poses and the step is defined at all others.
    """
    first = chains.start[a]
    n = chains.start[a + 1] - first
    lower, upper = chains.lower[first : first + n], chains.upper[first : first + n]
    K, E, V, S = stack((6, 6)), stack((3, 3)), stack((3, 6)), stack((2, n))
    e, e_new, y, step, old = V[0], V[1], V[2], S[0], S[1]
    for i in range(n):
        q[i] = min(max(q[i], lower[i]), upper[i])
    couple(chains, a, q)
    forward(chains, a, q, R_WL, p_WL)
    error = _error(R_WT, p_WT, m, R_WL[n], p_WL[n], E, e)
    held, factor, current = False, DAMPING, True
    for _ in range(ITERATIONS):
        if error < TOLERANCE:
            break
        if current:
            jacobian(chains, a, R_WL, p_WL, p_WL[n], J)
        held = _damped_step(J, m, e, factor * error * error, q, lower, upper, K, y, step)
        for i in range(n):
            old[i] = q[i]
            q[i] = min(max(q[i] + step[i], lower[i]), upper[i])
        couple(chains, a, q)
        forward(chains, a, q, R_WL, p_WL)
        error_new = _error(R_WT, p_WT, m, R_WL[n], p_WL[n], E, e_new)
        current = error_new < error
        if current:
            stalled = error_new > STALLED * error
            error = error_new
            e[:m] = e_new[:m]
            factor = max(0.25 * factor, DAMPING)
            if stalled and error > TOLERANCE:
                break
        else:
            q[:] = old
            factor *= 16.0
    if not current:
        forward(chains, a, q, R_WL, p_WL)
    return error, not held


@kernel
def inverse(chains: Chains, a: int, R_WT: Array, p_WT: Array, q: Array, R_WL: Array, p_WL: Array) -> tuple[float, bool]:
    """Joints of chain a that bring its tip frame to the pose (R_WT, p_WT), from q (n_a,) in place; 6 free ones in general.

    Returns (residual, inside): residual = √(|Δp|² + |Δφ|²) with Δp in m and the rotation vector Δφ in rad, < 1e-10
    where the pose is reached; what remains where it is out of reach is a local least-squares error, not a failure of
    the method. q is always within the joint limits; inside is False when a joint had to be held on its limit in the
    last step. R_WL, p_WL are left as `forward` writes them for the q found.
    """
    J = stack((6, q.shape[0]))
    return _converge(chains, a, R_WT, p_WT, 6, q, R_WL, p_WL, J)


@kernel
def turn_towards(R: Array, axis_T: Array, axis_W: Array, d: Array, e: Array) -> float:
    """d = R axis_T, e = the shortest rotation vector that brings d onto axis_W; returns its angle in [0, π]."""
    rotate(R, axis_T, d)
    e[0], e[1], e[2] = cross(d, axis_W)
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


@kernel
def _null_step(
    J: Array, still: Array, e: Array, damping: float, q: Array, lower: Array, upper: Array, W: Array, step: Array
) -> float:
    """Step that turns by e without moving the point; returns the share of it, in (0, 1], that the limits allow.

    Joints on their limit that would be pushed beyond it are locked: their columns of J are cleared.
    """
    n = q.shape[0]
    while True:
        step[:] = 0.0
        used = meet_task(J, 0, still, 0.0, 0, W, step)
        meet_task(J, 3, e, damping, used, W, step)
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


@kernel
def inverse_point(
    chains: Chains, a: int, p_WT: Array, axis_T: Array, axis_W: Array, q: Array, R_WL: Array, p_WL: Array
) -> tuple[float, float]:
    """Joints of chain a that bring the origin of its tip frame to p_WT and turn axis_T towards axis_W, from q in place.

    The point comes first: the direction R_WT axis_T ≈ axis_W (unit vectors) is improved only along motions that keep
    the point, each followed by a return to it, so that the angle never grows and the point is never traded for it.
    Any number of joints, within their limits; axis_T = 0 asks for no direction. Returns (residual, angle): |Δp| in m,
    < 1e-10 where the point is reached, and the angle in rad left between R_WT axis_T and axis_W, a local minimum as far
    as ITERATIONS go.
    R_WL, p_WL are left as `forward` writes them for the q found.
    """
    first = chains.start[a]
    n = chains.start[a + 1] - first
    lower, upper = chains.lower[first : first + n], chains.upper[first : first + n]
    J, W, S, V = stack((6, n)), stack((13, max(n, 3))), stack((2, n)), stack((3, 3))
    step, best, d, e, still = S[0], S[1], V[0], V[1], V[2]
    residual, _ = _converge(chains, a, R_WL[n], p_WT, 3, q, R_WL, p_WL, J)
    angle = turn_towards(R_WL[n], axis_T, axis_W, d, e)
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
        angle_new = turn_towards(R_WL[n], axis_T, axis_W, d, e)
        if residual_new < TOLERANCE and angle_new < angle:
            gain = angle - angle_new
            residual, angle = residual_new, angle_new
            damping *= 0.3
            if gain < ANGLE and share == 1.0:
                break
        else:
            q[:] = best
            forward(chains, a, q, R_WL, p_WL)
            turn_towards(R_WL[n], axis_T, axis_W, d, e)
            damping = max(4.0 * damping, 0.03)
    return residual, angle
