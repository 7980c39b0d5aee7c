"""The global planner (paper §3): A* over the object's quantised configuration space among static obstacles.

Its nodes are subgoals, its arcs nominal paths. It also decides where static surfaces carry the object: an arc's cost weighs
its length against the least force that holds the object there with the supports it touches.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.basis import program
from regrasp.kernels.features import TOUCH
from regrasp.kernels.forces import EDGES, friction_edges
from regrasp.kernels.sampling import sample
from regrasp.kernels.simplex import OPTIMAL, solve
from regrasp.kernels.surfaces import tangents
from regrasp.planner.collision import closer, object_hits, place
from regrasp.planner.hand import Hand
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Pose
from regrasp.planner.poses import FREE, Node, PoseGrid
from regrasp.planner.supports import Support, touching
from regrasp.search import astar

Array = NDArray[np.float64]
NEAR_INFINITE = 1e6


@dataclass(frozen=True)
class GlobalPlanner:
    """Settings of the global planner.

    step: grid step in parts of the object's radius. angle: about the step between orientations, rad. clearance: m between
    object and obstacles. weight: how far f = g + weight · h may overestimate (the route is at most so much longer).
    nodes: expanded before the search gives up. force: cost of one weight of holding force, in parts of an arc's length.
    penalty: factor on the cost of an arc on which the local planner failed.
    """

    step: float = 0.6
    angle: float = 0.6
    clearance: float = 0.002
    weight: float = 1.0
    nodes: int = 4000
    force: float = 0.2
    penalty: float = 3.0


class Router:
    """A* on a PoseGrid with the obstacles and supports of a hand; keeps what failed arcs taught it."""

    def __init__(self, hand: Hand, grid: PoseGrid, supports: tuple[Support, ...], up_W: Array, settings: GlobalPlanner):
        self.hand, self.grid, self.supports, self.up_W, self.settings = hand, grid, supports, up_W, settings
        self.penalties: astar.Penalties[Node] = astar.Penalties()
        self._free: dict[tuple[Node, Node], bool] = {}
        self._force: dict[Node, float] = {}
        static = slice(hand.geom_start[-1], hand.object_geom)
        count = hand.object_geom + 1 - hand.geom_start[-1]
        self._R_WB, self._p_WB = np.zeros((count, 3, 3)), np.zeros((count, 3))
        self._R_WB[:-1], self._p_WB[:-1] = hand.geoms.R_LG[static], hand.geoms.p_LG[static]
        self._grasp_points = sample(hand.kind_O, hand.size_O, 24)

    def blocked(self, pose: Pose, clearance: float) -> str:
        """What the object would hit at a pose: '' if nothing, else the kind of body."""
        hand, R_B, p_B = self.hand, self._R_WB, self._p_WB
        place(hand, hand.object_geom, hand.object_geom + 1, pose[0][None], pose[1][None], R_B[-1:], p_B[-1:])
        if object_hits(hand, R_B, p_B, clearance):
            return "an obstacle"
        first = hand.geom_start[-1]
        for support in self.supports:
            row = support.geom - first
            if closer(hand, hand.object_geom, R_B[-1], p_B[-1], support.geom, R_B[row], p_B[row], -TOUCH):
                return f"the support {support.name}"
        return ""

    def in_reach(self, pose: Pose) -> bool:
        """Whether some agent could touch the object at a pose at all."""
        far = np.linalg.norm(self.hand.chains.p_WB - pose[1], axis=1)
        return bool(np.any(far <= self.hand.reach + self.hand.radius))

    def free(self, a: Node, b: Node) -> bool:
        """Whether the object gets from a to b clear of everything and within reach."""
        key = (a, b) if a < b else (b, a)
        if key not in self._free:
            count = self.looks(self.grid.length(*key, self.hand.radius))
            self._free[key] = self.clear(*self.grid.arc(*key, count))
        return self._free[key]

    def looks(self, length: float) -> int:
        """Steps in which a way of this length (`path.distance`) is looked at."""
        return max(1, math.ceil(length / (0.08 * self.hand.radius)))

    def clear(self, R: Array, p: Array) -> bool:
        """Whether the object is clear of everything and within reach at all poses, R (n, 3, 3), p (n, 3)."""
        clearance = self.settings.clearance
        return all(self.in_reach(pose) and not self.blocked(pose, clearance) for pose in zip(R, p, strict=True))

    def least_force(self, node: Node) -> float:
        """Σ of normal forces, in weights, that hold the object at a node if fingers could touch it anywhere."""
        if node not in self._force:
            self._force[node] = self._hold(node)
        return self._force[node]

    def _hold(self, node: Node) -> float:
        pose = self.grid.pose(node)
        assert pose is not None
        hand = self.hand
        rests = [] if node.support == FREE else touching(hand, self.supports[node.support], *pose)
        points = [(p, -n, float(np.min(hand.mu)), 1.0) for p, n in zip(*self._grasp_points, strict=True)]
        points += [(p, pose[0].T @ n, self.supports[node.support].mu, 0.0) for p, n in rests]
        lp = program(EDGES * len(points), 1)
        x, y = np.empty(3), np.empty(3)
        for c, (p, n, mu, cost) in enumerate(points):
            tangents(n, x, y)
            friction_edges(p - hand.p_OM_O, n, x, y, mu, hand.radius, lp.A, EDGES * c)
            lp.cost[EDGES * c : EDGES * (c + 1)] = cost
        lp.group[:] = -1
        lp.b[:3], lp.b[3:] = pose[0].T @ self.up_W, 0.0
        status, value, _ = solve(lp, EDGES * len(points), False)
        return value if status == OPTIMAL else NEAR_INFINITE

    def cost(self, a: Node, b: Node) -> float:
        """Cost of an arc: its length times 1 + force · (least holding force); inf where it is not free."""
        if not self.free(a, b):
            return math.inf
        length = self.grid.length(a, b, self.hand.radius)
        if not self.supports:
            return length  # the least force is the same everywhere
        return length * (1.0 + self.settings.force * 0.5 * (self.least_force(a) + self.least_force(b)))

    def neighbours(self, node: Node) -> list[Node]:
        """Where an arc may lead from a node (`PoseGrid.neighbours`)."""
        return self.grid.neighbours(node)

    def heuristic(self, node: Node) -> float:
        """Length of the straight way to the goal: never more than the cost, as the length is a metric."""
        return self.grid.length(node, self.grid.goal, self.hand.radius)

    def route(self, start: Node, stop: Callable[[], bool]) -> list[Node] | Failure:
        """Subgoals from a node to the goal, as few as keep the route free and no dearer, or why there are none.

        Once `stop` says so, the search is given up.
        """
        s = self.settings
        result = astar.find(self, start, self.grid.goal, self.penalties, s.weight, s.nodes, stop)
        if isinstance(result, astar.Failure):
            return Failure(
                "route", "global planner", "object", f"no way to the goal among the obstacles ({result.reason})",
                "a finer planner.route.step, more planner.route.nodes, or a goal that can be reached",
            )  # fmt: skip
        return self._straightened(list(result.nodes))

    def _straightened(self, path: list[Node]) -> list[Node]:
        """Leave out subgoals between which the object may as well go straight."""
        out = [path[0]]
        while out[-1] != path[-1]:
            here = path.index(out[-1])
            step = here + 1
            for far in range(len(path) - 1, here + 1, -1):
                along = sum(self.raised(a, b) for a, b in zip(path[here:far], path[here + 1 : far + 1], strict=True))
                if self.raised(path[here], path[far]) <= along * (1.0 + 1e-9):
                    step = far
                    break
            out.append(path[step])
        return out

    def raised(self, a: Node, b: Node) -> float:
        """Cost of an arc with what failures have added to it."""
        return self.penalties.apply(a, b, self.cost(a, b))

    def failed(self, a: Node, b: Node) -> None:
        """The local planner failed between a and b: raise that arc's cost, so that other routes are tried first."""
        self.penalties.penalise(a, b, self.settings.penalty)
