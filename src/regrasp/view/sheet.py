"""The paper on which frames stand side by side: a title with a legend, the frames with their captions, room below."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from regrasp.view.ink import AGENT_FORCE, DARK, GREY, SUPPORT_FORCE, Ink
from regrasp.view.show import Show

GAP, CAPTION, TITLE = 14, 34, 46


@dataclass(frozen=True)
class Entry:
    """A line of the legend: words, and a line or, with a length in px, an arrow."""

    words: str
    colour: str
    arrow: float | None = None
    width: float = 2.0
    dash: tuple[float, float] | None = None


def lay(
    show: Show, pictures: Sequence[Image.Image], captions: Sequence[str], entries: Sequence[Entry], below: int
) -> tuple[Image.Image, Ink, int]:
    """Frames with captions, `below` px of room under them: the sheet, the ink to be put on it, and where the room begins."""
    columns = len(pictures) if len(pictures) <= 4 else -(-len(pictures) // 2)
    rows = -(-len(pictures) // columns)
    wide, high = show.camera.width, show.camera.height
    top = TITLE + rows * (high + CAPTION) + GAP
    size = (columns * wide + (columns + 1) * GAP, top + below)
    sheet, ink = Image.new("RGB", size, "white"), Ink(*size)
    for number, (picture, words) in enumerate(zip(pictures, captions, strict=True)):
        corner = (GAP + number % columns * (wide + GAP), TITLE + number // columns * (high + CAPTION))
        sheet.paste(picture, corner)
        at = np.array([corner[0] + 2.0, corner[1] + high + CAPTION / 2])
        ink.text(at, str(number + 1), 16, anchor="lm", bold=True)
        ink.text(at + [18.0, 0.0], words, 15, anchor="lm")
    ink.text(np.array([GAP, TITLE / 2]), str(show.plan.scene.get("name", "")), 19, anchor="lm", bold=True)
    _legend(ink, entries)
    return sheet, ink, top


def forces(show: Show, supports: bool) -> list[Entry]:
    """Legend of the arrows, with a round force for scale."""
    if show.force_scale <= 0:
        return []
    shown = show.force_scale / show.camera.pixel_size(float(np.linalg.norm(show.stage.centre - show.camera.eye)))
    round_force = 10 ** np.floor(np.log10(60 / shown))
    round_force *= max(step for step in (1, 2, 5) if step * round_force * shown <= 60)
    length = float(round_force * shown)
    of_supports = [Entry("of a support", SUPPORT_FORCE, length, 4.0)] if supports else []
    return [Entry(f"force of an agent ({round_force:g} N)", AGENT_FORCE, length, 4.0), *of_supports]


WAY = Entry("path of the object", GREY)
GOAL = Entry("goal", DARK, dash=(4, 4))


def _legend(ink: Ink, entries: Sequence[Entry]) -> None:
    """From the right to the left of the title's line."""
    x, y = float(ink.size[0] - GAP), TITLE / 2
    for entry in reversed(entries):
        x -= 8.3 * len(entry.words) + 8
        ink.text(np.array([x, y]), entry.words, 14, anchor="lm")
        long = entry.arrow or 30.0
        tail = np.array([x - 10 - long, y])
        if entry.arrow:
            ink.arrow(tail, tail + [long, 0.0], entry.colour, entry.width)
        else:
            ink.line(np.stack([tail, tail + [long, 0.0]]), entry.colour, entry.width, entry.dash)
        x -= long + 34
