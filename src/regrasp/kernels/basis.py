"""The force program and its bases: a dense basis matrix with an explicit inverse over the active rows.

The rows are equilibrium (always active) and those caps that were violated on the way.
"""

import math

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import inlined
from regrasp.kernels.records import Record
from regrasp.kernels.rotations import Array

Indices = NDArray[np.int64]

# A column whose best pivot is smaller depends on the others.
_SINGULAR = 1e-6


class Program(Record):
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
    table: Array  # (6+G, 6+G) the basis as it is inverted
    place: Indices  # (6+G,) the columns of the table, then their places in the basis
    w: Array  # (6+G,) pivot column
    d: Array  # (N,) reduced costs
    alpha: Array  # (N,) pivot row
    ratio: Array  # (N,) of the ratio test
    share: Array  # (1+G,) per group, entry 0 for columns without one
    arm: Array  # (N / 8, 3) scratch for who fills the program, as are the three below: contacts from the centre of mass
    sticks: NDArray[np.uint8]  # (N / 8,) whether they stick
    sigma: Array  # (N / 8,) their shares in a disturbance
    least: Array  # (G,) what a group bears at least


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
        table=np.zeros((rows, rows)),
        place=np.zeros(rows, np.int64),
        w=np.zeros(rows),
        d=np.zeros(columns),
        alpha=np.zeros(columns),
        ratio=np.zeros(columns),
        share=np.zeros(1 + groups),
        arm=np.zeros((columns // 8, 3)),
        sticks=np.zeros(columns // 8, np.uint8),
        sigma=np.zeros(columns // 8),
        least=np.zeros(groups),
    )


@inlined
def combine(A: Array, group: Indices, rows: Indices, share: Array, n: int, m: int, v: Array, out: Array) -> None:
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


@inlined
def column(A: Array, group: Indices, rows: Indices, inverse: Array, m: int, q: int, w: Array) -> None:
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


@inlined
def pivot(inverse: Array, w: Array, m: int, width: int, r: int) -> None:
    """The variable with column w (m,) takes place r of the basis: product-form update of the inverse (m, width)."""
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
    for k in range(6, width):
        t = s * inverse[r, k]
        for i in range(m):
            inverse[i, k] -= w[i] * t
        inverse[r, k] = t


@inlined
def square(inverse: Array, m: int, i: int) -> float:
    """Squared length of row i of the inverse."""
    s = 0.0
    for k in range(6):
        s += inverse[i, k] * inverse[i, k]
    for k in range(6, m):
        s += inverse[i, k] * inverse[i, k]
    return s


@inlined
def times_load(inverse: Array, b: Array, cap: Array, rows: Indices, m: int, i: int) -> float:
    """Row i of the inverse times the right-hand side (b, caps) of the active rows."""
    s = 0.0
    for k in range(6):
        s += inverse[i, k] * b[k]
    for k in range(6, m):
        s += inverse[i, k] * cap[rows[k] - 6]
    return s


@inlined
def load(P: Program, n: int) -> int:
    """Factor P.basis from scratch and derive x, y and d; returns the number of active rows.

    Columns that depend on the others are left out, the logical variables of the uncovered rows stay in their place.
    """
    A, group, rows, head, inverse, table, place, x, y, w = (
        P.A, P.group, P.rows, P.head, P.inverse, P.table, P.place, P.x, P.y, P.w
    )  # fmt: skip
    total = y.size
    y[:] = 1.0
    for i in range(total):
        if P.basis[i] < 0:
            y[-1 - P.basis[i]] = 0.0  # this row keeps its logical variable
    m = 0
    for row in range(total):
        if row < 6 or (y[row] > 0.0 and P.cap[row - 6] < math.inf):
            rows[m] = row
            head[m] = -1 - row
            x[m] = y[row]  # whether a column may take the place
            m += 1
    columns = 0
    for i in range(total):
        q = P.basis[i]
        if 0 <= q < n:
            for k in range(6):
                table[k, columns] = A[k, q]
            for k in range(6, m):
                table[k, columns] = 1.0 if rows[k] == 6 + group[q] else 0.0
            place[columns] = q
            columns += 1
    for c in range(columns, 6):
        for k in range(m):
            table[k, c] = 0.0
    # Gauss-Jordan in place: where a column becomes a unit column, the inverse's column of its place is kept instead.
    for c in range(columns):
        r = -1
        largest = _SINGULAR
        for k in range(m):
            size = x[k] * abs(table[k, c])
            if size > largest:
                r, largest = k, size
        q = place[c]
        place[c] = r
        if r >= 0:
            head[r] = q
            x[r] = 0.0
            for k in range(m):
                w[k] = table[k, c]
                table[k, c] = 0.0
            table[r, c] = 1.0
            pivot(table, w, m, columns, r)
    for i in range(m):
        for k in range(m):
            inverse[i, k] = 0.0
        inverse[i, i] = 1.0
    for c in range(columns):
        r = place[c]
        if r >= 0:
            for i in range(m):
                inverse[i, r] = table[i, c]
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
        combine(A, group, rows, P.share, n, m, w, P.d)
        for j in range(n):
            P.d[j] = P.cost[j] - P.d[j]
    for i in range(m):
        P.x[i] = times_load(inverse, P.b, P.cap, rows, m, i)
    return m


@inlined
def add_cap(P: Program, m: int, g: int) -> None:
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


@inlined
def forget(basis: Indices) -> None:
    """The basis of all logical variables."""
    for i in range(basis.size):
        basis[i] = -1 - i


@inlined
def remember(P: Program, m: int) -> None:
    """P.basis = the basis of the complete program: inactive caps have their slack basic."""
    forget(P.basis)
    for k in range(m):
        P.basis[P.rows[k]] = P.head[k]
