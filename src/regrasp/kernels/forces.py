"""Contact forces (paper §3): the cones of the contacts as columns of the force program, and back to forces.

minimise cᵀλ subject to Aλ = b (six rows: forces, torques / length), λ ≥ 0, Σ_{group(e) = g} λ_e ≤ cap_g.

Each column of A is one generator of a contact's cone with normal component 1, so λ_e is a normal force; c_e is 1 for
an agent's contact and 0 for a passive one, and cap_g is the largest normal force of agent g. Forces are in units of the
object's weight. `simplex.solve` solves the program.
"""

import math

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import Array, Vector, cross, plus

Indices = NDArray[np.int64]

EDGES = 8
_H = math.sqrt(0.5)
_COS = (1.0, _H, 0.0, -_H, -1.0, -_H, 0.0, _H)
_SIN = (0.0, _H, 1.0, _H, 0.0, -_H, -1.0, -_H)


@kernel
def friction_edges(
    p: Vector, n_in: Vector, x: Vector, y: Vector, mu: float, length: float, A: Array, first: int
) -> None:
    """The EDGES edges of a friction cone as columns first … first+EDGES-1 of A: [f; p × f / length].

    f = n_in + μ (cos θ x + sin θ y), θ = 2π e / EDGES; n_in is the unit normal into the object, x and y are unit
    tangents, p is the contact point from the centre of mass (m), all in W. The pyramid lies inside the cone.
    """
    pn, px, py = cross(p, n_in), cross(p, x), cross(p, y)
    s = 1.0 / length
    for e in range(EDGES):
        u = mu * _COS[e]
        v = mu * _SIN[e]
        j = first + e
        A[0, j] = n_in[0] + u * x[0] + v * y[0]
        A[1, j] = n_in[1] + u * x[1] + v * y[1]
        A[2, j] = n_in[2] + u * x[2] + v * y[2]
        A[3, j] = s * (pn[0] + u * px[0] + v * py[0])
        A[4, j] = s * (pn[1] + u * px[1] + v * py[1])
        A[5, j] = s * (pn[2] + u * px[2] + v * py[2])


@kernel
def ray(p: Vector, n_in: Vector, t: Vector, mu: float, length: float, A: Array, at: int) -> None:
    """The one boundary ray of a sliding contact as column `at` of A: f = n_in + μ t, t the unit direction of friction.

    t is the slip v̂ of a tip relative to the object, for a support minus the object's (Coulomb). See friction_edges.
    """
    f = plus(n_in, mu, t)
    torque = cross(p, f)
    s = 1.0 / length
    A[0, at], A[1, at], A[2, at] = f
    A[3, at], A[4, at], A[5, at] = s * torque[0], s * torque[1], s * torque[2]


@kernel
def contact_forces(A: Array, solution: Array, first: Indices, weight: float, f: Array) -> None:
    """f[i] = weight Σ λ_e A[:3, e] over the columns first[i] ≤ e < first[i+1] of contact i: (k, 3), N, in W."""
    for i in range(f.shape[0]):
        for r in range(3):
            s = 0.0
            for e in range(first[i], first[i + 1]):
                s += solution[e] * A[r, e]
            f[i, r] = weight * s
