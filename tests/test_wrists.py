"""Hands on arms: carried, turned by wrist and fingers, proved, executed; two hands on two arms carry together."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from regrasp.plan import FIRST_ROLL, Plan
from regrasp.planner.method import plan_scene
from regrasp.planner.outcome import Outcome
from regrasp.planner.task import Settings
from regrasp.scene.load import validate
from regrasp.scene.schema import Scene
from regrasp.scene.world import from_plan
from regrasp.settings import read
from regrasp.verify.check import check
from regrasp.verify.replay import replay

EXAMPLES = Path(__file__).parents[1] / "examples"


def crane(**changes: Any) -> Scene:
    scene = yaml.safe_load((EXAMPLES / "crane.yaml").read_text(encoding="utf-8"))
    scene["model"] |= {"file": str(EXAMPLES / "crane.xml"), **changes.pop("model", {})}
    return validate({**scene, **changes})


def planned(scene: Scene, seed: int = 0) -> Outcome:
    return plan_scene(scene, seed, read(Settings, scene.planner))


def certified(outcome: Outcome) -> Plan:
    assert outcome.plan is not None, str(outcome.failure)
    certificate = check(outcome.plan)
    assert certificate.passed, [str(finding) for finding in certificate.refusals]
    return outcome.plan


def test_what_the_arm_can_do_it_does_and_the_fingers_stay() -> None:
    """The ball rests in the palm all the way, so the fingers' joints do not move; physics takes it to the goal."""
    goal = {"pose": {"position": [-0.04, 0.03, 0.1], "euler": [0.0, 0.0, 0.4]}}
    plan = certified(planned(crane(goal=goal)))
    assert plan.joint_names[-4:] == ("robot/x", "robot/y", "robot/z", "robot/yaw")
    fingers, arm = plan.joints[..., :-4].reshape(-1, 9), plan.joints[..., -4:].reshape(-1, 4)
    assert np.ptp(fingers, axis=0).max() < 1e-6
    np.testing.assert_allclose(arm[-1] - arm[0], [0.06, 0.03, 0.02, 0.4], atol=1e-6)
    found = replay(plan)
    assert found.passed, [str(each.failure) for each in found.nominal]


def test_what_the_arm_leaves_of_a_turn_the_fingers_make() -> None:
    """The crane turns by 0.5 rad at most, and does not tilt; the ball does."""
    start = {"pose": {"position": [-0.1, 0.0, 0.08]}}
    goal = {"pose": {"position": [-0.05, 0.0, 0.08], "euler": [0.0, 0.25, 0.0]}}
    plan = certified(planned(crane(start=start, goal=goal)))
    arm = plan.joints[..., -4:].reshape(-1, 4)
    np.testing.assert_allclose(arm[-1] - arm[0], [0.05, 0.0, 0.0, 0.0], atol=1e-6)
    assert np.ptp(plan.joints[..., :-4].reshape(-1, 9), axis=0).max() > 0.05


def test_two_hands_on_two_arms_carry_a_bar(tmp_path: Path) -> None:
    both = mujoco.MjSpec()
    for side, x, quat in (("a-", -0.12, [0.0, 0.0, 0.0, 1.0]), ("b-", 0.12, [1.0, 0.0, 0.0, 0.0])):
        frame = both.worldbody.add_frame(pos=[x, 0.0, 0.0], quat=quat)  # idle fingers at the ends
        both.attach(mujoco.MjSpec.from_file(str(EXAMPLES / "crane.xml")), frame=frame, prefix=side)
    both.compile()
    (tmp_path / "two.xml").write_text(both.to_xml())
    home = [0.0, -0.4, 0.7]
    scene = {
        "name": "two",
        "model": {"file": str(tmp_path / "two.xml"), "posture": {"a-front_root": -1.0, "b-front_root": -1.0}},
        "agents": [{"name": f"{side}{finger}", "tip": f"{side}{finger}_tip", "home": home}
                   for side in ("a-", "b-") for finger in ("left", "right")],
        "object": {"shape": "capsule", "size": [0.026, 0.12], "mass": 0.2},
        "start": {"pose": {"position": [0.0, 0.0, 0.2], "euler": [0.0, np.pi / 2, 0.0]}},
        "goal": {"pose": {"position": [0.03, 0.05, 0.22], "euler": [0.0, np.pi / 2, 0.2]}},
    }  # fmt: skip
    plan = certified(planned(validate(scene)))
    world = from_plan(plan.scene, plan.xml, plan.assets)
    assert [agent.arm for agent in world.agents] == [0, 0, 1, 1]
    arms = plan.joints[..., -8:].reshape(-1, 2, 4)
    assert np.all(np.ptp(arms[..., :3], axis=0) > 0.015)
    assert np.all(plan.V < FIRST_ROLL)
