"""The object's configuration space: a metric, near-uniform rotations, a finite graph of moves clear by MuJoCo's distances."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tables import Distances, graph, task

from regrasp.planner.arcs import Arc
from regrasp.planner.moves import AXES
from regrasp.planner.path import distance, interpolate
from regrasp.planner.poses import GOAL, SAME, START, THERE, PoseGraph, orientations, super_fibonacci
from regrasp.planner.route import GlobalPlanner

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


def circle(axis: str) -> list[np.ndarray]:
    start = Rotation.from_euler("xyz", [0.3, 0.2, 0.1]).as_matrix()
    return orientations((axis,), start, start, STEP)


@pytest.mark.parametrize("axis", ["rx", "ry", "rz"])
def test_one_rotation_is_a_circle(axis: str) -> None:
    """From the start round a full turn in steps of about the chosen angle back to the start."""
    found = circle(axis)
    turn = np.array([Rotation.from_matrix(R @ found[START].T).as_rotvec() for R in found])
    a = AXES.index(axis) - 3
    np.testing.assert_allclose(np.delete(turn, a, axis=1), 0.0, atol=1e-12)
    angle = np.unique(np.round(np.mod(turn[:, a], 2 * np.pi), 9) % round(2 * np.pi, 9))
    assert np.max(np.diff(np.append(angle, 2 * np.pi))) <= STEP + 1e-9


@pytest.mark.parametrize("freedoms", [("rx",), ("rx", "rz"), ("rx", "ry", "rz")])
def test_turns_lead_from_the_start_to_every_orientation(freedoms: tuple[str, ...]) -> None:
    """In the air, one arc after another; the whole turn of one rotation closes on the start."""
    g = graph(task("box", freedoms=freedoms, start=IN_AIR, goal=IN_AIR))
    explore(g)
    reached = np.array([R for R, _ in g.poses])
    for R in g.rotations:
        assert np.min(np.max(np.abs(reached - R), axis=(1, 2))) < 1e-3
    assert any(a != START and b == GOAL for a, b in g.arcs)  # the goal is the start


def test_three_rotations_are_about_a_step_apart() -> None:
    """Each orientation of the set has its nearest neighbour about the chosen angle away."""
    q = Rotation.from_matrix(np.array(orientations(("rx", "ry", "rz"), np.eye(3), np.eye(3), STEP))[2:]).as_quat()
    nearest = (angles_between(q, q) + 4.0 * np.eye(len(q))).min(axis=1)
    assert np.mean(nearest) == pytest.approx(STEP, rel=0.25)


IN_AIR = (0.0, 0.0, 0.15, 0.3, 0.2, 0.1)
CORNER = {"start": (0.0, 0.0, 0.025), "goal": (0.01, 0.0, 0.06)}


def explore(g: PoseGraph, most: int = 100_000) -> set[int]:
    """All nodes that arcs lead to, or the first that `most` expansions do."""
    seen, edge = {START}, [START]
    while edge and most > 0:
        node, most = edge.pop(0), most - 1
        new = [b for b in g.neighbours(node) if b not in seen]
        seen |= set(new)
        edge += new
    return seen


@pytest.fixture(scope="module")
def corner() -> PoseGraph:
    """A box on a table before a wall, that may move in a plane across both, a ball behind it; its first 60 nodes expanded."""
    g = graph(task("box", ("table", "wall"), ("ball",), ("x", "z", "ry"), **CORNER))
    explore(g, 60)
    return g


def nearly(one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> None:
    """Two poses are one to what the graph takes for that."""
    assert np.linalg.norm(one[1] - other[1]) <= THERE[0]
    assert np.linalg.norm(Rotation.from_matrix(one[0] @ other[0].T).as_rotvec()) <= THERE[1]


def test_arcs_lead_from_node_to_node_and_are_clear_all_the_way(corner: PoseGraph) -> None:
    """By MuJoCo: nothing is entered, obstacles are kept the clearance from, what an arc says it touches it does."""
    distances = Distances(task("box", ("table", "wall"), ("ball",), ("x", "z", "ry"), **CORNER))
    supports, clearance = len(corner.supports), corner.resolution.clearance
    # Looked at every 2 % of the radius at least, the object gets no nearer between than by half of that.
    slack = max(0.001, 0.01 * corner.hand.radius)
    assert len(corner.arcs) > 100
    for (a, b), arc in corner.arcs.items():
        nearly(arc.start, corner.poses[a])
        nearly(arc.goal, corner.poses[b])
        assert set(arc.on) <= set(corner.held[a]) & set(corner.held[b])
        for u in np.linspace(0.0, 1.0, 7):
            gaps = distances(*arc.pose(u))
            np.testing.assert_allclose(gaps[list(arc.on)], 0.0, atol=2.5e-5)
            assert np.all(gaps[:supports] > -slack)
            assert np.all(gaps[supports:] > clearance - slack)
        assert distances(*arc.goal).min() > -2e-6


def test_a_node_knows_what_it_touches(corner: PoseGraph) -> None:
    """Also two surfaces at once: the corner of table and wall, the wall alone, an edge on the one and a face on the other."""
    distances = Distances(task("box", ("table", "wall"), ("ball",), ("x", "z", "ry"), **CORNER))
    for (R, p), held in zip(corner.poses, corner.held, strict=True):
        gaps = distances(R, p)[:2]
        assert np.all(np.abs(gaps[list(held)]) < 2.2e-5)
        assert np.all(np.delete(gaps, held) > 1.8e-5)
    assert set(corner.held) == {(), (0,), (1,), (0, 1)}
    both = [corner.poses[a][0] for a, held in enumerate(corner.held) if held == (0, 1)]
    flat = [np.max(np.abs(R[0])) > 1.0 - 1e-6 for R in both]  # it turns about y
    assert any(flat)
    assert not all(flat)


def distinct(g: PoseGraph) -> None:
    """No two nodes that touch the same are one pose; the goal apart."""
    for a, b in itertools.combinations([a for a in range(len(g.poses)) if a != GOAL], 2):
        if g.held[a] == g.held[b] and np.linalg.norm(g.poses[a][1] - g.poses[b][1]) <= SAME[0]:
            assert Rotation.from_matrix(g.poses[a][0] @ g.poses[b][0].T).magnitude() > SAME[1], (a, b)


def test_the_graph_is_finite(corner: PoseGraph) -> None:
    """On a line between two bodies it ends, with no pose twice and no arc twice."""
    t = task("box", ("table", "wall"), (), ("x", "ry"), start=(0.0, 0.0, 0.025), goal=(0.02, 0.0, 0.025))
    g = graph(t)
    seen = explore(g)
    assert seen == set(range(len(g.poses)))
    assert len(seen) < 200
    assert all(len(set(g.neighbours(a))) == len(g.neighbours(a)) for a in seen)
    distinct(g)
    distinct(corner)


def test_a_slide_over_an_edge_has_a_node_just_before_the_box_tips() -> None:
    """It rests there; a little further it does not. The one that goes on, does not."""
    t = task("box", ("edge",), (), ("x", "z", "ry"), start=(-0.01, 0.0, 0.025), goal=(0.05, 0.0, 0.05))
    g = graph(t)
    ends = [b for b in g.neighbours(START) if g.arcs[START, b].kind == "slide" and g.poses[b][1][0] > -0.01]
    rests = {b: g.resting(b) for b in ends}
    assert set(rests.values()) == {True, False}
    last = max(g.poses[b][1][0] for b in ends if rests[b])
    assert -0.0015 < last < 0.0  # the centre is over the edge at 0
    assert all(g.poses[b][1][0] > 0.0 for b in ends if not rests[b])


def test_what_is_in_the_air_does_not_rest() -> None:
    g = graph(task("box", ("table",), start=(0.0, 0.0, 0.05), goal=(0.0, 0.0, 0.025)))
    assert (g.resting(START), g.resting(GOAL)) == (False, True)


def test_bodies_that_stop_moves_are_remembered_where_they_did_nearest_to_the_goal() -> None:
    """Distances of Eq.: |Δp| + r · angle from the goal; carriers too."""
    t = task("sphere", ("table",), ("post",), ("x", "y"), start=(0.0, 0.0, 0.025), goal=(0.0, 0.12, 0.025))
    g = graph(t)
    explore(g, 12)
    names = {t.router.name(body): note for body, note in g.blocked.items()}
    assert "post" in names
    note, goal = names["post"], np.array([0.0, 0.12, 0.025])
    assert note.far == pytest.approx(np.linalg.norm(note.pose[1] - goal), abs=1e-9)
    gap = Distances(t)(*note.pose)[note.body]
    assert gap == pytest.approx(g.resolution.clearance, abs=1e-6)


SUBSETS = [tuple(s) for size in range(1, 7) for s in itertools.combinations(AXES, size)]


def kept(freedoms: tuple[str, ...], turn: np.ndarray) -> np.ndarray:
    """What must vanish of an arc's turn vector: its components about axes that are not free."""
    return turn[[a for a in range(3) if AXES[a + 3] not in freedoms]]


@pytest.mark.parametrize("supports", [(), ("slope",)], ids=["in the air", "over a slope"])
@settings(max_examples=12, deadline=None, derandomize=True)
@given(freedoms=st.sampled_from(SUBSETS), seed=st.integers(0, 100))
def test_every_arc_moves_the_object_in_its_freedoms_only(supports, freedoms, seed: int) -> None:
    """A random walk from the start over neighbours."""
    g = graph(task("box", supports, (), freedoms, start=IN_AIR, goal=IN_AIR))
    rng = np.random.default_rng(seed)
    fixed = [a for a in range(3) if AXES[a] not in freedoms]
    node = START
    for _ in range(4):
        others = g.neighbours(node)
        if not others:
            break
        for other in others:
            arc: Arc = g.arcs[node, other]
            p = arc.poses(np.linspace(0.0, 1.0, 7))[1]
            np.testing.assert_allclose((p - g.start[1])[:, fixed], 0.0, atol=1e-6)
            np.testing.assert_allclose(kept(freedoms, arc.w), 0.0, atol=2e-6 * (1.0 + arc.angle))
        node = others[rng.integers(len(others))]


def test_start_and_goal_are_exact() -> None:
    """Though the goal lies in no cell's middle; the arc that gets there ends there."""
    goal = (0.0123, -0.0456, 0.16, 1.0, -0.5, 2.0)
    g = graph(task("box", start=IN_AIR, goal=goal))
    R = Rotation.from_euler("xyz", goal[3:]).as_matrix()
    np.testing.assert_allclose(g.poses[GOAL][0], R, atol=1e-12)
    np.testing.assert_array_equal(g.poses[GOAL][1], goal[:3])
    assert GOAL in g.neighbours(START)
    nearly(g.arcs[START, GOAL].goal, g.poses[GOAL])
    assert g.near_goal(g.poses[GOAL])
    assert not g.near_goal((R, g.poses[GOAL][1] + 2.0 * THERE[0]))
    assert len(orientations((), R, R, STEP)) == 2


def test_a_finer_resolution_makes_more_nodes() -> None:
    """Half the steps: about twice as many positions on a line."""
    counts = []
    for part in (1.0, 0.5):
        t = task("sphere", ("table", "wall"), ("ball",), ("x",), start=(0.0, 0.0, 0.025), goal=(0.03, 0.0, 0.025),
                 route=GlobalPlanner(step=0.6 * part))  # fmt: skip
        counts.append(len(explore(graph(t))))
    assert 1.5 * counts[0] <= counts[1] <= 3 * counts[0]
