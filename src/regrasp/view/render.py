"""A plan as one picture: frames side by side as in the paper's Figs. 2 and 4, with contact motions and forces."""

from collections.abc import Sequence

import numpy as np
from PIL import Image

from regrasp.plan import Plan
from regrasp.scene.world import from_plan
from regrasp.view import sheet, show, strip
from regrasp.view.frames import Instant, choose, planned
from regrasp.view.show import Show


def render(plan: Plan, count: int = 6) -> Image.Image:
    """The picture of a plan in at most `count` frames, and its matrix V below them."""
    instants = choose(plan, count)
    shown = prepare(plan, instants)
    times = [plan.time[i.interval, i.sample] - plan.time[0, 0] for i in instants]
    captions = [
        f"t = {time:.2f} s, interval {instant.interval + 1} of {len(plan.V)}"
        for time, instant in zip(times, instants, strict=True)
    ]
    entries = [*sheet.forces(shown, bool(plan.support_names)), sheet.WAY, sheet.GOAL]
    frames = [frame(shown, instant) for instant in instants]
    page, ink, top = sheet.lay(shown, frames, captions, entries, strip.height(plan))
    strip.draw(ink, plan, instants, show.colours(plan), sheet.GAP, top)
    return ink.on(page)


def prepare(plan: Plan, instants: Sequence[Instant]) -> Show:
    """World, colours, camera and scale of forces for these instants of a plan."""
    world = from_plan(plan.scene, plan.xml, plan.assets)
    forces = np.concatenate([plan.force_W, plan.support_force_W], axis=2)
    largest = float(np.linalg.norm(forces, axis=-1).max(initial=0.0))
    return show.set_up(plan, world, [planned(world, plan, instant) for instant in instants], largest)


def frame(shown: Show, instant: Instant) -> Image.Image:
    """The frame of one instant."""
    return show.frame(shown, planned(shown.world, shown.plan, instant))
