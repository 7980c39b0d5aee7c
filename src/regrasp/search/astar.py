"""A* (Hart, Nilsson & Raphael 1968) on any graph, with arcs that can turn out dearer than they looked.

What an arc costs may take long to find out. It is asked for when the arc's end is the best open node by a lower bound of the
cost, so that arcs which no good path takes are never asked for (lazy weighted A*: Cohen, Phillips & Likhachev 2014).

A plan's arc may fail after the path was found. `Penalties` remembers that between searches: the arc's cost is raised
and the search runs again from wherever the plan has got to.
"""

import heapq
import math
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Generic, Protocol, TypeVar

Node = TypeVar("Node", bound=Hashable)


class Graph(Protocol[Node]):
    """What is searched. Nodes are hashable; the order of neighbours decides between equal paths."""

    def neighbours(self, node: Node) -> Iterable[Node]:
        """Nodes at the other ends of the arcs out of `node`."""

    def bound(self, a: Node, b: Node) -> float:
        """Lower bound ≥ 0 of the cost of the arc from a to b, soon known."""

    def cost(self, a: Node, b: Node) -> float:
        """Cost ≥ 0 of the arc from a to b, inf if it is barred; asked only when the search gets to it."""

    def heuristic(self, node: Node) -> float:
        """Lower bound ≥ 0 of the cost from `node` to the goal."""


@dataclass
class Penalties(Generic[Node]):
    """Raised arc costs: cost · factor + extra. Costs only rise, so every lower bound stays one."""

    raised: dict[tuple[Node, Node], tuple[float, float]] = field(default_factory=dict)

    def penalise(self, a: Node, b: Node, factor: float = 1.0, extra: float = 0.0) -> None:
        """Raise the cost of the arc from a to b once more, by a factor ≥ 1 and an extra ≥ 0; extra inf bars it."""
        if not 1.0 <= factor < math.inf:
            raise ValueError(f"factor is {factor}, legal: ≥ 1 and finite")
        if not extra >= 0.0:
            raise ValueError(f"extra is {extra}, legal: ≥ 0")
        old_factor, old_extra = self.raised.get((a, b), (1.0, 0.0))
        self.raised[a, b] = (old_factor * factor, old_extra * factor + extra)

    def apply(self, a: Node, b: Node, cost: float) -> float:
        """The raised cost of the arc from a to b."""
        factor, extra = self.raised.get((a, b), (1.0, 0.0))
        return cost * factor + extra


class Reason(StrEnum):
    """Why there is no path."""

    EXHAUSTED = "every node that can be reached was expanded: the goal is cut off; free an arc or refine the graph"
    BUDGET = "the node budget ran out before the goal was reached: raise it"
    STOPPED = "the search was stopped before the goal was reached"


@dataclass(frozen=True)
class Path(Generic[Node]):
    """A path with its cost, penalties included: at most `weight` times the least one."""

    nodes: tuple[Node, ...]
    cost: float
    expanded: int


@dataclass(frozen=True)
class Failure(Generic[Node]):
    """No path; `nearest` is the node met whose heuristic is the least."""

    reason: Reason
    nearest: Node
    expanded: int


@dataclass(frozen=True, slots=True)
class Progress(Generic[Node]):
    """The search goes on: the node expanded last, the numbers of expanded and open nodes, a lower bound of the cost."""

    node: Node
    expanded: int
    open: int
    bound: float


@dataclass
class Search(Generic[Node]):
    """A search under way; `init` makes it and `step` moves it on.

    queue: open nodes by estimated cost of the whole path, heuristic and number of the entry; with the cost to get there and,
    where that is a bound only, the node before.
    """

    graph: Graph[Node]
    goal: Node
    penalties: Penalties[Node]
    weight: float
    budget: int
    cost: dict[Node, float]
    parent: dict[Node, Node]
    estimate: dict[Node, float]
    queue: list[tuple[float, float, int, float, Node, Node | None]]
    nearest: Node
    entries: int = 0
    expanded: int = 0
    bound: float = 0.0


def init(
    graph: Graph[Node],
    start: Node,
    goal: Node,
    penalties: Penalties[Node] | None = None,
    weight: float = 1.0,
    budget: int = 1_000_000,
) -> Search[Node]:
    """A search from start to goal with the heuristic times `weight` ≥ 1 (Pohl 1970) and up to `budget` expansions."""
    if not weight >= 1.0:
        raise ValueError(f"weight is {weight}, legal: ≥ 1")
    estimate = graph.heuristic(start)
    return Search(
        graph=graph,
        goal=goal,
        penalties=Penalties() if penalties is None else penalties,
        weight=weight,
        budget=budget,
        cost={start: 0.0},
        parent={},
        estimate={start: estimate},
        queue=[(weight * estimate, estimate, 0, 0.0, start, None)],
        nearest=start,
    )


def step(search: Search[Node]) -> Progress[Node] | Path[Node] | Failure[Node]:
    """Expand the open node of the least cost + weight · heuristic.

    Ties go to the smaller heuristic, then to the node found first, so a search has one outcome. A node that is reached
    more cheaply after its expansion is opened again: the heuristic need not be consistent, only a lower bound.
    """
    queue, best = search.queue, search.cost
    while queue:
        total, estimate, _, reached, node, before = queue[0]
        if before is None and reached <= best[node]:
            break
        heapq.heappop(queue)
        if before is not None and reached < best.get(node, math.inf):
            _settle(search, before, node)
    if not queue:
        return Failure(Reason.EXHAUSTED, search.nearest, search.expanded)
    if node == search.goal:
        return Path(_trace(search), best[search.goal], search.expanded)
    if search.expanded >= search.budget:
        return Failure(Reason.BUDGET, search.nearest, search.expanded)
    heapq.heappop(queue)
    search.expanded += 1
    search.bound = max(search.bound, total / search.weight)
    if estimate < search.estimate[search.nearest]:
        search.nearest = node
    for other in search.graph.neighbours(node):
        arc = search.penalties.apply(node, other, search.graph.bound(node, other))
        if not arc >= 0.0:
            raise ValueError(f"bound of the arc {node} to {other} is {arc}, legal: ≥ 0 or inf")
        if reached + arc < best.get(other, math.inf):
            _push(search, reached + arc, other, node)
    return Progress(node, search.expanded, len(queue), search.bound)


def _settle(search: Search[Node], a: Node, b: Node) -> None:
    """Open b by the arc from a at its true cost, if that is less than b has cost so far."""
    arc = search.penalties.apply(a, b, search.graph.cost(a, b))
    if not arc >= 0.0:
        raise ValueError(f"cost of the arc {a} to {b} is {arc}, legal: ≥ 0 or inf")
    cost = search.cost[a] + arc
    if cost < search.cost.get(b, math.inf):
        search.cost[b] = cost
        search.parent[b] = a
        _push(search, cost, b, None)


def _push(search: Search[Node], cost: float, node: Node, before: Node | None) -> None:
    """An entry of the queue, unless no path leads on from the node."""
    if node not in search.estimate:
        search.estimate[node] = search.graph.heuristic(node)
    h = search.estimate[node]
    if h < math.inf and cost < math.inf:
        search.entries += 1
        heapq.heappush(search.queue, (cost + search.weight * h, h, search.entries, cost, node, before))


def _trace(search: Search[Node]) -> tuple[Node, ...]:
    """The nodes from the start to the goal."""
    nodes = [search.goal]
    while nodes[-1] in search.parent:
        nodes.append(search.parent[nodes[-1]])
    return tuple(reversed(nodes))


def find(
    graph: Graph[Node],
    start: Node,
    goal: Node,
    penalties: Penalties[Node] | None = None,
    weight: float = 1.0,
    budget: int = 1_000_000,
    stop: Callable[[Progress[Node]], bool] = lambda _: False,
) -> Path[Node] | Failure[Node]:
    """Run a search (see `init`) to its end, or until `stop`, told of each expansion, says so."""
    search = init(graph, start, goal, penalties, weight, budget)
    while isinstance(outcome := step(search), Progress):
        if stop(outcome):
            return Failure(Reason.STOPPED, search.nearest, search.expanded)
    return outcome
