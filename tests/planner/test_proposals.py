"""The start grasps that are shown to choose from: they hold, and with how little friction."""

import numpy as np
import pytest

from regrasp.planner.outcome import Failure
from regrasp.planner.proposals import Proposal, propose
from regrasp.planner.task import Settings
from regrasp.scene.load import load, validate
from regrasp.scene.schema import Scene
from regrasp.settings import read
from regrasp.verify.check import check


def proposals(scene: Scene, count: int = 3) -> tuple[Proposal, ...]:
    found = propose(scene, 0, count, read(Settings, scene.planner))
    assert not isinstance(found, Failure), found
    return found


def pinch(max_force: float, friction: float = 0.7) -> Scene:
    """A ball between two tips at the same height."""
    return validate({
        "name": "pinch", "model": {"hand": "puma", "fingers": 2}, "max_force": max_force, "friction": friction,
        "object": {"shape": "sphere", "size": [0.03], "mass": 0.1},
        "start": {"pose": {"position": [0, 0, 0.2]}, "grasp": [
            {"agent": "finger1", "point": [0.03, 0, 0]}, {"agent": "finger2", "point": [-0.03, 0, 0]},
        ]},
        "goal": {"pose": {"position": [0, 0, 0.22]}},
    })  # fmt: skip


@pytest.mark.parametrize("name", ["fig2-planar", "fig3-puma3", "step-tumble"])
def test_every_grasp_holds(name: str):
    """By the judge: all but the goal, which a plan at rest does not reach."""
    scene = load(name)
    for proposal in proposals(scene):
        refused = [str(finding) for finding in check(proposal.rest).refusals if "goal" not in finding.name]
        assert not refused
        assert {hold.agent for hold in proposal.holds}.isdisjoint(scene.start.off)


@pytest.mark.parametrize("name", ["fig3-puma3", "step-tumble"])
def test_a_grasp_written_into_the_scene_is_the_same(name: str):
    scene = load(name)
    first, *_ = proposals(scene)
    plain = first.to_dict()
    start = {
        **scene.start.model_dump(),
        "grasp": [{"agent": hold["agent"], "joints": hold["q"]} for hold in plain["holds"]],
        "off": plain["off"],
    }
    (again,) = proposals(validate({**scene.model_dump(mode="json"), "start": start}))
    for hold, same in zip(first.holds, again.holds, strict=True):
        np.testing.assert_allclose(hold.p_O, same.p_O, atol=1e-6)
        np.testing.assert_allclose(hold.q, same.q, atol=1e-5)


def test_the_friction_that_a_pinch_needs():
    """μ f = m g / 2 at the largest force f; a pyramid of eight edges may need 1/cos 22.5° as much."""
    weight = 0.1 * 9.81
    for most in (2.0, 4.0, 8.0):
        (found,) = proposals(pinch(most))
        needed = weight / (2 * most) / 0.7
        assert needed - 1e-3 <= found.friction <= needed / np.cos(np.pi / 8) + 1e-3


def test_a_grasp_that_cannot_hold_is_no_proposal():
    found = propose(pinch(8.0, friction=0.03), 0, 1, Settings())
    assert isinstance(found, Failure)
    assert found.constraint == "equilibrium"
