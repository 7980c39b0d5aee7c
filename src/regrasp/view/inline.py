"""A plan shown in a notebook: its motion as a film, its curves as a figure, both inside the page."""

import base64
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from regrasp.plan import Plan
from regrasp.view import clip, planned
from regrasp.view.figure import figure, save


@dataclass(frozen=True)
class Inline:
    """HTML that a notebook shows as the value of a cell. It asks for nothing from elsewhere."""

    html: str

    def _repr_html_(self) -> str:
        return self.html


def shown(plan: Plan, what: Sequence[str] = ("V", "forces"), speed: float | None = None) -> Inline:
    """The plan's counts, its clip, and the panels `what` of its figure (see `regrasp.view.figure`).

    speed: of the clip, as a multiple of real time; by default as slow as is short enough.
    """
    told = plan.summary()
    words = (
        f"{told['scene']}: {told['intervals']} intervals, {len(told['agents'])} agents, {told['duration']:.3g} s of motion, "
        f"{'feasible' if told['feasible'] else 'NOT feasible'}"
    )
    with tempfile.TemporaryDirectory() as folder:
        film, curves = Path(folder) / "plan.mp4", Path(folder) / "plan.svg"
        clip.write(planned.prepare(plan), film, speed)
        save(figure(plan, what), curves)
        source = base64.b64encode(film.read_bytes()).decode()
        # Only the element itself: a page has its own head.
        drawing = curves.read_text(encoding="utf-8")
    return Inline(
        f"<p>{escape(words)}</p>"
        f'<video controls loop muted autoplay width="640" src="data:video/mp4;base64,{source}"></video>'
        f"<div>{drawing[drawing.index('<svg') :]}</div>"
    )
