"""Passes over many cases inside compiled code: a call from Python would cost more than the kernels that are measured.

They are compiled anew in each run, in less than a second each: numba's cache would not notice that a kernel below has changed.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from regrasp.kernels.basis import Program
from regrasp.kernels.chains import Chains, forward, jacobian
from regrasp.kernels.contact import advance
from regrasp.kernels.distances import distance
from regrasp.kernels.grids import Grids
from regrasp.kernels.inverse import inverse
from regrasp.kernels.simplex import solve
from regrasp.kernels.wrist import Wrists, solve_all, solve_near

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(nogil=True)
def forwards(chains: Chains, Q: Array, R: Array, p: Array, count: int) -> None:
    """Chain c mod k at the joints Q (N, n) one after the other."""
    k = len(chains.start) - 1
    for c in range(count):
        forward(chains, c % k, Q[c % len(Q)], R, p)


@njit(nogil=True)
def jacobians(chains: Chains, R: Array, p: Array, J: Array, count: int) -> None:
    """The same Jacobian again and again, of chain 0 at the link poses R, p."""
    for _ in range(count):
        jacobian(chains, 0, R, p, p[len(p) - 1], J)


@njit(nogil=True)
def inverses(
    chains: Chains, agents: Ints, R: Array, p: Array, seeds: Array, q: Array, R_L: Array, p_L: Array, count: int
) -> None:  # fmt: skip
    """Damped Newton to the poses R (N, 3, 3), p (N, 3) from the seeds; q (N, n): the joints found."""
    for c in range(count):
        s = c % len(p)
        q[s] = seeds[s]
        inverse(chains, agents[s], R[s], p[s], q[s], R_L, p_L)


@njit(nogil=True)
def nearest(
    chains: Chains, wrists: Wrists, agents: Ints, R: Array, p: Array, seeds: Array, q: Array, count: int
) -> None:  # fmt: skip
    """The closed form's nearest solutions, as `inverses`."""
    for c in range(count):
        s = c % len(p)
        q[s] = seeds[s]
        solve_near(chains, wrists, agents[s], R[s], p[s], q[s])


@njit(nogil=True)
def all_solutions(
    chains: Chains, wrists: Wrists, agents: Ints, R: Array, p: Array, Q: Array, found: Ints, count: int
) -> None:  # fmt: skip
    """All solutions of the closed form: Q (N, 8, 6), found (N,)."""
    for c in range(count):
        s = c % len(p)
        found[s] = solve_all(chains, wrists, agents[s], R[s], p[s], Q[s])


@njit(nogil=True)
def contacts(
    kind_O: int, size_O: Array, kind_T: int, size_T: Array, grids: Grids, command: Array, substeps: int,
    p: Array, c: Array, R: Array, x: Array, p_end: Array, c_end: Array, R_end: Array, x_end: Array, count: int,
) -> None:  # fmt: skip
    """Contact motions from the starts p, c, R, x (N, …) to the ends."""
    for pass_ in range(count):
        s = pass_ % len(p)
        p_end[s], c_end[s], R_end[s], x_end[s] = p[s], c[s], R[s], x[s]
        advance(kind_O, size_O, kind_T, size_T, grids, command, substeps, p_end[s], c_end[s], R_end[s], x_end[s])


@njit(nogil=True)
def distances(
    kind: Ints, core: Array, radius: Array, R: Array, p: Array, limit: float, found: Array, count: int
) -> None:  # fmt: skip
    """Bodies 2s and 2s + 1: found (N,)."""
    for c in range(count):
        s = c % len(found)
        a, b = 2 * s, 2 * s + 1
        found[s] = distance(kind[a], core[a], radius[a], R[a], p[a], kind[b], core[b], radius[b], R[b], p[b], limit)


@njit(nogil=True)
def programs(
    P: Program, columns: Ints, A: Array, b: Array, group: Ints, cap: Array, warm: bool, value: Array, pivots: Ints,
    count: int,
) -> None:  # fmt: skip
    """Force programs in the order of an arc, copied into P: value (N,), inf without equilibrium; pivots (N,)."""
    for c in range(count):
        s = c % len(columns)
        P.A[:], P.b[:], P.group[:], P.cap[:] = A[s], b[s], group[s], cap[s]
        status, found, pivots[s] = solve(P, columns[s], warm)
        value[s] = found if status == 0 else np.inf
