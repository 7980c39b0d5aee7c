"""The built-in scenes with supports and passages: planned with seed 0 as they are, certified, and done as they say."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp.plan import Plan
from regrasp.planner.method import plan_scene
from regrasp.planner.supports import SEPARATE, STICK
from regrasp.planner.task import Settings
from regrasp.scene.load import load
from regrasp.verify.check import check

SLOW = pytest.mark.slow


def turns(plan: Plan) -> np.ndarray:
    """R_WO (N M, 3, 3)."""
    return Rotation.from_quat(plan.object_quaternion.reshape(-1, 4), scalar_first=True).as_matrix()


def positions(plan: Plan) -> np.ndarray:
    return plan.object_position.reshape(-1, 3)


def borne(plan: Plan, name: str) -> np.ndarray:
    """In which intervals a support bears."""
    columns = [a for a, other in enumerate(plan.support_names) if other == name]
    return np.any(plan.support_mode[:, columns] != SEPARATE, axis=1)


def rolls(plan: Plan) -> None:
    """Along the table without slipping, as far as half its circumference."""
    assert np.all(plan.support_mode == STICK)
    pitch = 2.0 * np.arctan2(plan.object_quaternion[..., 2], plan.object_quaternion[..., 0])
    np.testing.assert_allclose(
        plan.object_position[..., 0] + np.pi / 2 * 0.03, 0.03 * np.mod(pitch, 2 * np.pi), atol=1e-6
    )


def is_drawn(plan: Plan) -> None:
    """On the shelf all the way, and not turned: there is no room for it."""
    assert np.all(borne(plan, "shelf"))
    np.testing.assert_allclose(turns(plan), np.broadcast_to(np.eye(3), turns(plan).shape), atol=1e-9)


def is_lifted_over_the_edge(plan: Plan) -> None:
    """It leaves the table only where it reaches over it by more than a fingertip's radius."""
    lifted = positions(plan)[:, 2] > 0.0035 + 1e-6
    assert lifted.any()
    assert np.all(positions(plan)[lifted, 0] + 0.045 > 0.01)


def is_pushed(plan: Plan) -> None:
    """Never lifted, sliding on its table, round the post."""
    assert np.all(borne(plan, "table"))
    np.testing.assert_allclose(positions(plan)[:, 2], 0.025, atol=1e-6)
    post = np.einsum("sba,sb->sa", turns(plan), [0.025, 0.0, 0.025] - positions(plan))
    assert np.min(np.linalg.norm(np.maximum(np.abs(post) - [0.04, 0.03, 0.025], 0.0), axis=1)) > 0.01


def goes_lengthwise(plan: Plan) -> None:
    """Where it is between the capsules its long axis is along the passage: across it, it is no wider than the gap."""
    between = np.abs(positions(plan)[:, 0]) < 1e-2
    across = np.hypot(0.045 * turns(plan)[between, 1, 0], 0.03 * turns(plan)[between, 1, 1])
    assert between.any()
    assert np.all(across < 0.045 - 0.006)


def is_drawn_straight_up(plan: Plan) -> None:
    """As long as its end is in the hole it stays upright, within the millimetre that the hole leaves."""
    inside = positions(plan)[:, 2] - 0.045 < 0.04 - 1e-3
    assert np.all(np.abs(positions(plan)[inside, :2]) < 0.001 + 1e-6)
    tilt = turns(plan)[inside, 2, 2]
    np.testing.assert_allclose(tilt, 1.0, atol=1e-9)


def tumbles(plan: Plan) -> None:
    """One finger, the cube never off both table and step, a quarter of a turn."""
    assert plan.V.shape[1] == 1
    assert np.all(borne(plan, "table") | borne(plan, "step"))
    assert borne(plan, "step")[-1]


def is_tipped_up(plan: Plan) -> None:
    """On the table all the way, first on its face, last on its end."""
    assert np.all(borne(plan, "table"))
    assert turns(plan)[0, 2, 2] > 1.0 - 1e-9
    assert abs(turns(plan)[-1, 2, 0]) > 1.0 - 1e-6


@pytest.mark.parametrize(
    ("name", "does"),
    [
        pytest.param("ball-roll", rolls, marks=SLOW),
        ("book-shelf", is_drawn),
        ("card-edge", is_lifted_over_the_edge),
        pytest.param("heavy-push", is_pushed, marks=SLOW),
        pytest.param("passage-carry", goes_lengthwise, marks=SLOW),
        ("peg-hole", is_drawn_straight_up),
        ("step-tumble", tumbles),
        ("wall-pivot", is_tipped_up),
    ],
)
def test_a_built_in_scene_proves_itself(name: str, does: Callable[[Plan], None]) -> None:
    outcome = plan_scene(load(name), 0, Settings())
    assert outcome.plan is not None, str(outcome.failure)
    certificate = check(outcome.plan)
    assert certificate.passed, [str(finding) for finding in certificate.refusals]
    does(outcome.plan)
