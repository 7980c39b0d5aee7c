"""Start grasps side by side: each with the forces with which it holds the object at rest."""

from collections.abc import Sequence

from PIL import Image

from regrasp.plan import Plan
from regrasp.view import render, sheet, show
from regrasp.view.frames import Instant, planned

START = Instant(0, 0)


def page(rests: Sequence[Plan], captions: Sequence[str]) -> Image.Image:
    """The picture of grasps, each a plan in which the object rests; all seen from where the first is seen best."""
    first = render.prepare(rests[0], [START])
    frames = [show.frame(first, planned(first.world, rest, START)) for rest in rests]
    paper, ink, _ = sheet.lay(first, frames, captions, sheet.forces(first, bool(rests[0].support_names)), 0)
    return ink.on(paper)
