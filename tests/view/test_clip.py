"""Clips: as long as what they show, every picture where the motion is at its time, the same on any number of cores."""

from dataclasses import replace

import av
import mujoco
import numpy as np
import pytest
from PIL import Image

from regrasp.view import planned
from regrasp.view.clip import FORMS, LAST, Form, pace, ticks, write
from regrasp.view.frames import Instant, put
from regrasp.view.ink import AGENT_FORCE, AGENTS, rgb


@pytest.fixture(scope="module")
def reel(home_plan):
    """A planned motion of 5 s; the object is blue as nothing else, so that it can be found in a picture."""
    made = planned.prepare(home_plan("fig2-planar"))
    blue = made.show.stage.colour.copy()
    blue[made.show.world.object_geoms] = [0.0, 0.0, 1.0]
    return made.seen_by(replace(made.show, stage=replace(made.show.stage, colour=blue)))


def near(image, colour) -> np.ndarray:
    """Image points (n, 2) that have the colour, roughly: films code colours coarsely."""
    y, x = np.nonzero(np.abs(np.asarray(image.convert("RGB")) / 255 - rgb(colour)).max(axis=2) < 0.1)
    return np.stack([x, y], axis=1) + 0.5


def middle_of_blue(image) -> np.ndarray:
    """The middle of the blue object."""
    pixels = np.asarray(image.convert("RGB")) / 255
    y, x = np.nonzero((pixels[..., 2] > 0.3) & (pixels[..., 2] > 1.8 * pixels[..., :2].max(axis=2)))
    return np.array([x.min() + x.max(), y.min() + y.max()]) / 2 + 0.5


def frames_of(path) -> list[tuple[float, Image.Image]]:
    """Times, s, at which the pictures of a clip begin, and the pictures."""
    if path.suffix == ".mp4":
        with av.open(str(path)) as film:
            return [(float(frame.time), frame.to_image()) for frame in film.decode(video=0)]
    found, time = [], 0.0
    with Image.open(path) as gif:
        for i in range(gif.n_frames):
            gif.seek(i)
            found.append((time / 1000, gif.convert("RGB")))
            time += gif.info["duration"]
        assert gif.info["duration"] == LAST
    return found


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_every_picture_shows_the_motion_at_its_time(reel, tmp_path, suffix):
    path, delay = tmp_path / f"a{suffix}", FORMS[suffix].delay
    speed = 5.0 / (3 * delay / 1000)
    assert write(reel, path, speed, cores=2) == 4
    found, count = frames_of(path), 4
    assert len(found) == count + (LAST // delay if suffix == ".mp4" else 0)
    plan = reel.show.plan
    scale = FORMS[suffix].width / reel.show.camera.width
    for time, image in found:
        assert image.width == FORMS[suffix].width
        then = min(time * speed, 5.0)
        u = then / 5.0
        p = (1 - u) * plan.object_position[0, 0] + u * plan.object_position[-1, -1]
        # The object turns evenly and moves on a line; an ellipse's outline is centred where its centre is, but arrows cross it.
        assert np.linalg.norm(middle_of_blue(image) - scale * reel.show.camera.project(p)) < 10
    for colour in (AGENT_FORCE, *AGENTS[: len(plan.agent_names)]):
        assert len(near(found[0][1], colour)) > 10


def test_several_processes_share_the_same_work(reel, tmp_path):
    for cores in (1, 2):
        write(reel, tmp_path / f"{cores}.gif", 40.0, cores)
    assert (tmp_path / "1.gif").read_bytes() == (tmp_path / "2.gif").read_bytes()


def test_between_samples_the_state_is_the_plan_s_motion(home_plan):
    plan = home_plan("fig3-puma3")
    shown = planned.prepare(plan)
    world = shown.show.world
    data = mujoco.MjData(world.model)
    for j, m in ((0, 0), (2, 3), (4, 3)):
        put(world, plan, Instant(j, m), data)
        row = int(np.argmin(np.abs(shown.time - plan.time[j, m])))
        there = shown.state(row)
        assert np.abs(there.qpos - data.qpos).max() < 2e-3
        assert there.interval + there.part == pytest.approx(j + m / 3, abs=0.01)
    forces = {arrow.colour: np.linalg.norm(arrow.force) for arrow in shown.state(0).arrows}
    assert forces[AGENT_FORCE] == pytest.approx(np.linalg.norm(plan.force_W[0, 0], axis=1)[-1])


def test_pictures_are_evenly_spaced_and_end_with_the_last_row():
    time, form = np.linspace(0.0, 5.0, 501), Form(480, 70, 150)
    rows = ticks(time, 2.0, form)
    assert rows[0] == 0
    assert rows[-1] == 500
    assert np.allclose(time[rows[:-1]], 0.14 * np.arange(len(rows) - 1), atol=0.0051)
    for length, speed in ((5.0, 1.0), (10.0, 1.0), (11.0, 2.0), (30.0, 4.0)):
        assert pace(time / 5.0 * length, form) == speed
