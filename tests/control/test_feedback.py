"""The integrator and the smoother of the object feedback, against their closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp.control.feedback import Feedback, State, displacement, init, step, tip_shift

SETTINGS = Feedback(period=0.02, rate=3.0, smoothing=0.1, reach=0.015, bend=0.35)
ON, OFF = np.array([True, True]), np.array([True, False])


def run(
    error,
    count: int,
    bears=ON,
    follows: bool = True,
    settings: Feedback = SETTINGS,
    state: State | None = None,
    free=None,
):
    """States after each of `count` measurements of a constant error."""
    states = [state or init(2)]
    for _ in range(count):
        states.append(
            step(
                settings,
                states[-1],
                np.asarray(error, dtype=float),
                bears,
                follows,
                np.eye(6) if free is None else free,
            )
        )
    return states


def test_the_displacement_moves_the_planned_pose_to_the_measured_one():
    rng = np.random.default_rng(0)
    for angle in (0.0, 1e-9, 1e-3, 0.3, 1.5, np.pi / 2, 2.5, 3.1):
        axis = rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        planned, turn = Rotation.random(rng=rng), Rotation.from_rotvec(angle * axis)
        p, shift = rng.standard_normal((2, 3))
        found = displacement(p, planned.as_matrix(), p + shift, (turn * planned).as_matrix())
        np.testing.assert_allclose(found, [*shift, *(angle * axis)], atol=1e-13)


def test_a_tip_shift_is_the_velocity_of_a_rigid_body():
    """Against a small finite motion about the object's origin: the error falls with the square."""
    rng = np.random.default_rng(1)
    offset, p_WO, p_WT = rng.standard_normal(6), rng.standard_normal(3), rng.standard_normal(3)
    errors = []
    for h in (1e-2, 5e-3, 2.5e-3):
        moved = p_WO + h * offset[:3] + Rotation.from_rotvec(h * offset[3:]).apply(p_WT - p_WO)
        shift = tip_shift(h * offset, p_WO, p_WT)
        errors.append(np.linalg.norm(moved - p_WT - shift[:3]))
        np.testing.assert_array_equal(shift[3:], h * offset[3:])
    assert np.all(np.log2(np.array(errors[:-1]) / errors[1:]) > 1.95)


@pytest.mark.parametrize("bears", [ON, OFF, ~ON])
def test_without_error_nothing_is_corrected(bears):
    for state in run(np.zeros(6), 50, bears):
        assert not any(part.any() for part in (state.c, state.own, state.seen))


def test_the_correction_grows_at_its_rate_against_the_error():
    error = np.array([1e-3, -2e-3, 5e-4, 0.01, 0.0, -0.02])
    for n, state in enumerate(run(error, 30)):
        np.testing.assert_allclose(state.c, -SETTINGS.rate * SETTINGS.period * n * error, atol=1e-15)


def test_errors_that_supports_bar_are_not_corrected():
    lifts = np.diag([1.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    error = np.array([1e-3, -2e-3, 5e-4, 0.01, 0.005, -0.02])
    last = run(error, 30, free=lifts)[-1].c
    np.testing.assert_allclose(last, run(lifts @ error, 30)[-1].c, atol=1e-15)
    assert not last[[2, 3, 4]].any()


def test_the_correction_stops_at_its_limits_and_keeps_its_direction():
    error = np.array([3e-3, -4e-3, 0.0, 0.2, 0.0, 0.1])
    last = run(error, 500)[-1].c
    for part, limit in ((slice(0, 3), SETTINGS.reach), (slice(3, 6), SETTINGS.bend)):
        assert np.linalg.norm(last[part]) == pytest.approx(limit)
        assert last[part] @ error[part] == pytest.approx(-limit * np.linalg.norm(error[part]))
    # It comes back as fast as it went: nothing has wound up behind the limit.
    back = run(-error, 5, state=State(last, np.zeros((2, 6)), np.zeros(6)))
    np.testing.assert_allclose(back[-1].c - last, 5 * SETTINGS.rate * SETTINGS.period * error, atol=1e-12)


def test_one_limit_does_not_touch_the_other():
    last = run(np.array([0.01, 0, 0, 1e-4, 0, 0]), 100)[-1].c
    assert np.linalg.norm(last[:3]) == pytest.approx(SETTINGS.reach)
    assert last[3] == pytest.approx(-100 * SETTINGS.rate * SETTINGS.period * 1e-4)


def test_an_object_that_is_not_carried_is_not_corrected():
    assert not run(np.full(6, 1e-3), 50, follows=False)[-1].c.any()


@pytest.mark.parametrize("rate", [1.0, 3.0, 12.0])
def test_noise_averages_out(rate):
    """Closed over an object that is where d + c puts it: an AR(1) process about −d, of variance rT/(2 − rT) σ²."""
    settings = Feedback(rate=rate, reach=1.0, bend=3.0)
    rng, sigma, d = np.random.default_rng(3), 1e-3, np.array([2e-3, 0, -1e-3, 0.01, 0, 0])
    state, seen = init(2), []
    for n in range(20000):
        state = step(settings, state, d + state.c + sigma * rng.standard_normal(6), ON, True, np.eye(6))
        if n > 2000:
            seen.append(state.c)
    a = rate * settings.period
    variance = a / (2.0 - a) * sigma**2
    np.testing.assert_allclose(np.var(seen, axis=0), variance, rtol=0.25)
    np.testing.assert_allclose(np.mean(seen, axis=0), -d, atol=5 * sigma / np.sqrt(a * 18000))


def test_a_constant_displacement_is_taken_back_exponentially():
    """The object goes where c sends it: what is left falls by 1 − rT each period."""
    d, state = np.array([4e-3, 0, 0, 0, 0.1, 0]), init(2)
    for n in range(100):
        np.testing.assert_allclose(d + state.c, d * (1 - SETTINGS.rate * SETTINGS.period) ** n, atol=1e-14)
        state = step(SETTINGS, state, d + state.c, ON, True, np.eye(6))


def test_a_finger_off_the_object_follows_what_is_seen():
    """Smoothed twice, with b = T/τ: after n measurements of a constant e its offset is e (1 − (1 + n b) (1 − b)ⁿ)."""
    error = np.array([2e-3, 1e-3, 0, 0, 0.05, 0])
    b = SETTINGS.period / SETTINGS.smoothing
    for n, state in enumerate(run(error, 60, OFF, follows=False)):
        np.testing.assert_allclose(state.c + state.own[1], error * (1.0 - (1.0 + n * b) * (1.0 - b) ** n), atol=1e-15)
        assert not state.own[0].any()


def test_smoothing_shorter_than_the_period_follows_at_once():
    error = np.full(6, 1e-3)
    last = run(error, 1, OFF, settings=Feedback(period=0.02, smoothing=0.001))[-1]
    np.testing.assert_allclose(last.c + last.own[1], error, atol=1e-15)


def test_touch_down_keeps_the_fingers_place():
    """In contact its own part stays as it was: the target moves on by the change of c alone."""
    rng = np.random.default_rng(4)
    state = run(np.array([3e-3, 0, 1e-3, 0, 0.02, 0]), 7, OFF)[-1]
    own = state.own[1].copy()
    assert np.linalg.norm(own) > 1e-3
    for _ in range(20):
        after = step(SETTINGS, state, 1e-3 * rng.standard_normal(6), ON, True, np.eye(6))
        np.testing.assert_array_equal(after.own[1], own)
        np.testing.assert_allclose((after.c + after.own[1]) - (state.c + state.own[1]), after.c - state.c, atol=1e-16)
        state = after
