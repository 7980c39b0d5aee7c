"""A running plan planned again: from where the object is, to where it should be, and never with an exception."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from regrasp.errors import InputError
from regrasp.kernels.chains import forward
from regrasp.kernels.inverse import inverse
from regrasp.plan import OFF, RELOCATE, STAY, Plan
from regrasp.planner.hand import Hand, hand_of
from regrasp.planner.method import Settings, plan_scene
from regrasp.planner.path import Pose
from regrasp.planner.replan import Replanner, Replanning, apart, interval_at, pose_at
from regrasp.planner.resume import resampled, with_touching
from regrasp.scene.load import load
from regrasp.scene.world import from_plan
from regrasp.verify.check import check

Array = NDArray[np.float64]
SOME = Replanning(iterations=400)
FAR, TURNED = 0.02, math.radians(15.0)


@pytest.fixture(scope="module")
def plan() -> Plan:
    outcome = plan_scene(load("puma4-obstacles"), 1, Settings())
    assert outcome.plan is not None
    return outcome.plan


@pytest.fixture(scope="module")
def hand(plan: Plan) -> Hand:
    return hand_of(from_plan(plan.scene, plan.xml, plan.assets))


def joints_at(plan: Plan, t: float) -> Array:
    j = interval_at(plan, t)
    return CubicSpline(plan.time[j], plan.joints[j])(t)


def moved(plan: Plan, hand: Hand, t: float, shift: Array, turn: Array) -> tuple[Pose, Array] | None:
    """The object displaced from its place at time t, and the joints with which the fingers that hold it went along."""
    (R, p), q = pose_at(plan, t), joints_at(plan, t)
    D = Rotation.from_rotvec(turn).as_matrix()
    for i in np.flatnonzero(plan.V[interval_at(plan, t)] < RELOCATE):
        mine = slice(hand.chains.start[i], hand.chains.start[i + 1])
        joints = q[mine].copy()
        R_WL, p_WL = np.empty((len(joints) + 1, 3, 3)), np.empty((len(joints) + 1, 3))
        forward(hand.chains, i, joints, R_WL, p_WL)
        residual, _ = inverse(hand.chains, i, D @ R_WL[-1], p + shift + D @ (p_WL[-1] - p), joints, R_WL, p_WL)
        if residual > 1e-7:
            return None
        q[mine] = joints
    return (D @ R, p + shift), q


def pushed(plan: Plan, hand: Hand, seed: int) -> tuple[float, Pose, Array]:
    """A time, and a state up to 20 mm and 15° off the path that the fingers reach."""
    rng = np.random.default_rng(seed)
    while True:
        t = float(rng.uniform(0.1, 0.8) * plan.time[-1, -1])
        d, a = rng.standard_normal(3), rng.standard_normal(3)
        shift, turn = (x * rng.uniform(0.4, 1.0) / np.linalg.norm(x) for x in (d, a))
        state = moved(plan, hand, t, FAR * shift, TURNED * turn)
        if state is not None:
            return t, *state


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
    goal = plan.scene["goal"]["pose"]["position"]
    done = 0
    for seed in range(6):
        t, X_WO, q = pushed(plan, hand, seed)
        answer = Replanner(plan, SOME, seed).step(t, X_WO, q)
        assert answer.new == (answer.failure is None)
        if not answer.new:
            assert answer.plan is plan
            assert answer.failure is not None
            assert answer.failure.reason
            assert answer.failure.remedy
            continue
        done += 1
        new = answer.plan
        assert new.time[0, 0] == t
        assert max(apart(pose_at(new, t), X_WO)) < 1e-6
        np.testing.assert_allclose(new.joints[0, 0], q, atol=1e-6)
        np.testing.assert_allclose(new.object_position[-1, -1], goal, atol=1e-9)
        certificate = check(new)
        assert certificate.passed, [str(finding) for finding in certificate.refusals]
    assert done >= 4


def test_a_plan_planned_again_can_be_planned_again(plan: Plan, hand: Hand) -> None:
    replanner = Replanner(plan, SOME)
    t = 0.3 * float(plan.time[-1, -1])
    for up in (0.008, 0.006):
        state = moved(replanner.plan, hand, t, np.array([0.0, 0.0, up]), np.zeros(3))
        assert state is not None
        answer = replanner.step(t, *state)
        assert answer.new, str(answer.failure)
        assert answer.plan is replanner.plan
        t += 0.5
    assert check(answer.plan).passed


def test_the_same_seed_gives_the_same_plan(plan: Plan, hand: Hand) -> None:
    state = moved(plan, hand, 2.0, np.array([0.0, 0.0, 0.01]), np.zeros(3))
    assert state is not None
    plans = [Replanner(plan, Replanning(iterations=100), 3).step(2.0, *state).plan for _ in range(2)]
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
        answer = Replanner(plan, Replanning(iterations=10**6, time_limit=limit)).step(2.0, *state)
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
