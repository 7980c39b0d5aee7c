"""A hand whose last joints follow the ones before them: planned, proved, executed with the model's own constraint."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from regrasp.plan import Plan
from regrasp.planner.hand import hand_of
from regrasp.planner.method import plan_scene
from regrasp.planner.task import Settings
from regrasp.scene.load import load
from regrasp.scene.world import build
from regrasp.settings import read
from regrasp.verify.check import check
from regrasp.verify.physics import Physics, nominal
from regrasp.verify.replay import Bench, control_of, replay

LINKAGE = str(Path(__file__).parents[1] / "examples" / "linkage.yaml")


@pytest.fixture(scope="module")
def plan() -> Plan:
    scene = load(LINKAGE)
    outcome = plan_scene(scene, 0, read(Settings, scene.planner))
    assert outcome.plan is not None, str(outcome.failure)
    return outcome.plan


def test_planning_counts_free_joints_within_all_ranges() -> None:
    """At the ends of the masters' planning ranges every joint, followers too, is within its own."""
    world = build(load(LINKAGE))
    chains = hand_of(world).chains
    assert chains.free.tolist() == [3, 3, 3]
    for i, agent in enumerate(world.agents):
        mine = slice(chains.start[i], chains.start[i + 1])
        for end in (chains.lower[mine], chains.upper[mine]):
            q = agent.coupling.expand(np.where(np.isfinite(end), end, 0.0))
            assert np.all((agent.lower < q) & (q < agent.upper))


def test_the_plan_is_certified_and_a_torn_coupling_is_not(plan: Plan) -> None:
    certificate = check(plan)
    assert certificate.passed, [str(finding) for finding in certificate.refusals]
    joints = plan.joints.copy()
    joints[:, :, plan.joint_names.index("robot/left_end")] += 1e-5  # the tip moves by 0.2 µm only
    refusals = check(dataclasses.replace(plan, joints=joints)).refusals
    assert [finding.name for finding in refusals] == ["coupled joints"]
    assert refusals[0].who == "robot/left_end"


def test_only_free_joints_are_driven_and_physics_takes_the_object_to_the_goal(plan: Plan) -> None:
    bench = Bench(plan, control_of(plan))
    physics = Physics(bench.world, nominal(bench.world), bench.gains)
    assert physics.model.nu == 9
    assert len(plan.joint_names) == 12
    found = replay(plan)
    assert found.passed, [str(each.failure) for each in found.nominal]
