"""Framing: what happens is in the picture and fills it, whatever size the robots are."""

import mujoco
import numpy as np
import pytest

from regrasp.view import planned
from regrasp.view.frames import put_all
from regrasp.view.framing import HIGHEST, LOWEST


@pytest.mark.parametrize("scene", ["mobile-panel", "tray-handover", "fig2-planar"])
def test_the_object_s_way_and_the_tips_fill_the_picture(home_plan, scene):
    shown = planned.prepare(home_plan(scene))
    camera, world = shown.show.camera, shown.show.world
    data = mujoco.MjData(world.model)
    points = []
    for row in (0, len(shown.time) // 2, len(shown.time) - 1):
        put_all(world, shown.state(row).qpos, data)
        points += [data.xpos[world.object_body].copy(), *(data.geom_xpos[agent.tip_geom] for agent in world.agents)]
    seen = camera.project(np.array(points))
    assert (seen >= 0).all()
    assert (seen <= [camera.width, camera.height]).all()
    assert np.ptp(seen, axis=0).max() > 0.5 * camera.width
    assert camera.height % 2 == 0
    assert LOWEST - 0.01 <= camera.height / camera.width <= HIGHEST + 0.01
