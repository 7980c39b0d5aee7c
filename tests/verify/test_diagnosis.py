"""What is said of an execution that failed: the earliest event, its interval, and who; on executions written by hand."""

import dataclasses

import numpy as np
import pytest

from regrasp.verify.diagnosis import GONE, diagnose, succeeded
from regrasp.verify.execution import EVERY, Execution, Touch, Trouble
from regrasp.verify.physics import PERIOD

TICK = EVERY * PERIOD
LONG = round(GONE / TICK)
"""Records without force that are a lost contact."""
S, K = 200, 3
NAMES = ("thumb", "index", "ring")
TOLERANCE = (3e-3, 0.05)


def fine() -> Execution:
    """Two seconds in four intervals without any trouble; every agent presses with 2 N."""
    force = np.broadcast_to([0.0, 0.0, 2.0], (S, K, 3)).copy()
    return Execution(
        time=np.arange(S) * TICK, interval=np.arange(S) // 50, qpos=np.zeros((S, 7)), error=np.zeros((S, 6)),
        force_W=force.copy(), planned_W=force.copy(), bears=np.ones((S, K), bool), slip=np.zeros((S, K)),
        strained=np.zeros((S, K), bool), touches=(), trouble=None, seconds=S * TICK, wall=1.0,
    )  # fmt: skip


def drifting(run: Execution, row: int = 180, shift: float = 0.01, turn: float = 0.0) -> Execution:
    """The execution with the object off its path from the row on."""
    run.error[row:, 1], run.error[row:, 4] = shift, turn
    return run


def told(run: Execution) -> tuple[int, float, str, str]:
    failure = diagnose(run, NAMES, TOLERANCE)
    assert failure is not None
    return failure.interval, pytest.approx(failure.time), failure.who, failure.why


def test_success_has_no_failure_whatever_happened_on_the_way():
    run = drifting(fine())
    run.error[-1] = 0.0
    run.slip[100:, 1] = 0.01
    run.strained[50, 0] = True
    assert succeeded(run, TOLERANCE)
    assert diagnose(run, NAMES, TOLERANCE) is None


@pytest.mark.parametrize(("shift", "turn", "good"), [(2.9e-3, 0.049, True), (3.1e-3, 0.0, False), (0.0, 0.051, False)])
def test_success_is_the_last_record_within_both_tolerances(shift, turn, good):
    run = drifting(fine(), shift=shift, turn=turn)
    assert succeeded(run, TOLERANCE) is good
    assert (diagnose(run, NAMES, TOLERANCE) is None) is good


def test_trouble_is_a_failure_even_at_the_goal():
    run = dataclasses.replace(fine(), trouble=Trouble("dropped", "object", 2.0))
    assert not succeeded(run, TOLERANCE)
    interval, _, who, why = told(run)
    assert (interval, who, why) == (3, "object", "dropped")


@pytest.mark.parametrize(("shift", "turn"), [(0.01, 0.0), (0.0, 0.1)])
def test_drift_begins_where_the_object_leaves_the_tolerance_for_good(shift, turn):
    run = drifting(fine(), 120, shift, turn)
    run.error[60:70, 0] = 0.02  # out and in again
    interval, time, who, why = told(run)
    assert (interval, who) == (2, "object")
    assert time == 120 * TICK
    assert f"{1e3 * shift:.1f} mm and {np.degrees(turn):.1f}°" in why


@pytest.mark.parametrize("agent", range(K))
@pytest.mark.parametrize("row", [0, 47, 99, 130])
def test_a_lost_contact_is_told_with_when_it_began(agent, row):
    run = drifting(fine())
    run.force_W[row:, agent] = 0.0
    interval, time, who, why = told(run)
    assert (who, why) == (NAMES[agent], "lost contact")
    assert time == row * TICK
    assert interval == row // 50


def test_a_short_gap_a_light_finger_and_one_that_is_off_have_not_lost_contact():
    run = drifting(fine())
    run.force_W[20 : 20 + LONG - 1, 0] = 0.0
    run.planned_W[:, 1] *= 0.1
    run.force_W[:, 1] = 0.0
    run.bears[:, 2] = False
    run.planned_W[:, 2] = run.force_W[:, 2] = 0.0
    assert told(run)[2] == "object"


def test_gaps_add_up_only_when_they_follow_each_other():
    run = drifting(fine())
    for row in range(0, 150, LONG):
        run.force_W[row : row + LONG - 1, 0] = 0.0
    assert told(run)[2] == "object"


def test_slip_is_told_when_it_passes_two_millimetres():
    run = drifting(fine())
    run.slip[:, 1] = np.linspace(0.0, 4e-3, S)  # 2 mm in the middle
    run.slip[:, 2] = 1.9e-3
    interval, time, who, why = told(run)
    assert (interval, who, why) == (2, "index", "slipped, by 4.0 mm in all")
    assert time == 100 * TICK


def test_a_drive_at_its_limit_is_told():
    run = drifting(fine())
    run.strained[[55, 90], 2] = True
    interval, time, who, why = told(run)
    assert (interval, who, why) == (1, "ring", "has a drive at its limit")
    assert time == 55 * TICK


def test_a_contact_that_the_plan_does_not_have_is_told():
    run = dataclasses.replace(
        drifting(fine()), touches=(Touch("link3", "post", 160 * TICK), Touch("object", "post", 70 * TICK))
    )
    interval, time, who, why = told(run)
    assert (interval, who, why) == (1, "object", "touched post")
    assert time == pytest.approx(70 * TICK, abs=TICK)
    run = dataclasses.replace(run, touches=(Touch("ring", "object", 110 * TICK),))
    assert str(diagnose(run, NAMES, TOLERANCE)) == f"interval 2, t = {110 * TICK:.2f} s: ring touched the object"


EVENTS = {
    "lost contact": lambda run, row: run.force_W.__setitem__((slice(row, None), 0), 0.0),
    "slipped": lambda run, row: run.slip.__setitem__((slice(row, None), 1), 5e-3),
    "limit": lambda run, row: run.strained.__setitem__((row, 2), True),
    "drifts": lambda run, row: drifting(run, row),
}


@pytest.mark.parametrize("first", EVENTS)
@pytest.mark.parametrize("second", EVENTS)
def test_the_earliest_event_wins(first, second):
    if first == second:
        return
    run = fine()
    EVENTS[first](run, 60)
    EVENTS[second](run, 110)
    drifting(run, min(np.flatnonzero(run.off[:, 0] > 0.0), default=150))
    interval, time, _, why = told(run)
    assert first in why
    assert interval == 1
    assert time == 60 * TICK


def test_a_cause_is_named_before_its_effect_of_the_same_instant():
    run = drifting(fine(), 80)
    run.strained[80, 0] = True
    assert told(run)[2] == "thumb"


def test_before_the_first_record_trouble_itself_is_told():
    run = fine()
    empty = {
        each.name: getattr(run, each.name)[:0]
        for each in dataclasses.fields(run)
        if isinstance(getattr(run, each.name), np.ndarray)
    }
    run = dataclasses.replace(run, **empty, trouble=Trouble("MuJoCo warns: badqacc", "link2", -0.3))
    failure = diagnose(run, NAMES, TOLERANCE)
    assert (failure.interval, failure.time, failure.who, failure.why) == (0, -0.3, "link2", "MuJoCo warns: badqacc")


def test_a_failure_reads_as_a_sentence():
    run = drifting(fine())
    run.force_W[130:, 0] = 0.0
    assert str(diagnose(run, NAMES, TOLERANCE)) == f"interval 2, t = {130 * TICK:.2f} s: thumb lost contact"
