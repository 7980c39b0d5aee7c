"""The search as a page shows it: its motions are the plan's, its energy falls, and being looked at does not change it."""

import numpy as np
import pytest

from regrasp.plan import OFF
from regrasp.planner.method import plan_scene
from regrasp.planner.task import Settings
from regrasp.scene.load import load
from regrasp.scene.world import build
from regrasp.view import search
from regrasp.view.search import Search, drafted
from regrasp.view.sketch import rest


@pytest.fixture(scope="module")
def watched():
    """Plan, plan of the same search unwatched, stories, news."""
    scene = load("fig4-relocation")
    stories, news = [], []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "PAUSE", 0.0)
        patch.setattr(search, "OFTEN", 0.0)
        report = Search(build(scene), lambda kind, content: news.append((kind, content)), stories.append)
        plan = plan_scene(scene, 1, Settings(), report).plan
        report.end("")
    return plan, plan_scene(scene, 1, Settings()).plan, stories, news


def test_looking_does_not_change_the_search(watched):
    plan, alone, _, _ = watched
    np.testing.assert_array_equal(plan.V, alone.V)
    np.testing.assert_array_equal(plan.energy, alone.energy)
    np.testing.assert_array_equal(plan.joints, alone.joints)


def test_motions_lead_from_the_start_to_a_subgoal_of_the_route(watched):
    plan, _, stories, _ = watched
    assert len(stories) > 10
    for story in stories:
        assert story.header["draft"]
        pose, route = story.arrays["pose"][:, story.header["object"]], np.array(story.header["route"])
        np.testing.assert_allclose(pose[0, :3], plan.object_position[0, 0], atol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(route[:, :3] - pose[-1, :3], axis=1).min(), 0.0, atol=1e-6)
    goal = plan.object_position[-1, -1]
    assert any(np.allclose(story.header["route"][-1][:3], goal, atol=1e-6) for story in stories)


def test_the_least_energy_of_every_segment_falls_to_the_plan_s(watched):
    plan, _, _, news = watched
    assert {kind for kind, _ in news} == {"search"}
    best = np.array([least for _, least in news[-1][1]["curve"]])
    pieces = np.split(best, 1 + np.flatnonzero(np.diff(best) > 0.0))
    annealed = np.flatnonzero(np.bincount(plan.energy_segment) > 1)
    assert len(pieces) == len(annealed) == 2
    for piece, segment in zip(pieces, annealed, strict=True):
        assert piece[-1] < piece[0]
        assert plan.energy[plan.energy_segment == segment].min() == pytest.approx(piece[-1], rel=0.2)
    assert news[-1][1]["stage"] == "done"


def test_before_there_is_a_motion_the_scene_is_shown_at_rest():
    world = build(load("fig3-puma3"))
    plan = rest(world)
    assert (plan.V == OFF).all()
    story = drafted(plan)
    np.testing.assert_allclose(story.arrays["pose"][0, story.header["object"], :3], world.scene.start.pose.p, atol=1e-7)
    np.testing.assert_allclose(story.arrays["joints"][0, 0], world.start[world.joint_qpos], atol=1e-6)
