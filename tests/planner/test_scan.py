"""The scan: candidates that are free are touched, clear and reached, judged by MuJoCo; a tool points as it is told."""

import dataclasses

import numpy as np
import pytest
from arcs import NAMES, Arc, Oracle, arc, height
from scipy.spatial.transform import Rotation

from regrasp.kernels.chains import forward
from regrasp.kernels.inverse import inverse
from regrasp.kernels.sampling import sample
from regrasp.planner.scan import SPINS, UNKNOWN, aim, candidate_free


@pytest.mark.parametrize("name", NAMES)
def test_free_candidates_are_touched_and_clear(name: str) -> None:
    """On a candidate that has a row the agent's tip touches to 1e-6 m, its links keep the clearance from what is fixed
    and from the object, and no joint leaves its range."""
    a = arc(name)
    problem = a.problem(np.zeros((len(a.path.R_WO), len(a.task.names)), np.int16))
    oracle, clearance, world = Oracle(a.task), a.terms.clearance, a.task.world
    j, free = 2, 0
    for i, agent in enumerate(world.agents):
        others = {int(g) for b in world.agents if b is not agent for g in b.geoms}
        pairs = [
            p for p in world.collision_pairs if not others & set(p.tolist()) and set(p.tolist()) & set(agent.geoms)
        ]
        own = [set(p.tolist()) <= set(agent.geoms) for p in pairs]
        scan, found = problem.model[2], problem.found
        for c in range(len(scan.p_O)):
            row = candidate_free(a.hand, a.path, scan, found.R_WB[j], found.p_WB[j], j, i, c, clearance)
            if not row:
                continue
            assert scan.row[i, j, c] == row
            free += 1
            q = a.hand.home.copy()
            q[a.joints(i)] = scan.q[row, : len(agent.joints)]
            assert np.all((q[a.joints(i)] >= agent.lower - 1e-12) & (q[a.joints(i)] <= agent.upper + 1e-12))
            R_WO, p_WO = a.path.R_WO[j, 0], a.path.p_WO[j, 0]
            oracle.put(R_WO, p_WO, q)
            centre = R_WO.T @ (oracle.tip(i)[1] - p_WO)
            assert height(a, centre) == pytest.approx(a.hand.size_T[i, 0], abs=1e-6)
            assert np.linalg.norm(centre - scan.p[row]) == pytest.approx(a.hand.size_T[i, 0], abs=1e-6)
            for pair, itself in zip(pairs, own, strict=True):
                assert oracle.apart(*pair) >= (0.0 if itself else clearance) - 1e-6
    assert free > 10


def turn_onto(R: np.ndarray, axis: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """R turned by the shortest way until R axis is the wanted direction."""
    d = R @ axis
    e = np.cross(d, wanted)
    angle = np.arctan2(np.linalg.norm(e), d @ wanted)
    return Rotation.from_rotvec(angle * e / np.linalg.norm(e)).as_matrix() @ R


def solutions(a: Arc, i: int, R_WT: np.ndarray, p_WT: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Joints of agent i that put its tip there, (S, 6), found by damped Newton from random starts and from home."""
    mine = a.joints(i)
    lower, upper = a.hand.chains.lower[mine], a.hand.chains.upper[mine]
    found = []
    for q in [a.hand.home[mine].copy(), *rng.uniform(lower, upper, (30, 6))]:
        R, p = np.empty((7, 3, 3)), np.empty((7, 3))
        if inverse(a.hand.chains, i, R_WT, p_WT, q, R, p)[0] < 1e-9:
            found.append(q)
    return np.array(found).reshape(-1, 6)


@pytest.mark.parametrize("tilt", [0.0, 1.0])
def test_an_arm_aims_exactly_and_with_the_nearest_joints(tilt: float) -> None:
    """The tip is over the point, its tool points along the direction to round-off, within the limits; of all joints that do
    so with the same turn about the tool none is nearer to the seed. The turn is that from the seed by the shortest way, or
    where nothing reaches that, one in sixths about the tool; where none of them is reached, that is said.

    tilt: rad, of the tool from the last joint's axis, about which that joint would turn it instead.
    """
    a, rng = arc("fig3-puma3"), np.random.default_rng(0)
    axes = a.hand.axis_T @ Rotation.from_rotvec([tilt, 0.0, 0.0]).as_matrix()
    assert np.allclose(np.sum(axes * a.hand.axis_T, axis=1), np.cos(tilt))
    hand = dataclasses.replace(a.hand, axis_T=axes)
    chains, points, normals = a.hand.chains, *sample(a.hand.kind_O, a.hand.size_O, a.hand.grids, 200)
    R_WO, p_WO = a.path.R_WO[0, 0], a.path.p_WO[0, 0]
    counts = {"first turn": 0, "later": 0, "none": 0}
    for _ in range(120):
        i, c, high = rng.integers(len(a.task.names)), rng.integers(200), rng.choice([0.0, 0.01])
        mine, axis = a.joints(i), hand.axis_T[i]
        a_O = -normals[c] + 0.5 * rng.normal(size=3)
        a_O /= np.linalg.norm(a_O)
        seed = np.clip(a.hand.home[mine] + rng.normal(scale=0.3, size=6), chains.lower[mine], chains.upper[mine])
        q, R_WL, p_WL = seed.copy(), np.empty((7, 3, 3)), np.empty((7, 3))
        forward(chains, i, seed, R_WL, p_WL)
        turn, p_WT = (
            turn_onto(R_WL[6], axis, R_WO @ a_O),
            p_WO + R_WO @ (points[c] + (a.hand.size_T[i, 0] + high) * normals[c]),
        )
        reached = aim(hand, i, R_WO, p_WO, points[c], normals[c], high, a_O, q, R_WL, p_WL)
        steps = Rotation.from_rotvec(np.arange(SPINS)[:, None] * 2.0 * np.pi / SPINS * (R_WO @ a_O)).as_matrix()
        turns = steps @ turn
        if not reached:
            counts["none"] += 1
            assert not any(len(solutions(a, i, each, p_WT, rng)) for each in turns)
            continue
        oracle = Oracle(a.task)
        joints = a.hand.home.copy()
        joints[mine] = q
        oracle.put(R_WO, p_WO, joints)
        R, p = oracle.tip(i)
        np.testing.assert_allclose(p, p_WT, atol=1e-9)
        np.testing.assert_allclose(R @ axis, R_WO @ a_O, atol=1e-9)
        np.testing.assert_allclose(R_WL[6], R, atol=1e-9)
        assert np.all((q >= chains.lower[mine]) & (q <= chains.upper[mine]))
        which = int(np.argmin([np.linalg.norm(each - R) for each in turns]))
        np.testing.assert_allclose(R, turns[which], atol=1e-8)
        assert not any(len(solutions(a, i, each, p_WT, rng)) for each in turns[:which])
        others = solutions(a, i, turns[which], p_WT, rng)
        assert len(others)
        assert np.abs(q - seed).max() <= np.abs(others - seed).max(axis=1).min() + 1e-6
        counts["later" if which else "first turn"] += 1
    assert min(counts["first turn"], counts["none"], counts["later"] if tilt else 1) > 0, counts


def test_what_is_asked_once_is_not_scanned_again() -> None:
    """The answer stays, also when nothing would be in the way any more."""
    a = arc("fig3-puma3")
    problem = a.problem(np.zeros((len(a.path.R_WO), 3), np.int16))
    scan, found = problem.model[2], problem.found

    def ask(clearance: float) -> list[bool]:
        asked = [
            candidate_free(a.hand, a.path, scan, found.R_WB[1], found.p_WB[1], 1, 0, c, clearance) > 0
            for c in range(240)
        ]
        assert np.all(scan.row[0, 1, :240] != UNKNOWN)
        return asked

    strict = ask(0.01)
    assert ask(0.0) == strict
    scan.row[:] = UNKNOWN
    assert sum(ask(0.0)) > sum(strict)
