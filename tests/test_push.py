"""The example of re-planning: a push in mid-plan that drops the object, unless the plan is planned again."""

import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))

from push import planned, run, upwards

from regrasp.planner.replan import Replanner, Replanning


def test_a_pushed_object_still_reaches_its_goal() -> None:
    """Without a time limit, so that every machine takes the same steps."""
    plan = planned("fig4-relocation", 2)
    push = upwards(plan)
    alone, again = run(plan, push, None), run(plan, push, Replanner(plan, Replanning(time_limit=0.0)))
    assert alone.dropped
    assert not again.dropped
    assert again.answers[-1].complete
    assert again.pushed[0] >= 0.02
    assert again.pushed[1] >= math.radians(15.0)
    assert again.reached
