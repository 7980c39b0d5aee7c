"""Vectors and rotations: arithmetic of 3-vectors, products of 3×3 matrices, the exponential map of SO(3).

Vectors that are made on the way are triples: they stay in registers, where arrays would cost more than the arithmetic.
Nothing here allocates.
"""

import math

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import kernel

Array = NDArray[np.float64]
Triple = tuple[float, float, float]
Vector = Array | Triple


@kernel
def triple(a: Vector) -> Triple:
    """The entries of a (3,)."""
    return a[0], a[1], a[2]


@kernel
def plus(a: Vector, k: float, b: Vector) -> Triple:
    """a + k b."""
    return a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]


@kernel
def minus(a: Vector, b: Vector) -> Triple:
    """a − b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def along(x: Vector, y: Vector, a_x: float, a_y: float) -> Triple:
    """a_x x + a_y y."""
    return a_x * x[0] + a_y * y[0], a_x * x[1] + a_y * y[1], a_x * x[2] + a_y * y[2]


@kernel
def cross(a: Vector, b: Vector) -> Triple:
    """a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def dot(a: Vector, b: Vector) -> float:
    """aᵀb."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def norm(a: Vector) -> float:
    """Euclidean length |a|."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@kernel
def unit(a: Vector) -> Triple:
    """a / |a|, a ≠ 0."""
    length = norm(a)
    return a[0] / length, a[1] / length, a[2] / length


@kernel
def rotate(R: Array, a: Array, out: Array) -> None:
    """out = R a (out may be a)."""
    x = R[0, 0] * a[0] + R[0, 1] * a[1] + R[0, 2] * a[2]
    y = R[1, 0] * a[0] + R[1, 1] * a[1] + R[1, 2] * a[2]
    z = R[2, 0] * a[0] + R[2, 1] * a[1] + R[2, 2] * a[2]
    out[0], out[1], out[2] = x, y, z


@kernel
def rotate_back(R: Array, a: Array, out: Array) -> None:
    """out = Rᵀ a (out may be a)."""
    x = R[0, 0] * a[0] + R[1, 0] * a[1] + R[2, 0] * a[2]
    y = R[0, 1] * a[0] + R[1, 1] * a[1] + R[2, 1] * a[2]
    z = R[0, 2] * a[0] + R[1, 2] * a[1] + R[2, 2] * a[2]
    out[0], out[1], out[2] = x, y, z


@kernel
def rows(R: Array) -> tuple[Triple, Triple, Triple]:
    """The rows of R (3, 3)."""
    return triple(R[0]), triple(R[1]), triple(R[2])


@kernel
def multiply(A: Array, B: Array, out: Array) -> None:
    """out = A B (out may be A or B)."""
    # Read before anything is written: the compiler need not ask whether out is B.
    x, y, z = rows(B)
    for i in range(3):
        out[i, 0], out[i, 1], out[i, 2] = plus(along(x, y, A[i, 0], A[i, 1]), A[i, 2], z)


@kernel
def multiply_back(A: Array, B: Array, out: Array) -> None:
    """out = Aᵀ B (out may be B)."""
    x, y, z = rows(B)
    for i in range(3):
        out[i, 0], out[i, 1], out[i, 2] = plus(along(x, y, A[0, i], A[1, i]), A[2, i], z)


@kernel
def rodrigues(a2: float) -> tuple[float, float]:
    """(sin a / a, (1 − cos a) / a²) for a² = a2: the coefficients of [w] and [w]² in exp([w]) with |w| = a."""
    if a2 < 0.05:  # the series is faster and, for the second, more accurate than the quotients here
        s = 1.0 - a2 / 6.0 * (1.0 - a2 / 20.0 * (1.0 - a2 / 42.0 * (1.0 - a2 / 72.0 * (1.0 - a2 / 110.0))))
        c = 0.5 - a2 / 24.0 * (1.0 - a2 / 30.0 * (1.0 - a2 / 56.0 * (1.0 - a2 / 90.0 * (1.0 - a2 / 132.0))))
        return s, c
    a = math.sqrt(a2)
    return math.sin(a) / a, (1.0 - math.cos(a)) / a2


@kernel
def exp(w: Array, R: Array) -> None:
    """R = exp([w]), the rotation by |w| rad about w (Rodrigues), exact to round-off at w = 0 too."""
    s, c = rodrigues(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    x, y, z = w[0], w[1], w[2]
    R[0, 0] = 1.0 - c * (y * y + z * z)
    R[1, 1] = 1.0 - c * (x * x + z * z)
    R[2, 2] = 1.0 - c * (x * x + y * y)
    R[0, 1], R[1, 0] = c * x * y - s * z, c * x * y + s * z
    R[0, 2], R[2, 0] = c * x * z + s * y, c * x * z - s * y
    R[1, 2], R[2, 1] = c * y * z - s * x, c * y * z + s * x


@kernel
def log(R: Array, w: Array) -> None:
    """w with exp([w]) = R and |w| ≤ π, through the unit quaternion so that it holds at π as well."""
    # Shepperd 1978: divide by the largest of the four squared components.
    t = R[0, 0] + R[1, 1] + R[2, 2]
    if t >= R[0, 0] and t >= R[1, 1] and t >= R[2, 2]:
        qw = 1.0 + t
        x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    elif R[0, 0] >= R[1, 1] and R[0, 0] >= R[2, 2]:
        qw = R[2, 1] - R[1, 2]
        x, y, z = 1.0 + R[0, 0] - R[1, 1] - R[2, 2], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]
    elif R[1, 1] >= R[2, 2]:
        qw = R[0, 2] - R[2, 0]
        x, y, z = R[0, 1] + R[1, 0], 1.0 + R[1, 1] - R[0, 0] - R[2, 2], R[1, 2] + R[2, 1]
    else:
        qw = R[1, 0] - R[0, 1]
        x, y, z = R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], 1.0 + R[2, 2] - R[0, 0] - R[1, 1]
    if qw < 0.0:
        qw, x, y, z = -qw, -x, -y, -z
    s = math.sqrt(x * x + y * y + z * z)
    k = 2.0 / qw if s < 1e-12 * qw else 2.0 * math.atan2(s, qw) / s
    w[0], w[1], w[2] = k * x, k * y, k * z
