"""Column builders and the edges of the force program."""

import math

import numpy as np
import pytest

from regrasp.kernels import basis, forces, simplex
from regrasp.kernels.forces import EDGES
from regrasp.kernels.simplex import INFEASIBLE, OPTIMAL


def frame(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A random contact: point, inward normal and two tangents."""
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return rng.normal(size=3), Q[:, 0], Q[:, 1], Q[:, 2]


@pytest.mark.parametrize("mu", [0.0, 0.3, 1.5])
def test_edges_lie_on_the_cone_at_equal_angles(mu):
    rng = np.random.default_rng(1)
    for _ in range(20):
        p, n_in, x, y = frame(rng)
        A = np.full((6, EDGES + 4), np.nan)
        forces.friction_edges(p, n_in, x, y, mu, 0.25, A, 2)
        assert np.all(np.isnan(A[:, :2]))
        assert np.all(np.isnan(A[:, 2 + EDGES :]))
        f = A[:3, 2 : 2 + EDGES].T
        np.testing.assert_allclose(f @ n_in, 1.0, atol=1e-14)
        np.testing.assert_allclose(np.hypot(f @ x, f @ y), mu, atol=1e-14)
        if mu > 0.0:
            angle = np.unwrap(np.arctan2(f @ y, f @ x))
            np.testing.assert_allclose(np.diff(angle), 2 * math.pi / EDGES, atol=1e-12)
        np.testing.assert_allclose(A[3:, 2 : 2 + EDGES].T * 0.25, np.cross(p, f), atol=1e-14)


def test_ray_is_the_edge_along_the_slip():
    rng = np.random.default_rng(2)
    p, n_in, x, y = frame(rng)
    edges, one = np.zeros((6, EDGES)), np.zeros((6, 1))
    forces.friction_edges(p, n_in, x, y, 0.4, 0.1, edges, 0)
    for e in range(EDGES):
        angle = 2 * math.pi * e / EDGES
        forces.ray(p, n_in, math.cos(angle) * x + math.sin(angle) * y, 0.4, 0.1, one, 0)
        np.testing.assert_allclose(one[:, 0], edges[:, e], atol=1e-14)


def test_contact_forces_add_up_to_the_load():
    rng = np.random.default_rng(3)
    program = basis.program(4 * EDGES + 8, 0)
    for i, direction in enumerate(([1, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1])):
        n_in = -np.array(direction) / math.sqrt(3)
        x = np.cross(n_in, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        forces.friction_edges(-n_in, n_in, x, np.cross(n_in, x), 0.8, 1.0, program.A, EDGES * i)
    program.b[:3] = rng.normal(size=3)
    status, value, _ = simplex.solve(program, 4 * EDGES, False)
    assert status == OPTIMAL
    f = np.zeros((4, 3))
    forces.contact_forces(program.A, program.solution, np.arange(5) * EDGES, 9.81, f)
    np.testing.assert_allclose(f.sum(axis=0), 9.81 * program.b[:3], atol=1e-9)
    n_in = -np.array([[1, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]]) / math.sqrt(3)
    assert np.sum(f * n_in) == pytest.approx(9.81 * value, abs=1e-9)


@pytest.mark.parametrize("row", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_without_contacts_every_load_is_refused_and_no_load_costs_nothing(row, sign):
    program = basis.program(0, 2)
    assert simplex.solve(program, 0, False) == (OPTIMAL, 0.0, 0)
    program.b[row] = sign
    status, value, _ = simplex.solve(program, 0, False)
    assert (status, value) == (INFEASIBLE, math.inf)
    assert program.y @ np.concatenate((program.b, [0.0, 0.0])) > 0.0


def test_zero_load_needs_no_force():
    program = basis.program(2 * EDGES, 2)
    rng = np.random.default_rng(4)
    for i in range(2):
        forces.friction_edges(*frame(rng), 0.5, 1.0, program.A, EDGES * i)
    program.solution[:] = 7.0
    assert simplex.solve(program, 2 * EDGES, False) == (OPTIMAL, 0.0, 0)
    assert not program.solution.any()


def vertical(point: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A contact that pushes up."""
    return np.array(point), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def test_coincident_contacts_share_the_load_up_to_their_caps():
    program = basis.program(3 * EDGES, 3)
    program.group[:] = np.arange(3 * EDGES) // EDGES
    for i in range(3):
        forces.friction_edges(*vertical((0.0, 0.0, -1.0)), 0.5, 1.0, program.A, EDGES * i)
    program.b[2] = 1.0
    for cap, expected in ((np.inf, OPTIMAL), (0.4, OPTIMAL), (0.3, INFEASIBLE)):
        program.cap[:] = cap
        status, value, _ = simplex.solve(program, 3 * EDGES, False)
        assert status == expected
        if status == OPTIMAL:
            assert value == pytest.approx(1.0, abs=1e-12)
            assert program.solution.reshape(3, EDGES).sum(axis=1).max() <= cap + 1e-9


def test_without_friction_only_a_balanced_push_holds():
    program = basis.program(EDGES, 1)
    program.b[2] = 1.0
    forces.friction_edges(*vertical((0.0, 0.0, -1.0)), 0.0, 1.0, program.A, 0)
    assert simplex.solve(program, EDGES, False)[:2] == (OPTIMAL, pytest.approx(1.0))
    forces.friction_edges(*vertical((0.1, 0.0, -1.0)), 0.0, 1.0, program.A, 0)
    assert simplex.solve(program, EDGES, False)[0] == INFEASIBLE


def test_only_the_first_n_columns_count():
    program = basis.program(2 * EDGES, 0)
    program.b[2] = 1.0
    forces.friction_edges(*vertical((0.5, 0.0, -1.0)), 0.0, 1.0, program.A, 0)
    forces.friction_edges(*vertical((-0.5, 0.0, -1.0)), 0.0, 1.0, program.A, EDGES)
    assert simplex.solve(program, 2 * EDGES, False)[0] == OPTIMAL
    # the basis left behind names columns that this program does not have
    assert simplex.solve(program, EDGES, True)[0] == INFEASIBLE


def test_degenerate_integer_programs_do_not_cycle():
    # Entries in {-1, 0, 1} with zero costs tie in almost every ratio test and most basic values are zero.
    rng = np.random.default_rng(5)
    for _ in range(2000):
        n = int(rng.integers(1, 40))
        program = basis.program(n, 2)
        program.A[:] = rng.integers(-1, 2, (6, n))
        program.b[:] = program.A @ (rng.random(n) < 0.3) if rng.random() < 0.5 else rng.integers(-1, 2, 6)
        program.cost[:] = rng.integers(0, 2, n)
        program.group[:] = rng.integers(-1, 2, n)
        program.cap[:] = rng.integers(0, 4, 2)
        status, _, pivots = simplex.solve(program, n, False)
        assert status in (OPTIMAL, INFEASIBLE)
        assert pivots < 60


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_numbers_that_are_not_finite_are_never_borne(bad):
    for warm in (False, True):
        program = basis.program(EDGES, 1)
        program.b[2] = 1.0
        forces.friction_edges(*vertical((0.0, 0.0, -1.0)), 0.5, 1.0, program.A, 0)
        simplex.solve(program, EDGES, False)
        program.A[2, :] = bad
        assert simplex.solve(program, EDGES, warm)[0] != OPTIMAL
