"""The global planner (paper §3): A* over the object's quantised configuration space among static obstacles.

Its nodes are subgoals, its arcs nominal paths. It also decides where static surfaces carry the object: an arc's cost weighs
its length against the least force that holds the object along it with the supports it touches. What the local planner could
not do is remembered, arc by arc, at what cost.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.features import TOUCH
from regrasp.planner.arcs import Arc, straight
from regrasp.planner.hand import Hand
from regrasp.planner.holding import arc_force, at_rest, touchable
from regrasp.planner.outcome import Failure, Progress, Report
from regrasp.planner.path import Pose, distance
from regrasp.planner.poses import GOAL, START, PoseGraph, Resolution
from regrasp.planner.reserve import Margins
from regrasp.planner.supports import Support
from regrasp.planner.surroundings import gaps_at, surroundings_of
from regrasp.search import astar

Array = NDArray[np.float64]
FINER = 0.5
"""Of every step, on the finer level that is searched where the first finds no way."""
REPORTED = 20
"""Expansions between two reports."""


@dataclass(frozen=True)
class GlobalPlanner:
    """Settings of the global planner.

    step: between positions in parts of the object's radius. angle: about the step between orientations, rad. clearance: m
    between object and obstacles. weight: how far f = g + weight · h may overestimate (the route costs at most so many times
    the least). nodes: expanded before the search gives up; poses: made before it does, each about a kilobyte. force: cost of
    one weight of holding force, in parts of an arc's length; unrest: of a subgoal on a support on which the object does not
    rest, in radii. penalty: factor on the cost of an arc on which the local planner failed; lesson: the same on all arcs of its
    kind on the same supports, in scenes that have some. levels: resolutions tried, each finer than the one before.
    """

    step: float = 0.6
    angle: float = 0.6
    clearance: float = 0.002
    weight: float = 1.5
    nodes: int = 4000
    poses: int = 100_000
    force: float = 0.2
    unrest: float = 1.0
    penalty: float = 3.0
    lesson: float = 1.3
    levels: int = 2

    def __post_init__(self) -> None:
        if not self.weight >= 1.0:
            raise ValueError(f"weight is {self.weight}, legal: 1 or more")
        if self.levels < 1:
            raise ValueError(f"levels is {self.levels}, legal: 1 or more")


@dataclass(frozen=True)
class Leg:
    """One arc of a route and the nodes of the graph that it passes, its ends included."""

    arc: Arc
    nodes: tuple[int, ...]


class Router:
    """A* on a PoseGraph with the obstacles and supports of a hand; keeps what failed arcs taught it."""

    def __init__(
        self, hand: Hand, freedoms: tuple[str, ...], supports: tuple[Support, ...], start: Pose, goal: Pose,
        gravity: Array, margins: Margins, tip_clearance: float, settings: GlobalPlanner, names: dict[int, str],
    ) -> None:  # fmt: skip
        self.hand, self.supports, self.settings, self.names = hand, supports, settings, names
        self.around = surroundings_of(hand, supports)
        self.gravity, self.margins = gravity, margins
        self.points = touchable(hand, tip_clearance)
        self.level, self._freedoms = 0, freedoms
        self.lessons: dict[tuple[str, tuple[int, ...]], float] = {}
        self.start_pose, self.goal_pose = start, goal
        self._reset(start)

    def _reset(self, start: Pose) -> None:
        s, fine = self.settings, FINER**self.level
        resolution = Resolution(s.step * self.hand.radius * fine, s.angle * fine, s.clearance)
        self.graph = PoseGraph(
            self.hand, self.around, self.supports, self._freedoms, start, self.goal_pose, resolution, self.rests
        )
        self.penalties: astar.Penalties[int] = astar.Penalties()
        self._cost: dict[tuple[int, int], float] = {}
        self.weak: list[tuple[float, Arc]] = []

    def blocked(self, pose: Pose, clearance: float) -> str:
        """What the object would hit at a pose, '' if nothing."""
        gaps = np.empty(len(self.around.kind))
        gaps_at(self.around, *pose, clearance, gaps)
        for b, gap in enumerate(gaps):
            if gap < (-TOUCH if self.around.carries[b] else clearance):
                return self.name(b)
        return ""

    def name(self, b: int) -> str:
        """What a body of the surroundings is called."""
        return self.names[int(self.around.geom[b])]

    def in_reach(self, pose: Pose) -> bool:
        """Whether some agent could touch the object at a pose at all."""
        far = np.linalg.norm(self.hand.origin - pose[1], axis=1)
        return bool(np.any(far <= self.hand.span + self.hand.radius))

    def restarted(self) -> int:
        """The node to begin again from: the start."""
        if self.graph.start is not self.start_pose:
            self._reset(self.start_pose)
        return START

    def neighbours(self, node: int) -> list[int]:
        """Where an arc may lead from a node (`PoseGraph.neighbours`)."""
        return [other for other in self.graph.neighbours(node) if self.in_reach(self.graph.poses[other])]

    def rests(self, pose: Pose) -> bool:
        """Whether the object stays at a pose by itself."""
        return at_rest(self.hand, self.supports, pose, self.margins, self.gravity)

    def bound(self, a: int, b: int) -> float:
        """The arc's length."""
        return self.graph.arcs[a, b].length(self.hand.radius)

    def cost(self, a: int, b: int) -> float:
        """Cost of an arc: its length times 1 + force · (least holding force); inf where no fingers hold the object.

        More where it begins on a support on which the object does not rest: there the agents cannot take hold anew.
        """
        if (a, b) not in self._cost:
            arc = self.graph.arcs[a, b]
            stuck = self.graph.held[a] and not self.graph.resting(a)
            self._cost[a, b] = self.cost_of(arc) + (self.settings.unrest * self.hand.radius if stuck else 0.0)
            if self._cost[a, b] == math.inf:
                self.weak.append((distance(arc.goal, self.goal_pose, self.hand.radius), arc))
        return self._cost[a, b] * self.learnt(self.graph.arcs[a, b])

    def learnt(self, arc: Arc) -> float:
        """Factor on the cost of an arc that failures with others of its kind have left."""
        return self.lessons.get((arc.kind, arc.on), 1.0)

    def cost_of(self, arc: Arc) -> float:
        """The same of any arc."""
        force = arc_force(self.hand, self.supports, arc, self.points, self.margins, self.gravity)
        return arc.length(self.hand.radius) * (1.0 + self.settings.force * force)

    def heuristic(self, node: int) -> float:
        """Length of the straight way to the goal: never more than the cost, as the length is a metric."""
        return distance(self.graph.poses[node], self.goal_pose, self.hand.radius)

    def route(self, start: int, stop: Callable[[], bool], report: Report) -> list[Leg] | Failure:
        """Legs from a node to the goal, as few as are no dearer, or why there are none.

        Where there is no way at the first resolution, the next finer one is searched from the pose of the node. Once `stop`
        says so, the search is given up.
        """
        s = self.settings

        def watch(progress: astar.Progress[int]) -> bool:
            if progress.expanded % REPORTED == 0:
                report(Progress("route", progress.expanded, s.nodes, math.nan, math.nan))
            return stop() or len(self.graph.poses) > s.poses

        while True:
            outcome = astar.find(self, start, GOAL, self.penalties, s.weight, s.nodes, watch)
            if isinstance(outcome, astar.Path):
                return self._straightened(list(outcome.nodes))
            ended = outcome.reason == astar.Reason.EXHAUSTED
            if not ended or self.level + 1 == s.levels:
                return self._no_way(ended)
            self.level += 1
            self._reset(self.graph.poses[start])
            start = START

    def _no_way(self, ended: bool) -> Failure:
        """Why there is no route: a passage too narrow, forces too weak, or a search that was not done."""
        where = "global planner"
        step = self.graph.resolution.step
        bodies = sorted(self.graph.blocked.values(), key=lambda b: b.far)
        if not ended:
            by = f", stopped by {self.name(bodies[0].body)} nearest to it" if bodies else ""
            return Failure(
                "route", where, "object",
                f"the search ended after {len(self.graph.poses)} poses without a way to the goal{by}",
                "more planner.route.nodes or .poses, a larger planner.route.weight, or more time",
            )  # fmt: skip
        weak = min(self.weak, key=lambda w: w[0], default=None)
        if weak is not None and (not bodies or weak[0] <= bodies[0].far + step):
            carried = ", ".join(self.name(b) for b in weak[1].on)
            how = f"{weak[1].kind} on {carried}" if carried else f"{weak[1].kind} through the air"
            at = np.round(weak[1].start[1], 3).tolist()
            return Failure(
                "equilibrium", where, "object",
                f"no forces of the agents within their limits move it on towards the goal: not by a {how} from {at}",
                "a larger max_force, more friction, another agent or support",
            )  # fmt: skip
        if bodies:
            near = {body.body for body in bodies[:2] if body.far <= bodies[0].far + 2.0 * step}
            named = sorted(self.name(b) for b in near | set(self.graph.touched(bodies[0].pose)))
            at = np.round(bodies[0].pose[1], 3).tolist()
            return Failure(
                "route", where, "object", f"no way to the goal at a resolution of {1e3 * step:.0f} mm: the passage "
                f"{'between' if len(named) > 1 else 'beside'} {' and '.join(named)} near {at} is too narrow",
                "more room there, a smaller planner.route.step or .clearance, or a goal that can be reached",
            )  # fmt: skip
        return Failure(
            "route", where, "object", "no way to the goal within the freedoms and the agents' reach",
            "more freedoms, agents nearer to the way, or a goal that can be reached",
        )  # fmt: skip

    def _straightened(self, path: list[int]) -> list[Leg]:
        """The path's legs; subgoals are left out between which the object may as well go straight."""
        out: list[Leg] = []
        here = 0
        while here < len(path) - 1:
            step, best = here + 1, self.graph.arcs[path[here], path[here + 1]]
            for far in range(len(path) - 1, here + 1, -1):
                arc = self.shortcut(path[here], path[far])
                if arc is None:
                    continue
                along = sum(self.raised(a, b) for a, b in zip(path[here:far], path[here + 1 : far + 1], strict=True))
                direct = self.penalties.apply(path[here], path[far], self.cost_of(arc) * self.learnt(arc))
                if direct <= along * (1.0 + 1e-9):
                    step, best = far, arc
                    break
            out.append(Leg(best, tuple(path[here : step + 1])))
            here = step
        return out

    def shortcut(self, a: int, b: int) -> Arc | None:
        """The straight arc between two nodes (`way`), if the freedoms allow it."""
        arc = self.way(self.graph.poses[a], self.graph.poses[b])
        return arc if arc is not None and self.graph.free.allow(arc) else None

    def way(self, start: Pose, goal: Pose) -> Arc | None:
        """The straight arc between two poses, if the object can go it and stays on what it touches at both."""
        held = self.graph.touched(start)
        arc, body = self.graph.went(straight(start, goal), held)
        if body >= 0 or set(arc.on) != set(held) & set(self.graph.touched(goal)):
            return None
        return replace(arc, kind="slide" if arc.on else "straight")

    def raised(self, a: int, b: int) -> float:
        """Cost of an arc with what failures have added to it."""
        return self.penalties.apply(a, b, self.cost(a, b))

    def failed(self, leg: Leg) -> None:
        """The local planner failed on a leg: raise the cost of all it is made of, so that other routes are tried first."""
        pairs = set(zip(leg.nodes[:-1], leg.nodes[1:], strict=True)) | {(leg.nodes[0], leg.nodes[-1])}
        for a, b in sorted(pairs):
            self.penalties.penalise(a, b, self.settings.penalty)
        if self.supports:  # without them all ways are of one kind
            self.lessons[leg.arc.kind, leg.arc.on] = self.learnt(leg.arc) * self.settings.lesson
