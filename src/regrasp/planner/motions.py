"""The quantised contact motions y_j of the matrix V (paper §4) and the relative velocities they command."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import Vector

Array = NDArray[np.float64]

STAY = 0
ROLL_X, ROLL_MINUS_X, ROLL_Y, ROLL_MINUS_Y = 1, 2, 3, 4
SLIDE_X, SLIDE_MINUS_X, SLIDE_Y, SLIDE_MINUS_Y = 5, 6, 7, 8
RELOCATE = 9
OFF = 10
MOTION_COUNT = 11
ONTO = 11
"""In the search a relocation names its candidate: code ONTO + c takes the agent onto candidate c of the scan."""


@kernel
def whole(value: int) -> int:
    """The number as numba's int64: it would compile a kernel and all it calls a second time for a literal argument."""
    return np.int64(value)  # type: ignore[return-value]


@kernel
def is_sliding(code: int) -> bool:
    """Whether the contact motion is one of slide ±x, ±y."""
    return SLIDE_X <= code <= SLIDE_MINUS_Y


@kernel
def slide_direction(code: int, x: Vector, y: Vector, t: Array) -> None:
    """t = the direction in which a sliding tip moves over the object, and so of its friction on the object."""
    for a in range(3):
        along = x[a] if code <= SLIDE_MINUS_X else y[a]
        t[a] = along if code in (SLIDE_X, SLIDE_Y) else -along


def plain(V: NDArray[np.int16]) -> NDArray[np.int8]:
    """V with relocations as RELOCATE, whatever their candidates."""
    return np.where(V >= ONTO, RELOCATE, V).astype(np.int8)


@dataclass(frozen=True)
class MotionSteps:
    """How far one interval's contact motion goes: ω_max and v_max of the paper, as steps so that time may be stretched.

    roll: relative rotation of a rolling tip per interval, rad.
    slide: way of a sliding tip per interval, as a part of the object's radius.
    """

    roll: float = 0.1
    slide: float = 0.02


def commands(steps: MotionSteps, radius: float) -> NDArray[np.float64]:
    """(MOTION_COUNT, 4): ω_x, ω_y [rad] and v_x, v_y [m] of the tip relative to the object over one interval, in C."""
    table = np.zeros((MOTION_COUNT, 4))
    table[ROLL_X, 0], table[ROLL_MINUS_X, 0] = steps.roll, -steps.roll
    table[ROLL_Y, 1], table[ROLL_MINUS_Y, 1] = steps.roll, -steps.roll
    slide = steps.slide * radius
    table[SLIDE_X, 2], table[SLIDE_MINUS_X, 2] = slide, -slide
    table[SLIDE_Y, 3], table[SLIDE_MINUS_Y, 3] = slide, -slide
    return table
