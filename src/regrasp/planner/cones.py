"""The cone program of the plan's forces, at the instants (nodes) between intervals and, where asked for, within them."""

from dataclasses import dataclass

import clarabel
import numpy as np
from numpy.typing import NDArray

from regrasp.plan import NONE, SLIDE
from regrasp.planner.contacts import Contacts, bases, wrenches
from regrasp.planner.reserve import Margins, shares, spare

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

PENALTY = 1e3
"""P: large enough that an agent lacks of what it has to spare only where it must."""
JOIN = 100.0
"""Weight, in ω, of a change that has no time: where a sliding contact's direction jumps from one interval to the next."""
SAME = 1e-6
"""Directions of sliding that differ by less are one."""


@dataclass(frozen=True)
class Nodes:
    """Instants at which the program has forces: B of them, in time order, and the contacts there.

    of (N, M): the node of each sample, −1 for none; two intervals share the node between them. source (B, 2): interval and
    sample that a node's contacts are taken from. ray (B, C): the contact has one direction. basis (B, C, 3, 3): orthonormal
    columns that span a contact's forces; free (B, C, 3): which columns count. inward, p (B, C, 3). gap (B − 1,): intervals
    from each node to the next; span (B,): intervals that a node stands for.
    """

    of: Ints
    source: Ints
    ray: NDArray[np.bool_]
    basis: Array
    free: NDArray[np.bool_]
    inward: Array
    p: Array
    gap: Array
    span: Array


def nodes_of(contacts: Contacts, margin: float, dense: NDArray[np.bool_]) -> Nodes:
    """The nodes: the ends of all intervals, and every sample of the dense ones."""
    N, M, _ = contacts.p_W.shape[:3]
    ray, basis, free = bases(contacts, margin)
    at = np.zeros((N, M), bool)
    at[:, [0, -1]] = True
    at[dense] = True
    # The end of an interval and the beginning of the next are one node, unless a contact slides in two directions there.
    slides = contacts.mode == SLIDE
    jump = np.linalg.norm(contacts.slip_W[1:, 0] - contacts.slip_W[:-1, -1], axis=-1) > SAME
    split = np.any(slides[1:] & slides[:-1] & jump, axis=1)
    opens = at.copy()
    opens[1:, 0] = split
    of = np.where(at, np.cumsum(opens).reshape(N, M) - 1, -1)
    of[1:, 0] = np.where(split, of[1:, 0], of[:-1, -1])
    # A shared node takes its contacts from the interval in which something moves: there they slide, if at all.
    source = np.zeros((int(of.max()) + 1, 2), np.int64)
    for still in (True, False):
        j, s = np.nonzero(at & (contacts.moves != still)[:, None])
        source[of[j, s]] = np.stack([j, s], axis=1)
    j, s = source.T
    bears = np.ones((len(source), contacts.mode.shape[1]), bool)
    np.logical_and.at(bears, of[at], np.repeat((contacts.mode != NONE)[:, None], M, axis=1)[at])
    time = (np.arange(N)[:, None] + np.linspace(0.0, 1.0, M))[j, s]
    gap = np.maximum(np.diff(time), 0.0)
    span = 0.5 * (np.append(gap, 0.0) + np.append(0.0, gap))
    return Nodes(
        of,
        source,
        ray[j, s],
        basis[j, s],
        free[j, s] & bears[..., None],
        contacts.inward_W[j, s],
        contacts.p_W[j, s],
        gap,
        span,
    )


def tangents(n: Array) -> Array:
    """(…, 2, 3): two unit vectors across each unit normal and each other."""
    x = np.cross(n, np.eye(3)[np.argmin(np.abs(n), axis=-1)])
    x /= np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-300)
    return np.stack([x, np.cross(n, x)], axis=-2)


@dataclass(frozen=True)
class Sparse:
    """A matrix by compressed columns, as clarabel reads it from scipy, whose import takes longer than the solution.

    data (e,): entries, column by column; indices (e,): their rows; indptr (width + 1,): where each column starts.
    """

    data: Array
    indices: Ints
    indptr: Ints
    shape: tuple[int, int]
    has_canonical_format: bool = True  # rows in order, every place once


def sparse(values: Array, row: Ints, column: Ints, shape: tuple[int, int]) -> Sparse:
    """The matrix with the given entries (e,), which are at different places."""
    order = np.lexsort((row, column))
    starts = np.searchsorted(column[order], np.arange(shape[1] + 1))
    return Sparse(values[order], row[order], starts, shape)


class Rows:
    """Constraints A x + s = b, s in cones, block by block."""

    def __init__(self) -> None:
        self.entries: list[tuple[Array, Ints, Ints]] = []
        self.sides: list[Array] = []
        self.cones: list[object] = []
        self.count = 0

    def add(self, values: Array, row: Ints, column: Ints, side: Array, cones: list[object]) -> None:
        """Entries of A, rows counted from the block's first (both broadcast to the values), unless column is −1."""
        row, column = np.broadcast_to(row, values.shape), np.broadcast_to(column, values.shape)
        used = (column >= 0) & (values != 0.0)
        self.entries.append((values[used], row[used] + self.count, column[used]))
        self.sides.append(side)
        self.count += len(side)
        self.cones += cones

    def matrix(self, width: int) -> Sparse:
        """A."""
        values, row, column = (np.concatenate(part) for part in zip(*self.entries, strict=True))
        return sparse(values, row, column, (self.count, width))


def solve(contacts: Contacts, nodes: Nodes, margins: Margins, smoothness: float) -> Array | None:
    """The forces at the nodes, in the basis (B, C, 3), or None where there are none.

    Whether what it returns is exact enough is for the caller to say.
    """
    bears = nodes.free[..., 0]
    count = int(np.sum(nodes.free))
    column = np.where(nodes.free, np.cumsum(nodes.free).reshape(nodes.free.shape) - 1, -1)
    least = spares(contacts, nodes, margins)
    short = bears & (least > 0.0)  # contacts with an unknown for what they lack of it
    lack = count + np.cumsum(short).reshape(short.shape) - 1
    width = count + int(np.sum(short))
    linear = np.zeros(width)
    linear[count:] = PENALTY
    rows = constraints(contacts, nodes, margins, least, column, short, lack)
    options = clarabel.DefaultSettings()
    options.verbose = False
    options.direct_solve_method = "qdldl"  # one thread: the same forces on every machine
    quadratic = objective(nodes, column, width, smoothness)
    side = np.concatenate(rows.sides)
    answer = clarabel.DefaultSolver(quadratic, linear, rows.matrix(width), side, rows.cones, options).solve()
    if answer.status in (clarabel.SolverStatus.PrimalInfeasible, clarabel.SolverStatus.AlmostPrimalInfeasible):
        return None
    x = np.append(np.asarray(answer.x), 0.0)
    return np.where(nodes.free, x[column], 0.0)


def spares(contacts: Contacts, nodes: Nodes, margins: Margins) -> Array:
    """The normal force, in weights, that each contact has to spare at each node (B, C); supports have none.

    As in the search's program, `balance.spares`.
    """
    least = np.zeros(nodes.free.shape[:2])
    sticks = (nodes.free[..., 0] & ~nodes.ray).astype(np.uint8)
    share = np.zeros(sticks.shape[1])
    for b in range(len(sticks)):
        shares(nodes.p[b], sticks[b], contacts.shifts, contacts.turns, share)
        for i in np.flatnonzero(contacts.grips):
            least[b, i] = spare(margins, contacts.mu[i], share[i], contacts.cap[i])
    return np.where(nodes.free[..., 0], least, 0.0)


def objective(nodes: Nodes, column: Ints, width: int, smoothness: float) -> Sparse:
    """The matrix P of ½ xᵀ P x = Σ |f|² + ω Σ |Δf|², both as integrals over the intervals by the trapezoidal rule.

    Its upper triangle: each contact's basis at one node meets itself and, where two nodes are neighbours, the next one's.
    """
    weight = smoothness * np.where(nodes.gap > 0.0, 1.0 / np.maximum(nodes.gap, 1e-12), JOIN)
    same = nodes.span + np.append(weight, 0.0) + np.append(0.0, weight)
    blocks = []
    for a, b, factor in ((slice(None), slice(None), same), (slice(None, -1), slice(1, None), -weight)):
        values = np.einsum("bcae,bcaf,b->bcef", nodes.basis[a], nodes.basis[b], 2.0 * factor)
        row, place = np.broadcast_arrays(column[a][..., None], column[b][..., None, :])
        used = (row >= 0) & (place >= row) & (values != 0.0)
        blocks.append((values[used], row[used], place[used]))
    values, row, place = (np.concatenate(part) for part in zip(*blocks, strict=True))
    return sparse(values, row, place, (width, width))


def constraints(
    contacts: Contacts, nodes: Nodes, margins: Margins, least: Array, column: Ints, short: NDArray[np.bool_], lack: Ints
) -> Rows:
    """Equilibrium, limits, friction and what is to spare, at every node.

    The unknowns are in columns: `column` (B, C, 3) has the forces, `lack` (B, C), where a contact is `short`, how much less
    normal force it has to spare than least (B, C).
    """
    bears = nodes.free[..., 0]
    normal = np.einsum("bca,bcae->bce", nodes.inward, nodes.basis)
    rows = Rows()

    B = len(nodes.free)
    six = 6 * np.arange(B)[:, None, None, None] + np.arange(6)[:, None]
    side = np.tile(np.append(contacts.load_W, np.zeros(3)), B)
    rows.add(wrenches(nodes.p, nodes.basis), six, column[:, :, None], side, [clarabel.ZeroConeT(6 * B)])

    def bound(at: NDArray[np.bool_], sign: float, side: Array) -> None:
        """sign · f_n ≤ side, for the contacts `at` (B, C)."""
        b, c = np.nonzero(at)
        cones = [clarabel.NonnegativeConeT(len(b))]
        rows.add(sign * normal[b, c], np.arange(len(b))[:, None], column[b, c], side[b, c], cones)

    bound(bears & nodes.ray, -1.0, np.zeros(bears.shape))
    cap = np.where(nodes.ray & contacts.grips, np.minimum(contacts.cap, margins.slide), contacts.cap)
    bound(bears & np.isfinite(cap), 1.0, cap)
    # least − lack ≤ f_n
    b, c = np.nonzero(short)
    each, lacks, asked = np.arange(len(b)), lack[short], least[short]
    values, columns = np.column_stack([-normal[b, c], -np.ones(len(b))]), np.column_stack([column[b, c], lacks])
    rows.add(values, each[:, None], columns, -asked, [clarabel.NonnegativeConeT(len(b))])
    # 0 ≤ lack ≤ least
    rows.add(-np.ones(len(b)), each, lacks, np.zeros(len(b)), [clarabel.NonnegativeConeT(len(b))])
    rows.add(np.ones(len(b)), each, lacks, asked, [clarabel.NonnegativeConeT(len(b))])

    # The cones of contacts that rest or roll, moved up their normals by least − lack; their basis is the axes of W.
    b, c = np.nonzero(bears & ~nodes.ray)
    n = nodes.inward[b, c]
    use = (1.0 - margins.friction) * contacts.mu[c]
    cone = np.zeros((len(b), 3, 4))
    cone[:, 0, :3] = use[:, None] * n
    cone[:, 0, 3] = np.where(short[b, c], use, 0.0)
    cone[:, 1:, :3] = tangents(n)
    three = 3 * np.arange(len(b))[:, None, None] + np.arange(3)[:, None]
    columns = np.column_stack([column[b, c], np.where(short[b, c], lack[b, c], -1)])
    side = np.zeros((len(b), 3))
    side[:, 0] = -use * np.where(short[b, c], least[b, c], 0.0)
    rows.add(-cone, three, columns[:, None], side.ravel(), [clarabel.SecondOrderConeT(3)] * len(b))
    return rows
