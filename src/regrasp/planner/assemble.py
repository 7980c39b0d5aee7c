"""From motions to a plan: arcs joined, times laid on, everything a reader needs put beside it."""

import dataclasses
import importlib.metadata
import platform
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from regrasp import __version__
from regrasp.plan import Plan
from regrasp.planner.motion import Motion
from regrasp.planner.path import Pose
from regrasp.planner.supports import Support
from regrasp.scene.world import World

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Timing:
    """Durations of intervals; quasi-static motion may be stretched at will (DESIGN: time).

    speed: part of each joint's speed limit that is used. shortest: of any interval, s. object_speed: m/s.
    """

    speed: float = 0.5
    shortest: float = 0.05
    object_speed: float = 0.1


@dataclass(frozen=True)
class Segment:
    """One arc as it was planned: its motion and the history of its energy."""

    motion: Motion
    energy: Array


def quaternions(R: Array) -> Array:
    """Unit quaternions w x y z of rotations (…, 3, 3), each in the half space of the one before it."""
    q = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(scalar_first=True)
    flips = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0))
    q[1:] *= flips[:, None]
    return np.asarray(q.reshape(*R.shape[:-2], 4))


def durations(joints: Array, p_WO: Array, speeds: Array, timing: Timing) -> Array:
    """Duration of each interval (n,), s, from the joints' speed limits along their splines and the object's speed."""
    samples = joints.shape[1]
    s = np.linspace(0.0, 1.0, samples)
    fine = np.linspace(0.0, 1.0, 5 * (samples - 1) + 1)
    out = np.empty(len(joints))
    for j, q in enumerate(joints):
        rate = np.max(np.abs(CubicSpline(s, q)(fine, 1)) / (timing.speed * speeds))
        way = np.sum(np.linalg.norm(np.diff(p_WO[j], axis=0), axis=1)) / timing.object_speed
        out[j] = max(rate, way, timing.shortest)
    return out


def pose_row(pose: Pose) -> Array:
    """Position and quaternion of a pose, (7,)."""
    return np.concatenate([pose[1], Rotation.from_matrix(pose[0]).as_quat(scalar_first=True)])


def support_slots(motion: Motion, supports: tuple[Support, ...], P: int, first: Array) -> dict[str, Any]:
    """A motion's support arrays spread over the plan's P slots; slots of support a begin at first[a]."""
    n, samples = motion.path.R_WO.shape[:2]
    out: dict[str, Any] = {
        "support_mode": np.zeros((n, P), np.int8),
        "support_p_O": np.zeros((n, samples, P, 3)),
        "support_n_W": np.zeros((n, samples, P, 3)),
        "support_force_W": np.zeros((n, samples, P, 3)),
    }
    for a, support in enumerate(supports):
        out["support_n_W"][:, :, int(first[a]) : int(first[a + 1])] = support.n_W
    used = np.zeros(len(supports), int)
    for column, a in enumerate(motion.path.support_of):
        slot = int(first[a]) + used[a]
        used[a] += 1
        out["support_mode"][:, slot] = motion.path.support_mode[:, column]
        out["support_p_O"][:, :, slot] = motion.path.support_p_O[:, :, column]
        out["support_force_W"][:, :, slot] = motion.support_force_W[:, :, column]
    return out


def assemble(
    world: World, segments: list[Segment], subgoals: list[Pose], supports: tuple[Support, ...], timing: Timing,
    seed: int, settings: Any, remarks: tuple[str, ...],
) -> Plan:  # fmt: skip
    """The plan of consecutive segments along the subgoals (one more than segments)."""
    motions = [segment.motion for segment in segments]
    speeds = np.concatenate([agent.speed for agent in world.agents])
    per_support = [
        max((int(np.sum(motion.path.support_of == a)) for motion in motions), default=0) for a in range(len(supports))
    ]
    first = np.cumsum([0, *per_support])
    slots = [support_slots(motion, supports, int(first[-1]), first) for motion in motions]
    R = np.concatenate([motion.path.R_WO for motion in motions])
    p = np.concatenate([motion.path.p_WO for motion in motions])
    joints = np.concatenate([motion.joints for motion in motions])
    ends = np.cumsum(durations(joints, p, speeds, timing))
    begins = np.concatenate([[0.0], ends[:-1]])
    u = np.linspace(0.0, 1.0, R.shape[1])
    time = begins[:, None] * (1.0 - u) + ends[:, None] * u
    model = world.model
    return Plan(
        time=time,
        object_position=p,
        object_quaternion=quaternions(R),
        joints=joints,
        V=np.concatenate([motion.V for motion in motions]),
        twist=np.concatenate([motion.twist for motion in motions]),
        p_OC_O=np.concatenate([motion.p_OC_O for motion in motions]),
        n_O=np.concatenate([motion.n_O for motion in motions]),
        x_O=np.concatenate([motion.x_O for motion in motions]),
        force_W=np.concatenate([motion.force_W for motion in motions]),
        **{name: np.concatenate([slot[name] for slot in slots]) for name in slots[0]},
        segment=np.concatenate([np.full(len(motion.V), a, np.int64) for a, motion in enumerate(motions)]),
        route=np.array([pose_row(pose) for pose in subgoals]),
        energy=np.concatenate([segment.energy for segment in segments]),
        energy_segment=np.concatenate([np.full(len(s.energy), a, np.int64) for a, s in enumerate(segments)]),
        support_names=tuple(support.name for a, support in enumerate(supports) for _ in range(per_support[a])),
        agent_names=tuple(agent.name for agent in world.agents),
        joint_names=tuple(model.joint(int(j)).name for agent in world.agents for j in agent.joints),
        scene=world.scene.model_dump(mode="json"),
        xml=world.xml,
        assets=world.assets,
        seed=seed,
        settings=dataclasses.asdict(settings),
        versions=versions(),
        feasible=all(not motion.violations for motion in motions),
        remarks=remarks,
    )


def versions() -> dict[str, str]:
    """Versions of what made a plan."""
    names = ("mujoco", "numba", "numpy", "scipy")
    return {
        "regrasp": __version__,
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in names},
    }
