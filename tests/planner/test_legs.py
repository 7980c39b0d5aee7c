"""A leg in the simplest way that works: contacts kept, a new grasp where the object rests, halves; each certified in a plan."""

import dataclasses
import itertools
import re

import numpy as np
import pytest
from arcs import arc

from regrasp.plan import OFF, RELOCATE
from regrasp.planner import legs
from regrasp.planner.arcs import Arc
from regrasp.planner.assemble import Segment
from regrasp.planner.clock import start_clock
from regrasp.planner.configurations import Grasp
from regrasp.planner.legs import (
    STAYED,
    TOOK_HOLD,
    Planned,
    plan_leg,
    stances_for,
    stay,
    take_hold,
)  # fmt: skip
from regrasp.planner.local import LocalPlanner, terms_of
from regrasp.planner.method import plan_of
from regrasp.planner.outcome import Failure
from regrasp.planner.pieces import first_piece, intervals, paths_of, pieces_of, rest_at
from regrasp.planner.poses import START
from regrasp.planner.scan import new_scan
from regrasp.planner.stances import Stance, followed
from regrasp.planner.task import Settings, Task, prepare
from regrasp.scene.load import load
from regrasp.search.annealing import Settings as Annealing
from regrasp.verify.check import check


@pytest.fixture(scope="module")
def book() -> tuple[Task, list[Arc]]:
    """Two fingers and a book that slides on its shelf and rests wherever it is."""
    task = prepare(load("book-shelf"), Settings())
    route = task.router.route(START, lambda: False, lambda _: None)
    assert not isinstance(route, Failure)
    return task, [leg.arc for leg in route]


def stance(task: Task, arcs: list[Arc], seed: int) -> Stance:
    """The grasp that one random choice leads to."""
    one = dataclasses.replace(task.settings, grasp=dataclasses.replace(task.settings.grasp, restarts=1))
    task = dataclasses.replace(task, settings=one)
    made = stances_for(task, paths_of(task, arcs, None)[0], np.random.default_rng(seed), ())
    assert not isinstance(made, Failure), made
    return made[0]


def led(task: Task, arcs: list[Arc], grasp: Grasp | None) -> Planned | Failure:
    """The first of the arcs, planned from a grasp."""
    return plan_leg(task, arcs, grasp, 0, np.random.default_rng(0), lambda _: None, start_clock(0.0))


def proved(task: Task, segments: list[Segment]) -> None:
    """The plan of these segments leads to the goal and is certified."""
    plan = plan_of(task, segments, 0, True)
    assert not isinstance(plan, Failure), str(plan)
    certificate = check(plan)
    assert certificate.passed, [str(finding) for finding in certificate.refusals]


@pytest.mark.parametrize("name", ["fig3-puma3", "fig2-planar", "book-shelf", "wall-pivot"])
def test_who_stays_keeps_its_contact(name: str) -> None:
    """The point on the object is that of the grasp at every sample; the grasp at the end has the same points."""
    a = arc(name)
    made = stay(a.task, a.path, a.grasp, "here")
    assert not isinstance(made, Failure), str(made)
    segment, after = made
    np.testing.assert_array_equal(after.holds, a.grasp.holds)
    # A finger of few joints rolls where one of them nears its limit.
    still = (a.grasp.holds == 1) & ~np.any(segment.motion.V, axis=0)
    assert np.sum(still) >= 2
    np.testing.assert_allclose(after.p_OC[still], a.grasp.p_OC[still], atol=1e-9)
    points = segment.motion.p_OC_O[:, :, still]
    np.testing.assert_allclose(points, np.broadcast_to(a.grasp.p_OC[still], points.shape), atol=1e-6)


def test_a_grasp_that_does_not_hold_is_not_kept() -> None:
    """One of three fingers lets go: the failure says what breaks and where."""
    a = arc("fig3-puma3")
    holds = a.grasp.holds.copy()
    holds[0] = 0
    q = a.grasp.q.copy()
    q[a.joints(0)] = a.hand.home[a.joints(0)]
    g = a.grasp
    failure = stay(a.task, a.path, Grasp(q, holds, g.p_OC, g.p_TC, g.R_OT), "there")
    assert isinstance(failure, Failure)
    assert failure.constraint == "equilibrium"
    assert failure.where.startswith("there")


def test_the_grasp_changes_while_the_object_stands_still(book: tuple[Task, list[Arc]]) -> None:
    """From the grasp of one random choice to that of another, then on to the goal: certified as one plan."""
    task, arcs = book
    before, *others = (stance(task, arcs, seed) for seed in range(1, 12))
    wanted = next(
        other for other in others
        if not np.array_equal(other.candidates, before.candidates)
        and not isinstance(stay(task, paths_of(task, arcs, None)[0], other.grasp, ""), Failure)
    )  # fmt: skip
    changed = take_hold(task, arcs[0].start, before.grasp, wanted, "segment 1")
    assert not isinstance(changed, Failure), str(changed)
    segment, grasp = changed
    np.testing.assert_array_equal(grasp.holds, wanted.grasp.holds)
    np.testing.assert_allclose(grasp.p_OC, wanted.grasp.p_OC, atol=1e-9)
    path = segment.motion.path
    assert np.ptp(path.p_WO.reshape(-1, 3), axis=0).max() == 0.0
    assert np.ptp(path.R_WO.reshape(-1, 9), axis=0).max() == 0.0
    # One moves at a time; the others hold their contacts or are off.
    assert np.all(np.sum(segment.motion.V == RELOCATE, axis=1) <= 1)
    assert set(np.unique(segment.motion.V)) <= {0, RELOCATE, OFF}
    on = stay(task, paths_of(task, arcs, None)[0], grasp, "segment 2")
    assert not isinstance(on, Failure), str(on)
    proved(task, [segment, on[0]])


def test_a_leg_keeps_the_grasp_at_hand_if_it_can_and_takes_hold_if_there_is_none(book: tuple[Task, list[Arc]]) -> None:
    task, arcs = book
    fresh = led(task, arcs, None)
    assert isinstance(fresh, Planned)
    assert (fresh.how, fresh.failure, len(fresh.segments)) == (TOOK_HOLD, None, 1)
    kept = led(task, arcs, stance(task, arcs, 1).grasp)
    assert isinstance(kept, Planned)
    assert (kept.how, len(kept.segments)) == (STAYED, 1)
    for planned in (fresh, kept):
        proved(task, planned.segments)


def test_what_cannot_be_held_whole_is_held_in_halves(
    book: tuple[Task, list[Arc]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """If no contacts last for more than half of the arc, they are taken anew where the book rests in its middle."""
    task, arcs = book
    half = len(paths_of(task, arcs[:1], None)[0].R_WO) // 2 + 1

    def short(task: Task, path, grasp: Grasp, stage: str):
        return Failure("reach", stage, "", "too far", "") if len(path.R_WO) > half else stay(task, path, grasp, stage)

    monkeypatch.setattr(legs, "stay", short)
    planned = led(task, arcs, None)
    assert isinstance(planned, Planned)
    assert (planned.how, planned.failure) == (TOOK_HOLD, None)
    assert len(planned.segments) >= 2
    for one, two in itertools.pairwise(planned.segments):
        np.testing.assert_allclose(one.motion.path.p_WO[-1, -1], two.motion.path.p_WO[0, 0], atol=1e-12)
        np.testing.assert_allclose(one.motion.joints[-1, -1], two.motion.joints[0, 0], atol=1e-9)
    proved(task, planned.segments)


@pytest.mark.parametrize("seed", range(3))
def test_where_contacts_can_be_kept_along_the_whole_way_the_first_stance_keeps_them(seed: int) -> None:
    """Three mobile robots round a corner, where walls are in the way between the looks of the scan. Those that it calls
    lasting and are not lose a contact where following it says so."""
    task = prepare(load("mobile-panel"), Settings())
    route = task.router.route(START, lambda: False, lambda _: None)
    assert not isinstance(route, Failure)
    path = paths_of(task, [leg.arc for leg in route], None)[0]
    found = stances_for(task, path, np.random.default_rng(seed), ())
    assert not isinstance(found, Failure)
    assert found[0].kept == 1.0
    assert not isinstance(stay(task, path, found[0].grasp, "whole"), Failure)
    local = task.settings.local
    scan, terms = new_scan(task.hand, path, local.relocation), terms_of(task.hand, local)
    lost = [followed(task.hand, path, scan, terms, each.grasp)[0] for each in found]
    assert any(lost)
    for each, parts in zip(found, lost, strict=True):
        broken = stay(task, path, each.grasp, "whole")
        if parts:
            assert isinstance(broken, Failure)
            first = int(re.search(r"interval (\d+) of", broken.where).group(1))
            # Samples lie closer than interval ends.
            assert first <= 1 + round(min(parts.values()) * len(path.R_WO))


def test_what_contacts_cannot_be_kept_on_is_annealed() -> None:
    """Half a turn in four fingers: no grasp lasts; a search with few moves says what it could not do, and where."""
    settings = Settings(local=LocalPlanner(attempts=1, annealing=Annealing(iterations=40, trials=10)))
    task = prepare(load("fig4-relocation"), settings)
    route = task.router.route(START, lambda: False, lambda _: None)
    assert not isinstance(route, Failure)
    arcs, rng = [leg.arc for leg in route], np.random.default_rng(0)
    stances = stances_for(task, first_piece(task, arcs[0], None), rng, ())
    assert not isinstance(stances, Failure)
    planned = plan_leg(task, arcs, stances[0].grasp, 0, rng, lambda _: None, start_clock(0.0))
    assert isinstance(planned, Planned)
    assert planned.how == legs.ANNEALED
    assert len(planned.segments[-1].energy) == 41


def test_paths_join_and_have_the_intervals_that_turn_and_travel_ask_for(book: tuple[Task, list[Arc]]) -> None:
    task, arcs = book
    s, radius = task.settings, task.hand.radius
    for a in (*arcs, *arcs[0].halves()):
        n = intervals(task, a)
        assert n >= 4
        assert a.angle / n <= s.turn * (1.0 + 1e-9)
        assert a.length(0.0) / n <= s.travel * radius * (1.0 + 1e-9)
        whole, pieces = paths_of(task, [a], None)[0], pieces_of(task, a)
        assert len(whole.R_WO) == n
        assert all(count <= s.intervals for _, _, count in pieces)
        ends = [(pieces[0][1][0], a.start[1]), (pieces[-1][1][-1], a.goal[1])]
        ends += [(one[1][-1], two[1][0]) for one, two in itertools.pairwise(pieces)]
        for one, two in ends:
            np.testing.assert_allclose(one, two, atol=1e-12)
        paused, m = first_piece(task, a, None, pause=2), s.samples
        np.testing.assert_array_equal(paused.p_WO[2:], first_piece(task, a, None).p_WO)
        np.testing.assert_array_equal(paused.R_WO[:2], np.broadcast_to(pieces[0][0][0], (2, m + 1, 3, 3)))
    both = paths_of(task, list(arcs[0].halves()), None)[0]
    np.testing.assert_allclose(both.p_WO[-1, -1], arcs[0].goal[1], atol=1e-12)
    still = rest_at(task, arcs[0].start, 3, None)
    assert still.R_WO.shape[0] == 3
    assert np.ptp(still.p_WO.reshape(-1, 3), axis=0).max() == 0.0
