"""Bodies on a table, before a wall and over an edge, with two fingers in reach: small scenes, each made ready once."""

import numpy as np
from arcs import Oracle
from numpy.typing import NDArray

from regrasp.planner.hand import geom_index
from regrasp.planner.path import Pose
from regrasp.planner.poses import PoseGraph
from regrasp.planner.route import GlobalPlanner
from regrasp.planner.task import Settings, Task, prepare
from regrasp.scene.load import validate
from regrasp.scene.pose import Pose as Placed

Array = NDArray[np.float64]
HAND = {"hand": "puma", "fingers": 2, "palm": False, "pose": {"position": [0, 0, -0.1]}}
OBJECTS = {
    "box": {"shape": "box", "size": [0.03, 0.02, 0.025], "rounding": 0.004, "mass": 0.2},
    "cylinder": {"shape": "cylinder", "size": [0.02, 0.03], "rounding": 0.002, "mass": 0.2},
    "capsule": {"shape": "capsule", "size": [0.02, 0.03], "mass": 0.2},
    "sphere": {"shape": "sphere", "size": [0.025], "mass": 0.2},
    "ellipsoid": {"shape": "ellipsoid", "size": [0.03, 0.02, 0.025], "mass": 0.2},
    "card": {"shape": "box", "size": [0.045, 0.03, 0.0025], "rounding": 0.002, "mass": 0.04},
}
"""Two of them stand 25 mm high on the table."""
TILT = 0.4
BODIES = {
    "table": {"shape": "box", "size": [0.15, 0.15, 0.01], "pose": {"position": [0, 0, -0.01]}},
    "edge": {"shape": "box", "size": [0.075, 0.1, 0.01], "pose": {"position": [-0.075, 0, -0.01]}},
    "wall": {"shape": "box", "size": [0.01, 0.1, 0.05], "pose": {"position": [0.07, 0, 0.05]}},
    "post": {"shape": "capsule", "size": [0.008, 0.03], "pose": {"position": [0, 0.06, 0.03]}},
    "ball": {"shape": "sphere", "size": [0.02], "pose": {"position": [-0.08, 0.0, 0.02]}},
    "slope": {"shape": "plane", "pose": {"position": [0, 0, -0.02], "euler": [0.0, TILT, 0]}},
}
"""table: its top at z = 0. edge: a table that ends at x = 0. wall: its face at x = 0.06. slope: it falls with x."""
ROUTE = GlobalPlanner()
ALL = ("x", "y", "z", "rx", "ry", "rz")


MADE: dict[str, Task] = {}


def task(
    shape: str, supports: tuple[str, ...] = (), obstacles: tuple[str, ...] = (), freedoms: tuple[str, ...] = ALL,
    start: tuple[float, ...] = (0.0, 0.0, 0.1), goal: tuple[float, ...] = (0.0, 0.0, 0.1),
    route: GlobalPlanner = ROUTE, **fields: object,
) -> Task:  # fmt: skip
    """A scene, made ready once: start and goal are x, y, z and Euler angles, if any; other fields as in a scene file."""
    scene = {
        "name": "table", "model": HAND, "object": OBJECTS[shape], "supports": list(supports),
        "environment": [{"name": name, "friction": 0.5, **BODIES[name]} for name in (*supports, *obstacles)],
        "freedoms": list(freedoms), "start": {"pose": placed(start)}, "goal": {"pose": placed(goal)}, **fields,
    }  # fmt: skip
    key = f"{scene} {route}"
    if key not in MADE:
        MADE[key] = prepare(validate(scene), Settings(route=route))
    return MADE[key]


def placed(pose: tuple[float, ...]) -> dict[str, list[float]]:
    """A scene's pose."""
    return {"position": list(pose[:3]), "euler": list(pose[3:]) or [0.0, 0.0, 0.0]}


def at(*pose: float) -> Pose:
    """X_WO from x, y, z and Euler angles, if any."""
    where = Placed.model_validate(placed(pose))
    return where.R, where.p


def graph(t: Task) -> PoseGraph:
    """A graph of its own on the task's surroundings, nothing of it explored."""
    g, fresh = t.router.graph, t.router
    return PoseGraph(t.hand, fresh.around, t.supports, g.freedoms, g.start, g.goal, g.resolution, fresh.rests)


class Distances:
    """Of the object from the bodies of `Surroundings`, by MuJoCo, m; at most 5 cm."""

    def __init__(self, t: Task) -> None:
        self.oracle, self.home = Oracle(t), t.hand.home
        ids = {place: geom for geom, places in geom_index(t.world).items() for place in places}
        self.ids = [ids[int(place)] for place in t.router.around.geom]

    def __call__(self, R: Array, p: Array) -> Array:
        self.oracle.put(R, p, self.home)
        return np.array([self.of(body) for body in self.ids])

    def of(self, body: int) -> float:
        """Distance from one geom of the model."""
        return min(self.oracle.apart(body, int(g)) for g in self.oracle.world.object_geoms)


def velocity(poses: object, u: float, x: Array, h: float = 1e-5) -> Array:
    """Velocity, per unit of u, of the object's material point that is at x at part u: central differences."""
    (R_0, p_0), (R_1, p_1), (R, p) = poses(u - h), poses(u + h), poses(u)  # type: ignore[operator]
    x_O = R.T @ (x - p)
    return (R_1 @ x_O + p_1 - R_0 @ x_O - p_0) / (2.0 * h)
