"""What contacts keep in reserve: the share that each has in a wrench that nobody planned.

Fingers under impedance control answer a disturbance like springs. With equal springs at the contacts that stick, a wrench d
on the object changes their forces by the least squares Δf = Gᵀ (G Gᵀ)⁻¹ d. If each component of d has standard
deviation δ (weights; weights times the object's radius for torques), the force of contact i has δ σ_i,

  σ_i = ‖G_iᵀ (G Gᵀ)⁻¹‖_F.

A contact that shall stay within its cone then needs a normal force to spare that grows with σ_i: few contacts, or contacts
near a line, have to press more.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from regrasp.kernels.records import Record

Array = NDArray[np.float64]

SOFT = 0.02
"""Added to the contacts' moments of inertia (squared radii): a turn that no contact resists is resisted by so much."""


class Margins(Record):
    """What the force program leaves unused.

    friction: part of μ. grip: least normal force of an agent, in weights. disturbance: δ.
    slide: largest normal force of an agent that slides, in weights.
    """

    friction: float
    grip: float
    disturbance: float
    slide: float


@njit(cache=True, nogil=True)
def shares(p: Array, sticks: NDArray[np.uint8], shifts: Array, turns: Array, share: Array) -> None:
    """share (C,) = σ of the contacts at p (C, 3), in radii from the centre of mass; 0 for those that do not stick.

    shifts, turns (3,): 1 for the axes along and about which a disturbance acts, else 0.

    About the centroid c of the contacts G Gᵀ falls apart: a force moves all alike, a torque turns them about c, with the
    contacts' moment of inertia J: Δf_i = F / count + J⁻¹ (τ − c × F) × (p_i − c).
    """
    C = len(sticks)
    count = 0
    c, d = np.zeros(3), np.zeros(3)
    for i in range(C):
        share[i] = 0.0
        if sticks[i]:
            count += 1
            for a in range(3):
                c[a] += p[i, a]
    if count == 0:
        return
    for a in range(3):
        c[a] /= count
    J = np.zeros((3, 3))
    for i in range(C):
        if sticks[i]:
            for a in range(3):
                d[a] = p[i, a] - c[a]
            square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
            for a in range(3):
                J[a, a] += square
                for b in range(3):
                    J[a, b] -= d[a] * d[b]
    for a in range(3):
        J[a, a] += SOFT
    inverse = np.zeros((3, 3))
    invert(J, inverse)
    # column of the turn J⁻¹ (−c × F) for each axis of F, and of J⁻¹ τ for each axis of τ
    lever, turn = np.zeros((3, 3)), np.zeros((3, 3))
    for a in range(3):
        x, y = (a + 1) % 3, (a + 2) % 3
        for b in range(3):
            # −c × e_a has components −c_y·… : (c × e_a)_x = c_y, (c × e_a)_y = −c_x with x, y, a right-handed
            lever[b, a] = shifts[a] * (-inverse[b, x] * c[y] + inverse[b, y] * c[x])
            turn[b, a] = turns[a] * inverse[b, a]
    for i in range(C):
        if sticks[i]:
            total = 0.0
            for a in range(3):
                d[a] = p[i, a] - c[a]
            for a in range(3):
                for b in range(3):
                    x, y = (b + 1) % 3, (b + 2) % 3
                    force = lever[x, a] * d[y] - lever[y, a] * d[x]
                    if a == b:
                        force += shifts[a] / count
                    torque = turn[x, a] * d[y] - turn[y, a] * d[x]
                    total += force * force + torque * torque
            share[i] = np.sqrt(total)


@njit(cache=True, nogil=True)
def invert(A: Array, inverse: Array) -> None:
    """The inverse of a regular symmetric 3×3 matrix, by its adjugate."""
    for a in range(3):
        for b in range(3):
            x, y, u, v = (a + 1) % 3, (a + 2) % 3, (b + 1) % 3, (b + 2) % 3
            inverse[b, a] = A[x, u] * A[y, v] - A[x, v] * A[y, u]
    det = A[0, 0] * inverse[0, 0] + A[0, 1] * inverse[1, 0] + A[0, 2] * inverse[2, 0]
    for a in range(3):
        for b in range(3):
            inverse[a, b] /= det


@njit(cache=True, nogil=True)
def spare(margins: Margins, mu: float, share: float, cap: float) -> float:
    """The normal force, in weights, that a contact has to spare: its grip, and what keeps a force |Δf| = δ σ_i in its cone.

    A cone of half angle atan μ moved up its axis by s keeps the distance s μ / √(1 + μ²). At most half the cap.
    """
    return min(margins.grip + margins.disturbance * share * np.sqrt(1.0 + mu * mu) / mu, 0.5 * cap)
