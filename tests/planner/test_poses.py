"""The object's configuration space: a metric, near-uniform rotations, a grid that closes and keeps to its freedoms."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from regrasp.planner.path import distance, interpolate
from regrasp.planner.poses import AXES, START, PoseGrid, orientations, super_fibonacci
from regrasp.planner.task import Settings, prepare
from regrasp.scene.load import validate

STEP = 0.6


def angles_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles (len(a), len(b)) between rotations given as quaternions."""
    return 2.0 * np.arccos(np.clip(np.abs(a @ b.T), 0.0, 1.0))


def test_distance_is_a_metric_and_the_straight_path_is_that_long() -> None:
    rng = np.random.default_rng(0)
    turns = Rotation.random(60, rng=rng).as_matrix()
    turns[:20] = turns[20:40] @ Rotation.from_rotvec(1e-9 * rng.normal(size=(20, 3))).as_matrix()  # near one another
    poses = list(zip(turns, rng.normal(size=(60, 3)) * 0.1, strict=True))
    r = 0.04
    for a, b, c in zip(poses[:20], poses[20:40], poses[40:], strict=True):
        assert distance(a, a, r) == pytest.approx(0.0, abs=1e-9)
        assert distance(a, b, r) == pytest.approx(distance(b, a, r), abs=1e-12)
        assert distance(a, b, r) > 0.0
        assert distance(a, c, r) <= distance(a, b, r) + distance(b, c, r) + 1e-12
        R, p = interpolate(a, c, np.linspace(0, 1, 9))
        steps = [distance(x, y, r) for x, y in itertools.pairwise(zip(R, p, strict=True))]
        np.testing.assert_allclose(steps, distance(a, c, r) / 8, atol=1e-9)  # constant twist
        np.testing.assert_allclose(R[-1], c[0], atol=1e-12)


@pytest.mark.parametrize("count", [100, 183, 1000])
def test_super_fibonacci_is_near_uniform(count: int) -> None:
    """Nearest neighbours are about equally far, and no rotation is further from the set than they are.

    Balls of half the least distance of the closest packing would fill about 0.6 of SO(3); chance leaves neighbours that
    nearly coincide.
    """
    q = super_fibonacci(count)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-12)
    between = angles_between(q, q) + 4.0 * np.eye(count)
    nearest = between.min(axis=1)
    ideal = (6.0 * np.pi / count) ** (1 / 3) * 2.0  # spacing of balls of equal volume: (θ - sin θ)/π ≈ θ³/(6π), θ half
    assert nearest.min() > 0.5 * ideal
    assert nearest.max() < 1.2 * ideal
    probes = Rotation.random(2000, rng=np.random.default_rng(0)).as_quat()
    assert angles_between(probes, q).min(axis=1).max() < 1.2 * ideal


def grid(freedoms: tuple[str, ...], goal: dict | None = None, **fields: object):
    scene = {
        "name": "grid", "model": {"hand": "puma", "fingers": 3}, "freedoms": list(freedoms),
        "object": {"shape": "box", "size": [0.03, 0.02, 0.04], "rounding": 0.004, "mass": 0.2},
        "start": {"pose": {"position": [0, 0, 0.2], "euler": [0.3, 0.2, 0.1]}},
        "goal": {"pose": goal or {"position": [0, 0, 0.2], "euler": [0.3, 0.2, 0.1]}}, **fields,
    }  # fmt: skip
    return prepare(validate(scene), Settings()).router.grid


@pytest.mark.parametrize("axis", ["rx", "ry", "rz"])
def test_one_rotation_is_a_circle(axis: str) -> None:
    """From the start round a full turn in steps of about the chosen angle back to the start."""
    g = grid((axis,))
    start = g.rotations[START]
    turn = [Rotation.from_matrix(R @ start.T).as_rotvec() for R in g.rotations]
    a = AXES.index(axis) - 3
    np.testing.assert_allclose(np.delete(turn, a, axis=1), 0.0, atol=1e-12)
    angle = np.round(np.mod(np.array(turn)[:, a], 2 * np.pi), 9) % round(2 * np.pi, 9)
    ring = np.argsort(angle)
    ring = ring[np.append(True, np.diff(angle[ring]) > 1e-6)]
    assert np.max(np.diff(np.append(angle[ring], 2 * np.pi))) <= STEP + 1e-9
    for one, other in zip(ring, np.roll(ring, -1), strict=True):
        twins = [b for b in range(len(angle)) if abs(angle[b] - angle[other]) < 1e-6]
        assert any(b in g.near[one] for b in twins)


@pytest.mark.parametrize("direction", [[1, 0, 0], [0, 0, 1], [1, -2, 0.5]])
def test_three_rotations_close(direction: list[float]) -> None:
    """A full turn about any axis, rounded to the grid, goes on in a few steps each time and returns to the start."""
    g = grid(("x", "y", "z", "rx", "ry", "rz"))
    d = np.array(direction) / np.linalg.norm(direction)
    q = Rotation.from_matrix(np.array(g.rotations)).as_quat()
    turns = Rotation.from_rotvec(np.linspace(0, 2 * np.pi, 200)[:, None] * d) * Rotation.from_matrix(g.rotations[START])
    visited = np.argmin(angles_between(turns.as_quat(), q).round(9), axis=1)
    assert visited[0] == visited[-1] == START
    assert len(set(visited.tolist())) > 6
    for a, b in itertools.pairwise(visited.tolist()):
        near = {a, *g.near[a]}
        far = {b, *g.near[b]}
        assert {d for c in far for d in (c, *g.near[c])} & {d for c in near for d in (c, *g.near[c])}  # four at most


@pytest.mark.parametrize("freedoms", [("rx",), ("rx", "rz"), ("rx", "ry", "rz")])
def test_neighbours_are_mutual_near_and_connect_all(freedoms: tuple[str, ...]) -> None:
    g = grid(freedoms)
    for a, others in enumerate(g.near):
        assert a not in others
        assert all(a in g.near[b] for b in others)
    reached, edge = {START}, {START}
    while edge:
        edge = {b for a in edge for b in g.near[a]} - reached
        reached |= edge
    assert reached == set(range(len(g.rotations)))


def test_three_rotations_are_about_a_step_apart() -> None:
    """Each orientation of the set has its nearest neighbour about the chosen angle away."""
    q = Rotation.from_matrix(np.array(orientations(("rx", "ry", "rz"), np.eye(3), np.eye(3), STEP))[2:]).as_quat()
    nearest = (angles_between(q, q) + 4.0 * np.eye(len(q))).min(axis=1)
    assert np.mean(nearest) == pytest.approx(STEP, rel=0.25)


SUBSETS = [tuple(s) for size in range(1, 7) for s in itertools.combinations(AXES, size)]


def kept(freedoms: tuple[str, ...], start: np.ndarray, R: np.ndarray) -> np.ndarray:
    """What must vanish of R startᵀ = Rz Ry Rx where it is a product of turns about the free axes only."""
    turn = R @ start.T
    free = {name for name in freedoms if name.startswith("r")}
    if len(free) == 3:
        return np.zeros(1)
    if len(free) == 2:
        (missing,) = {"rx", "ry", "rz"} - free
        return np.array({"rx": turn[2, 1], "ry": turn[2, 0], "rz": turn[1, 0]}[missing])
    v = Rotation.from_matrix(turn).as_rotvec()
    return np.delete(v, [AXES.index(name) - 3 for name in free])


TABLE = {"name": "table", "shape": "plane", "pose": {"position": [0, 0, 0.16], "euler": [0.1, 0.2, 0]}}


@pytest.mark.parametrize("table", [(), (TABLE,)], ids=["in the air", "over a tilted table"])
@settings(max_examples=12, deadline=None, derandomize=True)
@given(freedoms=st.sampled_from(SUBSETS), seed=st.integers(0, 100))
def test_every_node_differs_from_the_start_in_the_freedoms_only(table, freedoms, seed: int) -> None:
    """A random walk from the start over neighbours."""
    g = grid(freedoms, environment=table, supports=[body["name"] for body in table])
    rng = np.random.default_rng(seed)
    fixed = [a for a in range(3) if AXES[a] not in freedoms]
    R0, p0 = g.start_pose
    node = g.start
    for _ in range(5):
        others = [other for other in g.neighbours(node) if not other.exact]
        if not others:
            break
        for other in others:
            R, p = g.pose(other)
            np.testing.assert_allclose((p - p0)[fixed], 0.0, atol=1e-12)
            np.testing.assert_allclose(kept(freedoms, R0, R), 0.0, atol=1e-9)
        node = others[rng.integers(len(others))]


def test_start_and_goal_are_exact() -> None:
    R, p = Rotation.from_euler("xyz", [1.0, -0.5, 2.0]).as_matrix(), np.array([0.0123, -0.0456, 0.21])
    g = grid(AXES, {"position": p.tolist(), "euler": [1.0, -0.5, 2.0]})
    np.testing.assert_allclose(g.pose(g.goal)[0], R, atol=1e-12)
    np.testing.assert_array_equal(g.pose(g.goal)[1], p)
    assert g.goal in g.neighbours(g.start)
    assert len(orientations((), R, R, STEP)) == 2


@pytest.mark.parametrize("freedoms", [("rz",), ("rx", "rz"), ("rx", "ry", "rz")])
@pytest.mark.parametrize("step", [0.4, 1.1])
def test_neighbouring_orientations_are_those_of_a_search_tree(freedoms: tuple[str, ...], step: float) -> None:
    """All within 1.6 steps, and more only where fewer than five are so near."""
    start, goal = Rotation.from_rotvec([[0.3, -0.2, 0.1], [1.0, 0.5, -2.0]]).as_matrix()
    poses = PoseGrid((start, np.zeros(3)), (goal, np.zeros(3)), freedoms, 0.01, step, None, ())
    q = Rotation.from_matrix(np.array(poses.rotations)).as_quat()
    balls = cKDTree(np.vstack([q, -q])).query_ball_point(q, 2.0 * np.sin(1.6 * step / 4.0))
    within = [{b % len(q) for b in ball} - {a} for a, ball in enumerate(balls)]
    for a, near in enumerate(poses.near):
        assert within[a] <= set(near)
        assert all(a in poses.near[b] for b in near)
        for b in set(near) - within[a]:
            assert min(len(within[a]), len(within[b])) < 5
