"""The time limit of a run and its shares."""

import math
import time
from dataclasses import dataclass


@dataclass(frozen=True)
class Clock:
    """A time limit under way: from `start` to `end` on time.monotonic(), s; `end` is inf where there is no limit."""

    start: float
    end: float

    def up(self) -> bool:
        """Whether the time is up."""
        return time.monotonic() >= self.end

    def elapsed(self) -> float:
        """The part of the time that has passed, 0 … 1; always 0 without a limit."""
        if math.isinf(self.end):
            return 0.0
        return 1.0 if self.up() else (time.monotonic() - self.start) / (self.end - self.start)

    def share(self, parts: int) -> "Clock":
        """The next of `parts` equal parts of the time that is left."""
        now = time.monotonic()
        return Clock(now, now + max(0.0, self.end - now) / parts)


def start_clock(limit: float) -> Clock:
    """A clock that starts now; limit: s, 0 for none."""
    now = time.monotonic()
    return Clock(now, now + (limit if limit > 0.0 else math.inf))
