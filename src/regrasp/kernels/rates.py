"""Joint rates from velocities with priorities: the linear velocity of a point first, the angular one as far as it goes.

The Jacobian is `chains.jacobian`'s: rows 0–2 the velocity of a point, rows 3–5 the angular velocity of its link.
"""

import math

from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import Array
from regrasp.kernels.stack import stack

SINGULAR = 1e-2  # pivot ratio below which a task direction counts as nearly singular and is damped
VANISHED = 1e-9  # pivot ratio below which it is not there at all


@kernel
def solve(K: Array, m: int, y: Array) -> None:
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


@kernel
def _remove(G: Array, u: Array) -> None:
    """Take the part along the unit row u out of every row of G."""
    for r in range(G.shape[0]):
        s = 0.0
        for i in range(u.shape[0]):
            s += G[r, i] * u[i]
        for i in range(u.shape[0]):
            G[r, i] -= s * u[i]


@kernel
def meet_task(J: Array, row: int, target: Array, damping: float, used: int, W: Array, out: Array) -> int:
    """out += the step that meets J[row : row + 3] out = target in the least-squares sense, not moving along W[:used].

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
    solve(K, rank, y)
    for k in range(rank):
        for i in range(n):
            out[i] += W[used + k, i] * y[k]
    return used + rank


@kernel
def rates(J: Array, v: Array, w: Array, qd: Array, w_achieved: Array) -> float:
    """Joint rates qd (n,) with J[:3] qd = v exactly and J[3:] qd = w in the least-squares sense, from `jacobian`'s J.

    Any number of joints: six realise w exactly away from singularities, fewer what they can (Siciliano & Slotine 1991,
    task priority); near a singularity of either task the rates are damped. v, w in W. Writes the angular velocity
    achieved, w_achieved = J[3:] qd, and returns |J[:3] qd − v|, zero to round-off unless J[:3] is nearly singular.
    """
    n = J.shape[1]
    W = stack((13, max(n, 3)))
    qd[:] = 0.0
    used = meet_task(J, 0, v, 0.0, 0, W, qd)
    meet_task(J, 3, w, 0.0, used, W, qd)
    defect = 0.0
    for r in range(3):
        s, t = 0.0, 0.0
        for i in range(n):
            s += J[r, i] * qd[i]
            t += J[3 + r, i] * qd[i]
        w_achieved[r] = t
        defect += (s - v[r]) ** 2
    return math.sqrt(defect)
