"""Maintaining contact: MuJoCo's kinematics see the tip on the surface, rolling and sliding as commanded."""

import dataclasses

import numpy as np
import pytest
from arcs import Arc, Oracle, arc, height

from regrasp.kernels.chains import forward, jacobian
from regrasp.planner.follow import AGILE, is_agile, is_full, turns_little
from regrasp.planner.motion import Motion
from regrasp.planner.motions import SLIDE_MINUS_Y, SLIDE_X
from regrasp.planner.path import nominal_path
from regrasp.planner.trace import trace_contact


@dataclasses.dataclass(frozen=True)
class Followed:
    """A motion without relocations: R_OT (n, m + 1, k, 3, 3), p_OT (n, m + 1, k, 3) by MuJoCo, and what was lost."""

    arc: Arc
    motion: Motion
    R_OT: np.ndarray
    p_OT: np.ndarray
    lost: np.ndarray


def followed(name: str, seed: int) -> Followed:
    a = arc(name)
    n, samples = a.path.R_WO.shape[:2]
    k = len(a.task.names)
    V = np.random.default_rng(seed).integers(0, SLIDE_MINUS_Y + 1, (n, k)).astype(np.int16)
    problem = a.problem(V)
    motion = a.motion(problem)
    oracle = Oracle(a.task)
    R, p = np.zeros((n, samples, k, 3, 3)), np.zeros((n, samples, k, 3))
    for j in range(n):
        for s in range(samples):
            R_WO, p_WO = a.path.R_WO[j, s], a.path.p_WO[j, s]
            oracle.put(R_WO, p_WO, motion.joints[j, s])
            for i in range(k):
                R_WT, p_WT = oracle.tip(i)
                R[j, s, i], p[j, s, i] = R_WO.T @ R_WT, R_WO.T @ (p_WT - p_WO)
    lost = problem.found.lost[problem.current.at[1:]] == 1
    lost = np.logical_or.accumulate(lost, axis=0)  # after a loss joints and contact part
    bends = np.abs(np.diff(motion.joints, 2, axis=1)).max(axis=1)
    # Near a singularity neighbouring samples are no measure of velocities.
    lost |= np.maximum.reduceat(bends, a.hand.chains.start[:-1], axis=1) > 2e-3
    return Followed(a, motion, R, p, lost)


CASES = [(name, seed) for name in ("fig3-puma3", "fig4-relocation", "fig2-planar") for seed in range(2)]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: f"{case[0]}-{case[1]}")
def case(request: pytest.FixtureRequest) -> Followed:
    return followed(*request.param)


def test_the_contact_gap_stays_below_a_micrometre(case: Followed) -> None:
    n, samples = case.p_OT.shape[:2]
    assert not case.lost.all()
    worst = 0.0
    for j in range(n):
        for i in np.flatnonzero(~case.lost[j]):
            for s in range(samples):
                p = case.p_OT[j, s, i]
                worst = max(worst, abs(height(case.arc, p) - case.arc.hand.size_T[i, 0]))
                reach = np.linalg.norm(p - case.motion.p_OC_O[j, s, i])
                assert reach == pytest.approx(case.arc.hand.size_T[i, 0], abs=1e-6)
    assert worst <= 1e-6


def test_tips_roll_without_slip_and_slide_without_turning(case: Followed) -> None:
    """Central differences of X_OT: v of the tip's point at the contact and ω are the interval's stated relative motion,
    with no spin, in the contact frame. Agents of any number of joints keep v; fewer than six turn as they can."""
    n, samples = case.p_OT.shape[:2]
    m = samples - 1
    seen = 0
    for j in range(n):
        for i in np.flatnonzero(~case.lost[j]):
            code = case.motion.V[j, i]
            turned = np.zeros(2)
            for s in range(1, m):
                R = case.R_OT[j, s, i]
                skew = m / 2 * (case.R_OT[j, s + 1, i] - case.R_OT[j, s - 1, i]) @ R.T
                w = 0.5 * np.array([skew[2, 1] - skew[1, 2], skew[0, 2] - skew[2, 0], skew[1, 0] - skew[0, 1]])
                v = m / 2 * (case.p_OT[j, s + 1, i] - case.p_OT[j, s - 1, i])
                v = v + np.cross(w, case.motion.p_OC_O[j, s, i] - case.p_OT[j, s, i])
                x, nn = case.motion.x_O[j, s, i], case.motion.n_O[j, s, i]
                C = np.stack([x, np.cross(nn, x), nn])
                # v: rolled way of 0.1 rad on the tip is about 1 mm, a slide about as much.
                np.testing.assert_allclose(C @ v, [*case.motion.twist[j, i, 2:], 0.0], atol=2e-6)
                turned += (C @ w)[:2] / (m - 1)
                if is_full(case.arc.hand, i):
                    np.testing.assert_allclose(C @ w, [*case.motion.twist[j, i, :2], 0.0], atol=1e-4)
            np.testing.assert_allclose(turned, case.motion.twist[j, i, :2], atol=5e-3)
            if is_full(case.arc.hand, i):
                np.testing.assert_array_equal(case.motion.twist[j, i], case.arc.terms.commands[code])
            elif code >= SLIDE_X:
                np.testing.assert_array_equal(case.motion.twist[j, i, 2:], case.arc.terms.commands[code, 2:])
            seen += 1
    assert seen > 2


def test_contact_normals_are_opposed_and_frames_transported(case: Followed) -> None:
    """n is the direction from the object to the tip's centre; x stays a unit tangent."""
    for j, i in zip(*np.nonzero(~case.lost), strict=True):
        n = case.motion.n_O[j, :, i]
        d = case.p_OT[j, :, i] - case.motion.p_OC_O[j, :, i]
        np.testing.assert_allclose(d, case.arc.hand.size_T[i, 0] * n, atol=1e-6)
        x = case.motion.x_O[j, :, i]
        np.testing.assert_allclose(np.sum(x * n, axis=1), 0.0, atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(x, axis=1), 1.0, atol=1e-9)


def test_with_six_joints_the_contact_path_is_the_same_on_any_path_of_the_object() -> None:
    a = arc("fig3-puma3")
    hand, n, m = a.hand, 2, a.path.R_WO.shape[1] - 1
    R, p = np.tile(a.path.R_WO[0, 0], (n * m + 1, 1, 1)), np.tile(a.path.p_WO[0, 0], (n * m + 1, 1))
    still = nominal_path(R, p, n, m, np.array([0.0, 0.0, -9.81]), hand, ())
    for i in range(len(a.task.names)):
        for command in a.terms.commands[: SLIDE_MINUS_Y + 1]:
            traces = []
            for path in (a.path, still):
                p_OC, p_TC, x_O, n_O = (np.zeros((m + 1, 3)) for _ in range(4))
                R_OT = np.zeros((m + 1, 3, 3))
                q = np.zeros((m + 1, 6))
                p_OC[0], p_TC[0], R_OT[0] = a.grasp.p_OC[i], a.grasp.p_TC[i], a.grasp.R_OT[i]
                q[0] = a.grasp.q[a.joints(i)]
                trace_contact(hand, path, command, 0, i, p_OC, p_TC, R_OT, x_O, q, n_O)
                traces.append((p_OC, p_TC, R_OT, x_O, n_O))
            for one, other in zip(*traces, strict=True):
                np.testing.assert_array_equal(one, other)
            assert np.any(traces[0][2][m] != traces[0][2][0]) == np.any(command[:2] != 0.0)


def test_what_turns_little_is_told_from_the_inverse() -> None:
    """The largest entry of J⁻¹ against AGILE; a singular J turns without limit."""
    rng = np.random.default_rng(0)
    seen = [0, 0]
    for _ in range(400):
        J = rng.normal(size=(6, 6)) * 10.0 ** rng.uniform(-1, 1)
        largest = np.abs(np.linalg.inv(J)).max()
        for size in (1.0 - 1e-9, 1.0 + 1e-9, rng.uniform(0.2, 5.0)):
            little = turns_little(J * largest / AGILE * size)
            assert little == (size > 1.0)
            seen[little] += 1
        row = rng.integers(6)
        J[row] = J[row - 1] if rng.random() < 0.5 else 0.0
        assert not turns_little(J)
    assert min(seen) > 100


def test_a_puma_is_agile_away_from_its_singularities() -> None:
    """By the inverse of its Jacobian at random joints, and never with its wrist stretched."""
    a, rng = arc("fig3-puma3"), np.random.default_rng(1)
    R_WL, p_WL, J = np.empty((7, 3, 3)), np.empty((7, 3)), np.empty((6, 6))
    seen = [0, 0]
    for _ in range(200):
        q = rng.uniform(a.hand.chains.lower[:6], a.hand.chains.upper[:6])
        forward(a.hand.chains, 0, q, R_WL, p_WL)
        jacobian(a.hand.chains, 0, R_WL, p_WL, p_WL[6], J)
        J[:3] /= a.hand.radius
        little = bool(np.abs(np.linalg.inv(J)).max() <= AGILE)
        assert is_agile(a.hand, 0, R_WL, p_WL) == little
        seen[little] += 1
        q[4] = 0.0
        forward(a.hand.chains, 0, q, R_WL, p_WL)
        assert not is_agile(a.hand, 0, R_WL, p_WL)
    assert min(seen) > 10
