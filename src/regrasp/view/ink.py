"""Drawing on pictures: smooth lines, arrows, text on chips. Lengths are pixels of the finished image throughout."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

Array = NDArray[np.float64]
Colour = str

DARK, GREY, WHITE = "#2b2b2b", "#8a8a8a", "#ffffff"
AGENTS = ("#56B4E9", "#009E73", "#CC79A7", "#F0E442", "#E69F00", "#661100")
"""Okabe and Ito's colours, and a dark one: told apart by colour-blind eyes too, one for each agent, in turn."""
AGENT_FORCE, SUPPORT_FORCE = "#D55E00", "#0072B2"
"""The two of Okabe and Ito's colours that no agent has: forces of agents, forces of supports."""

SMOOTH = 3
"""Lines are drawn this many times larger and then reduced."""


@cache
def font(size: float, bold: bool = False) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, which has the signs used here and comes with matplotlib."""
    from matplotlib import get_data_path

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(get_data_path()) / "fonts" / "ttf" / name), size)


def rgb(colour: Colour) -> Array:
    """'#rrggbb' as three numbers in 0…1."""
    return np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])


class Ink:
    """A transparent sheet over a picture of (width, height) px; `on(picture)` puts it there."""

    def __init__(self, width: int, height: int) -> None:
        self._sheet = Image.new("RGBA", (SMOOTH * width, SMOOTH * height), (255, 255, 255, 0))
        self._draw = ImageDraw.Draw(self._sheet)
        self.size = (width, height)

    def line(self, points: Array, colour: Colour, width: float, dash: tuple[float, float] | None = None) -> None:
        """A polyline through points (n, 2), whole or in dashes of (drawn, left out) px."""
        for part in _dashes(points, dash) if dash else [points]:
            corners = [(float(x) * SMOOTH, float(y) * SMOOTH) for x, y in part]
            self._draw.line(corners, fill=colour, width=round(width * SMOOTH), joint="curve")

    def disc(self, centre: Array, radius: float, colour: Colour, edge: Colour | None = None) -> None:
        self._draw.circle(
            (float(centre[0]) * SMOOTH, float(centre[1]) * SMOOTH),
            radius * SMOOTH,
            fill=colour,
            outline=edge,
            width=SMOOTH if edge else 0,
        )

    def arrow(self, tail: Array, head: Array, colour: Colour, width: float = 4.0) -> None:
        """An arrow with a white border; one too short for a head is drawn as a head alone."""
        along = head - tail
        length = float(np.linalg.norm(along))
        if length < 1.0:
            return
        along = along / length
        across = np.array([-along[1], along[0]])
        barb = min(3.6 * width, max(length, 2.2 * width))
        neck = head - barb * along
        for grown, ink in ((2.0, WHITE), (0.0, colour)):
            half = width / 2 + grown
            if length > barb:
                back = tail - grown * along
                self._polygon(
                    [back + half * across, neck + half * across, neck - half * across, back - half * across], ink
                )
            wing, tip = 1.6 * width + 1.6 * grown, head + 2.2 * grown * along
            foot = neck - grown * along
            self._polygon([foot + wing * across, tip, foot - wing * across], ink)

    def text(
        self, at: Array, words: str, size: float, colour: Colour = DARK, anchor: str = "mm", bold: bool = False
    ) -> None:
        """One line of text at a point; the anchor is Pillow's ('lm': left middle)."""
        self._draw.text(
            (float(at[0]) * SMOOTH, float(at[1]) * SMOOTH),
            words,
            fill=colour,
            font=font(size * SMOOTH, bold),
            anchor=anchor,
        )

    def box(self, low: Array, high: Array, fill: Colour | None, edge: Colour | None = None, round: float = 0.0) -> None:
        self._draw.rounded_rectangle(
            (*(float(v) * SMOOTH for v in low), *(float(v) * SMOOTH for v in high)),
            radius=round * SMOOTH,
            fill=fill,
            outline=edge,
            width=SMOOTH if edge else 0,
        )

    def on(self, picture: Image.Image) -> Image.Image:
        """The picture (RGB) with the sheet on it."""
        sheet = self._sheet.resize(self.size, Image.Resampling.BOX, reducing_gap=None)
        return Image.alpha_composite(picture.convert("RGBA"), sheet).convert("RGB")

    def _polygon(self, corners: Sequence[Array], colour: Colour) -> None:
        self._draw.polygon([(float(x) * SMOOTH, float(y) * SMOOTH) for x, y in corners], fill=colour)


def chips(
    ink: Ink, anchors: Array, centre: Array, radii: Array, words: Sequence[str], colours: Sequence[Colour]
) -> None:
    """A labelled chip beside each anchor (n, 2), away from `centre`, pushed apart until none covers another."""
    size, pad = 15.0, np.array([7.0, 4.0])
    extent = np.array([[font(size).getlength(w) + size, size] for w in words]) + 2 * pad
    away = anchors - centre
    away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    place = anchors + away * (radii[:, None] + 12 + np.abs(away * extent / 2).sum(axis=1, keepdims=True))
    limit = np.array(ink.size)
    for _ in range(60):
        place = np.clip(place, extent / 2 + 4, limit - extent / 2 - 4)
        for a in range(len(words)):
            for b in range(a):
                apart = place[a] - place[b]
                cover = (extent[a] + extent[b]) / 2 + 3 - np.abs(apart)
                if (cover > 0).all():
                    axis = int(np.argmin(cover))
                    push = np.sign(apart[axis]) or 1.0
                    place[a, axis] += push * cover[axis] / 2
                    place[b, axis] -= push * cover[axis] / 2
    for at, anchor, whole, word, colour in zip(place, anchors, extent, words, colours, strict=True):
        ink.line(np.stack([anchor, at]), GREY, 1.2)
        ink.box(at - whole / 2, at + whole / 2, WHITE, colour, round=6)
        left = at - [whole[0] / 2 - pad[0], 0]
        ink.disc(left + [size / 2 - 3, 0], size / 2 - 2, colour, DARK)
        ink.text(left + [size + 1, 0], word, size, anchor="lm")


def _dashes(points: Array, dash: tuple[float, float]) -> list[Array]:
    """Pieces of a polyline (n, 2), by arc length: drawn and left out in turn."""
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(step)])
    starts = np.arange(0.0, at[-1], sum(dash))
    pieces = []
    for start in starts:
        s = np.concatenate([[start], at[(at > start) & (at < start + dash[0])], [min(start + dash[0], at[-1])]])
        pieces.append(np.stack([np.interp(s, at, points[:, 0]), np.interp(s, at, points[:, 1])], axis=1))
    return pieces
