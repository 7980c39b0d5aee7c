"""A* against Dijkstra, the bound of weighted A*, penalties that reroute, budgets and dead ends."""

import itertools
import math

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from regrasp.search import astar
from regrasp.search.astar import Failure, Path, Penalties, Progress, Reason


class Roads:
    """Points in the plane joined by directed arcs no shorter than the distance, which is the heuristic."""

    def __init__(self, seed, n=120, degree=4, scale=1.0):
        rng = np.random.default_rng(seed)
        self.points = rng.random((n, 2))
        self.goal = n - 1
        self.scale = scale
        self.arcs = {a: {} for a in range(n)}
        for a in range(n):
            near = np.argsort(np.linalg.norm(self.points - self.points[a], axis=1))[1 : 3 * degree]
            for b in rng.choice(near, rng.integers(1, degree), replace=False):
                self.arcs[a][int(b)] = self.distance(a, b) * rng.uniform(1.0, 3.0)

    def distance(self, a, b):
        return float(np.linalg.norm(self.points[a] - self.points[b]))

    def neighbours(self, node):
        return self.arcs[node]

    def bound(self, a, b):
        return self.distance(a, b)

    def cost(self, a, b):
        return self.arcs[a][b]

    def heuristic(self, node):
        return self.scale * self.distance(node, self.goal)

    def least(self, start):
        """Dijkstra's cost from start to the goal."""
        entries = [(a, b, c) for a, out in self.arcs.items() for b, c in out.items()]
        a, b, c = zip(*entries, strict=True)
        n = len(self.arcs)
        return float(dijkstra(csr_array((c, (a, b)), shape=(n, n)), indices=start)[self.goal])


class Grid:
    """Unit steps on a square grid among walls, with the city-block heuristic."""

    def __init__(self, size, walls=(), goal=None):
        self.size, self.walls = size, set(walls)
        self.goal = goal or (size - 1, size - 1)
        self.asked = []

    def neighbours(self, node):
        x, y = node
        for other in ((x + 1, y), (x, y + 1), (x - 1, y), (x, y - 1)):
            if 0 <= other[0] < self.size and 0 <= other[1] < self.size:
                yield other

    def bound(self, a, b):
        return 1.0

    def cost(self, a, b):
        self.asked.append((a, b))
        return math.inf if b in self.walls else 1.0

    def heuristic(self, node):
        return float(abs(node[0] - self.goal[0]) + abs(node[1] - self.goal[1]))


def length(graph, nodes):
    return sum(graph.cost(a, b) for a, b in itertools.pairwise(nodes))


@pytest.mark.parametrize("scale", [0.0, 0.5, 1.0])
def test_cost_equals_dijkstras_on_random_graphs(scale):
    found = 0
    for seed in range(60):
        roads = Roads(seed, scale=scale)
        least = roads.least(0)
        outcome = astar.find(roads, 0, roads.goal)
        if math.isinf(least):
            assert isinstance(outcome, Failure)
            assert outcome.reason is Reason.EXHAUSTED
        else:
            assert isinstance(outcome, Path)
            assert outcome.cost == pytest.approx(least, rel=1e-12)
            assert outcome.nodes[0] == 0
            assert outcome.nodes[-1] == roads.goal
            assert length(roads, outcome.nodes) == pytest.approx(least, rel=1e-12)
            found += 1
    assert 20 < found < 60


def test_an_inconsistent_lower_bound_still_gives_the_least_cost():
    for seed in range(60):
        roads = Roads(seed)
        rng = np.random.default_rng(seed)
        shrink = rng.choice([0.0, 1.0], len(roads.arcs))
        exact = roads.heuristic
        roads.heuristic = lambda node, shrink=shrink, exact=exact: shrink[node] * exact(node)
        outcome = astar.find(roads, 0, roads.goal)
        least = roads.least(0)
        assert isinstance(outcome, Path) == math.isfinite(least)
        if isinstance(outcome, Path):
            assert outcome.cost == pytest.approx(least, rel=1e-12)


@pytest.mark.parametrize("weight", [1.5, 3.0, 10.0])
def test_weighted_search_stays_within_its_bound_and_expands_fewer_nodes(weight):
    plain, weighted = 0, 0
    for seed in range(60):
        roads = Roads(seed)
        outcome = astar.find(roads, 0, roads.goal, weight=weight)
        if isinstance(outcome, Path):
            least = astar.find(roads, 0, roads.goal)
            assert outcome.cost <= weight * least.cost * (1 + 1e-12)
            plain += least.expanded
            weighted += outcome.expanded
    assert weighted < plain


def test_a_failed_arc_is_avoided_from_where_the_plan_has_got_to():
    grid = Grid(5)
    penalties = Penalties()
    first = astar.find(grid, (0, 0), grid.goal, penalties)
    a, b = first.nodes[3:5]
    penalties.penalise(a, b, extra=10.0)
    again = astar.find(grid, a, grid.goal, penalties)
    assert again.nodes[0] == a
    assert again.nodes[1] != b
    assert again.cost == 5.0  # another way of the same length: the arc alone was penalised
    assert astar.find(grid, (0, 0), grid.goal).nodes == first.nodes  # nothing sticks to the graph


def test_the_only_way_is_taken_at_its_raised_cost():
    corridor = Grid(5, walls=[(1, y) for y in range(5) if y != 2])
    penalties = Penalties()
    penalties.penalise((0, 2), (1, 2), factor=3.0)
    penalties.penalise((0, 2), (1, 2), factor=2.0, extra=1.0)
    path = astar.find(corridor, (0, 0), corridor.goal, penalties)
    assert ((0, 2), (1, 2)) in itertools.pairwise(path.nodes)
    assert path.cost == 8.0 - 1.0 + 3.0 * 2.0 + 1.0
    penalties.penalise((0, 2), (1, 2), extra=math.inf)
    assert isinstance(astar.find(corridor, (0, 0), corridor.goal, penalties), Failure)


def test_raised_costs_equal_dijkstras_on_the_graph_with_these_costs():
    for seed in range(30):
        roads = Roads(seed)
        rng = np.random.default_rng(seed)
        penalties = Penalties()
        for a, out in roads.arcs.items():
            for b in out:
                if rng.random() < 0.3:
                    penalties.penalise(a, b, factor=1 + rng.random(), extra=rng.random())
        outcome = astar.find(roads, 0, roads.goal, penalties)
        for a, out in roads.arcs.items():
            for b, cost in out.items():
                out[b] = penalties.apply(a, b, cost)
        least = roads.least(0)
        assert isinstance(outcome, Path) == math.isfinite(least)
        if isinstance(outcome, Path):
            assert outcome.cost == pytest.approx(least, rel=1e-12)


@pytest.mark.parametrize("change", [{"factor": 0.5}, {"extra": -1.0}, {"factor": math.inf}])
def test_costs_are_never_lowered(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        Penalties().penalise(0, 1, **change)


def test_budget_ends_the_search_with_the_nearest_node():
    grid = Grid(20, walls=[(10, y) for y in range(19)])
    outcome = astar.find(grid, (0, 0), grid.goal, budget=20)
    assert outcome == Failure(Reason.BUDGET, outcome.nearest, 20)
    assert grid.heuristic(outcome.nearest) < grid.heuristic((0, 0))
    needed = astar.find(grid, (0, 0), grid.goal)
    assert isinstance(needed, Path)
    assert isinstance(astar.find(grid, (0, 0), grid.goal, budget=needed.expanded), Path)
    assert isinstance(astar.find(grid, (0, 0), grid.goal, budget=needed.expanded - 1), Failure)


def test_stop_ends_the_search():
    asked = iter([False, False, True])
    outcome = astar.find(Roads(3), 0, Roads(3).goal, stop=lambda _: next(asked))
    assert outcome == Failure(Reason.STOPPED, outcome.nearest, 3)


def test_a_goal_behind_walls_exhausts_the_graph():
    grid = Grid(6, walls=[(4, 4), (4, 5), (5, 4)])
    outcome = astar.find(grid, (0, 0), grid.goal)
    assert outcome == Failure(Reason.EXHAUSTED, outcome.nearest, 36 - 4)
    assert grid.heuristic(outcome.nearest) == 2.0


def test_start_at_the_goal_is_a_path_of_one_node():
    assert astar.find(Grid(3), (2, 2), (2, 2)) == Path(((2, 2),), 0.0, 0)


def test_costs_are_asked_only_where_the_search_gets_to():
    grid = Grid(50, goal=(0, 5))
    path = astar.find(grid, (0, 0), (0, 5))
    assert {a for a, _ in grid.asked} == set(path.nodes[:-1])


def test_equal_paths_are_told_apart_by_the_order_of_the_neighbours():
    paths = {astar.find(Grid(8), (0, 0), (7, 7)).nodes for _ in range(3)}
    assert len(paths) == 1


def test_progress_counts_and_bounds_the_cost_from_below():
    roads = next(r for r in map(Roads, range(60)) if math.isfinite(r.least(0)))
    search = astar.init(roads, 0, roads.goal)
    steps = []
    while isinstance(outcome := astar.step(search), Progress):
        steps.append(outcome)
    assert [s.expanded for s in steps] == list(range(1, len(steps) + 1))
    bounds = [s.bound for s in steps]
    assert bounds == sorted(bounds)
    assert bounds[-1] <= outcome.cost + 1e-12
    assert isinstance(astar.step(search), Path)  # asked again, the answer is the same


def test_a_negative_cost_is_refused():
    grid = Grid(3)
    grid.cost = lambda a, b: -1.0
    with pytest.raises(ValueError, match="legal: ≥ 0"):
        astar.find(grid, (0, 0), (2, 2))


class Asked(Roads):
    """Roads that remember whose cost was asked for, with bounds between the distance and the cost."""

    def __init__(self, seed, tightness):
        super().__init__(seed)
        self.tightness, self.costs, self.bounds = tightness, [], []

    def bound(self, a, b):
        self.bounds.append((a, b))
        tight = self.tightness * (self.arcs[a][b] - self.distance(a, b)) if self.tightness else 0.0
        return self.distance(a, b) + tight

    def cost(self, a, b):
        self.costs.append((a, b))
        return super().cost(a, b)


@pytest.mark.parametrize("weight", [1.0, 2.0])
def test_a_lazy_search_is_the_eager_one_and_asks_for_fewer_costs(weight):
    """However far the bounds are below the costs, the path is within its bound of the least, and the costs of little more
    than half of the arcs seen are asked for, the fewer the tighter the bounds are."""
    asked, seen = dict.fromkeys((0.0, 0.5, 1.0), 0), dict.fromkeys((0.0, 0.5, 1.0), 0)
    for seed in range(60):
        outcomes = []
        for tightness in asked:
            roads = Asked(seed, tightness)
            outcomes.append(astar.find(roads, 0, roads.goal, weight=weight))
            asked[tightness] += len(roads.costs)
            seen[tightness] += len(roads.bounds)
            assert set(roads.costs) <= set(roads.bounds)
        assert len({type(outcome) for outcome in outcomes}) == 1
        if isinstance(outcomes[0], Path):
            least = Roads(seed).least(0)
            for outcome in outcomes:
                assert outcome.cost == pytest.approx(length(Roads(seed), outcome.nodes), rel=1e-12)
                assert least * (1 - 1e-12) <= outcome.cost <= weight * least * (1 + 1e-12)
    assert asked[1.0] < asked[0.5] < asked[0.0] < 0.6 * seen[0.0]


def test_no_cost_is_asked_that_a_best_path_could_not_have():
    """Cost to get there + bound + heuristic is at most the least cost; and none is asked twice, as this heuristic is
    consistent."""
    for seed in range(60):
        roads = Asked(seed, 0.0)
        outcome = astar.find(roads, 0, roads.goal)
        if not isinstance(outcome, Path):
            continue
        assert len(set(roads.costs)) == len(roads.costs)
        n = len(roads.arcs)
        a, b, c = zip(*((a, b, c) for a, out in roads.arcs.items() for b, c in out.items()), strict=True)
        reached = dijkstra(csr_array((c, (a, b)), shape=(n, n)), indices=0)
        for a, b in roads.costs:
            assert reached[a] + roads.distance(a, b) + roads.heuristic(b) <= outcome.cost * (1 + 1e-12)


def test_arcs_that_turn_out_barred_are_passed_by():
    """Behind bounds that promise a way: the path is the least of those that are not barred, or there is none."""
    found = 0
    for seed in range(30):
        roads = Asked(seed, 0.0)
        rng = np.random.default_rng(seed)
        for out in roads.arcs.values():
            for b in out:
                if rng.random() < 0.15:
                    out[b] = math.inf
        outcome = astar.find(roads, 0, roads.goal)
        least = roads.least(0)
        assert isinstance(outcome, Path) == math.isfinite(least)
        if isinstance(outcome, Path):
            assert outcome.cost == pytest.approx(least, rel=1e-12)
            found += 1
    assert 5 < found < 30
