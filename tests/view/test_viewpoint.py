"""Where a scene is looked at from: nothing stands before the tips."""

import mujoco
import numpy as np

from regrasp.view.frames import choose, planned, put_all
from regrasp.view.render import prepare
from regrasp.view.shading import DRAWN, OBJECT, hits
from regrasp.view.viewpoint import viewpoint


def test_a_ball_before_the_tips_is_looked_round(home_plan):
    """A link is blown up and put where the best view was: the view leaves it, and sees the tips again."""
    plan = home_plan("fig3-puma3")
    show = prepare(plan, choose(plan, 2))
    world, stage = show.world, show.stage
    states = [planned(world, plan, instant) for instant in choose(plan, 2)]
    best = viewpoint(stage, world, states)
    data = mujoco.MjData(stage.model)

    def seen(forward: np.ndarray) -> float:
        shares = []
        for state in states:
            put_all(world, state.qpos, data)
            for agent in world.agents:
                hit, _, _ = hits(stage, data, data.geom_xpos[agent.tip_geom], -forward[None], (DRAWN, OBJECT))
                shares.append(hit[0] < 0)
        return float(np.mean(shares))

    assert seen(best) > 0.6
    link = int(world.agents[0].geoms[0])
    put_all(world, states[0].qpos, data)
    body = stage.model.geom_bodyid[link]
    place = data.xmat[body].reshape(3, 3).T @ (stage.centre - 3.0 * stage.radius * best - data.xpos[body])
    for model in (stage.model, world.model):
        model.geom_type[link] = mujoco.mjtGeom.mjGEOM_SPHERE
        model.geom_size[link] = model.geom_rbound[link] = 0.6 * stage.radius
        model.geom_pos[link] = place
    blocked = seen(best)
    assert blocked < 0.5
    assert seen(viewpoint(stage, world, states)) > blocked
