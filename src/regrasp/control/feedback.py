"""Object feedback: the measured pose of the object corrects where the fingertips go.

Two errors have two remedies. Fingers that hold the object carry it: a common rigid displacement c of their targets
moves it back, and integrates the error, so that noise averages out. Fingers on their way to the object must meet it where it
is: their targets move with the object, by its displacement e, smoothed.

A displacement is a small rigid motion (shift of the object's origin, m; turn, rad), in W.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.settings import demand

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Feedback:
    """Settings of the object feedback.

    period: s, between measurements, as of a camera. rate: 1/s, of the integral correction. smoothing: s, time constant
    with which fingers off the object follow its measured pose. reach: m, largest shift of the correction; its turn is
    limited to `bend`, rad.
    """

    period: float = 0.02
    rate: float = 3.0
    smoothing: float = 0.1
    reach: float = 0.015
    bend: float = 0.35

    def __post_init__(self) -> None:
        demand(self, positive=("period", "smoothing"), from_zero=("rate", "reach", "bend"))


@dataclass(frozen=True)
class State:
    """c (6,): displacement of what the fingers hold. own (k, 6): what each finger adds. seen (6,): smoothed error."""

    c: Array
    own: Array
    seen: Array


def init(k: int) -> State:
    """No correction yet, k agents."""
    return State(np.zeros(6), np.zeros((k, 6)), np.zeros(6))


def displacement(p_WO: Array, R_WO: Array, p_measured: Array, R_measured: Array) -> Array:
    """The displacement (6,) from a planned to a measured pose: shift and rotation vector, of less than 180°."""
    (a, xy, xz), (yx, b, yz), (zx, zy, c) = (R_measured @ R_WO.T).tolist()
    x, y, z = 0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)  # the axis times sin θ
    sine = math.sqrt(x * x + y * y + z * z)
    scale = math.atan2(sine, 0.5 * (a + b + c - 1.0)) / sine if sine > 0.0 else 1.0
    dx, dy, dz = (p_measured - p_WO).tolist()
    return np.array([dx, dy, dz, scale * x, scale * y, scale * z])


def step(settings: Feedback, state: State, error: Array, bears: NDArray[np.bool_], follows: bool, free: Array) -> State:
    """The state after a measurement with the given error (6,).

    follows: the object is carried, so c may move it, by the projection `free` (6, 6) in no direction that supports bar.
    """
    blend = min(1.0, settings.period / settings.smoothing)
    seen = state.seen + blend * (error - state.seen)
    c = state.c
    if follows:
        c = c - settings.rate * settings.period * (free @ error)
        for part, limit in ((slice(0, 3), settings.reach), (slice(3, 6), settings.bend)):
            length = float(np.linalg.norm(c[part]))
            if length > limit:
                c = c.copy()
                c[part] *= limit / length
    # A finger off the object comes to c + own = seen; in contact its own part stays as it was at touch-down.
    own = np.where(bears[:, None], state.own, state.own + blend * (seen - c - state.own))
    return State(c, own, seen)


def tip_shift(offset: Array, p_WO: Array, p_WT: Array) -> Array:
    """The displacement (6,) of the object's origin as seen at a fingertip: its shift and turn."""
    x, y, z = p_WT - p_WO
    a, b, c = offset[3:]
    return np.array(
        [
            offset[0] + b * z - c * y,
            offset[1] + c * x - a * z,
            offset[2] + a * y - b * x,
            offset[3],
            offset[4],
            offset[5],
        ]
    )
