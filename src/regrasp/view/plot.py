"""Curves over time, drawn with the ink of the frames above them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.view.ink import DARK, GREY, Ink

Array = NDArray[np.float64]

FAINT = "#E4E4E0"


@dataclass(frozen=True)
class Panel:
    """A rectangle of the sheet (left, top, width, height in px) that shows times 0 … `until` s and values 0 … `largest`."""

    left: float
    top: float
    width: float
    height: float
    until: float
    largest: float

    def at(self, time: Array | float, value: Array | float) -> Array:
        """Image points (..., 2) of values at times; what is too large lies on the upper edge."""
        x = self.left + self.width * np.asarray(time) / self.until
        y = self.top + self.height * (1 - np.minimum(np.asarray(value) / self.largest, 1.0))
        return np.stack(np.broadcast_arrays(x, y), axis=-1)

    def axes(self, ink: Ink, heading: str, marks: Sequence[float] | Array) -> None:
        """Heading, ticks, and a numbered dashed line at each of the marks, s."""
        ink.text(self.at(0, self.largest) - [0, 30], heading, 14, anchor="lm", bold=True)
        for value in np.arange(0, self.largest, step(self.largest, self.height / 28)):
            ink.line(self.at(np.array([0, self.until]), value), FAINT, 1.0)
            ink.text(self.at(0, value) - [6, 0], f"{value:g}", 12, anchor="rm")
        pace = step(self.until, self.width / 70)
        for time in np.arange(0, self.until + 1e-9, pace):
            ink.text(self.at(time, 0) + [0, 11], f"{time:g}", 12)
            ink.line(np.stack([self.at(time, 0), self.at(time, 0) + [0, 4]]), GREY, 1.0)
        ink.text(self.at(self.until, 0) + [16, 11], "s", 12)
        for number, time in enumerate(marks):
            ink.line(self.at(time, np.array([0, self.largest])), DARK, 1.0, dash=(3, 4))
            ink.text(self.at(time, self.largest) - [0, 9], str(number + 1), 12, bold=True)
        ink.line(self.at(np.array([0, self.until]), 0), GREY, 1.2)

    def limit(self, ink: Ink, value: float, since: float, words: str, colour: str) -> None:
        """A dashed line at a value that should not be passed from a time on; left out where the panel ends before. Named
        at its left end, or before that where the name would run out of the panel."""
        if value < self.largest and since < self.until:
            ink.line(self.at(np.array([since, self.until]), value), colour, 1.6, dash=(7, 4))
            late = since > 0.6 * self.until
            ink.text(self.at(since, value) + [-4 if late else 4, -8], words, 12, colour, anchor="rm" if late else "lm")


def step(length: float, parts: float) -> float:
    """The round step (1, 2 or 5 times a power of ten) that cuts a length into at most so many parts, 1 or more."""
    least = length / max(parts, 1.0)
    power = float(10 ** np.floor(np.log10(least)))
    return next(power * digit for digit in (1, 2, 5, 10) if power * digit >= least * (1 - 1e-9))
