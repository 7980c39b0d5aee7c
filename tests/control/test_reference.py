"""The reference is the plan's own motion, sampled; before it the approach, after it the hold; delays move contacts."""

import dataclasses

import mujoco
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from regrasp.control.controller import agent_joints
from regrasp.control.reference import Phases, delayed, reference
from regrasp.plan import FIRST_ROLL, FIRST_SLIDE, MOTIONS, OFF, RELOCATE, STAY, Plan
from regrasp.scene.load import load
from regrasp.scene.world import World, build

SCENES = ("fig2-planar", "fig3-puma3")
PERIOD = 0.01
PHASES = Phases(standoff=0.008, approach=0.4, load=0.25, settle=0.2, hold=0.5)


@pytest.fixture(scope="module", params=SCENES)
def case(request, restless) -> tuple[Plan, World]:
    return restless(request.param), build(load(request.param))


def plan_times(plan: Plan, ref) -> np.ndarray:
    """Time in the plan of the rows from start to end."""
    return np.linspace(plan.time[0, 0], plan.time[-1, -1], ref.end - ref.start + 1)


def tips(world: World, q: np.ndarray) -> np.ndarray:
    """Positions of the tips (k, 3)."""
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.start
    data.qpos[np.concatenate([agent.qpos for agent in world.agents])] = q
    mujoco.mj_kinematics(world.model, data)
    return data.geom_xpos[[agent.tip_geom for agent in world.agents]].copy()


def test_the_rows_of_the_plan_are_its_splines_slerps_and_linear_forces(case):
    plan, world = case
    ref = reference(plan, world, PERIOD, PHASES)
    for row, t in zip(range(ref.start, ref.end + 1), plan_times(plan, ref), strict=True):
        j = int(np.flatnonzero(plan.time[:, 0] <= t)[-1])
        knots = plan.time[j]
        assert ref.interval[row] == j
        joints = make_interp_spline(knots, plan.joints[j], k=3)  # not-a-knot, as B-splines
        np.testing.assert_allclose(ref.q[row], joints(t), atol=1e-12)
        np.testing.assert_allclose(ref.qd[row], joints.derivative()(t), atol=1e-10)
        np.testing.assert_allclose(ref.p_WO[row], make_interp_spline(knots, plan.object_position[j])(t), atol=1e-12)
        s = min(int(np.flatnonzero(knots <= t)[-1]), len(knots) - 2)
        u = (t - knots[s]) / (knots[s + 1] - knots[s])
        R0, R1 = (Rotation.from_quat(plan.object_quaternion[j, s + i], scalar_first=True) for i in (0, 1))
        R = R0 * Rotation.from_rotvec(u * (R0.inv() * R1).as_rotvec())
        np.testing.assert_allclose(ref.R_WO[row], R.as_matrix(), atol=1e-12)
        on = np.isfinite(plan.p_OC_O[j, 0, :, 0])
        assert np.array_equal(ref.bears[row], on)
        for i in np.flatnonzero(on):
            force, point = (
                [np.interp(t, knots, array[j, :, i, axis]) for axis in range(3)]
                for array in (plan.force_W, plan.p_OC_O)
            )
            np.testing.assert_allclose(ref.force_W[row, i], force, atol=1e-12)
            np.testing.assert_allclose(ref.p_WC[row, i], ref.p_WO[row] + R.apply(point), atol=1e-12)
        assert not ref.force_W[row, ~on].any()


def test_at_a_change_of_contact_the_new_interval_counts(case):
    """Intervals of half a second and a period of 1/64 s: every change falls on a row, to the bit."""
    plan, world = case
    N, M = plan.time.shape
    even = dataclasses.replace(plan, time=0.5 * (np.arange(N)[:, None] + np.linspace(0.0, 1.0, M)))
    ref = reference(even, world, 1 / 64, PHASES)
    rows = ref.start + 32 * np.arange(N)
    assert np.array_equal(ref.interval[rows], np.arange(N))
    assert np.array_equal(ref.bears[rows], np.isfinite(plan.p_OC_O[:, 0, :, 0]))
    np.testing.assert_allclose(ref.force_W[rows], plan.force_W[:, 0], atol=1e-12)
    np.testing.assert_allclose(ref.q[rows], plan.joints[:, 0], atol=1e-12)


def test_the_rates_are_the_joints_derivative(case):
    """Central differences of a cubic are off by h² q'''/6: halving the period quarters the error."""
    plan, world = case
    duration = plan.time[-1, -1]
    errors = []
    for count in (400, 800, 1600):
        ref = reference(plan, world, duration / count, PHASES)
        rows = np.arange(ref.start + 1, ref.end)
        t = plan_times(plan, ref)[1:-1]
        inside = np.min(np.abs(t[:, None] - plan.time.ravel()), axis=1) > 1.5 * duration / 400
        slope = (ref.q[rows + 1] - ref.q[rows - 1]) / (2.0 * ref.period)
        errors.append(np.abs(slope - ref.qd[rows])[inside].max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 1.8)


def test_approach_is_smooth_and_its_rates_are_its_derivative(case):
    plan, world = case
    fine = reference(plan, world, 1e-3, PHASES)
    q, qd = fine.q[: fine.touch + 1], fine.qd[: fine.touch + 1]
    assert not qd[0].any()
    assert not qd[-1].any()
    slope = (q[2:] - q[:-2]) / 2e-3
    assert np.abs(q[0] - q[-1]).max() > 1e-3  # it does move
    assert np.abs(slope - qd[1:-1]).max() < 1e-4 * np.abs(qd).max()


def test_joints_are_continuous_from_standoff_to_hold(case):
    plan, world = case
    ref = reference(plan, world, 1e-3, PHASES)
    assert np.abs(np.diff(ref.q, axis=0)).max() < 1.05e-3 * np.abs(ref.qd).max()
    rest = slice(ref.touch, ref.start)
    assert np.array_equal(ref.q[rest], np.broadcast_to(plan.joints[0, 0], ref.q[rest].shape))
    assert not ref.qd[rest].any()
    assert np.abs(ref.q[ref.end :] - plan.joints[-1, -1]).max() < 1e-12
    assert not ref.qd[ref.end + 1 :].any()


def test_the_phases_take_the_time_that_is_asked(case):
    plan, world = case
    ref = reference(plan, world, PERIOD, PHASES)
    assert ref.touch * PERIOD == pytest.approx(0.4)
    assert (ref.start - ref.touch) * PERIOD == pytest.approx(0.45)
    assert (len(ref) - 1 - ref.end) * PERIOD == pytest.approx(0.5)
    assert ref.time(ref.start) == 0.0
    assert ref.time(ref.end) == pytest.approx(plan.time[-1, -1], abs=PERIOD)
    assert np.all(ref.interval[: ref.start] == -1)
    assert np.all(np.diff(ref.interval) >= 0)


def test_the_fingers_come_along_the_outward_normals(case):
    """Half the standoff, half the relative error: the way is right to second order."""
    plan, world = case
    R = Rotation.from_quat(plan.object_quaternion[0, 0], scalar_first=True)
    n_W = plan.n_O[0, 0] @ R.as_matrix().T
    errors = []
    for standoff in (0.008, 0.004):
        ref = reference(plan, world, PERIOD, dataclasses.replace(PHASES, standoff=standoff))
        way = tips(world, ref.q[0]) - tips(world, ref.q[ref.touch])
        errors.append(np.linalg.norm(way - standoff * n_W, axis=1).max() / standoff)
    assert errors[0] < 0.06
    assert errors[1] < 0.55 * errors[0]


def test_a_finger_that_begins_off_the_object_stays(restless):
    plan, world = restless("fig3-puma3"), build(load("fig3-puma3"))
    arrays = {name: getattr(plan, name).copy() for name in ("p_OC_O", "n_O", "x_O")}
    for array in arrays.values():
        array[0, :, 1] = np.nan
    ref = reference(dataclasses.replace(plan, **arrays), world, PERIOD, PHASES)
    moves = np.ptp(ref.q[: ref.start], axis=0) > 0.0
    columns = agent_joints(world)
    assert not moves[columns[1]].any()
    assert moves[columns[0]].any()
    assert moves[columns[2]].any()
    assert not ref.bears[: ref.start, 1].any()


def test_forces_build_up_evenly_between_touch_and_start(case):
    plan, world = case
    ref = reference(plan, world, PERIOD, PHASES)
    assert not ref.force_W[: ref.touch].any()
    assert not ref.bears[: ref.touch].any()
    first = ref.force_W[ref.start]
    full = ref.touch + round(PHASES.load / PERIOD)
    assert np.array_equal(
        ref.force_W[full - 1 : ref.start], np.broadcast_to(first, (ref.start - full + 1, *first.shape))
    )
    steps = np.diff(ref.force_W[ref.touch - 1 : full], axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to(first / (full - ref.touch), steps.shape), atol=1e-12)
    assert np.array_equal(ref.bears[ref.touch], ref.bears[ref.start])


def test_after_the_end_the_last_instant_holds(case):
    plan, world = case
    ref = reference(plan, world, PERIOD, PHASES)
    for array in (ref.q, ref.p_WO, ref.R_WO, ref.force_W, ref.p_WC, ref.bears):
        assert np.array_equal(array[ref.end :], np.broadcast_to(array[ref.end], array[ref.end :].shape))


def test_the_plans_clock_may_begin_at_any_time(case):
    """A plan that begins later is the same table with other times."""
    plan, world = case
    ref, late = (reference(dataclasses.replace(plan, time=plan.time + by), world, PERIOD, PHASES) for by in (0.0, 3.5))
    assert late.time(late.start) == 3.5
    assert late.time(late.end) == pytest.approx(plan.time[-1, -1] + 3.5, abs=PERIOD)
    for field in dataclasses.fields(ref):
        if field.name != "begin":
            np.testing.assert_allclose(getattr(late, field.name), getattr(ref, field.name), atol=1e-9)


def test_who_slides_is_the_plans_interval_by_interval(case):
    plan, world = case
    rng = np.random.default_rng(2)
    V = rng.choice([STAY, FIRST_ROLL, FIRST_SLIDE, RELOCATE - 1, RELOCATE, OFF], plan.V.shape).astype(np.int8)
    ref = reference(dataclasses.replace(plan, V=V), world, PERIOD, PHASES)
    sliding = np.char.startswith(np.array(MOTIONS)[V], "slide")
    assert 0 < sliding.sum() < sliding.size
    np.testing.assert_array_equal(ref.slides, sliding[np.maximum(ref.interval, 0)])


@pytest.mark.parametrize("period", [0.002, 0.007, 0.03])
def test_the_table_ends_at_the_goal_at_any_period(case, period):
    plan, world = case
    ref = reference(plan, world, period, PHASES)
    np.testing.assert_allclose(ref.q[[ref.start, ref.end]], plan.joints[[0, -1], [0, -1]], atol=1e-12)
    np.testing.assert_allclose(ref.p_WO[[ref.start, ref.end]], plan.object_position[[0, -1], [0, -1]], atol=1e-12)


def test_phases_may_be_left_out(case):
    """Each takes one period at least: the fingers still touch, load and settle in this order."""
    plan, world = case
    ref = reference(plan, world, PERIOD, Phases(0.0, 0.0, 0.0, 0.0, 0.0))
    assert (ref.touch, ref.start, len(ref) - 1 - ref.end) == (1, 3, 1)
    assert np.array_equal(ref.q[: ref.start], np.broadcast_to(plan.joints[0, 0], (3, plan.joints.shape[2])))
    assert np.array_equal(ref.force_W[1], ref.force_W[ref.start])


def changes(bears: np.ndarray) -> np.ndarray:
    return np.flatnonzero(np.diff(bears)) + 1


def test_without_delay_the_table_is_the_same(case):
    plan, world = case
    ref = reference(plan, world, PERIOD, PHASES)
    same = delayed(ref, agent_joints(world), 0.0, np.random.default_rng(1))
    for field in dataclasses.fields(ref):
        assert np.array_equal(getattr(same, field.name), getattr(ref, field.name)), field.name


@pytest.mark.parametrize("delay", [0.02, 0.1])
def test_contact_changes_move_by_at_most_the_delay_and_the_ends_stay(case, delay):
    plan, world = case
    ref = reference(plan, world, PERIOD, PHASES)
    columns = agent_joints(world)
    moved = []
    for seed in range(40):
        late = delayed(ref, columns, delay, np.random.default_rng(seed))
        for i in range(len(columns)):
            before, after = changes(ref.bears[:, i]), changes(late.bears[:, i])
            assert len(after) == len(before)
            moved.append((after - before) * PERIOD)
        for name in ("q", "qd", "force_W", "bears", "slides", "p_WC"):
            assert np.array_equal(getattr(late, name)[[0, -1]], getattr(ref, name)[[0, -1]]), name
        for name in ("p_WO", "R_WO", "interval"):
            assert np.array_equal(getattr(late, name), getattr(ref, name)), name
        # Nothing is invented: forces and joints of an instant are those of one instant of the table.
        for i, mine in enumerate(columns):
            both = np.concatenate([late.q[:, mine], late.force_W[:, i]], axis=1)
            known = np.concatenate([ref.q[:, mine], ref.force_W[:, i]], axis=1)
            assert set(map(bytes, both)) <= set(map(bytes, known))
    all_moves = np.concatenate(moved)
    assert np.abs(all_moves).max() <= delay + 0.51 * PERIOD
    assert all_moves.min() < -0.5 * delay
    assert all_moves.max() > 0.5 * delay


def test_a_slide_is_as_late_as_its_agents_contact(case):
    """Of an agent that slides in all of its intervals but the one off the object."""
    plan, world = case
    V = np.full_like(plan.V, FIRST_SLIDE)
    V[~np.isfinite(plan.p_OC_O[:, 0, :, 0])] = RELOCATE
    ref = reference(dataclasses.replace(plan, V=V), world, PERIOD, PHASES)
    inside = slice(ref.start + 11, ref.end - 10)  # beyond the delays, within the plan
    moved = 0
    for seed in range(10):
        late = delayed(ref, agent_joints(world), 0.1, np.random.default_rng(seed))
        assert np.array_equal(late.slides[inside], late.bears[inside])
        moved += not np.array_equal(late.slides, ref.slides)
    assert moved > 5


def test_every_agent_is_late_on_its_own(case):
    plan, world = case
    ref = reference(plan, world, PERIOD, PHASES)
    touches = np.array([
        [changes(late.bears[:, i])[0] for i in range(len(world.agents))]
        for late in (delayed(ref, agent_joints(world), 0.1, np.random.default_rng(seed)) for seed in range(200))
    ])  # fmt: skip
    off_diagonal = np.corrcoef(touches.T)[~np.eye(len(world.agents), dtype=bool)]
    assert np.abs(off_diagonal).max() < 0.25  # 3.5 standard deviations of 200 independent pairs


def test_the_same_numbers_drawn_give_the_same_delays(case):
    plan, world = case
    ref = reference(plan, world, PERIOD, PHASES)
    tables = [delayed(ref, agent_joints(world), 0.05, np.random.default_rng(seed)) for seed in (3, 3, 4)]
    assert np.array_equal(tables[0].bears, tables[1].bears)
    assert np.array_equal(tables[0].q, tables[1].q)
    assert not np.array_equal(tables[0].q, tables[2].q)
