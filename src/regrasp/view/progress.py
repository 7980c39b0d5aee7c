"""Progress of long work on stderr: a bar with the energy on a terminal, plain lines elsewhere."""

import math
import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID


class Step(Protocol):
    """What the planner tells while it works: the stage, how much of it is done, the current and the best energy."""

    @property
    def stage(self) -> str: ...
    @property
    def done(self) -> int: ...
    @property
    def total(self) -> int: ...
    @property
    def energy(self) -> float: ...
    @property
    def best(self) -> float: ...


class Reporter:
    """A context in which every call with a `Step` shows it; `interval` s pass at least between two plain lines."""

    def __init__(self, interval: float = 2.0) -> None:
        self._interval = interval
        self._bar: Bar | None = None
        self._task: TaskID | None = None
        self._stage = ""
        self._next = 0.0

    def __enter__(self) -> "Reporter":
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as Bar

            self._bar = Bar(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[energy]}"),
                TimeElapsedColumn(),
                console=Console(stderr=True),
                transient=True,
            )
            self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, step: Step) -> None:
        if self._bar is not None:
            self._draw(self._bar, step)
        else:
            self._print(step)

    def _draw(self, bar: "Bar", step: Step) -> None:
        if self._task is None:
            self._task = bar.add_task(step.stage, total=step.total, energy="")
        bar.update(
            self._task,
            description=step.stage,
            completed=step.done,
            total=step.total,
            energy=_energy(step),
        )

    def _print(self, step: Step) -> None:
        now = time.monotonic()
        if step.stage == self._stage and now < self._next:
            return
        self._stage, self._next = step.stage, now + self._interval
        energy = _energy(step)
        print(f"{step.stage}: {step.done}/{step.total}{', ' if energy else ''}{energy}", file=sys.stderr, flush=True)


def _energy(step: Step) -> str:
    """The energies in words; stages that have none report NaN."""
    return "" if math.isnan(step.energy) else f"energy {step.energy:.4g}, best {step.best:.4g}"
