"""Where a page looks from: nothing stands before the tips."""

import mujoco
import numpy as np

from regrasp.scene.world import from_plan
from regrasp.view.viewpoint import outlook


def test_a_ball_before_the_tips_is_looked_round(home_plan):
    """A link is blown up and put where the best view was: the view leaves it, and sees the tips again."""
    plan = home_plan("fig3-puma3")
    world = from_plan(plan.scene, plan.xml, plan.assets)
    model, data = world.model, mujoco.MjData(world.model)
    data.qpos[:] = world.start
    mujoco.mj_kinematics(model, data)

    def hidden(towards: np.ndarray) -> int:
        """Tips from whose ends nothing can be seen of an eye."""
        count = 0
        for agent in world.agents:
            end = data.geom_xpos[agent.tip_geom] + 1.001 * model.geom_size[agent.tip_geom, 0] * towards
            count += mujoco.mj_ray(model, data, end, towards, None, 1, -1, np.zeros(1, np.int32)) >= 0.0
        return count

    first = outlook(world, [world.start])
    assert hidden(first.towards) <= 1
    link = int(world.agents[0].geoms[0])
    body, away = model.geom_bodyid[link], first.centre + 3.0 * first.radius * first.towards
    model.geom_type[link] = mujoco.mjtGeom.mjGEOM_SPHERE
    model.geom_size[link] = model.geom_rbound[link] = 1.2 * first.radius
    model.geom_pos[link] = data.xmat[body].reshape(3, 3).T @ (away - data.xpos[body])
    mujoco.mj_kinematics(model, data)
    assert hidden(first.towards) == len(world.agents)
    assert hidden(outlook(world, [world.start]).towards) <= 1


def test_the_outlook_holds_object_and_tips(home_plan):
    plan = home_plan("fig2-planar")
    world = from_plan(plan.scene, plan.xml, plan.assets)
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.start
    mujoco.mj_kinematics(world.model, data)
    seen = outlook(world, [world.start])
    np.testing.assert_array_equal(seen.towards, [0.0, -1.0, 0.0])  # a planar scene
    for place in (*(data.geom_xpos[agent.tip_geom] for agent in world.agents), data.xpos[world.object_body]):
        assert np.linalg.norm(place - seen.centre) < seen.radius
