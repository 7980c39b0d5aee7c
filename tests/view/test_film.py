"""Pictures of executions: what happened is drawn where it happened, what was planned where it was planned."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from PIL import Image

from regrasp.errors import InputError
from regrasp.verify.execution import Execution, Trouble
from regrasp.view import film
from regrasp.view.film import PLANNED, instants, prepare, replayed
from regrasp.view.frames import Instant, put
from regrasp.view.ink import AGENT_FORCE, Ink, rgb
from regrasp.view.plot import Panel, step
from regrasp.view.shading import silhouette
from regrasp.view.show import frame

SHIFT = np.array([0.03, 0.0, 0.02])
GOAL, TUBE = (2e-3, 0.035), (5e-3, 0.087)


@pytest.fixture(scope="session")
def made(home_plan):
    """Scene, shift → its plan and an execution that brings the object off by the shift, growing in time.

    The contacts bear twice what is planned; a record every 0.1 s; the plan takes 5 s."""

    def make(name, shift=SHIFT):
        plan = home_plan(name)
        world = film.from_plan(plan.scene, plan.xml, plan.assets)
        time = np.linspace(0.0, 5.0, 51)
        data = mujoco.MjData(world.model)
        qpos, force, bears = [], [], []
        for t in time:
            j = min(int(t), 4)
            m = int(np.argmin(np.abs(plan.time[j] - t)))
            put(world, plan, Instant(j, m), data)
            data.qpos[world.object_qpos : world.object_qpos + 3] += t / 5.0 * shift
            qpos.append(data.qpos.copy())
            force.append(plan.force_W[j, m])
            bears.append(np.isfinite(plan.p_OC_O[j, m, :, 0]))
        k = len(plan.agent_names)
        error = np.zeros((51, 6))
        error[:, :3] = time[:, None] / 5.0 * shift
        return plan, Execution(
            time=time, interval=np.minimum(time.astype(int), 4), qpos=np.array(qpos), error=error,
            force_W=2.0 * np.array(force), planned_W=np.array(force), bears=np.array(bears), slip=np.zeros((51, k)),
            strained=np.zeros((51, k), bool), touches=(), trouble=None, seconds=5.0, wall=0.1,
        )  # fmt: skip

    return make


def cut(run, count):
    """The first records of an execution."""
    arrays = {key: value[:count] for key, value in vars(run).items() if isinstance(value, np.ndarray)}
    return replace(run, **arrays)


def near(image, colour) -> np.ndarray:
    """Image points (n, 2) that have the colour."""
    y, x = np.nonzero(np.abs(np.asarray(image.convert("RGB")) / 255 - rgb(colour)).max(axis=2) < 0.02)
    return np.stack([x, y], axis=1) + 0.5


def test_the_planned_pose_is_the_plan_s_at_the_same_time(made):
    plan, run = made("fig3-puma3")
    shown = prepare(plan, run)
    for j in range(5):
        assert np.allclose(shown.pose[10 * j, :3], plan.object_position[j, 0], atol=1e-9)
        assert abs(shown.pose[10 * j, 3:] @ plan.object_quaternion[j, 0]) == pytest.approx(1.0)
    assert np.allclose(shown.pose[-1, :3], plan.object_position[-1, -1], atol=1e-9)


def test_the_object_is_drawn_where_it_was_and_outlined_where_it_should_have_been(made):
    plan, run = made("fig2-planar")
    shown = prepare(plan, replace(run, force_W=0.0 * run.force_W))
    camera, red = shown.show.camera, shown.show.stage.colour.copy()
    red[shown.show.world.object_geoms] = [1.0, 0.0, 0.0]
    shown = replace(shown, show=replace(shown.show, stage=replace(shown.show.stage, colour=red)))
    there = shown.state(50)
    image = np.asarray(frame(shown.show, there)) / 255
    y, x = np.nonzero((image[..., 0] > 0.3) & (image[..., 0] > 1.8 * image[..., 1:].max(axis=2)))
    address = shown.show.world.object_qpos
    was, planned = camera.project(run.qpos[50, address : address + 3]), camera.project(plan.object_position[-1, -1])
    middle = np.array([x.min() + x.max(), y.min() + y.max()]) / 2 + 0.5
    assert np.linalg.norm(was - planned) > 60
    assert np.linalg.norm(middle - was) < 3
    data = mujoco.MjData(shown.show.stage.model)
    put(shown.show.world, plan, Instant(4, 3), data)
    inside = np.pad(silhouette(shown.show.stage, data, camera), 1)
    around = inside[2:, 1:-1] & inside[:-2, 1:-1] & inside[1:-1, 2:] & inside[1:-1, :-2]
    border = inside[1:-1, 1:-1] & ~around
    assert (image[border].max(axis=1) < 0.45).mean() > 0.85


def test_measured_forces_stand_at_the_tips_contacts_and_planned_ones_are_thin(made):
    plan, run = made("fig2-planar", 0.0 * SHIFT)
    one = np.zeros_like(run.force_W)
    one[:, 0] = [0.0, 0.0, 3.0]
    shown = prepare(plan, replace(run, force_W=one, planned_W=0.0 * run.planned_W))
    image = frame(shown.show, shown.state(0))
    arrow = shown.state(0).arrows[0]
    points = near(image, AGENT_FORCE)
    head = shown.show.camera.project(arrow.head)
    tail = shown.show.camera.project(arrow.head - shown.show.force_scale * one[0, 0])
    assert np.linalg.norm(points - head, axis=1).min() < 4
    assert np.linalg.norm(points - tail, axis=1).min() < 4
    # The contact is on the object.
    radius = shown.show.world.object_size[0]
    assert np.linalg.norm(arrow.head - plan.object_position[0, 0]) == pytest.approx(radius, rel=1e-3)
    swapped = prepare(plan, replace(run, force_W=0.0 * run.force_W, planned_W=one))
    bare = replace(shown.state(0), arrows=())
    inked = [
        np.any(np.asarray(frame(each.show, each.state(0))) != np.asarray(frame(each.show, bare)), axis=2).sum()
        for each in (shown, swapped)
    ]
    assert 50 < inked[1] < 0.85 * inked[0]
    assert not len(near(frame(swapped.show, swapped.state(0)), AGENT_FORCE))


def test_forces_are_drawn_to_the_same_scale(made):
    plan, run = made("fig2-planar")
    shown = prepare(plan, run)
    arrows = shown.state(0).arrows
    thin, thick = [a for a in arrows if a.colour == PLANNED], [a for a in arrows if a.colour == AGENT_FORCE]
    assert len(thin) == len(thick) == len(plan.agent_names)
    assert np.allclose([2 * a.force for a in thin], [a.force for a in thick])


def test_a_dropped_execution_is_drawn_as_far_as_it_went(made):
    plan, run = made("fig2-planar")
    dropped = replace(cut(run, 28), trouble=Trouble("dropped", "object", 2.8))
    shown = prepare(plan, dropped)
    rows = instants(shown, 4)
    assert rows[0] == 0
    assert rows[-1] == 27
    assert (np.diff(rows) > 0).all()
    assert shown.words(27) == "t = 2.70 s, off by 19.5 mm 0.0°: dropped"
    assert "dropped" not in shown.words(26)
    image = replayed(shown, GOAL, TUBE, 2)
    whole = replayed(prepare(plan, run), GOAL, TUBE, 2)
    assert image.width == whole.width
    # The allowance on the way is drawn once per panel, that at the end not even begun.
    first, second = (near(each.crop((0, each.height - film.PLOT, *each.size)), AGENT_FORCE) for each in (image, whole))
    assert len(first) > 200
    assert len(np.unique(first[:, 1])) > 1
    assert len(second) > 200


def test_an_execution_that_never_began_can_not_be_drawn(made):
    plan, run = made("fig2-planar")
    with pytest.raises(InputError, match="not a finite number"):
        prepare(plan, replace(cut(run, 0), trouble=Trouble("not a finite number", "finger1", -0.1)))


def test_a_panel_maps_time_and_value_monotonically_and_draws_there():
    panel = Panel(40.0, 30.0, 200.0, 100.0, 2.0, 5.0)
    assert np.allclose(panel.at(np.array([0.0, 2.0]), np.array([0.0, 5.0])), [[40.0, 130.0], [240.0, 30.0]])
    points = panel.at(np.linspace(0, 2, 50), np.linspace(0, 7, 50))
    assert (np.diff(points[:, 0]) > 0).all()
    assert (np.diff(points[:, 1]) <= 0).all()
    assert points[:, 1].min() == 30.0
    ink = Ink(300, 150)
    panel.limit(ink, 2.0, 1.0, "", "#ff0000")
    panel.limit(ink, 6.0, 0.0, "", "#ff0000")
    panel.limit(ink, 3.0, 2.5, "", "#ff0000")
    drawn = near(ink.on(Image.new("RGB", (300, 150), "white")), "#ff0000")
    assert np.allclose(drawn[:, 1], 90.0, atol=1.0)
    assert drawn[:, 0].min() == pytest.approx(140.0, abs=1.0)


@pytest.mark.parametrize("length", [1e-3, 0.7, 1.0, 3.3, 42.0, 9e4])
@pytest.mark.parametrize("parts", [0.5, 1.0, 4.4, 10.0])
def test_ticks_are_round_and_as_many_as_there_is_room_for(length, parts):
    found = step(length, parts)
    digit = found / 10 ** np.floor(np.log10(found * (1 + 1e-9)))
    assert round(digit, 9) in (1, 2, 5)
    assert length / found <= max(parts, 1.0) * (1 + 1e-6)
    assert length / found > max(parts, 1.0) / 2.5 * (1 - 1e-6)
