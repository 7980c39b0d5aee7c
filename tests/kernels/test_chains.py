"""Chains, rates, inverse problems: a Puma-like arm with a spherical wrist, its first joints as fingers, a mobile base.

Forward kinematics and Jacobian against MuJoCo stand in tests/planner/test_arrays.py.
"""

import dataclasses

import mujoco
import numpy as np
import pytest

from regrasp.kernels.chains import Chains, couple, forward, jacobian
from regrasp.kernels.inverse import inverse, inverse_point
from regrasp.kernels.rates import rates
from regrasp.kernels.rotations import exp, log
from regrasp.planner.arrays import chains_from

LINKS = [  # axis, anchor in the link before: waist, shoulder, elbow, and a spherical wrist with its centre 0.43 m on
    ("0 0 1", "0 0 0.6"),
    ("0 1 0", "0 0.15 0"),
    ("0 1 0", "0.43 0 0"),
    ("1 0 0", "0.43 0 0"),
    ("0 1 0", "0 0 0"),
    ("1 0 0", "0 0 0"),
]


def arm(joints: int = 6, limit: float = 6.0, base: bool = False) -> Chains:
    """The first joints of the arm, with a tip 0.06 m past the wrist (0.43 m past the elbow for a finger)."""
    xml = '<body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><geom size="0.1"/>' if base else ""
    for axis, anchor in LINKS[:joints]:
        xml += f'<body pos="{anchor}"><joint axis="{axis}" range="{-limit} {limit}"/><geom size="0.01"/>'
    tip = "0.06 0 0" if joints > 3 else "0.43 0 0"
    xml += f'<geom pos="{tip}" size="0.01"/>' + "</body>" * (joints + base)
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian" autolimits="true"/><worldbody>{xml}</worldbody></mujoco>'
    )
    return chains_from(model, [list(range(model.njnt))], [model.ngeom - 1])


def place(chains: Chains, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    R_WL, p_WL = np.empty((len(q) + 1, 3, 3)), np.empty((len(q) + 1, 3))
    forward(chains, 0, q, R_WL, p_WL)
    return R_WL, p_WL


def jacobian_at(chains: Chains, q: np.ndarray) -> np.ndarray:
    R_WL, p_WL = place(chains, q)
    J = np.empty((6, len(q)))
    jacobian(chains, 0, R_WL, p_WL, p_WL[-1], J)
    return J


def error(chains: Chains, q: np.ndarray, R_WT: np.ndarray, p_WT: np.ndarray) -> float:
    """√(|Δp|² + |Δφ|²), computed here."""
    R_WL, p_WL = place(chains, q)
    w = np.empty(3)
    log(R_WL[-1].T @ R_WT, w)
    return float(np.hypot(np.linalg.norm(p_WL[-1] - p_WT), np.linalg.norm(w)))


def solve(chains: Chains, R_WT: np.ndarray, p_WT: np.ndarray, seed: np.ndarray) -> tuple[float, bool, np.ndarray]:
    """inverse, with what must hold of every answer checked."""
    q, R_WL, p_WL = seed.copy(), np.empty((len(seed) + 1, 3, 3)), np.empty((len(seed) + 1, 3))
    residual, inside = inverse(chains, 0, R_WT, p_WT, q, R_WL, p_WL)
    assert np.isfinite(q).all()
    assert (q >= chains.lower).all()
    assert (q <= chains.upper).all()
    assert residual == pytest.approx(error(chains, q, R_WT, p_WT), abs=1e-12)
    np.testing.assert_array_equal(p_WL, place(chains, q)[1])
    return residual, inside, q


def solve_point(
    chains: Chains, p_WT: np.ndarray, axis_T: np.ndarray, axis_W: np.ndarray, seed: np.ndarray
) -> tuple[float, float, np.ndarray]:
    """inverse_point, with what must hold of every answer checked."""
    q, R_WL, p_WL = seed.copy(), np.empty((len(seed) + 1, 3, 3)), np.empty((len(seed) + 1, 3))
    residual, angle = inverse_point(chains, 0, p_WT, axis_T, axis_W, q, R_WL, p_WL)
    R, p = place(chains, q)
    assert (q >= chains.lower).all()
    assert (q <= chains.upper).all()
    assert residual == pytest.approx(np.linalg.norm(p[-1] - p_WT), abs=1e-12)
    d = R[-1] @ axis_T
    assert angle == pytest.approx(np.arctan2(np.linalg.norm(np.cross(d, axis_W)), d @ axis_W), abs=1e-12)
    np.testing.assert_array_equal(p_WL, p)
    return residual, angle, q


def regular(rng: np.random.Generator) -> np.ndarray:
    """Joints of the arm away from the shoulder, elbow and wrist singularities."""
    return np.array([rng.uniform(-3, 3), rng.uniform(-0.5, 0.5), *rng.uniform(0.5, 2, 1), *rng.uniform(0.5, 2.5, 3)])


@pytest.mark.parametrize(("joints", "base"), [(1, False), (3, False), (6, False), (6, True)])
def test_jacobian_is_the_derivative_of_forward(joints: int, base: bool) -> None:
    rng, chains, h = np.random.default_rng(0), arm(joints, base=base), 1e-6
    for _ in range(10):
        q = rng.uniform(-3, 3, joints + 2 * base)
        J, w = jacobian_at(chains, q), np.empty(3)
        for i, step in enumerate(h * np.eye(len(q))):
            (R_a, p_a), (R_b, p_b) = place(chains, q - step), place(chains, q + step)
            log(R_b[-1] @ R_a[-1].T, w)
            np.testing.assert_allclose(J[:, i], np.r_[p_b[-1] - p_a[-1], w] / (2 * h), atol=1e-8)


def coupled(joints: int) -> Chains:
    """The arm with its last joint following the one before, q_f = 0.2 − 0.7 q_m, and its second the first, q_f = 1.5 q_m."""
    chains = arm(joints)
    master, gain, offset = np.arange(joints), np.ones(joints), np.zeros(joints)
    master[[1, -1]], gain[[1, -1]], offset[-1] = [0, joints - 2], [1.5, -0.7], 0.2
    lower, upper = chains.lower.copy(), chains.upper.copy()
    lower[[1, -1]], upper[[1, -1]] = -np.inf, np.inf
    return dataclasses.replace(
        chains, lower=lower, upper=upper, free=np.array([joints - 2]), master=master, gain=gain, offset=offset
    )


@pytest.mark.parametrize("joints", [4, 6])
def test_a_followers_motion_is_its_masters(joints: int) -> None:
    """The reduced Jacobian is the derivative along the coupling; a follower by itself does nothing."""
    rng, chains, h = np.random.default_rng(10), coupled(joints), 1e-6
    for _ in range(10):
        q = rng.uniform(-3, 3, joints)
        couple(chains, 0, q)
        J, w = jacobian_at(chains, q), np.empty(3)
        for i, step in enumerate(h * np.eye(joints)):
            if chains.master[i] != i:
                assert not J[:, i].any()
                continue
            ends = q - step, q + step
            for end in ends:
                couple(chains, 0, end)
            (R_a, p_a), (R_b, p_b) = (place(chains, end) for end in ends)
            log(R_b[-1] @ R_a[-1].T, w)
            np.testing.assert_allclose(J[:, i], np.r_[p_b[-1] - p_a[-1], w] / (2 * h), atol=1e-8)


def test_the_inverse_keeps_joints_coupled() -> None:
    """Four free joints of six reach a point that some posture reaches, and their followers are where they belong."""
    rng, chains = np.random.default_rng(11), coupled(6)
    axis, reached = np.array([1.0, 0.0, 0.0]), 0
    for _ in range(100):
        q = rng.uniform(-1.5, 1.5, 6)
        couple(chains, 0, q)
        R, p = place(chains, q)
        residual, _, found = solve_point(chains, p[-1], axis, R[-1] @ axis, q + rng.uniform(-0.1, 0.1, 6))
        asked = found.copy()
        couple(chains, 0, asked)
        np.testing.assert_array_equal(found, asked)
        reached += residual < 1e-10
    assert reached > 95


def test_a_neighbouring_pose_is_reached_on_the_same_branch() -> None:
    rng, chains = np.random.default_rng(1), arm()
    for _ in range(300):
        q = regular(rng)
        seed = q + rng.uniform(-0.1, 0.1, 6)
        R, p = place(chains, q)
        residual, inside, found = solve(chains, R[-1], p[-1], seed)
        assert residual < 1e-10
        assert inside
        np.testing.assert_allclose(found, q, atol=1e-7)  # of the eight solutions the one it came from


def test_a_mobile_base_moves_no_more_than_it_must() -> None:
    """Eight joints: the step is the least one, so q stays near the seed although the solution isn't unique."""
    rng, chains = np.random.default_rng(2), arm(base=True)
    for _ in range(100):
        q = np.r_[rng.normal(size=2), regular(rng)]
        seed = q + rng.uniform(-0.1, 0.1, 8)
        R, p = place(chains, q)
        residual, _, found = solve(chains, R[-1], p[-1], seed)
        assert residual < 1e-10
        assert np.linalg.norm(found - seed) <= np.linalg.norm(q - seed) + 1e-2


@pytest.mark.parametrize("elbow", [0.0, 1e-9, 1e-4])
@pytest.mark.parametrize("wrist", [0.0, 1e-9, 1e-4])
def test_singular_arms_are_reached_or_their_residual_is_honest(elbow: float, wrist: float) -> None:
    rng, chains = np.random.default_rng(3), arm()
    for _ in range(30):
        q = regular(rng)
        q[2], q[4] = elbow, wrist
        R, p = place(chains, q)
        residual, _, _ = solve(chains, R[-1], p[-1], q + rng.uniform(-0.05, 0.05, 6))
        assert residual < 1e-4  # convergence is only linear at a fold of the map
        residual, _, found = solve(chains, R[-1], p[-1], q)
        assert residual < 1e-10
        np.testing.assert_array_equal(found, q)


def test_out_of_reach_ends_at_the_nearest_stretch() -> None:
    """A point beyond the stretched arm: nothing better than the distance to the sphere of reach exists."""
    rng, chains = np.random.default_rng(4), arm()
    shoulder, reach = np.array([0, 0, 0.6]), np.hypot(0.15, 0.43 + 0.43) + 0.06
    for _ in range(50):
        q = regular(rng)
        R, p = place(chains, q)
        out = (p[-1] - shoulder) / np.linalg.norm(p[-1] - shoulder)
        far = shoulder + (reach + rng.uniform(0.05, 1)) * out
        residual, _, _ = solve(chains, R[-1], far, q)
        assert residual >= np.linalg.norm(far - shoulder) - reach - 1e-9
        residual, _, _ = solve_point(chains, far, np.array([1.0, 0, 0]), out, q)
        assert residual >= np.linalg.norm(far - shoulder) - reach - 1e-9


def test_limits_hold_and_are_reported() -> None:
    rng, chains = np.random.default_rng(5), arm()
    held = 0
    for _ in range(200):
        q = regular(rng)
        k, gap = rng.integers(6), rng.choice([0.0, 1e-3, 0.05])
        upper = chains.upper.copy()
        upper[k] = q[k] - gap  # the joint that the pose needs stops short of it
        stopped = dataclasses.replace(chains, upper=upper)
        R, p = place(chains, q)
        residual, inside, _ = solve(stopped, R[-1], p[-1], np.minimum(q - rng.uniform(0, 0.1, 6), upper))
        if gap == 0.0:
            assert residual < 1e-9  # a pose on the limit is within it
        else:
            assert residual > 1e-10
            assert not inside
            held += 1
    assert held > 50


def test_a_seed_outside_the_limits_is_brought_in() -> None:
    chains = arm(limit=1.0)
    q = np.array([0.1, -0.2, 0.8, 0.3, 0.7, 0.2])
    R, p = place(chains, q)
    residual, inside, _ = solve(chains, R[-1], p[-1], q + np.array([0, 0, 0.5, 0, 0.4, 0]))
    assert residual < 1e-10
    assert inside


def test_a_redundant_chain_goes_round_a_limit() -> None:
    """With a base to spare, a joint on its stop is made up for by the others."""
    rng, chains = np.random.default_rng(6), arm(base=True)
    for _ in range(50):
        q = np.r_[rng.normal(size=2), regular(rng)]
        upper = chains.upper.copy()
        upper[2] = q[2] - 0.02  # the waist
        R, p = place(chains, q)
        residual, _, _ = solve(dataclasses.replace(chains, upper=upper), R[-1], p[-1], np.minimum(q, upper))
        assert residual < 1e-10


@pytest.mark.parametrize("joints", [3, 4, 6])
def test_the_point_comes_first(joints: int) -> None:
    rng, chains = np.random.default_rng(7), arm(joints)
    slopes = []
    for _ in range(100):
        q = regular(rng)[:joints]
        p = place(chains, q)[1][-1]
        axis_T, axis_W = (a / np.linalg.norm(a) for a in rng.normal(size=(2, 3)))
        residual, _, found = solve_point(chains, p, axis_T, axis_W, q + rng.uniform(-0.1, 0.1, joints))
        assert residual < 1e-10
        if joints == 3:
            np.testing.assert_allclose(found, q, atol=1e-7)  # nothing is free
        J, d = jacobian_at(chains, found), place(chains, found)[0][-1] @ axis_T
        slopes.append(np.linalg.norm(np.linalg.svd(J[:3])[2][3:] @ J[3:].T @ np.cross(d, axis_W)))
    # First-order optimality: no motion that keeps the point turns the axis noticeably nearer.
    assert np.median(slopes) < 1e-4
    assert max(slopes) < 0.05  # rad/rad, where the axis hardly moves at all


def test_six_joints_reach_the_direction_too() -> None:
    rng, chains = np.random.default_rng(8), arm()
    axis_T = np.array([1.0, 0.0, 0.0])
    for _ in range(100):
        q = regular(rng)
        R, p = place(chains, q)
        axis_W = R[-1] @ axis_T
        residual, angle, _ = solve_point(chains, p[-1], axis_T, axis_W, q + rng.uniform(-0.2, 0.2, 6))
        assert residual < 1e-10
        assert angle < 1e-6


def test_the_direction_never_gets_worse_and_limits_hold() -> None:
    """Against placing the point alone (an axis that is aligned already asks for nothing)."""
    rng, chains = np.random.default_rng(9), arm(6, limit=2.6)
    for _ in range(100):
        q = np.clip(regular(rng), -2.6, 2.6)
        q[rng.integers(3, 6)] = 2.6
        seed = np.clip(q + rng.uniform(-0.1, 0.1, 6), -2.6, 2.6)
        p = place(chains, q)[1][-1]
        axis_T, axis_W = (a / np.linalg.norm(a) for a in rng.normal(size=(2, 3)))
        alone, R_WL, p_WL = seed.copy(), np.empty((7, 3, 3)), np.empty((7, 3))
        inverse_point(chains, 0, p, np.zeros(3), axis_W, alone, R_WL, p_WL)
        before = np.arccos(np.clip(R_WL[-1] @ axis_T @ axis_W, -1, 1))
        residual, angle, _ = solve_point(chains, p, axis_T, axis_W, seed)
        assert residual < 1e-10
        assert angle <= before + 1e-7


def test_an_opposed_direction_is_turned() -> None:
    chains, axis_T = arm(), np.array([1.0, 0.0, 0.0])
    q = np.array([0.3, -0.2, 1.0, 0.8, 1.2, 0.4])
    R, p = place(chains, q)
    residual, angle, _ = solve_point(chains, p[-1], axis_T, -R[-1] @ axis_T, q)
    assert residual < 1e-10
    assert angle < 1.0


def rates_of(J: np.ndarray, v: np.ndarray, w: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    qd, achieved = np.empty(J.shape[1]), np.empty(3)
    defect = rates(J, v, w, qd, achieved)
    np.testing.assert_allclose(achieved, J[3:] @ qd, atol=1e-12 * max(1, np.abs(qd).max()))
    assert defect == pytest.approx(np.linalg.norm(J[:3] @ qd - v), abs=1e-12)
    return defect, qd, achieved


@pytest.mark.parametrize(("joints", "base"), [(3, False), (4, False), (5, False), (6, False), (6, True)])
def test_rates_meet_v_exactly_and_w_as_far_as_it_goes(joints: int, base: bool) -> None:
    """Oracle: equality-constrained least squares through the null space of J_v, with LAPACK."""
    rng, chains = np.random.default_rng(10), arm(joints, base=base)
    for _ in range(100):
        J = jacobian_at(chains, np.r_[np.zeros(2 * base), regular(rng)[:joints]])
        v, w = rng.normal(size=(2, 3))
        defect, qd, achieved = rates_of(J, v, w)
        assert defect < 1e-9
        particular = np.linalg.pinv(J[:3]) @ v
        Z = np.linalg.svd(J[:3])[2][3:].T
        best = particular + Z @ np.linalg.lstsq(J[3:] @ Z, w - J[3:] @ particular, rcond=1e-8)[0]
        np.testing.assert_allclose(achieved, J[3:] @ best, atol=1e-8)
        if joints == 6:
            np.testing.assert_allclose(achieved, w, atol=1e-8)
        if not base:
            np.testing.assert_allclose(qd, best, atol=1e-7)


@pytest.mark.parametrize("wrist", [0.0, 1e-12, 1e-6, 1e-3])
def test_rates_stay_bounded_at_a_wrist_singularity(wrist: float) -> None:
    rng, chains = np.random.default_rng(11), arm()
    for _ in range(50):
        q = regular(rng)
        q[4] = wrist
        v, w = rng.normal(size=(2, 3))
        defect, qd, achieved = rates_of(jacobian_at(chains, q), v, w)
        assert defect < 1e-9  # the point's velocity doesn't pay for it
        assert np.abs(qd).max() < 1e3
        assert np.linalg.norm(achieved - w) <= np.linalg.norm(w) + 50 * np.linalg.norm(v)


def test_rates_of_a_stretched_finger_report_what_they_miss() -> None:
    chains = arm(3)
    J = jacobian_at(chains, np.array([0.4, 0.3, 0.0]))
    out = np.linalg.svd(J[:3])[0][:, 2]  # the direction that a stretched finger can't move in
    defect, qd, _ = rates_of(J, out, np.zeros(3))
    assert defect == pytest.approx(1.0, abs=1e-6)
    assert np.abs(qd).max() < 1e-6
    defect, _, achieved = rates_of(np.zeros((6, 3)), out, out)
    assert defect == pytest.approx(1.0)
    np.testing.assert_array_equal(achieved, 0.0)


def test_rates_integrate_to_the_commanded_rotation() -> None:
    """Rolling in place: ω held for one second with v = 0 turns the tip by exp(ω) and leaves its point where it was."""
    chains, q = arm(), np.array([0.3, -0.2, 1.0, 0.8, 1.2, 0.4])
    R_0, p_0 = place(chains, q)
    w, n, R = np.array([0.2, -0.3, 0.25]), 2000, np.empty((3, 3))
    for _ in range(n):
        middle = q + rates_of(jacobian_at(chains, q), np.zeros(3), w)[1] / (2 * n)
        q = q + rates_of(jacobian_at(chains, middle), np.zeros(3), w)[1] / n
    exp(w, R)
    R_1, p_1 = place(chains, q)
    np.testing.assert_allclose(R_1[-1], R @ R_0[-1], atol=1e-6)
    np.testing.assert_allclose(p_1[-1], p_0[-1], atol=1e-6)
