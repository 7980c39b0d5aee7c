"""The time limit: shares that use all of it, and a run that says when it is up."""

import math

import pytest

from regrasp.planner import clock
from regrasp.planner.chain import BLOCK
from regrasp.planner.clock import start_clock
from regrasp.planner.method import plan_scene
from regrasp.planner.task import Settings
from regrasp.scene.load import load


@pytest.fixture
def now(monkeypatch):
    """The time, as a list of one number."""
    time = [100.0]
    monkeypatch.setattr(clock.time, "monotonic", lambda: time[0])
    return time


def test_shares_are_equal_parts_of_what_is_left(now):
    whole = start_clock(12.0)
    for parts in (3, 2, 1):
        part = whole.share(parts)
        assert part.end - part.start == pytest.approx(4.0)
        assert part.elapsed() == 0.0
        now[0] += 3.0
        assert part.elapsed() == pytest.approx(0.75)
        now[0] += 1.0
        assert part.up()
        assert part.elapsed() == 1.0
    assert whole.up()
    assert whole.share(1).elapsed() == 1.0


def test_without_a_limit_no_time_passes(now):
    whole = start_clock(0.0)
    now[0] += 1e9
    assert not whole.up()
    assert whole.elapsed() == whole.share(3).elapsed() == 0.0


def test_a_run_out_of_time_says_so():
    """And has the best plan so far: that of one block of moves, which no time limit keeps it from."""
    outcome = plan_scene(load("fig4-relocation"), 0, Settings(time_limit=1e-6))
    assert outcome.failure is not None
    assert outcome.failure.constraint == "time"
    assert "segment 1" in str(outcome.failure)
    assert "1e-06 s" in str(outcome.failure)
    assert outcome.plan is not None
    assert not outcome.plan.feasible
    assert len(outcome.plan.energy) == 1 + BLOCK


@pytest.mark.parametrize("limit", [-1.0, math.inf, math.nan])
def test_limits_that_are_none_are_refused(limit):
    with pytest.raises(ValueError, match="time_limit"):
        Settings(time_limit=limit)
