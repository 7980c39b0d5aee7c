"""A robot that nobody here built, by a scene file alone: planned, proved, executed by its own drives."""

import os
from pathlib import Path

import numpy as np
import pytest

from regrasp.plan import Plan
from regrasp.planner.method import plan_scene
from regrasp.planner.task import Settings
from regrasp.scene.load import load
from regrasp.settings import read
from regrasp.verify.check import check
from regrasp.verify.physics import Physics, nominal
from regrasp.verify.replay import Bench, control_of, replay

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(scope="module")
def plan() -> Plan:
    scene = load(str(EXAMPLES / "gantry.yaml"))
    outcome = plan_scene(scene, 0, read(Settings, scene.planner))
    assert outcome.plan is not None, str(outcome.failure)
    return outcome.plan


def test_the_plan_is_certified(plan: Plan) -> None:
    certificate = check(plan)
    assert certificate.passed, [str(finding) for finding in certificate.refusals]


def test_its_own_servos_move_it(plan: Plan) -> None:
    """No drive is added: its servos are set to the gains that the controller counts on, and keep their limits."""
    bench = Bench(plan, control_of(plan))
    physics = Physics(bench.world, nominal(bench.world), bench.gains)
    assert physics.model.nu == len(plan.joint_names) == 9
    servo = physics.drives.actuator
    np.testing.assert_allclose(-physics.model.actuator_biasprm[servo, 1], bench.gains.K)
    np.testing.assert_allclose(-physics.model.actuator_biasprm[servo, 2], bench.gains.D)
    np.testing.assert_array_equal(
        physics.model.actuator_forcerange[servo], bench.world.model.actuator_forcerange[servo]
    )


def test_physics_takes_the_object_to_the_goal(plan: Plan) -> None:
    found = replay(plan)
    assert found.passed, [str(each.failure) for each in found.nominal]


@pytest.mark.skipif("MENAGERIE_ROOT" not in os.environ, reason="needs a copy of MuJoCo Menagerie")
@pytest.mark.parametrize("seed", range(3))
def test_the_menageries_allegro_hand_is_planned_by_name_and_certified(seed: int) -> None:
    """Fingers of four joints, tips that are capsules, a palm that floats in its file."""
    scene = load(str(EXAMPLES / "allegro.yaml"))
    outcome = plan_scene(scene, seed, read(Settings, scene.planner))
    assert outcome.plan is not None, str(outcome.failure)
    certificate = check(outcome.plan)
    assert certificate.passed, [str(finding) for finding in certificate.refusals]
