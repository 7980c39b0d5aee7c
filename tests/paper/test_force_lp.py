"""Paper §3: the linear program of the contact forces, against HiGHS, by its own certificates and in closed form."""

import math
from dataclasses import dataclass

import highspy
import numpy as np
import pytest

from regrasp.kernels import basis, forces, simplex
from regrasp.kernels.basis import Program
from regrasp.kernels.forces import EDGES
from regrasp.kernels.simplex import FAILED, INFEASIBLE, OPTIMAL

FAMILIES = ("spatial", "planar", "capped", "supported", "sliding", "symmetric", "everything", "awkward")
GRASPS = 1000


@dataclass(frozen=True)
class Grasp:
    """The program of one random grasp: columns A (6, n), load b (6,), cost and group per column, cap per group."""

    A: np.ndarray
    b: np.ndarray
    cost: np.ndarray
    group: np.ndarray
    cap: np.ndarray


def random_grasp(seed: int) -> Grasp:
    """2–6 contacts on a sphere, a box or a flat disc, with the features that the family of the seed names."""
    rng = np.random.default_rng(seed)
    family = FAMILIES[seed % len(FAMILIES)]
    everything = family == "everything"
    k = int(rng.integers(2, 7))
    agents = k
    n_in = rng.normal(size=(k, 3))
    p = np.empty((k, 3))
    planar = family == "planar" or (everything and rng.random() < 0.3)
    if planar:
        n_in[:, 1] = 0.0
    if family == "symmetric":  # evenly spread round the vertical axis, or on opposite faces of a cube
        angle = 2 * math.pi * np.arange(k) / k
        n_in = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(k)))
        if rng.random() < 0.5:
            n_in = np.vstack((np.eye(3), -np.eye(3)))[rng.permutation(6)[:k]]
    if family == "awkward":  # coincident contacts, parallel normals
        n_in = np.round(n_in)
        n_in[np.linalg.norm(n_in, axis=1) == 0.0] = [0.0, 0.0, 1.0]
        n_in[1] = n_in[0]
    n_in /= np.linalg.norm(n_in, axis=1, keepdims=True)
    p = -n_in * rng.uniform(0.3, 1.0, (k, 1)) if rng.random() < 0.5 else -n_in.copy()
    if family not in ("symmetric", "awkward") and not planar:
        p += rng.normal(size=(k, 3)) * 0.1
    passive = np.zeros(k, bool)
    if family == "supported" or everything:
        passive[: rng.integers(1, k)] = True
        n_in[passive] = [0.0, 0.0, 1.0]
        p[passive, 2] = -1.0
    mu = rng.uniform(0.2, 1.2, k)
    columns: list[np.ndarray] = []
    cost: list[np.ndarray] = []
    group: list[np.ndarray] = []
    for i in range(k):
        a = np.array([0.0, 1.0, 0.0]) if abs(n_in[i, 1]) < 0.6 else np.array([1.0, 0.0, 0.0])
        x = np.cross(a, n_in[i])
        x /= np.linalg.norm(x)
        y = np.cross(n_in[i], x)
        if (family == "sliding" or everything) and rng.random() < 0.4:
            block = np.zeros((6, 1))
            turn = rng.uniform(0, 2 * math.pi)
            forces.ray(p[i], n_in[i], np.cos(turn) * x + np.sin(turn) * y, mu[i], 1.0, block, 0)
        else:
            block = np.zeros((6, EDGES))
            forces.friction_edges(p[i], n_in[i], x, y, mu[i], 1.0, block, 0)
            if planar:
                block = block[:, [0, 4]]
        columns.append(block)
        cost.append(np.full(block.shape[1], 0.0 if passive[i] else 1.0))
        group.append(np.full(block.shape[1], -1 if passive[i] else i))
    cap = np.full(agents, np.inf)
    if family in ("capped", "everything", "awkward"):
        cap = rng.choice([0.3, 0.7, 1.5, 4.0, np.inf], agents)
    b = np.zeros(6)
    b[2] = 1.0
    if family not in ("symmetric", "planar") and rng.random() < 0.3:
        b[:3] = rng.normal(size=3)
    A = np.hstack(columns)
    if planar:
        A[[1, 3, 5]] = 0.0
        b[[1, 3, 5]] = 0.0
    return Grasp(A, b, np.concatenate(cost), np.concatenate(group), cap)


def program_of(grasp: Grasp) -> Program:
    n = grasp.cost.size
    program = basis.program(n, grasp.cap.size)
    program.A[:], program.b[:], program.cost[:] = grasp.A, grasp.b, grasp.cost
    program.group[:], program.cap[:] = grasp.group, grasp.cap
    return program


def complete(grasp: Grasp) -> tuple[np.ndarray, np.ndarray]:
    """The matrix and the right-hand side with the rows of the caps."""
    groups = np.arange(grasp.cap.size)[:, None] == grasp.group[None, :]
    return np.vstack((grasp.A, groups)), np.concatenate((grasp.b, grasp.cap))


def highs_value(grasp: Grasp) -> float:
    """The optimal value by HiGHS, inf if it finds the program infeasible."""
    A, right = complete(grasp)
    rows, n = A.shape
    lp = highspy.HighsLp()
    lp.num_col_, lp.num_row_ = n, rows
    lp.col_cost_ = grasp.cost
    lp.col_lower_, lp.col_upper_ = np.zeros(n), np.full(n, np.inf)
    lp.row_lower_ = np.concatenate((grasp.b, np.full(grasp.cap.size, -np.inf)))
    lp.row_upper_ = right
    lp.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    lp.a_matrix_.start_ = np.arange(n + 1) * rows
    lp.a_matrix_.index_ = np.tile(np.arange(rows), n)
    lp.a_matrix_.value_ = A.T.ravel()
    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    solver.setOptionValue("presolve", "off")
    solver.setOptionValue("primal_feasibility_tolerance", 1e-10)
    solver.setOptionValue("dual_feasibility_tolerance", 1e-10)
    solver.passModel(lp)
    solver.run()
    status = solver.getModelStatus()
    if status == highspy.HighsModelStatus.kInfeasible:
        return math.inf
    assert status == highspy.HighsModelStatus.kOptimal, status
    return float(solver.getObjectiveValue())


def assert_certified(grasp: Grasp, program: Program, status: int, value: float) -> None:
    """Optimality by primal and dual feasibility and complementary slackness, infeasibility by Farkas, in arithmetic."""
    A, right = complete(grasp)
    y = program.y
    assert np.all(y[6:] <= 1e-9)
    if status == INFEASIBLE:
        y = y / np.linalg.norm(y)
        bounded = np.isfinite(right)
        assert np.all(np.abs(y[~bounded]) <= 1e-9)
        assert np.max(y @ A) <= 1e-9
        assert y[bounded] @ right[bounded] > 1e-8
        return
    x = program.solution
    total = 1.0 + x.sum()
    assert np.all(x >= 0.0)
    np.testing.assert_allclose(grasp.A @ x, grasp.b, atol=1e-10 * total)
    usage = A[6:] @ x
    assert np.all(usage <= grasp.cap + 1e-10 * total)
    reduced = grasp.cost - y @ A
    assert np.all(reduced >= -1e-9)
    assert np.max(x * reduced, initial=0.0) <= 1e-9 * total
    tight = y[6:] < -1e-9
    np.testing.assert_allclose(usage[tight], grasp.cap[tight], atol=1e-9)
    assert value == pytest.approx(grasp.cost @ x, abs=1e-9)


def test_value_and_verdict_equal_highs_on_1000_random_grasps():
    verdicts = {OPTIMAL: 0, INFEASIBLE: 0}
    for seed in range(GRASPS):
        grasp = random_grasp(seed)
        program = program_of(grasp)
        status, value, _ = simplex.solve(program, grasp.cost.size, False)
        expected = highs_value(grasp)
        assert status == (OPTIMAL if math.isfinite(expected) else INFEASIBLE), f"grasp {seed}"
        if status == OPTIMAL:
            assert value == pytest.approx(expected, abs=1e-9, rel=1e-9), f"grasp {seed}"
        assert_certified(grasp, program, status, value)
        verdicts[status] += 1
    assert min(verdicts.values()) > GRASPS // 5  # both verdicts are put to the test


def test_warm_start_from_any_basis_keeps_verdict_and_value():
    rng = np.random.default_rng(0)
    for seed in range(0, GRASPS, 3):
        grasp = random_grasp(seed)
        n = grasp.cost.size
        program = program_of(grasp)
        status, value, _ = simplex.solve(program, n, False)
        own = program.basis.copy()
        variables = np.concatenate((np.arange(n), -1 - np.arange(program.y.size)))
        starts = [own, *(rng.choice(variables, own.size, replace=False) for _ in range(3)), np.zeros_like(own)]
        for start in starts:
            program.basis[:] = start
            again, repeated, pivots = simplex.solve(program, n, True)
            assert again == status
            if status == OPTIMAL:
                assert repeated == pytest.approx(value, abs=1e-9, rel=1e-9)
            assert_certified(grasp, program, again, repeated)
            if start is own and status == OPTIMAL:
                assert pivots == 0


def test_warm_start_across_a_motion_gives_the_cold_values():
    rng = np.random.default_rng(3)
    moved = 0
    for seed in range(0, 200):
        grasp = random_grasp(seed)
        n = grasp.cost.size
        program = program_of(grasp)
        simplex.solve(program, n, False)
        for _ in range(5):
            program.A[:] += 0.02 * rng.normal(size=program.A.shape) * (program.A != 0.0)
            start = program.basis.copy()
            cold = simplex.solve(program, n, False)
            program.basis[:] = start
            warm = simplex.solve(program, n, True)
            assert warm[0] == cold[0] != FAILED
            assert warm[1] == pytest.approx(cold[1], abs=1e-9, rel=1e-9)
            moved += warm[2] < cold[2]
    assert moved > 500  # of 1,000: the old basis saves pivots


def test_value_does_not_depend_on_the_axes():
    # A flat grasp in slanted axes has rank 3 only up to round-off; verdict and value must not notice.
    rng = np.random.default_rng(7)
    for seed in range(400):
        grasp = random_grasp(seed)
        program = program_of(grasp)
        n = grasp.cost.size
        status, value, _ = simplex.solve(program, n, False)
        R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn = np.kron(np.eye(2), R)
        program.A[:], program.b[:] = turn @ grasp.A, turn @ grasp.b
        turned, same, _ = simplex.solve(program, n, False)
        assert turned == status, f"grasp {seed}"
        if status == OPTIMAL:
            assert same == pytest.approx(value, abs=1e-9, rel=1e-9)


def ring(k: int, mu: float, tilt: float = 0.0) -> Grasp:
    """k fingers evenly spread round a vertical cylinder of radius 1, x tangents turned by tilt from vertical."""
    A = np.zeros((6, EDGES * k))
    up = np.array([0.0, 0.0, 1.0])
    for i in range(k):
        n_in = -np.array([math.cos(2 * math.pi * i / k), math.sin(2 * math.pi * i / k), 0.0])
        side = np.cross(n_in, up)
        x = math.cos(tilt) * up + math.sin(tilt) * side
        forces.friction_edges(-n_in, n_in, x, np.cross(n_in, x), mu, 1.0, A, EDGES * i)
    n = A.shape[1]
    return Grasp(A, np.eye(6)[2], np.ones(n), np.arange(n) // EDGES, np.full(k, np.inf))


@pytest.mark.parametrize("k", [2, 3, 4, 5, 6])
@pytest.mark.parametrize("mu", [0.1, 0.5, 1.0])
def test_fingers_round_a_cylinder_press_with_weight_over_mu(k, mu):
    # Coulomb: k μ N = W with an edge of the pyramid straight up, so N = W / (k μ) each and W / μ together.
    grasp = ring(k, mu)
    program = program_of(grasp)
    status, value, _ = simplex.solve(program, grasp.cost.size, False)
    assert status == OPTIMAL
    assert value == pytest.approx(1.0 / mu, rel=1e-12)
    if k <= 3:  # the distribution is unique
        f = np.zeros((k, 3))
        forces.contact_forces(program.A, program.solution, np.arange(k + 1) * EDGES, 10.0, f)
        np.testing.assert_allclose(f[:, 2], 10.0 / k, atol=1e-9)
        np.testing.assert_allclose(np.hypot(f[:, 0], f[:, 1]), 10.0 / (k * mu), atol=1e-8)


def test_pyramid_turned_half_an_edge_costs_one_over_the_cosine():
    # The inscribed octagon reaches μ cos(π/8) between two edges.
    grasp = ring(3, 0.5, tilt=math.pi / EDGES)
    _, value, _ = simplex.solve(program_of(grasp), grasp.cost.size, False)
    assert value == pytest.approx(1.0 / (0.5 * math.cos(math.pi / EDGES)), rel=1e-12)


@pytest.mark.parametrize("k", [2, 3, 4])
def test_cap_decides_whether_the_ring_holds(k):
    mu = 0.5
    for factor, expected in ((1.001, OPTIMAL), (0.999, INFEASIBLE)):
        grasp = ring(k, mu)
        grasp.cap[:] = factor / (k * mu)
        program = program_of(grasp)
        status, value, _ = simplex.solve(program, grasp.cost.size, False)
        assert status == expected
        assert_certified(grasp, program, status, value)


def test_a_table_carries_for_nothing():
    # A passive contact below the centre of mass costs no effort; a finger is used only when the table alone tips.
    for offset, expected in ((0.0, 0.0), (0.5, 0.5)):
        A = np.zeros((6, 2))
        up = np.array([0.0, 0.0, 1.0])
        forces.ray(np.array([offset, 0.0, -1.0]), up, np.zeros(3), 0.0, 1.0, A, 0)
        forces.ray(np.array([offset - 1.0, 0.0, -1.0]), up, np.zeros(3), 0.0, 1.0, A, 1)
        grasp = Grasp(A, np.eye(6)[2], np.array([0.0, 1.0]), np.array([-1, 0]), np.array([np.inf]))
        status, value, _ = simplex.solve(program_of(grasp), 2, False)
        assert status == OPTIMAL
        assert value == pytest.approx(expected, abs=1e-12)
