"""The page as a file: it needs nothing else, and it is small."""

import re
from dataclasses import replace

import numpy as np

from regrasp.view.page import page
from regrasp.view.story import pack, tell

FETCHES = re.compile(
    r"https?://|\bfetch\(|XMLHttpRequest|EventSource|WebSocket|import\(|@import|\bsrc=|url\(|sendBeacon"
)


def test_the_file_has_nothing_in_it_that_asks_for_more(home_plan):
    text = page(pack(tell(home_plan("fig2-planar"))))
    code = re.sub(r'<script type="text/plain" id="story">.*?</script>', "", text, flags=re.DOTALL)
    assert not FETCHES.findall(code)
    assert re.findall(r'href="([^"]*)"', code) == ["data:,"]
    assert "{{" not in code


def test_only_the_served_page_listens(home_plan):
    packed = pack(tell(home_plan("fig2-planar")))
    assert "EventSource" in page(packed, live=True)


def test_240_frames_of_four_fingers_are_less_than_10_megabytes(home_plan):
    """Numbers without any pattern, which nothing compresses."""
    plan, rng = home_plan("fig4-relocation"), np.random.default_rng(0)
    again = -(-240 // plan.time.size)
    begins = np.arange(again)[:, None] * plan.time[-1, -1]
    longer = {"time": np.concatenate([plan.time + begin for begin in begins])}
    for name in ("object_position", "joints", "twist", "p_OC_O", "n_O", "x_O", "force_W"):
        rows = np.tile(getattr(plan, name), (again, *([1] * (getattr(plan, name).ndim - 1))))
        longer[name] = rows + 1e-3 * rng.standard_normal(rows.shape)
    for name in ("V", "object_quaternion", "support_mode", "support_p_O", "support_n_W", "support_force_W", "segment"):
        longer[name] = np.tile(getattr(plan, name), (again, *([1] * (getattr(plan, name).ndim - 1))))
    long = replace(plan, **longer, energy=rng.random(12000), energy_segment=np.zeros(12000, int))
    assert long.time.size >= 240
    assert len(page(pack(tell(long))).encode()) < 10e6
