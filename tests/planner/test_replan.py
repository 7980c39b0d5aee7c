"""A running plan planned again: from where the object is, to where it should be, and never with an exception."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from regrasp.bench.replans import Displaced, asked, draws, inside, moved
from regrasp.errors import InputError
from regrasp.plan import OFF, RELOCATE, STAY, Plan
from regrasp.planner.along import apart, joints_at, pose_at
from regrasp.planner.arms import poses_of
from regrasp.planner.configurations import Grasp
from regrasp.planner.hand import Hand, hand_of
from regrasp.planner.measured import measured_grasp
from regrasp.planner.method import Settings, plan_scene, prepare
from regrasp.planner.replan import CALLS, PAUSE, Replanner, Replanning
from regrasp.planner.resume import resampled, with_touching
from regrasp.scene.load import load
from regrasp.scene.world import from_plan
from regrasp.verify.check import check

SOME = Replanning(iterations=400, time_limit=0.0)


@pytest.fixture(scope="module")
def plan() -> Plan:
    outcome = plan_scene(load("puma4-obstacles"), 1, Settings())
    assert outcome.plan is not None
    return outcome.plan


@pytest.fixture(scope="module")
def hand(plan: Plan) -> Hand:
    return hand_of(from_plan(plan.scene, plan.xml, plan.assets))


def pushed(plan: Plan, hand: Hand, seed: int) -> Displaced:
    """A state up to 20 mm and 15° off the path that the fingers reach, with no body inside another."""
    states = (state for state in draws(plan, hand, np.random.default_rng(seed)) if state is not None)
    first = dataclasses.replace(SOME, iterations=10, runs=1)
    return next(state for state in states if not inside(asked(Replanner(plan, first), state)[0].failure))


@pytest.mark.parametrize("part", [0.0, 0.2, 0.5, 0.9, 1.0])
def test_on_its_path_the_plan_stays_the_same(plan: Plan, part: float) -> None:
    replanner = Replanner(plan, SOME)
    t = part * plan.time[-1, -1]
    R, p = pose_at(plan, t)
    for shift, turn in ((0.0, 0.0), (0.9 * SOME.position, 0.9 * SOME.rotation)):
        near = Rotation.from_rotvec([turn, 0.0, 0.0]).as_matrix() @ R, p + [0.0, 0.0, shift]
        answer = replanner.step(t, near, joints_at(plan, t))
        assert answer.plan is plan
        assert not answer.new
        assert answer.failure is None
        assert answer.off == pytest.approx((shift, turn), abs=1e-7)


def test_from_a_displaced_object_the_new_plan_begins_there_and_proves_itself(plan: Plan, hand: Hand) -> None:
    done = 0
    for seed in range(6):
        state = pushed(plan, hand, seed)
        replanner = Replanner(plan, SOME, seed)
        answers = asked(replanner, state)
        for answer in answers[:-1]:
            assert answer.plan is plan
        answer = answers[-1]
        assert answer.new == (answer.failure is None)
        if not answer.new:
            assert answer.plan is plan
            assert answer.failure is not None
            assert answer.failure.reason
            assert answer.failure.remedy
            continue
        done += 1
        new = answer.plan
        assert new.time[0, 0] == state.t
        assert max(apart(pose_at(new, state.t), state.X_WO)) < 1e-6
        np.testing.assert_allclose(new.joints[0, 0], state.q, atol=1e-6)
        if answer.complete:
            np.testing.assert_allclose(new.object_position[-1, -1], plan.object_position[-1, -1], atol=1e-9)
        certificate = check(new)
        assert certificate.passed, [str(finding) for finding in certificate.refusals]
    assert done >= 5


@pytest.mark.parametrize("seed", [0, 1])
def test_plan_after_plan_the_goal_is_reached_where_each_is_followed_exactly(plan: Plan, hand: Hand, seed: int) -> None:
    replanner, state = Replanner(plan, SOME, seed), pushed(plan, hand, seed)
    ends = []
    while True:
        answer = asked(replanner, state)[-1]
        assert answer.new, str(answer.failure)
        assert check(answer.plan).passed
        assert max(apart(pose_at(answer.plan, state.t), state.X_WO)) < 1e-6
        end = float(answer.plan.time[-1, -1])
        ends.append(end)
        if answer.complete:
            break
        before = 0.5 * (state.t + end)
        on_the_way = replanner.step(before, pose_at(answer.plan, before), joints_at(answer.plan, before))
        assert on_the_way.plan is answer.plan
        state = Displaced(end, pose_at(answer.plan, end), joints_at(answer.plan, end))
    assert max(apart(pose_at(answer.plan, end), pose_at(plan, plan.time[-1, -1]))) < 1e-7
    assert ends == sorted(ends)
    # At the goal nothing more is asked for.
    assert replanner.step(end, pose_at(answer.plan, end), joints_at(answer.plan, end)).plan is answer.plan


def test_a_step_anneals_no_more_than_it_may(plan: Plan, hand: Hand) -> None:
    for iterations, runs in ((100, 1), (300, 2)):
        some = dataclasses.replace(SOME, iterations=iterations, runs=runs)
        for seed in range(3):
            for answer in asked(Replanner(plan, some, seed), pushed(plan, hand, seed)):
                assert 0 < answer.iterations <= runs * iterations


def test_a_failed_search_goes_on_with_the_next_call() -> None:
    """What a few moves don't find at once, some more calls do: on a plan whose contacts do not just stay."""
    plan = plan_scene(load("fig4-relocation"), 0, Settings()).plan
    assert plan is not None
    hand = hand_of(from_plan(plan.scene, plan.xml, plan.assets))
    some = dataclasses.replace(SOME, iterations=100, runs=1)
    calls = [asked(Replanner(plan, some, seed), pushed(plan, hand, seed)) for seed in range(20)]
    late = [answers for answers in calls if len(answers) > 1]
    assert late
    assert any(answers[-1].new for answers in late)
    # The third and the fourth call search the way on which the object first rests.
    ended = [answers for answers in calls if answers[-1].new and len(answers) <= 2 * CALLS]
    rests = [len(answers) > CALLS for answers in ended]
    still = [np.ptp(answers[-1].plan.object_position[:PAUSE].reshape(-1, 3), axis=0).max() < 1e-12 for answers in ended]
    assert still == rests
    assert any(rests)


def test_a_plan_planned_again_can_be_planned_again(plan: Plan, hand: Hand) -> None:
    replanner = Replanner(plan, SOME)
    t = 0.3 * float(plan.time[-1, -1])
    for up in (0.008, 0.006):
        state = moved(replanner.plan, hand, t, np.array([0.0, 0.0, up]), np.zeros(3))
        assert state is not None
        answer = asked(replanner, state)[-1]
        assert answer.new, str(answer.failure)
        assert answer.plan is replanner.plan
        t += 0.5
    assert check(answer.plan).passed


def test_a_hand_on_an_arm_is_planned_again_from_where_the_arm_has_taken_it() -> None:
    plan = plan_scene(load("arm-hand-carry"), 0, Settings()).plan
    assert plan is not None
    hand = hand_of(from_plan(plan.scene, plan.xml, plan.assets))
    rng, n = np.random.default_rng(0), len(hand.home)
    for part in (0.2, 0.7):
        t = part * float(plan.time[-1, -1])
        (R, p), q = pose_at(plan, t), joints_at(plan, t)
        away = q.copy()
        away[n:] += 0.02 * rng.standard_normal(len(q) - n)
        R_WP, p_WP, _, _ = poses_of(hand, np.stack([q[n:], away[n:]]))
        turn = R_WP[1, 1] @ R_WP[1, 0].T
        X_WO = turn @ R, p_WP[1, 1] + turn @ (p - p_WP[1, 0])
        answer = asked(Replanner(plan, SOME), Displaced(t, X_WO, away))[-1]
        assert answer.new, str(answer.failure)
        assert answer.off[0] > SOME.position
        # A finger that rolls as its joints make it touches anew, within a micrometre of where it did.
        np.testing.assert_allclose(answer.plan.joints[0, 0], away, atol=1e-5)
        assert max(apart(pose_at(answer.plan, t), X_WO)) < 1e-6
        certificate = check(answer.plan)
        assert certificate.passed, [str(finding) for finding in certificate.refusals]


def test_a_finger_in_flight_stays_in_the_air_though_it_is_near(plan: Plan, hand: Hand) -> None:
    """Only one that the plan has in contact is given the contact that it nearly has."""
    task = prepare(load("puma4-obstacles"), Settings())
    i = int(np.argmax(np.all(plan.V < RELOCATE, axis=0)))
    X_WO, q, bears = pose_at(plan, plan.time[0, 0]), plan.joints[0, 0], plan.V[0] < RELOCATE
    back = X_WO[0], X_WO[1] - 0.002 * X_WO[0] @ plan.n_O[0, 0, i]
    for flies in (False, True):
        bears[i] = not flies
        grasp = measured_grasp(task, back, q, bears, 0.003, 0.0015)
        assert isinstance(grasp, Grasp), str(grasp)
        assert grasp.holds[i] == (not flies)
        mine = slice(hand.chains.start[i], hand.chains.start[i + 1])
        assert np.array_equal(grasp.q[mine], q[mine]) == flies


def test_the_same_seed_gives_the_same_plan(plan: Plan, hand: Hand) -> None:
    state = moved(plan, hand, 2.0, np.array([0.0, 0.0, 0.01]), np.zeros(3))
    assert state is not None
    plans = [asked(Replanner(plan, SOME, 3), state)[-1].plan for _ in range(2)]
    assert plans[0] is not plan
    assert plans[0]._bytes() == plans[1]._bytes()


def test_what_is_hopeless_is_said_and_the_plan_kept(plan: Plan, hand: Hand) -> None:
    replanner = Replanner(plan, SOME)
    (R, p), q, nowhere = pose_at(plan, 1.0), joints_at(plan, 1.0), np.full(3, np.nan)
    post = np.array(plan.scene["environment"][0]["pose"]["position"])
    dropped = p + [0.0, 0.0, 0.06]
    for pose, joints, constraint in (
        ((R, p + [2.0, 0.0, 0.0]), q, "reach"),
        ((R, post), q, "collision"),
        ((R, dropped), q, "equilibrium"),
        ((R, p - [0.0, 0.0, 0.02]), q, "collision"),  # the tips are inside the object
        ((R, nowhere), q, "start"),
        ((R, p), np.full_like(q, np.inf), "start"),
    ):
        answer = replanner.step(1.0, pose, joints)
        assert answer.plan is plan
        assert not answer.new
        assert answer.failure is not None
        assert answer.failure.constraint == constraint
        assert answer.failure.reason
        assert answer.failure.remedy
    with pytest.raises(InputError, match="q \\(24,\\)"):
        replanner.step(1.0, (R, p), q[1:])


def test_the_limit_bounds_a_step(plan: Plan, hand: Hand) -> None:
    """Nor does one that leaves no time for anything raise."""
    state = moved(plan, hand, 2.0, np.array([0.0, 0.0, 0.01]), np.zeros(3))
    assert state is not None
    for limit in (0.5, 1e-3):
        answer = Replanner(plan, Replanning(iterations=10**6, time_limit=limit)).step(state.t, state.X_WO, state.q)
        assert answer.seconds < 3.0
        assert answer.new == (answer.failure is None)


matrices = st.tuples(st.integers(1, 12), st.integers(1, 4), st.integers(0, 10**6)).map(
    lambda shape: np.random.default_rng(shape[2]).choice(
        np.array([0, 1, 5, OFF, RELOCATE], np.int8), shape[:2], p=[0.4, 0.2, 0.15, 0.15, 0.1]
    )
)


@given(matrices, st.integers(1, 30))
@settings(deadline=None)
def test_resampled_motions_keep_their_order_and_every_relocation_comes_once(V: NDArray[np.int8], n: int) -> None:
    # One at a time, as a plan has them.
    V = np.where((V == RELOCATE) & (np.sum(V == RELOCATE, axis=1, keepdims=True) > 1), STAY, V)
    out = resampled(V, n)
    assert out.shape == (n, V.shape[1])
    assert np.all(np.sum(out == RELOCATE, axis=1) <= 1)
    order, wanted = np.nonzero(out == RELOCATE)[1], np.nonzero(V == RELOCATE)[1]
    np.testing.assert_array_equal(order, wanted[:n])
    if len(wanted) <= n:
        for old, new in zip(V.T, out.T, strict=True):
            assert is_part(runs(new), runs(old))
    if n == len(V):
        np.testing.assert_array_equal(out, V)


def runs(column: NDArray[np.int8]) -> list[int]:
    """The motions of an agent one after the other, without the stays, each relocation on its own."""
    out: list[int] = []
    for code, group in itertools.groupby(column[column != STAY].tolist()):
        out += [code] * (len(list(group)) if code == RELOCATE else 1)
    return out


def is_part(short: list[int], long: list[int]) -> bool:
    rest = iter(long)
    return all(any(code == other for other in rest) for code in short)


def test_who_lost_its_contact_relocates_and_who_has_one_does_not() -> None:
    V = np.array([[1, 2, RELOCATE, OFF], [1, 3, 4, RELOCATE]], np.int8)
    kept = with_touching(V, np.array([True, True, False, False]))
    np.testing.assert_array_equal(kept, V)
    landed = with_touching(V, np.array([True, True, True, False]))
    np.testing.assert_array_equal(landed[:, 2], [4, 4])
    lost = with_touching(V, np.array([False, False, False, False]))
    assert len(lost) == 4
    np.testing.assert_array_equal(np.sum(lost == RELOCATE, axis=0), [1, 1, 1, 1])
    np.testing.assert_array_equal(np.argmax(lost == RELOCATE, axis=0), [0, 1, 2, 3])


@pytest.mark.parametrize("field", ["position", "rotation", "touch"])
def test_tolerances_are_positive(field: str) -> None:
    with pytest.raises(ValueError, match=field):
        dataclasses.replace(SOME, **{field: 0.0})
