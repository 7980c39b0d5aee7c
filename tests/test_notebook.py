"""The notebook of the examples runs as Jupyter runs it, and shows the plan in its page."""

import base64
import io
import re
from pathlib import Path

import av
import nbformat
import numpy as np
from nbclient import NotebookClient

from regrasp.view import clip, inline

NOTEBOOK = Path(__file__).parents[1] / "examples" / "notebook.ipynb"
SHORT = 'from regrasp.view import clip\nclip.FORMS = {".mp4": clip.Form(320, 100, 3), ".gif": clip.Form(320, 100, 3)}'
"""A clip of three pictures, so that the test is short."""


def film_of(html: str) -> list[np.ndarray]:
    """The pictures of the film inside a page."""
    content = base64.b64decode(re.search(r'src="data:video/mp4;base64,([^"]+)"', html)[1])
    with av.open(io.BytesIO(content)) as film:
        return [frame.to_ndarray(format="rgb24").astype(int) for frame in film.decode(video=0)]


def check(html: str) -> None:
    """A film that moves, a drawing, and nothing that is fetched."""
    pictures = film_of(html)
    assert (np.abs(pictures[-1] - pictures[0]).max(axis=2) > 60).mean() > 0.01
    assert html.count("<svg") == 1
    assert not re.search(r'(src|href|xlink:href)="(https?:)?//', html)


def test_the_notebook_runs_and_shows_a_film_and_a_figure():
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert not any(cell.get("outputs") for cell in notebook.cells)
    notebook.cells.insert(0, nbformat.v4.new_code_cell(SHORT))
    NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert not [output for output in outputs if output.output_type in ("error", "stream") and "Error" in str(output)]
    check(next(o.data["text/html"] for o in outputs if "text/html" in o.get("data", {})))


def test_a_plan_is_shown_with_its_counts(home_plan, monkeypatch):
    monkeypatch.setattr(clip, "FORMS", {".mp4": clip.Form(320, 100, 3)})
    plan = home_plan("fig2-planar")
    html = inline.shown(plan)._repr_html_()
    check(html)
    assert f"fig2-planar: {len(plan.V)} intervals, 3 agents, 5 s of motion, feasible" in html
