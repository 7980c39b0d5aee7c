"""A moving picture, GIF or MP4: frames at even steps of time, drawn on all cores."""

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from regrasp.processors import available
from regrasp.view import strip
from regrasp.view.frames import State
from regrasp.view.ink import AGENT_FORCE, GREY, SUPPORT_FORCE, Ink, rgb
from regrasp.view.show import Show, colours, frame

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Form:
    """width: px. delay: ms from one picture to the next. most: pictures; what would be longer runs faster."""

    width: int
    delay: int
    most: int


FORMS = {".gif": Form(360, 120, 75), ".mp4": Form(640, 40, 200)}
"""GIF counts in hundredths of a second, and grows with every pixel that changes."""
LAST = 1500
"""ms for which the last picture stands."""
COLOURS = 128
"""Of a GIF: with more it grows faster than it gets better."""
BAR = 32
"""Height of the line of words, px."""


class Reel(Protocol):
    """What happens in time: rows at times (T,), s, each with a state of the world and words about it."""

    @property
    def show(self) -> Show: ...
    @property
    def time(self) -> Array: ...
    def state(self, row: int) -> State: ...
    def words(self, row: int) -> str: ...
    def seen_by(self, show: Show) -> Self:
        """The same with another camera or stage."""


def write(reel: Reel, path: str | os.PathLike[str], speed: float | None = None, cores: int | None = None) -> int:
    """Write a clip, by the path's suffix one of FORMS; the number of its pictures.

    speed: as a multiple of real time; by default the slowest of 1, 2, 4 … that needs no more than the form's `most`
    pictures. cores: processes at work, by default one on each core.
    """
    form = FORMS[Path(path).suffix.lower()]
    speed = speed or pace(reel.time, form)
    rows = ticks(reel.time, speed, form)
    camera, stage = reel.show.camera, replace(reel.show.stage, subrays=2)
    height = 2 * round(camera.height * form.width / camera.width / 2)
    reel = reel.seen_by(replace(reel.show, camera=replace(camera, width=form.width, height=height), stage=stage))
    workers = min(cores or available(), len(rows))
    shares = [rows[first::workers] for first in range(workers)]
    if workers == 1:
        done = [_pictures(reel, rows, speed)]
    else:
        with ProcessPoolExecutor(workers) as pool:
            done = list(pool.map(_pictures, [reel] * workers, shares, [speed] * workers))
    pictures = [done[number % workers][number // workers] for number in range(len(rows))]
    if Path(path).suffix.lower() == ".gif":
        _gif(pictures, (AGENT_FORCE, SUPPORT_FORCE, *colours(reel.show.plan)), form, Path(path))
    else:
        _mp4(pictures, form, Path(path))
    return len(rows)


def pace(time: Array, form: Form) -> float:
    """The slowest of real time, twice, four times … as fast that needs no more than the form's pictures."""
    speed = 1.0
    while len(ticks(time, speed, form)) > form.most:
        speed *= 2
    return speed


def ticks(time: Array, speed: float, form: Form) -> list[int]:
    """Rows at which a clip's pictures are taken: every `delay` ms of the clip from the first, and the last."""
    step = speed * form.delay / 1000
    times = time[0] + step * np.arange(round((time[-1] - time[0]) / step) + 1)
    rows = [int(row) for row in np.abs(time[:, None] - times).argmin(axis=0)]
    return [*rows[:-1], len(time) - 1]


def _pictures(reel: Reel, rows: Sequence[int], speed: float) -> list[Image.Image]:
    """The frame at each row, and below it a line of words and the matrix V with the time marked."""
    show, made = reel.show, []
    width, height, below = show.camera.width, show.camera.height, strip.slim_height(show.plan)
    for row in rows:
        state = reel.state(row)
        page = Image.new("RGB", (width, 2 * round((height + BAR + below) / 2)), "white")
        page.paste(frame(show, state), (0, 0))
        ink = Ink(*page.size)
        middle = height + BAR / 2
        ink.text(np.array([10, middle]), reel.words(row), 15, anchor="lm")
        if speed != 1.0:
            ink.text(np.array([width - 10, middle]), f"{speed:g}×", 15, GREY, anchor="rm", bold=True)
        strip.slim(ink, show.plan, colours(show.plan), height + BAR, state.interval + state.part)
        made.append(ink.on(page))
    return made


def in_few_colours(pictures: Sequence[Image.Image], accents: Sequence[str]) -> list[Image.Image]:
    """Pictures of one size with one palette for all, in which the accents are."""
    width = pictures[0].width
    some = [np.asarray(pictures[i]) for i in np.unique(np.linspace(0, len(pictures) - 1, 6).astype(int))]
    signs = (255 * np.array([rgb(colour) for colour in accents])).round()
    # The colours that carry meaning cover little of a picture: the palette's method would mix them with others.
    some.append(np.repeat(signs.astype(np.uint8), 40 * width, axis=0).reshape(-1, width, 3))
    palette = Image.fromarray(np.concatenate(some)).quantize(COLOURS, method=Image.Quantize.MEDIANCUT)
    return [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures]


def _gif(pictures: Sequence[Image.Image], accents: Sequence[str], form: Form, path: Path) -> None:
    """What stands still keeps its colour, and only what moves is stored."""
    plain = in_few_colours(pictures, accents)
    delays = [form.delay] * (len(plain) - 1) + [LAST]
    plain[0].save(path, "GIF", save_all=True, append_images=plain[1:], duration=delays, loop=0, disposal=1)


def _mp4(pictures: Sequence[Image.Image], form: Form, path: Path) -> None:
    """H.264 in 4:2:0, which every browser plays; the index first, so that it plays while it loads."""
    import av

    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as file:
        stream = file.add_stream("libx264", rate=1000 // form.delay, options={"crf": "27", "preset": "slow"})
        stream.width, stream.height = pictures[0].size
        stream.pix_fmt = "yuv420p"
        for picture in [*pictures, *[pictures[-1]] * (LAST // form.delay)]:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(np.asarray(picture), "rgb24")))
        file.mux(stream.encode())
