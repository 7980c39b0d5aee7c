"""First arcs of the built-in scenes with few intervals, made ready by the planner's own functions, each once.

Lengths of steps are those of the default settings, so that what is compiled and computed here is what a plan computes.
"""

import dataclasses
import functools

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from regrasp.planner.chain import ContactMotions
from regrasp.planner.configurations import Grasp
from regrasp.planner.hand import Hand
from regrasp.planner.local import random_motions, terms_of
from regrasp.planner.method import opening
from regrasp.planner.motion import Motion, detail
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Path
from regrasp.planner.scan import DIRECTIONS, Scan, new_scan
from regrasp.planner.task import Settings, Task, prepare
from regrasp.planner.terms import Shortcuts, Terms
from regrasp.scene.load import load, validate
from regrasp.scene.schema import Scene

Array = NDArray[np.float64]
Codes = NDArray[np.int16]
SMALL = Settings(intervals=6)
NAMES = ("fig3-puma3", "fig4-relocation", "fig2-planar")


@dataclasses.dataclass(frozen=True)
class Arc:
    """The first six intervals or fewer of a scene, and a grasp at their start."""

    task: Task
    path: Path
    grasp: Grasp

    @property
    def hand(self) -> Hand:
        return self.task.hand

    @property
    def terms(self) -> Terms:
        return terms_of(self.hand, self.task.settings.local)

    def scan(self) -> Scan:
        """Candidates of which nothing is known yet."""
        return new_scan(self.hand, self.path, self.task.settings.local.relocation)

    def problem(self, V: Codes, shortcuts: Shortcuts | None = None) -> ContactMotions:
        """Eq. (1) on the arc with V evaluated from scratch, nothing known of the candidates."""
        return ContactMotions(self.hand, self.path, self.scan(), self.terms, self.grasp, V, shortcuts)

    def random(self, rng: np.random.Generator) -> Codes:
        """A random V."""
        candidates = DIRECTIONS * self.task.settings.local.relocation.candidates
        return random_motions(len(self.path.R_WO), len(self.task.names), candidates, rng)

    def motion(self, problem: ContactMotions) -> Motion:
        """The samples of the problem's current V."""
        return detail(self.hand, self.path, self.terms, problem.found, problem.current, problem.work, self.task.names)

    def joints(self, i: int) -> slice:
        """Where agent i's values stand in a row of joints."""
        return slice(int(self.hand.chains.start[i]), int(self.hand.chains.start[i + 1]))


def changed(scene: Scene, **fields: object) -> Scene:
    """The scene with top-level fields replaced, checked again."""
    return validate({**scene.model_dump(mode="json", exclude_defaults=True), **fields})


def made(scene: Scene, settings: Settings = SMALL) -> Arc:
    """The first arc of a scene."""
    task = prepare(scene, settings)
    begun = opening(task, np.random.default_rng(1))
    assert not isinstance(begun, Failure), begun
    return Arc(task, *begun)


@functools.cache
def arc(name: str) -> Arc:
    """The first arc of a built-in scene."""
    return made(load(name))


class Oracle:
    """MuJoCo's kinematics and distances of a task's world."""

    def __init__(self, task: Task) -> None:
        self.world, self.model = task.world, task.world.model
        self.data = mujoco.MjData(self.model)
        self.columns = np.concatenate([agent.qpos for agent in self.world.agents])
        self.tips = [agent.tip_geom for agent in self.world.agents]

    def put(self, R_WO: Array, p_WO: Array, q: Array) -> None:
        """Move object and agents."""
        at = self.world.object_qpos
        self.data.qpos[at : at + 3] = p_WO
        mujoco.mju_mat2Quat(self.data.qpos[at + 3 : at + 7], np.ascontiguousarray(R_WO).ravel())
        self.data.qpos[self.columns] = q
        mujoco.mj_kinematics(self.model, self.data)

    def tip(self, i: int) -> tuple[Array, Array]:
        """X_WT of agent i: (R_WT, p_WT)."""
        return self.data.geom_xmat[self.tips[i]].reshape(3, 3).copy(), self.data.geom_xpos[self.tips[i]].copy()

    def apart(self, a: int, b: int) -> float:
        """Signed distance of two geoms, at most 5 cm."""
        return mujoco.mj_geomDistance(self.model, self.data, int(a), int(b), 0.05, None)

    def clear(self, geoms: set[int] | None = None) -> float:
        """Least distance of all pairs that must not touch, or of those with a geom of the set, own links apart."""
        owner = {int(g): n for n, agent in enumerate(self.world.agents) for g in agent.geoms}
        return min(
            self.apart(a, b)
            for a, b in self.world.collision_pairs
            if owner.get(int(a), -1) != owner.get(int(b), -2) and (geoms is None or int(a) in geoms or int(b) in geoms)
        )

    def folded(self) -> float:
        """Least distance of pairs of one agent's own links that must not touch."""
        owner = {int(g): n for n, agent in enumerate(self.world.agents) for g in agent.geoms}
        pairs = [(a, b) for a, b in self.world.collision_pairs if owner.get(int(a), -1) == owner.get(int(b), -2)]
        return min((self.apart(a, b) for a, b in pairs), default=np.inf)


def height(arc: Arc, p_O: Array) -> float:
    """Distance of a point outside the object from its surface: by closed form, or Lagrange for the ellipsoid."""
    size = arc.hand.size_O
    if arc.task.world.scene.object.shape == "sphere":
        return float(np.linalg.norm(p_O) - size[0])
    assert arc.task.world.scene.object.shape == "ellipsoid"
    a2 = size[:3] ** 2
    # The foot is a² p / (a² + t) with the t > 0 at which it lies on the surface: a falling, convex function of t.
    t = 0.0
    for _ in range(100):
        value = np.sum(a2 * p_O**2 / (a2 + t) ** 2) - 1.0
        t += value / (2.0 * np.sum(a2 * p_O**2 / (a2 + t) ** 3))
    return float(np.linalg.norm(p_O - a2 * p_O / (a2 + t)))


def between(motion: Motion, j: int, extra: int) -> Array:
    """Joints of interval j on the cubic spline through its samples, `extra` points between any two."""
    q = motion.joints[j]
    s = np.arange(len(q))
    return CubicSpline(s, q)(np.linspace(0, len(q) - 1, (len(q) - 1) * (extra + 1) + 1))
