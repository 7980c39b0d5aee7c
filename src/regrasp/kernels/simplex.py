"""A dense dual simplex for the force program (paper §3).

Costs are never negative, so y = 0 is dual feasible: the search starts from six artificial variables without a phase 1,
and a leaving row without an entering column is a certificate of infeasibility. A cap becomes a row only when it is
violated, which keeps dual feasibility.
"""

import math

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.basis import Program, add_cap, column, combine, forget, load, pivot, remember, square, times_load
from regrasp.kernels.native import inlined, kernel, ordered
from regrasp.kernels.rotations import Array

Indices = NDArray[np.int64]

OPTIMAL, INFEASIBLE, FAILED = 0, 1, 2

# A load within this distance (weights) of what the contacts can bear counts as borne: more than the round-off of flat
# or symmetric grasps, whose matrices are singular but for it, far less than what a plan may leave unbalanced.
_PRIMAL = 1e-9
_DUAL = 1e-10
# Entries of a pivot row below this part of its length are round-off: only forces of ten weights could make use of them.
_PIVOT = 1e-10
# Residual (weights, relative to the sum of forces) above which the inverse has drifted.
_BALANCE = 1e-8
# Ratios and dual steps closer than this are equal.
_TIE = 1e-13
# Pivots without progress before Bland's rule takes over, and pivots before the solver gives up.
_STALL = 12
_LIMIT = 400
_NONE = -(1 << 62)


@inlined
def _leaving(inverse: Array, x: Array, head: Indices, m: int, bland: bool) -> int:
    """The basic variable furthest outside its bounds, measured in the space of loads (dual steepest edge), or -1.

    With `bland` the infeasible variable of the smallest index (Bland 1977), which cannot cycle.
    """
    r = -1
    most = _PRIMAL * _PRIMAL
    for i in range(m):
        if x[i] < 0.0 or (x[i] > 0.0 and -6 <= head[i] < 0):
            score = x[i] * x[i] / square(inverse, m, i)
            if score > most:
                if not bland:
                    most = score
                    r = i
                elif r < 0 or head[i] < head[r]:
                    r = i
    return r


@ordered
def _smallest_ratio(d: Array, alpha: Array, sign: float, least: float, n: int, ratio: Array) -> float:
    """Smallest d_j / -(sign α_j) over the columns with -(sign α_j) > least, inf without any; ratio gets all of them."""
    for j in range(n):
        a = -sign * alpha[j]
        ratio[j] = d[j] / a if a > least else math.inf
    step = math.inf
    for j in range(n):
        step = min(step, ratio[j])
    return step


@inlined
def _entering(P: Program, n: int, m: int, r: int, sign: float, bland: bool) -> int:
    """The variable that keeps the reduced costs ≥ 0 when row r leaves (P.alpha is its pivot row), or _NONE.

    Ties go to the largest pivot, or with `bland` to the smallest index.
    """
    inverse, rows, alpha, ratio, y = P.inverse, P.rows, P.alpha, P.ratio, P.y
    least = _PIVOT * math.sqrt(square(inverse, m, r))
    step = _smallest_ratio(P.d, alpha, sign, least, n, ratio)
    for k in range(6, m):
        a = -sign * inverse[r, k]
        if a > least:
            step = min(step, -y[rows[k]] / a)
    q = _NONE
    if step == math.inf:
        return q
    step += _TIE
    largest = 0.0
    for k in range(6, m):
        a = -sign * inverse[r, k]
        code = -1 - rows[k]
        if a > least and -y[rows[k]] <= step * a and (code < q or q == _NONE if bland else a > largest):
            q, largest = code, a
    if bland and q != _NONE:
        return q
    for j in range(n):
        if ratio[j] <= step and abs(alpha[j]) > largest:
            q, largest = j, abs(alpha[j])
            if bland:
                return q
    return q


@inlined
def _violated(P: Program, m: int) -> int:
    """The group whose cap the basic solution exceeds most, or -1."""
    if P.cap.size == 0:
        return -1
    head, share = P.head, P.share
    share[:] = 0.0
    for i in range(m):
        if head[i] >= 0:
            share[P.group[head[i]] + 1] += P.x[i]
    for k in range(6, m):
        share[P.rows[k] - 5] = 0.0
    worst = -1
    most = _PRIMAL
    for g in range(P.cap.size):
        if share[g + 1] - P.cap[g] > most:
            worst, most = g, share[g + 1] - P.cap[g]
    return worst


@inlined
def _balanced(P: Program, m: int, objective: float) -> bool:
    """Whether the basic solution bears the load and costs what the dual solution bounds, by arithmetic on the data."""
    A, b, x, y, head = P.A, P.b, P.x, P.y, P.head
    e0, e1, e2, e3, e4, e5 = b[0], b[1], b[2], b[3], b[4], b[5]
    total = 1.0
    for i in range(m):
        j = head[i]
        if j >= 0:
            u = x[i]
            total += abs(u)
            e0 -= A[0, j] * u
            e1 -= A[1, j] * u
            e2 -= A[2, j] * u
            e3 -= A[3, j] * u
            e4 -= A[4, j] * u
            e5 -= A[5, j] * u
    bound = y[0] * b[0] + y[1] * b[1] + y[2] * b[2] + y[3] * b[3] + y[4] * b[4] + y[5] * b[5]
    for k in range(6, m):
        bound += y[P.rows[k]] * P.cap[P.rows[k] - 6]
    error = max(max(abs(e0), abs(e1), abs(e2)), max(abs(e3), abs(e4), abs(e5)), abs(bound - objective))
    return bool(error <= _BALANCE * total)


@inlined
def _start(P: Program, n: int) -> int:
    """Load P.basis, or all logical variables where P.basis is not dual feasible; returns the number of active rows."""
    m = 0
    for _ in range(2):
        m = load(P, n)
        feasible = True
        for j in range(n):
            feasible &= P.d[j] >= -_DUAL
        for k in range(6, m):
            feasible &= P.y[P.rows[k]] <= _DUAL
        if feasible:
            break
        forget(P.basis)
    return m


@kernel
def solve(P: Program, n: int, warm: bool) -> tuple[int, float, int]:
    """Solve the program over its first n columns: (status, objective, pivots).

    OPTIMAL: P.solution holds λ, P.y the dual solution: c_j ≥ yᵀ(column j), caps included, y[6:] ≤ 0, and the objective
    is yᵀ(b, caps). INFEASIBLE: P.y is a Farkas ray: yᵀ(column j) ≤ 0 for every column, y[6:] ≤ 0 and yᵀ(b, caps) > 0,
    where a column's entry in row 6+g is 1 if it belongs to group g; the objective is inf. FAILED: the pivot
    limit or round-off; the objective is nan. Data that are not finite never end OPTIMAL.

    With `warm` the search starts from P.basis, which may come from any earlier program; where that is not dual
    feasible for this one it starts afresh, so the optimal value never depends on it.
    """
    A, group, rows, head, inverse = P.A, P.group, P.rows, P.head, P.inverse
    x, y, w, d, alpha = P.x, P.y, P.w, P.d, P.alpha
    if not warm:
        forget(P.basis)
    sound = False
    m = 0
    stalled = 0
    pivots = 0
    while pivots < _LIMIT:
        if not sound:
            m = _start(P, n)
            sound = True
        r = _leaving(inverse, x, head, m, stalled > _STALL)
        if r < 0:
            g = _violated(P, m)
            if g >= 0:
                add_cap(P, m, g)
                m += 1
                continue
            objective = 0.0
            for i in range(m):
                if head[i] >= 0:
                    objective += P.cost[head[i]] * x[i]
            remember(P, m)
            if _balanced(P, m, objective):
                for j in range(n):
                    P.solution[j] = 0.0
                for i in range(m):
                    if head[i] >= 0:
                        P.solution[head[i]] = max(x[i], 0.0)
                return OPTIMAL, objective, pivots
        else:
            sign = 1.0 if x[r] < 0.0 else -1.0
            combine(A, group, rows, P.share, n, m, inverse[r], alpha)
            q = _entering(P, n, m, r, sign, stalled > _STALL)
            if q == _NONE:
                remember(P, m)
                excess = -sign * times_load(inverse, P.b, P.cap, rows, m, r)
                if excess > _PRIMAL * math.sqrt(square(inverse, m, r)):
                    y[:] = 0.0
                    for k in range(m):
                        y[rows[k]] = -sign * inverse[r, k]
                    return INFEASIBLE, math.inf, pivots
            else:
                column(A, group, rows, inverse, m, q, w)
                a = alpha[q] if q >= 0 else w[r]
                if abs(w[r] - a) <= 1e-8 * (1.0 + abs(a)):
                    step = max(d[q] if q >= 0 else -y[-1 - q], 0.0) / a
                    stalled = 0 if step * x[r] > _TIE else stalled + 1
                    for j in range(n):
                        d[j] -= step * alpha[j]
                    for k in range(m):
                        y[rows[k]] += step * inverse[r, k]
                    move = x[r] / w[r]
                    for i in range(m):
                        x[i] -= move * w[i]
                    x[r] = move
                    pivot(inverse, w, m, m, r)
                    head[r] = q
                    pivots += 1
                    continue
                remember(P, m)
        # The data did not confirm what the inverse says, so it has drifted: load the basis again, then start afresh.
        if pivots >= _LIMIT // 3:
            forget(P.basis)
        sound = False
        pivots += _LIMIT // 3
    return FAILED, math.nan, pivots
