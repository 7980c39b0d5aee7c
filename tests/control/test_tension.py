"""Strain is what is no rigid motion; letting it go leaves the object held and the sliding finger's push as planned."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp.control.tension import Release, released, strain

CASES = range(20)
EYES = np.tile(1e-3 * np.eye(3), (4, 1, 1))
NONE = np.zeros(4, bool)


@pytest.fixture(params=CASES)
def tips(request):
    """Four tips about an object of 5 cm, their offsets of a millimetre, unit normals."""
    rng = np.random.default_rng(request.param)
    n = rng.standard_normal((4, 3))
    return (
        0.05 * rng.standard_normal((4, 3)),
        1e-3 * rng.standard_normal((4, 3)),
        n / np.linalg.norm(n, axis=1)[:, None],
    )


def test_a_rigid_motion_is_no_strain(tips):
    p, _, _ = tips
    shift, turn = np.array([1e-3, -2e-3, 5e-4]), np.array([0.02, -0.01, 0.03])
    rest = strain(p, shift + np.cross(turn, p))
    # What the small term for tips on a line leaves of a turn.
    assert np.abs(rest).max() < 0.05 * np.abs(np.cross(turn, p)).max()
    assert np.abs(strain(p, np.tile(shift, (4, 1)))).max() < 1e-15


def test_strain_does_no_work_on_the_object(tips):
    """As forces at the tips it has no resultant, and next to no torque; where the fingers press on each other it stays."""
    p, d, _ = tips
    rest = strain(p, d)
    np.testing.assert_allclose(rest.sum(axis=0), 0.0, atol=1e-15)
    r = p - p.mean(axis=0)
    assert np.abs(np.cross(r, rest).sum(axis=0)).max() < 0.05 * np.linalg.norm(r, axis=1).max() * np.abs(d).max()
    squeeze = -0.02 * r
    np.testing.assert_allclose(strain(p, squeeze), squeeze, atol=1e-12)


def test_strain_does_not_depend_on_the_frame(tips):
    p, d, _ = tips
    R = Rotation.from_rotvec([0.3, -1.1, 0.7])
    np.testing.assert_allclose(strain(R.apply(p) + 0.4, R.apply(d)), R.apply(strain(p, d)), atol=1e-12)


def test_two_tips_and_tips_on_a_line_have_only_their_distance_to_strain():
    for count in (2, 3):
        p = np.linspace(-0.03, 0.03, count)[:, None] * [[0.6, 0.0, 0.8]]
        d = 1e-3 * np.random.default_rng(count).standard_normal((count, 3))
        rest = strain(p, d)
        assert np.isfinite(rest).all()
        if count == 2:
            along = np.array([0.6, 0.0, 0.8])
            np.testing.assert_allclose(rest, (rest @ along)[:, None] * along, atol=5e-6)
            assert (rest[1] - rest[0]) @ along == pytest.approx((d[1] - d[0]) @ along)


def test_one_finger_or_none_has_no_strain(tips):
    p, d, n = tips
    for sticks in (NONE, np.arange(4) == 2):
        assert not released(Release(), 0.02, p, d, sticks, NONE, n, EYES).any()


def test_strain_goes_at_its_rate_and_the_rigid_part_stays(tips):
    p, d, n = tips
    settings, period, sticks = Release(between=3.0), 0.02, ~NONE
    rest, before = d.copy(), strain(p, d)
    for _ in range(50):
        rest -= released(settings, period, p, rest, sticks, NONE, n, EYES)
    np.testing.assert_allclose(
        np.linalg.norm(strain(p, rest)), (1 - 3.0 * period) ** 50 * np.linalg.norm(before), rtol=0.05
    )
    np.testing.assert_allclose(rest.mean(axis=0), d.mean(axis=0), atol=1e-15)


def test_a_sliding_finger_loses_its_springs_push_and_nothing_else(tips):
    """At full rate the spring C⁻¹ d of the remaining offset has no force along the normal; the target moves along it only."""
    p, d, n = tips
    rng = np.random.default_rng(7)
    A = rng.standard_normal((4, 3, 3))
    compliance = 1e-3 * (A @ A.swapaxes(1, 2) + 0.1 * np.eye(3))
    slides = np.arange(4) == 1
    moved = released(Release(sliding=50.0), 0.02, p, d, ~slides & NONE, slides, n, compliance)
    push = np.linalg.norm(np.linalg.solve(compliance[1], d[1]))
    assert n[1] @ np.linalg.solve(compliance[1], d[1] - moved[1]) == pytest.approx(0.0, abs=1e-2 * push)
    np.testing.assert_allclose(np.cross(moved[1], n[1]), 0.0, atol=1e-18)
    assert not moved[~slides].any()


def test_a_planar_finger_yields_in_its_plane():
    """It has no compliance across the plane; the normal in it is what its target moves along, as far as the tip is off."""
    flat = np.diag([1e-3, 0.0, 1e-3])[None]
    d, n = np.array([[2e-3, 0.0, 1e-3]]), np.array([[0.0, 0.0, 1.0]])
    moved = released(Release(sliding=50.0), 0.02, 0 * d, d, np.array([False]), np.array([True]), n, flat)
    np.testing.assert_allclose(moved, [[0.0, 0.0, 1e-3]], atol=1e-12)


@pytest.mark.parametrize("wrong", [{"between": -1.0}, {"sliding": np.nan}, {"sliding": np.inf}])
def test_rates_that_mean_nothing_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Release(**wrong)
