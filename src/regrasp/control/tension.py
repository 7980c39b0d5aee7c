"""Tension: what springs at the fingertips do to each other instead of to the object.

Where the tips stand off their targets, the offsets d fall into a rigid motion of all of them, which is the object being
elsewhere, and a rest, which is strain between the fingers: contacts that are not quite where the plan has them make it grow as
they roll. The rest is let go slowly, so that the forces between the fingers stay those that are fed forward; the rigid part is
kept, the object is held as stiffly as before. Where a finger slides the spring's force along the normal is let go quickly: it
presses with the force of the plan wherever the surface is.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.settings import demand

Array = NDArray[np.float64]

SOFT = 1e-3
"""Added to the tips' moments of inertia, relative to the largest: tips on a line resist no turn about it."""

STIFF = 1e-4
"""Compliance added to a tip's, relative to its trace: a planar finger does not yield across its plane."""


@dataclass(frozen=True)
class Release:
    """Rates, 1/s, at which strain is let go: between fingers that stick, and of one that slides along its normal."""

    between: float = 3.0
    sliding: float = 20.0

    def __post_init__(self) -> None:
        demand(self, from_zero=("between", "sliding"))


def strain(p: Array, d: Array) -> Array:
    """The part (m, 3) of offsets d (m, 3) of tips at p (m, 3) that is no small rigid motion, by least squares."""
    r = p - p.sum(axis=0) / len(p)
    shift = d.sum(axis=0) / len(d)
    J = -(r.T @ r)
    square = -float(J.trace())
    J.flat[::4] += square + SOFT * max(2.0 * square, 1e-12)
    turn = np.linalg.solve(J, _cross(r, d).sum(axis=0))
    return np.asarray(d - shift - _cross(turn, r))


def _cross(a: Array, b: Array) -> Array:
    """a × b of (…, 3); np.cross is slow for a handful of vectors."""
    return np.asarray(a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]])


def released(
    settings: Release, period: float, p: Array, d: Array, sticks: NDArray[np.bool_], slides: NDArray[np.bool_], n: Array,
    compliance: Array,
) -> Array:  # fmt: skip
    """By how much the targets (k, 3) give way in one period: p, d as above for all k tips, n (k, 3) the normals.

    compliance (k, 3, 3): m/N, of the tips. A sliding finger's target moves along the normal until the spring has no force
    along it, n · C⁻¹ (d − s n) = 0: where C is not isotropic an offset across the normal presses, too.
    """
    out = np.zeros_like(d)
    if np.count_nonzero(sticks) > 1:
        out[sticks] = min(1.0, settings.between * period) * strain(p[sticks], d[sticks])
    for i in np.flatnonzero(slides):
        C = compliance[i] + STIFF * compliance[i].trace() * np.eye(3)
        press = np.linalg.solve(C, n[i])
        out[i] = min(1.0, settings.sliding * period) * (press @ d[i]) / (press @ n[i]) * n[i]
    return out
