"""Serial chains (fingers, arms, arms on mobile bases): forward kinematics and Jacobian.

Link i of a chain is the frame that moves with its joint i: origin on the joint's anchor. The tip frame T is fixed in
the last link. Every pose is X_AB = (R_AB, p_AB).

A joint may follow another one of its chain, q_f = offset + gain · q_m. Its value is kept beside the others', and a rate or a
step of the master is one of both: the follower's column of a Jacobian belongs to the master.
"""

import math

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import kernel
from regrasp.kernels.records import Record
from regrasp.kernels.rotations import Array, along, multiply, plus, rows

HINGE, SLIDE = 0, 1


class Chains(Record):
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
    free: NDArray[np.int64]  # (k,) joints of each chain that follow no other
    master: NDArray[np.int64]  # (nq,) the joint of its chain, 0 … n_a − 1, that each one follows; itself if it is free
    gain: Array  # (nq,)
    offset: Array  # (nq,)


@kernel
def couple(chains: Chains, a: int, q: Array) -> None:
    """Give the joints of q (n_a,) that follow others the values that these ask for."""
    first, n = chains.start[a], q.shape[0]
    if chains.free[a] < n:
        for i in range(n):
            m = chains.master[first + i]
            if m != i:
                q[i] = chains.offset[first + i] + chains.gain[first + i] * q[m]


@kernel
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
            P_0, P_1, P_2 = rows(P)
            for r in range(3):
                h0, h1, h2 = plus(along(P_0, P_1, R[r, 0], R[r, 1]), R[r, 2], P_2)
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


@kernel
def jacobian(chains: Chains, a: int, R_WL: Array, p_WL: Array, p_W: Array, J: Array) -> None:
    """Geometric Jacobian J (6, n_a) of the point p_W of chain a's last link, from the poses that `forward` wrote.

    Rows 0–2: velocity of the point; rows 3–5: angular velocity of the last link; both in W. What followers do is in their
    master's column, their own is zero.
    """
    first = chains.start[a]
    n = chains.start[a + 1] - first
    for i in range(n):
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
    if chains.free[a] < n:
        for i in range(n):
            m = chains.master[first + i]
            if m != i:
                for r in range(6):
                    J[r, m] += chains.gain[first + i] * J[r, i]
                    J[r, i] = 0.0
