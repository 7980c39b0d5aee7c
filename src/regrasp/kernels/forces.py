"""Contact forces (paper §3): the linear program over linearised friction cones, solved by a dense dual simplex.

minimise cᵀλ subject to Aλ = b (six rows: forces, torques / length), λ ≥ 0, Σ_{group(e) = g} λ_e ≤ cap_g.

Each column of A is one generator of a contact's cone with normal component 1, so λ_e is a normal force; c_e is 1 for an
agent's contact and 0 for a passive one. Costs are never negative, so y = 0 is dual feasible: the dual simplex starts from
six artificial variables without a phase 1, and a leaving row without an entering column is a certificate of infeasibility.
A cap becomes a row only when it is violated, which keeps dual feasibility. Forces are in units of the object's weight.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

OPTIMAL, INFEASIBLE, FAILED = 0, 1, 2

EDGES = 8
_H = math.sqrt(0.5)
_COS = (1.0, _H, 0.0, -_H, -1.0, -_H, 0.0, _H)
_SIN = (0.0, _H, 1.0, _H, 0.0, -_H, -1.0, -_H)

# A basic variable is infeasible when moving the load by more than this (in weights) would be needed to mend it.
_PRIMAL = 1e-11
_DUAL = 1e-10
# Entries of a pivot row below this part of its length are round-off.
_PIVOT = 1e-9
# A column of a given basis whose best pivot is smaller depends on the others.
_SINGULAR = 1e-6
# Ratios and dual steps closer than this are equal.
_TIE = 1e-13
# Residual (in weights, relative to the sum of forces) above which the inverse has drifted.
_BALANCE = 1e-11
# Pivots without progress before Bland's rule takes over, and pivots before the solver gives up.
_STALL = 12
_LIMIT = 400
_NONE = -(1 << 62)


class Program(NamedTuple):
    """The program's data, its result and the solver's work space, for up to N columns and G groups.

    Rows 0–5 are equilibrium, row 6+g is the cap of group g. A basis holds one variable per row: j ≥ 0 is column j,
    -1-i the logical variable of row i (an artificial fixed at zero for i < 6, the cap's slack otherwise).
    """

    A: Array  # (6, N) force / weight and torque / (weight · length) of each column
    b: Array  # (6,) what the contacts have to bear: minus the external wrench
    cost: Array  # (N,) ≥ 0
    group: Indices  # (N,) the group whose cap a column counts against, or -1
    cap: Array  # (G,) largest sum of a group's λ, may be inf
    solution: Array  # (N,) λ
    y: Array  # (6+G,) dual solution or Farkas ray, see solve
    basis: Indices  # (6+G,) the last basis
    inverse: Array  # (6+G, 6+G) of the basis matrix over the active rows
    x: Array  # (6+G,) values of the basic variables
    head: Indices  # (6+G,) the basic variables over the active rows
    rows: Indices  # (6+G,) the active rows
    w: Array  # (6+G,) pivot column
    d: Array  # (N,) reduced costs
    alpha: Array  # (N,) pivot row
    ratio: Array  # (N,) of the ratio test
    share: Array  # (1+G,) per group, entry 0 for columns without one


def program(columns: int, groups: int) -> Program:
    """An empty program for up to `columns` columns and exactly `groups` groups: no load, unit costs, no caps."""
    rows = 6 + groups
    return Program(
        A=np.zeros((6, columns)),
        b=np.zeros(6),
        cost=np.ones(columns),
        group=np.full(columns, -1),
        cap=np.full(groups, np.inf),
        solution=np.zeros(columns),
        y=np.zeros(rows),
        basis=-1 - np.arange(rows),
        inverse=np.zeros((rows, rows)),
        x=np.zeros(rows),
        head=np.zeros(rows, np.int64),
        rows=np.zeros(rows, np.int64),
        w=np.zeros(rows),
        d=np.zeros(columns),
        alpha=np.zeros(columns),
        ratio=np.zeros(columns),
        share=np.zeros(1 + groups),
    )


@njit(cache=True, nogil=True)
def friction_edges(
    p: Array, n_in: Array, x: Array, y: Array, mu: float, length: float, A: Array, first: int
) -> None:
    """The EDGES edges of a friction cone as columns first … first+EDGES-1 of A: [f; p × f / length].

    f = n_in + μ (cos θ x + sin θ y), θ = 2π e / EDGES; n_in is the unit normal into the object, x and y are unit
    tangents, p is the contact point from the centre of mass (m), all in W. The pyramid lies inside the cone.
    """
    a0 = p[1] * n_in[2] - p[2] * n_in[1]
    a1 = p[2] * n_in[0] - p[0] * n_in[2]
    a2 = p[0] * n_in[1] - p[1] * n_in[0]
    x0 = p[1] * x[2] - p[2] * x[1]
    x1 = p[2] * x[0] - p[0] * x[2]
    x2 = p[0] * x[1] - p[1] * x[0]
    y0 = p[1] * y[2] - p[2] * y[1]
    y1 = p[2] * y[0] - p[0] * y[2]
    y2 = p[0] * y[1] - p[1] * y[0]
    s = 1.0 / length
    for e in range(EDGES):
        u = mu * _COS[e]
        v = mu * _SIN[e]
        j = first + e
        A[0, j] = n_in[0] + u * x[0] + v * y[0]
        A[1, j] = n_in[1] + u * x[1] + v * y[1]
        A[2, j] = n_in[2] + u * x[2] + v * y[2]
        A[3, j] = s * (a0 + u * x0 + v * y0)
        A[4, j] = s * (a1 + u * x1 + v * y1)
        A[5, j] = s * (a2 + u * x2 + v * y2)


@njit(cache=True, nogil=True)
def ray(p: Array, n_in: Array, t: Array, mu: float, length: float, A: Array, at: int) -> None:
    """The one boundary ray of a sliding contact as column `at` of A: f = n_in + μ t, t the unit direction of friction.

    For a tip t is its slip v relative to the object, for a support it is minus the object's (Coulomb); see friction_edges.
    """
    f0 = n_in[0] + mu * t[0]
    f1 = n_in[1] + mu * t[1]
    f2 = n_in[2] + mu * t[2]
    s = 1.0 / length
    A[0, at] = f0
    A[1, at] = f1
    A[2, at] = f2
    A[3, at] = s * (p[1] * f2 - p[2] * f1)
    A[4, at] = s * (p[2] * f0 - p[0] * f2)
    A[5, at] = s * (p[0] * f1 - p[1] * f0)


@njit(cache=True, nogil=True)
def contact_forces(A: Array, solution: Array, first: Indices, weight: float, f: Array) -> None:
    """f[i] = weight Σ λ_e A[:3, e] over the columns first[i] ≤ e < first[i+1] of contact i: (k, 3), N, in W."""
    for i in range(f.shape[0]):
        for r in range(3):
            s = 0.0
            for e in range(first[i], first[i + 1]):
                s += solution[e] * A[r, e]
            f[i, r] = weight * s


@njit(cache=True, nogil=True, forceinline=True)
def _combine(A: Array, group: Indices, rows: Indices, share: Array, n: int, m: int, v: Array, out: Array) -> None:
    """out_j = vᵀ (column j over the active rows)."""
    v0, v1, v2, v3, v4, v5 = v[0], v[1], v[2], v[3], v[4], v[5]
    for j in range(n):
        out[j] = v0 * A[0, j] + v1 * A[1, j] + v2 * A[2, j] + v3 * A[3, j] + v4 * A[4, j] + v5 * A[5, j]
    if m > 6:
        share[:] = 0.0
        for k in range(6, m):
            share[rows[k] - 5] = v[k]
        for j in range(n):
            out[j] += share[group[j] + 1]


@njit(cache=True, nogil=True, forceinline=True)
def _column(A: Array, group: Indices, rows: Indices, inverse: Array, m: int, q: int, w: Array) -> None:
    """w = B⁻¹ times the column of variable q over the active rows."""
    if q >= 0:
        a0, a1, a2, a3, a4, a5 = A[0, q], A[1, q], A[2, q], A[3, q], A[4, q], A[5, q]
        for i in range(m):
            w[i] = (
                inverse[i, 0] * a0
                + inverse[i, 1] * a1
                + inverse[i, 2] * a2
                + inverse[i, 3] * a3
                + inverse[i, 4] * a4
                + inverse[i, 5] * a5
            )
    else:
        for i in range(m):
            w[i] = 0.0
    row = 6 + group[q] if q >= 0 else -1 - q
    for k in range(6, m):
        if rows[k] == row:
            for i in range(m):
                w[i] += inverse[i, k]


@njit(cache=True, nogil=True, forceinline=True)
def _pivot(inverse: Array, w: Array, m: int, r: int) -> None:
    """The variable with column w takes place r of the basis: product-form update of the inverse."""
    s = 1.0 / w[r]
    r0, r1, r2 = s * inverse[r, 0], s * inverse[r, 1], s * inverse[r, 2]
    r3, r4, r5 = s * inverse[r, 3], s * inverse[r, 4], s * inverse[r, 5]
    for i in range(m):
        u = w[i]
        inverse[i, 0] -= u * r0
        inverse[i, 1] -= u * r1
        inverse[i, 2] -= u * r2
        inverse[i, 3] -= u * r3
        inverse[i, 4] -= u * r4
        inverse[i, 5] -= u * r5
    inverse[r, 0], inverse[r, 1], inverse[r, 2] = r0, r1, r2
    inverse[r, 3], inverse[r, 4], inverse[r, 5] = r3, r4, r5
    for k in range(6, m):
        t = s * inverse[r, k]
        for i in range(m):
            inverse[i, k] -= w[i] * t
        inverse[r, k] = t


@njit(cache=True, nogil=True, forceinline=True)
def _times_load(inverse: Array, b: Array, cap: Array, rows: Indices, m: int, i: int) -> float:
    """Row i of the inverse times the right-hand side (b, caps) of the active rows."""
    s = 0.0
    for k in range(6):
        s += inverse[i, k] * b[k]
    for k in range(6, m):
        s += inverse[i, k] * cap[rows[k] - 6]
    return s


@njit(cache=True, nogil=True, forceinline=True)
def _load(P: Program, n: int) -> int:
    """Factor P.basis from scratch and derive x, y and d; returns the number of active rows.

    Columns that depend on the others are left out, the logical variables of the uncovered rows stay in their place.
    """
    A, group, rows, head, inverse, w, y = P.A, P.group, P.rows, P.head, P.inverse, P.w, P.y
    total = y.size
    y[:] = 0.0
    for i in range(total):
        if P.basis[i] < 0:
            y[-1 - P.basis[i]] = 1.0  # this row keeps its logical variable
    m = 0
    for row in range(total):
        if row < 6 or (y[row] == 0.0 and P.cap[row - 6] < math.inf):
            rows[m] = row
            head[m] = -1 - row
            m += 1
    for i in range(m):
        for k in range(m):
            inverse[i, k] = 0.0
        inverse[i, i] = 1.0
    columns = 0
    for i in range(total):
        q = P.basis[i]
        if 0 <= q < n:
            columns += 1
            _column(A, group, rows, inverse, m, q, w)
            r = -1
            largest = _SINGULAR
            for k in range(m):
                if head[k] < 0 and y[rows[k]] == 0.0 and abs(w[k]) > largest:
                    r, largest = k, abs(w[k])
            if r >= 0:
                _pivot(inverse, w, m, r)
                head[r] = q
    y[:] = 0.0
    if columns == 0:
        for j in range(n):
            P.d[j] = P.cost[j]
    else:
        for k in range(m):
            s = 0.0
            for i in range(m):
                if head[i] >= 0:
                    s += P.cost[head[i]] * inverse[i, k]
            w[k] = s
            y[rows[k]] = s
        _combine(A, group, rows, P.share, n, m, w, P.d)
        for j in range(n):
            P.d[j] = P.cost[j] - P.d[j]
    for i in range(m):
        P.x[i] = _times_load(inverse, P.b, P.cap, rows, m, i)
    return m


@njit(cache=True, nogil=True, forceinline=True)
def _leaving(inverse: Array, x: Array, head: Indices, m: int, bland: bool) -> int:
    """The basic variable furthest outside its bounds, measured in the space of loads (dual steepest edge), or -1.

    With `bland` the infeasible variable of the smallest index (Bland 1977), which cannot cycle.
    """
    r = -1
    most = _PRIMAL * _PRIMAL
    for i in range(m):
        if x[i] < 0.0 or (x[i] > 0.0 and -6 <= head[i] < 0):
            score = x[i] * x[i] / _square(inverse, m, i)
            if score > most:
                if not bland:
                    most = score
                    r = i
                elif r < 0 or head[i] < head[r]:
                    r = i
    return r


@njit(cache=True, nogil=True, forceinline=True)
def _square(inverse: Array, m: int, i: int) -> float:
    """Squared length of row i of the inverse."""
    s = 0.0
    for k in range(6):
        s += inverse[i, k] * inverse[i, k]
    for k in range(6, m):
        s += inverse[i, k] * inverse[i, k]
    return s


@njit(cache=True, nogil=True, forceinline=True, fastmath={"nnan", "nsz"})
def _smallest_ratio(d: Array, alpha: Array, sign: float, least: float, n: int, ratio: Array) -> float:
    """Smallest d_j / -(sign α_j) over the columns with -(sign α_j) > least, inf without any; ratio gets all of them."""
    for j in range(n):
        a = -sign * alpha[j]
        ratio[j] = d[j] / a if a > least else math.inf
    step = math.inf
    for j in range(n):
        step = min(step, ratio[j])
    return step


@njit(cache=True, nogil=True, forceinline=True)
def _entering(P: Program, n: int, m: int, r: int, sign: float, bland: bool) -> int:
    """The variable that keeps the reduced costs ≥ 0 when row r leaves (P.alpha is its pivot row), or _NONE.

    Ties go to the largest pivot, or with `bland` to the smallest index.
    """
    inverse, rows, alpha, ratio, y = P.inverse, P.rows, P.alpha, P.ratio, P.y
    least = _PIVOT * math.sqrt(_square(inverse, m, r))
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
        if a > least and -y[rows[k]] <= step * a and a > largest:
            q, largest = -1 - rows[k], a
            if bland:
                return q
    for j in range(n):
        if ratio[j] <= step and abs(alpha[j]) > largest:
            q, largest = j, abs(alpha[j])
            if bland:
                return q
    return q


@njit(cache=True, nogil=True, forceinline=True)
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


@njit(cache=True, nogil=True, forceinline=True)
def _add_cap(P: Program, m: int, g: int) -> None:
    """Row m becomes the cap of group g with its slack basic: the reduced costs stay as they are."""
    inverse, head = P.inverse, P.head
    value = P.cap[g]
    for k in range(m):
        inverse[m, k] = 0.0
        inverse[k, m] = 0.0
    for i in range(m):
        if head[i] >= 0 and P.group[head[i]] == g:
            value -= P.x[i]
            for k in range(m):
                inverse[m, k] -= inverse[i, k]
    inverse[m, m] = 1.0
    P.rows[m] = 6 + g
    head[m] = -7 - g
    P.x[m] = value


@njit(cache=True, nogil=True, forceinline=True)
def _balanced(P: Program, m: int, objective: float) -> bool:
    """Whether the basic solution balances the load and its cost equals the dual objective, by arithmetic on the data."""
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
    return error <= _BALANCE * total


@njit(cache=True, nogil=True, forceinline=True)
def _forget(basis: Indices) -> None:
    """The basis of all logical variables."""
    for i in range(basis.size):
        basis[i] = -1 - i


@njit(cache=True, nogil=True, forceinline=True)
def _remember(P: Program, m: int) -> None:
    """P.basis = the basis of the complete program: inactive caps have their slack basic."""
    _forget(P.basis)
    for k in range(m):
        P.basis[P.rows[k]] = P.head[k]


@njit(cache=True, nogil=True, forceinline=True)
def _start(P: Program, n: int) -> int:
    """Load P.basis, or all logical variables where P.basis is not dual feasible; returns the number of active rows."""
    while True:
        m = _load(P, n)
        feasible = True
        for j in range(n):
            feasible &= P.d[j] >= -_DUAL
        for k in range(6, m):
            feasible &= P.y[P.rows[k]] <= _DUAL
        if feasible:
            return m
        _forget(P.basis)


@njit(cache=True, nogil=True)
def solve(P: Program, n: int, warm: bool) -> tuple[int, float, int]:
    """Solve the program over its first n columns: (status, objective, pivots).

    OPTIMAL: P.solution holds λ, P.y the dual solution: c_j ≥ yᵀ(column j), caps included, y[6:] ≤ 0, and the objective
    is yᵀ(b, caps). INFEASIBLE: P.y is a Farkas ray: yᵀ(column j) ≤ 0 for every column, y[6:] ≤ 0 and yᵀ(b, caps) > 0,
    where a column's entry in row 6+g is 1 if it belongs to group g; the objective is inf. FAILED (never met on a
    sound program): the pivot limit or round-off; the objective is nan.

    With `warm` the search starts from P.basis, which may come from any earlier program; where that is not dual
    feasible for this one it starts afresh, so the optimal value never depends on it.
    """
    A, group, rows, head, inverse = P.A, P.group, P.rows, P.head, P.inverse
    x, y, w, d, alpha = P.x, P.y, P.w, P.d, P.alpha
    if not warm:
        _forget(P.basis)
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
                _add_cap(P, m, g)
                m += 1
                continue
            objective = 0.0
            for i in range(m):
                if head[i] >= 0:
                    objective += P.cost[head[i]] * x[i]
            _remember(P, m)
            if _balanced(P, m, objective):
                for j in range(n):
                    P.solution[j] = 0.0
                for i in range(m):
                    if head[i] >= 0:
                        P.solution[head[i]] = max(x[i], 0.0)
                return OPTIMAL, objective, pivots
        else:
            sign = 1.0 if x[r] < 0.0 else -1.0
            _combine(A, group, rows, P.share, n, m, inverse[r], alpha)
            q = _entering(P, n, m, r, sign, stalled > _STALL)
            if q == _NONE:
                _remember(P, m)
                excess = -sign * _times_load(inverse, P.b, P.cap, rows, m, r)
                if excess > _PRIMAL * math.sqrt(_square(inverse, m, r)):
                    y[:] = 0.0
                    for k in range(m):
                        y[rows[k]] = -sign * inverse[r, k]
                    return INFEASIBLE, math.inf, pivots
            else:
                _column(A, group, rows, inverse, m, q, w)
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
                    _pivot(inverse, w, m, r)
                    head[r] = q
                    pivots += 1
                    continue
                _remember(P, m)
        # The data did not confirm what the inverse says, so it has drifted: load the basis again, then start afresh.
        if pivots >= _LIMIT // 3:
            _forget(P.basis)
        sound = False
        pivots += _LIMIT // 3
    return FAILED, math.nan, pivots
