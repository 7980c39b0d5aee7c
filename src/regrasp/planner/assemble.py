"""From motions to a plan: arcs joined, hand-overs, forces and times laid on, all that a reader needs put beside it."""

import dataclasses
import functools
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import clarabel
import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from regrasp import __version__
from regrasp.plan import Plan
from regrasp.planner.contacts import Contacts, contacts_of
from regrasp.planner.course import joined, with_hand_overs
from regrasp.planner.hand import Hand
from regrasp.planner.loads import Loads, forces, most_lacking, place
from regrasp.planner.motion import Motion
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Pose
from regrasp.planner.reserve import Margins
from regrasp.planner.supports import Support
from regrasp.planner.timing import Timing, durations
from regrasp.planner.turns import quaternion
from regrasp.scene.world import World

Array = NDArray[np.float64]

LACKING = 1e-3
"""Weights that an agent may lack of what it has to spare before the plan says so."""


@dataclass(frozen=True)
class Segment:
    """One arc as it was planned: its motion and the history of its energy."""

    motion: Motion
    energy: Array


def quaternions(R: Array) -> Array:
    """Unit quaternions w x y z of rotations (…, 3, 3), each in the half space of the one before it."""
    q = quaternion(R.reshape(-1, 3, 3))
    flips = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0))
    q[1:] *= flips[:, None]
    return np.asarray(q.reshape(*R.shape[:-2], 4))


def pose_row(pose: Pose) -> Array:
    """Position and quaternion of a pose, (7,)."""
    return np.concatenate([pose[1], quaternion(pose[0])])


def assemble(
    world: World, hand: Hand, segments: list[Segment], subgoals: list[Pose], supports: tuple[Support, ...],
    margins: Margins, loads: Loads, timing: Timing, seed: int, settings: Any, complete: bool,
) -> Plan | Failure:  # fmt: skip
    """The plan of consecutive segments along the subgoals (one more than segments), or why no forces carry it.

    margins: what the forces leave unused. complete: whether the goal is reached without a broken constraint; if not, a plan
    comes without forces where there are none.
    """
    motions = [segment.motion for segment in segments]
    joint, support_names = joined(motions, supports)
    course = with_hand_overs(joint)
    mu = {support.name: support.mu for support in supports}
    contacts = contacts_of(course, hand, np.array([mu[name] for name in support_names]), np.array(world.scene.gravity))
    f = forces(contacts, margins, loads)
    lacks: tuple[str, ...] = ()
    if isinstance(f, Failure):
        if complete:
            return f
        f, lacks = np.zeros((*contacts.p_W.shape[:3], 3)), (f"without forces: {f}",)
    k, names = len(world.agents), tuple(agent.name for agent in world.agents)
    owner = np.repeat(np.arange(k), [len(agent.qpos) for agent in world.agents])
    speeds = np.concatenate([limb.speed for limb in world.limbs])
    ends = np.cumsum(durations(course, f[:, :, :k], owner, speeds, hand.radius, timing))
    begins = np.concatenate([[0.0], ends[:-1]])
    u = np.linspace(0.0, 1.0, f.shape[1])
    model = world.model
    return Plan(
        time=begins[:, None] * (1.0 - u) + ends[:, None] * u,
        object_position=course.object_position,
        object_quaternion=quaternions(course.object_rotation),
        joints=course.joints,
        V=course.V,
        twist=course.twist,
        p_OC_O=course.p_OC_O,
        n_O=course.n_O,
        x_O=course.x_O,
        force_W=hand.weight * f[:, :, :k],
        support_mode=course.support_mode,
        support_p_O=course.support_p_O,
        support_n_W=course.support_n_W,
        support_force_W=hand.weight * f[:, :, k:],
        segment=course.segment,
        route=np.array([pose_row(pose) for pose in subgoals]),
        energy=np.concatenate([segment.energy for segment in segments]),
        energy_segment=np.concatenate([np.full(len(s.energy), a, np.int64) for a, s in enumerate(segments)]),
        support_names=support_names,
        agent_names=names,
        joint_names=tuple(model.joint(int(j)).name for limb in world.limbs for j in limb.joints),
        scene=world.scene.model_dump(mode="json"),
        xml=world.xml,
        assets=world.assets,
        seed=seed,
        settings=dataclasses.asdict(settings),
        versions=versions(),
        feasible=complete,
        remarks=lacks or remarks(contacts, f, margins, names),
    )


def remarks(contacts: Contacts, f: Array, margins: Margins, names: tuple[str, ...]) -> tuple[str, ...]:
    """What the plan's user should know: which agent has least to spare, where equilibrium and limits leave it too little."""
    has, asked, (j, i) = most_lacking(contacts, f, margins)
    if asked - has <= LACKING:
        return ()
    said = f"{names[i]} has {max(has, 0.0):.2g} of {asked:.2g} weights to spare in {place(contacts, j)}"
    return (f"{said} (planner.local.energy.grip and .disturbance ask for them)",)


@functools.cache
def versions() -> Mapping[str, str]:
    """Versions of what made a plan."""
    return {
        "regrasp": __version__,
        "python": platform.python_version(),
        **{module.__name__: module.__version__ for module in (clarabel, mujoco, numba, np)},
    }
