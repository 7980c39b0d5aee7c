import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from regrasp.kernels import rotations

directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array).filter(lambda a: np.linalg.norm(a) > 1e-3)
# Small angles, the seam between series and quotient (a² = 0.05), and the neighbourhood of π.
angles = st.one_of(
    st.floats(0.0, math.pi),
    st.sampled_from([0.0, 1e-300, 1e-160, 1e-9, 1e-4, math.sqrt(0.05), math.pi - 1e-9, math.pi - 1e-12, math.pi]),
)


def rotation_vector(direction, angle):
    return angle * direction / np.linalg.norm(direction)


def exp(w):
    R = np.empty((3, 3))
    rotations.exp(w, R)
    return R


@settings(deadline=None)  # the first example compiles
@given(directions, angles)
def test_exp_is_the_matrix_exponential_and_a_rotation(direction, angle):
    w = rotation_vector(direction, angle)
    R = exp(w)
    hat = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    np.testing.assert_allclose(R, expm(hat), atol=2e-14)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=2e-15)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=2e-15)


def test_exp_of_zero_is_exactly_the_identity():
    assert np.array_equal(exp(np.zeros(3)), np.eye(3))


@pytest.mark.parametrize("a2", [0.0, 1e-12, 1e-6, 0.01, 0.05 * (1 - 1e-12), 0.05 * (1 + 1e-12), 1.0, 9.0])
def test_rodrigues_coefficients_to_round_off(a2):
    s, c = rotations.rodrigues(a2)
    # Both are entire functions of a²; the half angle avoids the cancellation of 1 − cos a.
    a = math.sqrt(a2)
    assert s == pytest.approx(np.sinc(a / math.pi), rel=1e-15, abs=0.0)
    assert c == pytest.approx(0.5 * np.sinc(a / (2.0 * math.pi)) ** 2, rel=3e-15, abs=0.0)


@settings(deadline=None)  # the first example compiles
@given(directions, angles)
def test_log_inverts_exp_up_to_the_sign_at_pi(direction, angle):
    R = exp(rotation_vector(direction, angle))
    w = np.empty(3)
    rotations.log(R, w)
    assert np.linalg.norm(w) <= math.pi + 1e-15
    np.testing.assert_allclose(exp(w), R, atol=1e-14)
    if angle < math.pi - 1e-6:
        np.testing.assert_allclose(w, rotation_vector(direction, angle), atol=1e-13)


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3), np.array([1.0, -1.0, 0.0]) / math.sqrt(2.0)])
def test_log_of_half_turns(axis):
    w = np.empty(3)
    rotations.log(2.0 * np.outer(axis, axis) - np.eye(3), w)
    np.testing.assert_allclose(np.abs(w @ axis), math.pi, atol=1e-15)
    assert np.linalg.norm(w) == pytest.approx(math.pi, abs=1e-15)


@settings(deadline=None)  # the first example compiles
@given(st.integers(0, 2**32 - 1))
def test_products_agree_with_numpy_also_in_place(seed):
    rng = np.random.default_rng(seed)
    A, B = Rotation.random(2, rng=rng).as_matrix()
    a, b, product = rng.normal(size=3), rng.normal(size=3), np.empty((3, 3))
    rotations.multiply(A, B, product)
    np.testing.assert_allclose(product, A @ B, atol=1e-15)
    rotations.multiply_back(A, B, product)
    np.testing.assert_allclose(product, A.T @ B, atol=1e-15)
    for function, place, expected in (
        (rotations.multiply, 0, A @ B),
        (rotations.multiply, 1, A @ B),
        (rotations.multiply_back, 1, A.T @ B),
    ):
        factors = [A.copy(), B.copy()]
        function(*factors, factors[place])
        np.testing.assert_allclose(factors[place], expected, atol=1e-15)
    for left, right in ((a, b), (tuple(a), tuple(b))):
        np.testing.assert_allclose(rotations.cross(left, right), np.cross(a, b), atol=1e-14)
        np.testing.assert_allclose(rotations.plus(left, 0.3, right), a + 0.3 * b, atol=1e-15)
        np.testing.assert_array_equal(rotations.minus(left, right), a - b)
        np.testing.assert_allclose(rotations.along(left, right, -2.0, 0.3), -2.0 * a + 0.3 * b, atol=1e-14)
        np.testing.assert_allclose(rotations.unit(left), a / np.linalg.norm(a), atol=1e-15)
    assert rotations.dot(a, b) == pytest.approx(a @ b, abs=1e-14)
    assert rotations.norm(a) == pytest.approx(np.linalg.norm(a), rel=1e-15)
    for function, expected in ((rotations.rotate, A @ a), (rotations.rotate_back, A.T @ a)):
        in_place = a.copy()
        function(A, in_place, in_place)
        np.testing.assert_allclose(in_place, expected, atol=1e-14)
