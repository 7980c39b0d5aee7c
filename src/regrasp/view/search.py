"""What a page is told of a search that goes on: its route, the best motion so far, the falling energy."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from regrasp.plan import Plan
from regrasp.scene.world import World
from regrasp.view.sketch import sketch
from regrasp.view.story import Story, tell

if TYPE_CHECKING:
    from regrasp.planner.outcome import Progress

PAUSE = 0.5
"""s between two stories: each stops the search for a while."""
OFTEN = 0.1
"""s between two words about the energy."""

MOST = 2000
"""Energies that a page is told of, the latest."""


class Search:
    """Called with every `Progress`: tells pages its figures, and now and then what the best motion looks like."""

    def __init__(
        self, world: World, news: Callable[[str, dict[str, Any]], None], show: Callable[[Story], None]
    ) -> None:
        self._world, self._news, self._show = world, news, show
        self._curve: list[tuple[float, float]] = []
        self._stage, self._next, self._speak = "", 0.0, 0.0

    def __call__(self, progress: "Progress") -> None:
        now = time.monotonic()
        if not math.isnan(progress.energy):
            self._curve.append((progress.energy, progress.best))
        if now >= self._speak or progress.stage != self._stage:
            self._speak = now + OFTEN
            self._tell(progress.stage, progress.done, progress.total)
        if progress.motions is not None and (now >= self._next or progress.stage != self._stage):
            motions = progress.motions()
            if motions:
                self._show(drafted(sketch(self._world, motions, progress.route)))
            self._next = time.monotonic() + PAUSE
        self._stage = progress.stage

    def end(self, failure: str) -> None:
        """The search is over: why there is no plan, '' where there is one."""
        self._tell(failure or "done", 1, 1)

    def _tell(self, stage: str, done: int, total: int) -> None:
        self._news("search", {"stage": stage, "done": done, "total": total, "curve": self._curve[-MOST:]})


def drafted(plan: Plan) -> Story:
    """The story of a `sketch`, which nobody is going to check."""
    story = tell(plan)
    return replace(story, header={**story.header, "draft": True})
