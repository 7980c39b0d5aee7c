"""The example of re-planning: a push in mid-plan that drops the object, unless the plan is planned again."""

import math
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))

from push import planned, run, upwards

from regrasp.planner.replan import Replanner


def test_a_pushed_object_still_reaches_its_goal() -> None:
    plan = planned("fig4-relocation", 0)
    push = upwards(plan)
    alone, again = run(plan, push, None), run(plan, push, Replanner(plan))
    assert alone.dropped
    assert not again.dropped
    assert again.steps
    assert again.pushed[0] >= 0.02
    assert again.pushed[1] >= math.radians(15.0)
    assert np.all(np.array(again.final) < (2e-3, math.radians(2.0)))
