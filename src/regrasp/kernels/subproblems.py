"""Subproblems of closed-form inverse kinematics: the turns about fixed axes that bring vectors where they must be.

From Paden 1986 and Kahan, numbered as by Elias and Wen 2022, "IK-Geo: unified robot inverse kinematics using subproblem
decomposition". With E = exp([h] θ) and unit h: 1, E p = x; 3, |E p − x| = d, which is 4 for the square; 4, xᵀ E p = d.

Angles are sought from a seed's, and the root nearest to it comes first. A turn is the triple (Δ, cos θ, sin θ), θ the
seed plus Δ, |Δ| ≤ π.
"""

import math

from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import Triple, Vector, cross, dot

Pair = tuple[float, float]
Roots = tuple[int, Pair, Pair]  # how many; (cos Δ, sin Δ) of the nearer and of the farther one

FREE: Roots = 1, (1.0, 0.0), (1.0, 0.0)  # any angle will do: the seed's
NO_ROOTS: Roots = 0, (1.0, 0.0), (1.0, 0.0)


@kernel
def turned(h: Vector, turn: Triple, p: Vector) -> Triple:
    """exp([h] θ) p."""
    _, c, s = turn
    k, x = (1.0 - c) * dot(h, p), cross(h, p)
    return c * p[0] + s * x[0] + k * h[0], c * p[1] + s * x[1] + k * h[1], c * p[2] + s * x[2] + k * h[2]


@kernel
def turned_back(h: Vector, turn: Triple, p: Vector) -> Triple:
    """exp([h] θ)ᵀ p."""
    return turned(h, (turn[0], turn[1], -turn[2]), p)


@kernel
def about(h: Vector, p: Triple, x: Triple, lever: float, seed: float) -> Triple:
    """Subproblem 1, exp([h] θ) p = x; the seed's angle where p and x are within `lever` of the axis."""
    # From the parts across the axis alone: near it the others' round-off would outweigh them.
    y, z = cross(h, p), cross(h, x)
    c, s = dot(y, z), dot(h, cross(y, z))
    length = math.sqrt(c * c + s * s)
    if length <= lever * lever:
        return 0.0, math.cos(seed), math.sin(seed)
    step = math.atan2(s, c) - seed
    return step - 2.0 * math.pi * math.floor(step / (2.0 * math.pi) + 0.5), c / length, s / length


@kernel
def roots(x: float, y: float, lever: float, b: float, square: float, fold: float, seed: Triple) -> Roots:
    """Subproblem 4 as x sin θ + y cos θ = b with lever = √(x² + y²) > 0 and square = lever² − b².

    Where that is negative, the angle nearest to a solution; one root where both are the same but for √square ≤ fold.
    """
    _, c, s = seed
    x, y, k = x * c - y * s, x * s + y * c, 1.0 / (lever * lever)
    if square > 0.0:
        z = math.sqrt(square)
    else:
        z, b = 0.0, math.copysign(lever, b)
    count = 1 if z <= fold else 2
    if x > 0.0:
        z = -z
    return count, ((y * b - x * z) * k, (x * b + y * z) * k), ((y * b + x * z) * k, (x * b - y * z) * k)


@kernel
def take(found: Roots, i: int, seed: Triple) -> Triple:
    """Root i as a turn."""
    c, s = found[1] if i == 0 else found[2]
    return math.atan2(s, c), c * seed[1] - s * seed[2], s * seed[1] + c * seed[2]


@kernel
def beyond(found: Roots, i: int, least: float) -> bool:
    """Whether root i lies as far off as the angle with the cosine `least`, or farther."""
    return (found[1][0] if i == 0 else found[2][0]) <= least
