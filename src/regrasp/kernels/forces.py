"""Contact forces (paper §3): the cones of the contacts as columns of the force program, and back to forces.

minimise cᵀλ subject to Aλ = b (six rows: forces, torques / length), λ ≥ 0, Σ_{group(e) = g} λ_e ≤ cap_g.

Each column of A is one generator of a contact's cone with normal component 1, so λ_e is a normal force; c_e is 1 for
an agent's contact and 0 for a passive one, and cap_g is the largest normal force of agent g. Forces are in units of the
object's weight. `simplex.solve` solves the program.
"""

import math

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import inlined, kernel
from regrasp.kernels.rotations import Array, Vector, cross, plus

Indices = NDArray[np.int64]

EDGES = 8
_H = math.sqrt(0.5)


@inlined
def _around(row: Array, first: int, a: float, x: float, y: float) -> None:
    """row[first + e] = a + cos θ x + sin θ y, θ = 2π e / EDGES."""
    d, f = _H * (x + y), _H * (y - x)
    row[first], row[first + 1], row[first + 2], row[first + 3] = a + x, a + d, a + y, a + f
    row[first + 4], row[first + 5], row[first + 6], row[first + 7] = a - x, a - d, a - y, a - f


@kernel
def friction_edges(
    p: Vector, n_in: Vector, x: Vector, y: Vector, mu: float, length: float, A: Array, first: int
) -> None:
    """The EDGES edges of a friction cone as columns first … first+EDGES-1 of A: [f; p × f / length].

    f = n_in + μ (cos θ x + sin θ y), θ = 2π e / EDGES; n_in is the unit normal into the object, x and y are unit
    tangents, p is the contact point from the centre of mass (m), all in W. The pyramid lies inside the cone.
    """
    s = mu / length
    pn, px, py = cross(p, n_in), cross(p, x), cross(p, y)
    for r in range(3):
        _around(A[r], first, n_in[r], mu * x[r], mu * y[r])
        _around(A[3 + r], first, pn[r] / length, s * px[r], s * py[r])


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
