"""What contacts keep in reserve: the share that each has in a wrench that nobody planned.

Fingers under impedance control answer a disturbance like springs. With equal springs at the contacts that stick, a wrench d
on the object changes their forces by the least squares Δf = Gᵀ (G Gᵀ)⁻¹ d, G = (…, G_i, …) being their grasp map. If each
component of d has standard deviation δ, in weights for the force and weights times the object's radius for the torque, the
change of contact i has the root mean square δ σ_i,

  σ_i = ‖G_iᵀ (G Gᵀ)⁻¹‖_F.

A contact that shall stay within its cone then needs a normal force to spare that grows with σ_i: few contacts, or contacts
near a line, have to press more.
"""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import kernel
from regrasp.kernels.records import Record
from regrasp.kernels.rotations import dot, minus
from regrasp.kernels.stack import stack

Array = NDArray[np.float64]

SOFT = 0.02
"""Squared radii added to the contacts' moments of inertia: so much resists a turn that no contact resists, as the one about
the line on which all of them stand. It keeps σ finite."""


class Margins(Record):
    """What the force programs of the search and of the plan leave unused.

    friction: part of μ of a contact that rests or rolls. grip: normal force, in weights, that every agent in contact has to
    spare; disturbance: δ, for which those that rest or roll have more to spare. slide: largest normal force, in weights, of
    an agent that slides.
    """

    friction: float
    grip: float
    disturbance: float
    slide: float


@kernel
def shares(p: Array, sticks: NDArray[np.uint8], shifts: Array, turns: Array, share: Array) -> None:
    """share (C,) = σ of the contacts at p (C, 3), in radii from the centre of mass; 0 for those that do not stick.

    shifts, turns (3,): 1 for the axes along and about which a disturbance acts, else 0.

    About the centroid c of the contacts that stick G Gᵀ falls apart: a force F moves all alike, a torque τ turns them about
    c, with their moment of inertia J (and `SOFT`): Δf_i = F / count + J⁻¹ (τ − c × F) × (p_i − c).
    """
    C = len(sticks)
    count, c0, c1, c2 = 0, 0.0, 0.0, 0.0
    for i in range(C):
        share[i] = 0.0
        if sticks[i]:
            count += 1
            c0 += p[i, 0]
            c1 += p[i, 1]
            c2 += p[i, 2]
    if count == 0:
        return
    c = (c0 / count, c1 / count, c2 / count)
    room = stack((4, 3, 3))
    room[0] = 0.0
    J, inverse, by_force, by_torque = room[0], room[1], room[2], room[3]
    for i in range(C):
        if sticks[i]:
            d = minus(p[i], c)
            square = dot(d, d)
            for a in range(3):
                J[a, a] += square
                for b in range(3):
                    J[a, b] -= d[a] * d[b]
    for a in range(3):
        J[a, a] += SOFT
    invert(J, inverse)
    # The columns are the turns J⁻¹ (−c × e_a) that a force along axis a makes, and J⁻¹ e_a that a torque about it makes.
    for a in range(3):
        x, y = (a + 1) % 3, (a + 2) % 3  # (x, y, a) is right-handed: c × e_a = c_y e_x − c_x e_y
        for b in range(3):
            by_force[b, a] = shifts[a] * (inverse[b, y] * c[x] - inverse[b, x] * c[y])
            by_torque[b, a] = turns[a] * inverse[b, a]
    for i in range(C):
        if sticks[i]:
            total = 0.0
            d = minus(p[i], c)
            for a in range(3):
                for b in range(3):
                    x, y = (b + 1) % 3, (b + 2) % 3
                    force = by_force[x, a] * d[y] - by_force[y, a] * d[x]
                    if a == b:
                        force += shifts[a] / count
                    torque = by_torque[x, a] * d[y] - by_torque[y, a] * d[x]
                    total += force * force + torque * torque
            share[i] = np.sqrt(total)


@kernel
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


@kernel
def spare(margins: Margins, mu: float, share: float, cap: float) -> float:
    """s: the normal force, in weights, that a contact has to spare; its cone is moved up its axis by it. cap: its limit.

    The grip, and what keeps a force in its cone when it changes by δ σ_i: a cone of half angle atan μ, moved up by s, lies at
    s μ / √(1 + μ²) from the surface of the one that stays. At most half the cap: the other half is for the load. Without
    friction nothing to spare would keep the contact from slipping.
    """
    if mu <= 0.0:
        return min(margins.grip, 0.5 * cap)
    return min(margins.grip + margins.disturbance * share * np.sqrt(1.0 + mu * mu) / mu, 0.5 * cap)
