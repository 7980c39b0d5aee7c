"""The contacts' shares in a disturbance: numpy's least squares, closed forms, invariance; and what the reserve is good for."""

import numpy as np
import pytest
import springs
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from springs import FREE, grasp_map

from regrasp.planner.reserve import SOFT, Margins, invert, shares, spare

Array = NDArray[np.float64]

PLANE = np.array([1.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
"""x, z and the turn about y."""


def sigma(p: Array, sticks: Array | None = None, shifts: Array = FREE, turns: Array = FREE) -> Array:
    """σ of contacts at p by the kernel; what stood in its output before does not count."""
    share = np.full(len(p), np.nan)
    shares(p, np.ones(len(p), np.uint8) if sticks is None else sticks, shifts, turns, share)
    return share


def points(rng: np.random.Generator, count: int) -> Array:
    return rng.normal(size=(count, 3)) * rng.uniform(0.1, 1.0, 3)


@pytest.mark.parametrize(("shifts", "turns"), [(FREE, FREE), PLANE, (np.zeros(3), FREE), (FREE, np.zeros(3))])
def test_shares_are_those_of_the_least_squares(shifts: Array, turns: Array) -> None:
    """From one contact, of which nothing but `SOFT` resists a turn, to eight; those that do not stick count for nothing."""
    rng = np.random.default_rng(0)
    for count in range(1, 9):
        for _ in range(20):
            p, sticks = points(rng, count + 2), np.zeros(count + 2, np.uint8)
            sticks[rng.permutation(count + 2)[:count]] = 1
            found = sigma(p, sticks, shifts, turns)
            np.testing.assert_allclose(found[sticks == 1], springs.shares(p[sticks == 1], shifts, turns), rtol=1e-9)
            np.testing.assert_array_equal(found[sticks == 0], 0.0)


def test_a_share_is_the_root_mean_square_of_the_change_by_springs() -> None:
    """Equal springs at the contacts, the object moved by a small twist until they bear a random wrench: what SOFT adds apart,
    the changes of force have the root mean square δ σ."""
    rng = np.random.default_rng(1)
    p = 10.0 * points(rng, 5)  # far apart, so that SOFT is nothing beside the moments of inertia
    G, delta = grasp_map(p), 0.3
    d = rng.normal(scale=delta, size=(6, 200_000))
    twist = np.linalg.solve(G @ G.T, d)
    change = np.linalg.norm((G.T @ twist).reshape(5, 3, -1), axis=1)
    np.testing.assert_allclose(np.sqrt(np.mean(change**2, axis=1)), delta * sigma(p), rtol=1e-2)


def test_shares_turn_with_the_contacts_and_keep_their_order() -> None:
    rng = np.random.default_rng(2)
    for count in (2, 3, 5):
        p = points(rng, count)
        R, order = Rotation.random(random_state=rng).as_matrix(), rng.permutation(count)
        np.testing.assert_allclose(sigma(p @ R.T), sigma(p), rtol=1e-9)
        np.testing.assert_allclose(sigma(p[order]), sigma(p)[order], rtol=1e-12)
        turned = p @ Rotation.from_rotvec([0.0, 0.7, 0.0]).as_matrix().T
        np.testing.assert_allclose(sigma(turned, None, *PLANE), sigma(p, None, *PLANE), rtol=1e-9)


@pytest.mark.parametrize("count", [3, 4, 5])
def test_contacts_evenly_on_a_great_circle(count: int) -> None:
    """Each bears 1/C of a force and, along the circle, 1 / (C + SOFT) of a torque about its axis; of torques about the axes in
    its plane J = C/2 + SOFT makes cos / J and sin / J."""
    angle = 2.0 * np.pi * np.arange(count) / count
    p = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    square = 3.0 / count**2 + 1.0 / (count + SOFT) ** 2 + 1.0 / (count / 2 + SOFT) ** 2
    np.testing.assert_allclose(sigma(p), np.sqrt(square), rtol=1e-12)


@pytest.mark.parametrize("height", [0.0, 0.5])
def test_an_antipodal_pair(height: float) -> None:
    """Half of a force each, and of the torques across their line what J = 2 + SOFT leaves; the turn about it reaches neither.
    Over the centre of mass a force along the line is a torque across it, too, by their height."""
    p = np.array([[1.0, 0.0, height], [-1.0, 0.0, height]])
    square = 3.0 / 4.0 + (2.0 + height**2) / (2.0 + SOFT) ** 2
    np.testing.assert_allclose(sigma(p), np.sqrt(square), rtol=1e-12)


def test_near_a_line_shares_grow_and_stay_finite() -> None:
    """Two pairs at the ends of a line, b off it: of a torque about it each bears b / (4 b² + SOFT), at most
    1 / (4 √SOFT) as they come nearer, and on the line nothing."""

    def near(b: float) -> float:
        share = sigma(np.array([[1.0, 0, b], [1.0, 0, -b], [-1.0, 0, b], [-1.0, 0, -b]]))
        across = (1.0 + b**2) / (4.0 + 4.0 * b**2 + SOFT) ** 2 + 1.0 / (4.0 + SOFT) ** 2
        about = b / (4.0 * b**2 + SOFT)
        np.testing.assert_allclose(share, np.sqrt(3.0 / 16.0 + across + about**2), rtol=1e-12)
        return float(share[0])

    nearest = 0.5 * np.sqrt(SOFT)
    shares_at = [near(b) for b in np.geomspace(1.0, nearest, 9)]
    assert np.all(np.diff(shares_at) > 0.0)
    assert shares_at[-1] > 1.0 / (4.0 * np.sqrt(SOFT)) > 2.0 * shares_at[0]
    assert all(near(b) < shares_at[-1] for b in (0.9 * nearest, 1e-2, 1e-6, 0.0))


def test_a_wide_grasp_has_smaller_shares_than_a_narrow_one() -> None:
    """Never below those of the force alone, 1/C in each axis, to which they fall as the contacts move apart."""
    rng = np.random.default_rng(3)
    p = points(rng, 4)
    p -= p.mean(axis=0)
    sizes = np.array([sigma(scale * p) for scale in (0.5, 1.0, 2.0, 4.0, 1e3)])
    assert np.all(np.diff(sizes, axis=0) < 0.0)
    np.testing.assert_allclose(sizes[-1], np.sqrt(3.0) / 4.0, rtol=1e-4)


def test_more_contacts_of_the_same_kind_share_alike() -> None:
    """Two agents at every point bear half each, SOFT apart."""
    p = 1e3 * points(np.random.default_rng(4), 4)
    np.testing.assert_allclose(sigma(np.vstack([p, p])), np.tile(sigma(p), 2) / 2.0, rtol=1e-6)


def test_without_contacts_there_are_no_shares() -> None:
    np.testing.assert_array_equal(sigma(np.zeros((3, 3)), np.zeros(3, np.uint8)), 0.0)
    assert len(sigma(np.zeros((0, 3)))) == 0


def test_the_inverse_is_one() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        B = rng.normal(size=(3, 3))
        A, inverse = B @ B.T + 0.02 * np.eye(3), np.empty((3, 3))
        invert(A, inverse)
        np.testing.assert_allclose(inverse @ A, np.eye(3), atol=1e-9)


def test_the_reserve_keeps_a_changed_force_in_its_cone() -> None:
    """Any force in the cone moved up its axis by s, changed by any |Δf| ≤ δ σ, stays in the cone and has the grip left;
    with s a thousandth smaller and no grip, some does not."""
    rng = np.random.default_rng(6)
    left = 0
    for _ in range(2000):
        mu, share, grip, delta = (
            rng.uniform(0.1, 1.5),
            rng.uniform(0.3, 3.0),
            rng.uniform(0.0, 0.2),
            rng.uniform(0.01, 0.3),
        )
        s = spare(Margins(0.3, grip, delta, 0.5), mu, share, np.inf)
        assert spare(Margins(0.3, 0.0, delta, 0.5), mu, share, np.inf) == pytest.approx(s - grip)
        part, angle = rng.choice([0.0, rng.random(), 1.0]), rng.uniform(0.0, 2.0 * np.pi)
        above = rng.choice([0.0, rng.exponential()])
        across = part * mu * above * np.array([np.cos(angle), np.sin(angle)])
        # The worst change points at the surface of the cone, down and outwards.
        worst = np.array([np.cos(angle), np.sin(angle), -mu]) / np.sqrt(1.0 + mu * mu)
        other = rng.normal(size=3)
        for change in (worst, rng.random() * other / np.linalg.norm(other)):
            f = np.append(across, s + above) + delta * share * change
            assert np.linalg.norm(f[:2]) <= mu * (f[2] - grip) + 1e-12
        f = np.append(across, 0.999 * (s - grip) + above) + delta * share * worst
        left += np.linalg.norm(f[:2]) > mu * f[2]
    assert left > 500


def test_no_more_than_half_the_limit_is_spared() -> None:
    assert spare(Margins(0.3, 0.1, 0.0, 0.5), 0.5, 7.0, 10.0) == 0.1
    assert spare(Margins(0.3, 0.1, 0.1, 0.5), 0.5, 1.0, 10.0) == pytest.approx(0.1 + 0.1 * np.sqrt(5.0))
    for grip, delta in ((9.0, 0.0), (0.0, 9.0), (0.0, np.inf)):
        assert spare(Margins(0.3, grip, delta, 0.5), 0.5, 1.0, 10.0) == 5.0
    assert spare(Margins(0.3, 0.1, 0.1, 0.5), 0.0, 1.0, 10.0) == 0.1
    assert spare(Margins(0.3, 0.1, 0.1, 0.5), 1e-12, 1.0, 10.0) == 5.0
