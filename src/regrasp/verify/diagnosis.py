"""Why an execution left its path, and in which interval that began."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.verify.execution import EVERY, Execution
from regrasp.verify.physics import PERIOD

Array = NDArray[np.float64]

SLIPPED = 2e-3
"""m of slip that explain a failure."""
GONE = 0.06
"""s without force where the plan has some."""
LIGHT = 0.3
"""Part of the agents' mean planned force below which its loss explains nothing."""


@dataclass(frozen=True)
class Failure:
    """interval, time (s): where it began; who: agent or body; why: in words."""

    interval: int
    time: float
    who: str
    why: str

    def __str__(self) -> str:
        who = f"{self.who} " if self.who else ""
        return f"interval {self.interval}, t = {self.time:.2f} s: {who}{self.why}"


def diagnose(run: Execution, names: Sequence[str], tolerance: tuple[float, float]) -> Failure | None:
    """What went wrong in an execution that does not end within the tolerance (m, rad); None if it does.

    The failure began at the earliest event before the object left the tolerance for good: a contact lost or slipped, a
    drive at its limit, a contact that the plan does not have.
    """
    if succeeded(run, tolerance):
        return None
    if not len(run.time):
        trouble = run.trouble
        assert trouble is not None
        return Failure(0, trouble.time, trouble.body, trouble.what)
    outside = np.any(run.off > tolerance, axis=1)
    inside = np.flatnonzero(~outside)
    left = int(inside[-1]) + 1 if len(inside) else 0
    left = min(left, len(run.time) - 1)
    row, who, why = min([*_events(run, names), (left, "object", _final_words(run))], key=lambda event: event[0])
    return Failure(int(run.interval[row]), float(run.time[row]), who, why)


def succeeded(run: Execution, tolerance: tuple[float, float]) -> bool:
    """Whether the object is at the goal within the tolerance (m, rad) and nothing was in trouble."""
    return run.trouble is None and bool(np.all(run.off[-1] <= tolerance))


def _final_words(run: Execution) -> str:
    if run.trouble:
        return run.trouble.what
    shift, turn = run.off[-1]
    return f"drifts off its path, at the end by {1e3 * shift:.1f} mm and {np.degrees(turn):.1f}°"


def _events(run: Execution, names: Sequence[str]) -> list[tuple[int, str, str]]:
    """(record, who, what) of everything that may explain a failure, the first of each kind and agent."""
    found = []
    planned, measured = np.linalg.norm(run.planned_W, axis=2), np.linalg.norm(run.force_W, axis=2)
    heavy = planned > LIGHT * planned[run.bears].mean() if run.bears.any() else run.bears
    window = max(1, round(GONE / (EVERY * PERIOD)))
    for i, name in enumerate(names):
        gone = np.convolve(heavy[:, i] & run.bears[:, i] & (measured[:, i] == 0.0), np.ones(window))[: len(run.time)]
        if np.any(gone >= window):
            found.append((int(np.argmax(gone >= window)) + 1 - window, name, "lost contact"))
        if run.slip[-1, i] > SLIPPED:
            found.append(
                (int(np.argmax(run.slip[:, i] > SLIPPED)), name, f"slipped, by {1e3 * run.slip[-1, i]:.1f} mm in all")
            )
        if run.strained[:, i].any():
            found.append((int(np.argmax(run.strained[:, i])), name, "has a drive at its limit"))
    for touch in run.touches:
        second = "the object" if touch.second == "object" else touch.second
        found.append((int(np.searchsorted(run.time, touch.time)), touch.first, f"touched {second}"))
    return [(min(row, len(run.time) - 1), who, why) for row, who, why in found]
