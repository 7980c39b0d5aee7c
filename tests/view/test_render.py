"""Pictures of plans: things are where the camera puts them, arrows follow the forces, frames follow the motion."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from regrasp.plan import RELOCATE
from regrasp.view.frames import Instant, choose, put
from regrasp.view.ink import AGENT_FORCE, SUPPORT_FORCE, rgb
from regrasp.view.render import frame, prepare, render
from regrasp.view.shading import silhouette


def pixels_of(image, colour) -> np.ndarray:
    """Image points (n, 2) that have the colour."""
    y, x = np.nonzero(np.abs(np.asarray(image) / 255 - rgb(colour)).max(axis=2) < 0.02)
    return np.stack([x, y], axis=1) + 0.5


def test_frames_are_first_last_and_the_relocation(home_plan):
    plan = home_plan("fig3-puma3")
    where = choose(plan, 3)
    assert where[0] == Instant(0, 0)
    assert where[-1] == Instant(len(plan.V) - 1, plan.time.shape[1] - 1)
    assert (plan.V[where[1].interval] == RELOCATE).any()
    for count in range(1, 8):
        found = [plan.time[i.interval, i.sample] for i in choose(plan, count)]
        assert len(found) <= count
        assert (np.diff(found) > 0).all()


def test_the_object_is_drawn_where_it_is(home_plan):
    plan = home_plan("fig3-puma3")
    show = prepare(plan, (Instant(0, 0), Instant(4, 3)))
    for instant in (Instant(0, 0), Instant(4, 3)):
        data = mujoco.MjData(show.stage.model)
        put(show.world, plan, instant, data)
        y, x = np.nonzero(silhouette(show.stage, data, show.camera))
        centre = show.camera.project(plan.object_position[instant.interval, instant.sample])
        assert np.allclose([x.mean() + 0.5, y.mean() + 0.5], centre, atol=1.5)
        # An ellipsoid's picture lies between those of its inscribed and its circumscribed sphere.
        size = show.camera.pixel_size(float(np.linalg.norm(show.stage.centre - show.camera.eye)))
        inner, outer = (np.pi * (r / size) ** 2 for r in (show.world.object_size[:3].min(), show.world.object_size[0]))
        assert 0.8 * inner < len(x) < 1.25 * outer


def test_frames_of_different_instants_differ_and_equal_ones_do_not(home_plan):
    plan = home_plan("fig2-planar")
    show = prepare(plan, (Instant(0, 0), Instant(4, 3)))
    first, again, last = (np.asarray(frame(show, i)) for i in (Instant(0, 0), Instant(0, 0), Instant(4, 3)))
    assert np.array_equal(first, again)
    assert (np.abs(first.astype(int) - last).max(axis=2) > 20).mean() > 0.02


def test_a_planar_scene_is_seen_along_y(home_plan):
    show = prepare(home_plan("fig2-planar"), (Instant(0, 0),))
    assert np.allclose(show.camera.R, [[1, 0, 0], [0, 0, 1], [0, 1, 0]])


def test_arrows_stand_at_the_contacts_and_follow_the_forces(home_plan):
    plan = home_plan("fig2-planar")
    only = plan.force_W.copy()
    only[:, :, 1:] = 0.0
    along = np.tile([0.0, 0.0, 1.0], (*plan.time.shape, 1))
    instant = Instant(0, 0)
    heads = {}
    for name, force in (("as it is", only[:, :, 0]), ("upwards", along), ("half", 0.5 * along)):
        forces = only.copy()
        forces[:, :, 0] = force
        forces[4] = 0.0
        forces[4, :, 0, 2] = 1.0  # keeps the scale of the arrows the same
        changed = replace(plan, force_W=forces)
        show = prepare(changed, (instant,))
        points = pixels_of(frame(show, instant), AGENT_FORCE)
        head = show.camera.project(plan.object_position[0, 0] + plan.p_OC_O[0, 0, 0])
        assert np.linalg.norm(points - head, axis=1).min() < 4
        middle = points.mean(axis=0) - head
        tail = show.camera.project(plan.object_position[0, 0] + plan.p_OC_O[0, 0, 0] - force[0, 0]) - head
        assert middle @ tail / np.linalg.norm(middle) / np.linalg.norm(tail) > 0.97
        heads[name] = np.linalg.norm(points - head, axis=1).max()
    assert heads["half"] == pytest.approx(0.5 * heads["upwards"], rel=0.1)


def test_without_forces_there_are_no_arrows(home_plan):
    plan = home_plan("fig2-planar")
    show = prepare(replace(plan, force_W=np.zeros_like(plan.force_W)), (Instant(0, 0),))
    image = frame(show, Instant(0, 0))
    assert not len(pixels_of(image, AGENT_FORCE))
    assert not len(pixels_of(image, SUPPORT_FORCE))


def test_a_support_s_force_has_its_own_colour(home_plan):
    plan = home_plan("fig2-planar")
    force = np.zeros_like(plan.support_force_W)
    force[..., 2] = 1.0
    show = prepare(replace(plan, support_force_W=force), (Instant(0, 0),))
    assert len(pixels_of(frame(show, Instant(0, 0)), SUPPORT_FORCE)) > 50


@pytest.mark.parametrize(("scene", "count", "across"), [("fig3-puma3", 2, 2), ("fig2-planar", 5, 3)])
def test_the_whole_picture(home_plan, scene, count, across):
    image = render(home_plan(scene), count)
    assert image.width == across * 640 + (across + 1) * 14
    # The strip of V below the frames has the relocation's dark cell.
    strip = np.asarray(image)[-100:]
    assert len(pixels_of(strip, "#3B3B3B")) > 500
