"""Giving way: forces that go with a pushed object still hold it, and a short leash is all that pulls it back."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp.control.feedback import displacement
from regrasp.control.yielding import Leash, beyond, carried, displaced, grasp_map


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("m", [1, 2, 4])
def test_carried_forces_keep_their_wrench_and_turn_what_fingers_do_to_each_other(seed: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    before = rng.standard_normal(3), Rotation.random(random_state=seed).as_matrix()
    moved = 0.3 * rng.standard_normal(6)
    now = displaced(before, moved)
    np.testing.assert_allclose(displacement(*before, *now), moved, atol=1e-12)
    r = rng.standard_normal((m, 3))
    G = grasp_map(r)
    inner = rng.standard_normal(3 * m)
    inner -= np.linalg.pinv(G) @ G @ inner
    turned, there = carried(inner.reshape(m, 3), r + before[0], before, now, 2.0)
    turn = now[1] @ before[1].T
    np.testing.assert_allclose(there, now[0] + r @ turn.T, atol=1e-12)
    np.testing.assert_allclose(turned, 2.0 * inner.reshape(m, 3) @ turn.T, atol=1e-9)
    if m < 3:
        return  # fewer than three points bear no torque about their line
    # The wrench that carries the weight stays as it is, in W.
    upright = displaced(before, np.array([0.1, 0.2, 0.3, 0.0, 0.0, 0.7]))
    weight = np.linalg.pinv(G) @ np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    force, p = carried((inner + weight).reshape(m, 3), r + before[0], before, upright, 3.0)
    np.testing.assert_allclose(grasp_map(p - upright[0]) @ force.ravel(), G @ weight, atol=1e-9)


def test_grasp_map_is_force_and_torque() -> None:
    rng = np.random.default_rng(0)
    r, f = rng.standard_normal((2, 4, 3))
    np.testing.assert_allclose(grasp_map(r) @ f.ravel(), np.concatenate([f.sum(axis=0), np.cross(r, f).sum(axis=0)]))


@pytest.mark.parametrize("far", [0.0, 0.5, 1.0, 1.5, 20.0])
def test_beyond_the_leash_is_all_that_is_longer_than_it(far: float) -> None:
    leash = Leash()
    d, a = np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])
    out = beyond(leash, np.concatenate([far * leash.shift * d, far * leash.turn * a]))
    np.testing.assert_allclose(out[:3], max(0.0, far - 1.0) * leash.shift * d, atol=1e-15)
    np.testing.assert_allclose(out[3:], max(0.0, far - 1.0) * leash.turn * a, atol=1e-15)


@pytest.mark.parametrize("field", ["shift", "turn", "grip"])
def test_what_cannot_be_is_refused(field: str) -> None:
    with pytest.raises(ValueError, match=field):
        Leash(**{field: -1.0})
