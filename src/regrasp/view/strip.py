"""The matrix V of contact motions as a strip of cells, as in the paper's Fig. 2: agents in rows."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from regrasp.plan import FIRST_SLIDE, OFF, RELOCATE, SLIDE, Plan
from regrasp.view.frames import Instant
from regrasp.view.ink import DARK, GREY, SUPPORT_FORCE, WHITE, Ink

Array = NDArray[np.float64]

STAY, ROLL, SLIP, MOVE, FREE = "#E4E4E0", "#BBD7EA", "#F2D29B", "#3B3B3B", "#FFFFFF"
ROW, SLIM = 26, 12


def height(plan: Plan) -> int:
    """Of the strip, in px."""
    return 58 + ROW * (plan.V.shape[1] + len(supports(plan)))


def draw(ink: Ink, plan: Plan, instants: Sequence[Instant], colours: Sequence[str], left: float, top: float) -> None:
    """Draw the strip from (left, top) to the same distance from the right edge; triangles mark the frames' instants."""
    N, k = plan.V.shape
    names = [*plan.agent_names, *supports(plan)]
    begin = left + 150
    cell = (ink.size[0] - left - begin) / N
    _legend(ink, begin, top + 10, k < len(names))
    top += 40
    for i, name in enumerate(names):
        y = top + ROW * i
        if i < k:
            ink.disc(np.array([left + 8, y + ROW / 2]), 6, colours[i], DARK)
        ink.text(np.array([left + 22, y + ROW / 2]), name, 14, anchor="lm")
    _cells(ink, plan, begin, top, cell, ROW)
    for number, instant in enumerate(instants):
        part = instant.sample / (plan.time.shape[1] - 1)
        x = begin + cell * (instant.interval + part)
        ink.line(np.array([[x, top - 4], [x, top + ROW * len(names) + 2]]), DARK, 1.2, dash=(4, 4))
        ink.text(np.array([x, top - 12]), str(number + 1), 13, bold=True)


def slim_height(plan: Plan) -> int:
    """Of the strip without words, in px."""
    return 10 + SLIM * (plan.V.shape[1] + len(supports(plan)))


def slim(ink: Ink, plan: Plan, colours: Sequence[str], top: float, at: float) -> None:
    """Draw the strip without words across the whole sheet; a line stands `at` intervals from its beginning."""
    N, k = plan.V.shape
    rows = k + len(supports(plan))
    cell = (ink.size[0] - 26 - 8) / N
    for i in range(k):
        ink.disc(np.array([13, top + SLIM * (i + 0.5)]), 4, colours[i], DARK)
    _cells(ink, plan, 26, top, cell, SLIM)
    x = 26 + cell * at
    ink.line(np.array([[x, top - 3], [x, top + SLIM * rows + 3]]), DARK, 2.0)


def _cells(ink: Ink, plan: Plan, left: float, top: float, cell: float, row: float) -> None:
    """The motions of all agents and what the object does on supports, in cells of so many px."""
    N, k = plan.V.shape
    for i, name in enumerate([*plan.agent_names, *supports(plan)]):
        for j in range(N):
            low = np.array([left + cell * j, top + row * i + 1.5])
            high = np.array([left + cell * (j + 1) - min(1.0, 0.2 * cell), top + row * (i + 1) - 1.5])
            if i < k:
                _motion(ink, int(plan.V[j, i]), low, high)
            else:
                _support(ink, plan, name, j, low, high)


def supports(plan: Plan) -> list[str]:
    """Names of the supports that the plan uses."""
    return sorted({name for p, name in enumerate(plan.support_names) if plan.support_mode[:, p].any()})


def fill(code: int) -> str:
    """Colour of a contact motion."""
    if FIRST_SLIDE <= code < RELOCATE:
        return SLIP
    return STAY if code == 0 else MOVE if code == RELOCATE else FREE if code == OFF else ROLL


def _motion(ink: Ink, code: int, low: Array, high: Array) -> None:
    ink.box(low, high, fill(code), "#D0D0CC" if code == OFF else None)
    word = "R" if code == RELOCATE else "" if code in (0, OFF) else _sign(code)
    if word and high[0] - low[0] > 9 * len(word) and high[1] - low[1] > 14:
        ink.text((low + high) / 2, word, 12, WHITE if code == RELOCATE else DARK)


def _sign(code: int) -> str:
    return ("+x", "−x", "+y", "−y")[(code - 1) % 4]


def _support(ink: Ink, plan: Plan, name: str, j: int, low: Array, high: Array) -> None:
    modes = [int(plan.support_mode[j, p]) for p, slot in enumerate(plan.support_names) if slot == name]
    if not any(modes):
        return
    middle = (low[1] + high[1]) / 2
    ink.box(np.array([low[0], middle - 4]), np.array([high[0], middle + 4]), SUPPORT_FORCE)
    if SLIDE in modes:
        ink.line(np.array([[low[0] + 2, middle], [high[0] - 2, middle]]), WHITE, 1.5, dash=(3, 3))


def _legend(ink: Ink, x: float, y: float, of_supports: bool) -> None:
    for own, words in (
        (STAY, "stay"),
        (ROLL, "roll about ±x, ±y"),
        (SLIP, "slide along ±x, ±y"),
        (MOVE, "relocate"),
        (FREE, "off"),
    ):
        ink.box(np.array([x, y - 7]), np.array([x + 20, y + 7]), own, GREY if own == FREE else None)
        ink.text(np.array([x + 27, y]), words, 13, anchor="lm")
        x += 50 + 7.6 * len(words)
    for sliding, words in ((False, "support sticks"), (True, "support slides")) if of_supports else ():
        ink.box(np.array([x, y - 4]), np.array([x + 20, y + 4]), SUPPORT_FORCE)
        if sliding:
            ink.line(np.array([[x + 2, y], [x + 18, y]]), WHITE, 1.5, dash=(3, 3))
        ink.text(np.array([x + 27, y]), words, 13, anchor="lm")
        x += 50 + 7.6 * len(words)
