"""Which instants of a plan tell its story, and the state of the world at them."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.plan import OFF, RELOCATE, Plan
from regrasp.scene.world import World
from regrasp.view.ink import AGENT_FORCE, SUPPORT_FORCE

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Instant:
    """Sample `sample` of interval `interval` of a plan."""

    interval: int
    sample: int


@dataclass(frozen=True)
class Arrow:
    """A force on the object: its contact (W, m), itself (W, N), and how it is drawn."""

    head: Array
    force: Array
    colour: str
    width: float = 4.0


@dataclass(frozen=True)
class State:
    """What one frame shows: the model's qpos in an interval of the plan, `part` (0 … 1) of it gone by, forces, ways (n, 3)
    of tips through the interval, and, where the object may be elsewhere, its planned pose (7,)."""

    qpos: Array
    interval: int
    part: float
    arrows: tuple[Arrow, ...]
    ways: tuple[Array, ...] = ()
    planned: Array | None = None


def choose(plan: Plan, count: int, intervals: int | None = None) -> tuple[Instant, ...]:
    """At most `count` instants: the first, the last, and from every stretch between the one where most happens.

    A relocation tells more than a change of supports, that more than an agent's change of motion. intervals: how many
    of the plan's count, by default all.
    """
    N, M = intervals or len(plan.time), plan.time.shape[1]
    if count == 1:
        return (Instant(N // 2, M // 2),)
    V, supports = plan.V[:N], plan.support_mode[:N]
    news = 4.0 * np.sum(V == RELOCATE, axis=1)
    news[1:] += np.sum(V[1:] != V[:-1], axis=1) + 2.0 * np.sum(supports[1:] != supports[:-1], axis=1)
    between = []
    inner = np.arange(1, N - 1) if N > 2 else np.arange(N)
    for stretch in np.array_split(inner, count - 2) if count > 2 else []:
        if stretch.size:
            # Among equals the one in the middle, so that frames spread over the motion.
            closeness = -np.abs(stretch - stretch.mean()) / (10 * N)
            between.append(Instant(int(stretch[np.argmax(news[stretch] + closeness)]), M // 2))
    return (Instant(0, 0), *between, Instant(N - 1, M - 1))


def planned(world: World, plan: Plan, instant: Instant) -> State:
    """The plan's state at an instant."""
    data = mujoco.MjData(world.model)
    put(world, plan, instant, data)
    part = instant.sample / (plan.time.shape[1] - 1)
    return State(data.qpos.copy(), instant.interval, part, _arrows(plan, instant), ways(world, plan, instant.interval))


def ways(world: World, plan: Plan, interval: int) -> tuple[Array, ...]:
    """Ways (M, 3), W, of the tips that relocate in an interval."""
    moving = [a.tip_geom for a, code in zip(world.agents, plan.V[interval], strict=True) if code == RELOCATE]
    if not moving:
        return ()
    data = mujoco.MjData(world.model)
    points = []
    for m in range(plan.time.shape[1]):
        put(world, plan, Instant(interval, m), data)
        points.append(data.geom_xpos[moving].copy())
    return tuple(np.stack(points, axis=1))


def put(world: World, plan: Plan, instant: Instant, data: mujoco.MjData) -> None:
    """Bring `data` into the plan's state at an instant: joints, object, kinematics."""
    j, m = instant.interval, instant.sample
    qpos = world.start.copy()
    qpos[world.joint_qpos] = plan.joints[j, m]
    qpos[world.object_qpos : world.object_qpos + 3] = plan.object_position[j, m]
    qpos[world.object_qpos + 3 : world.object_qpos + 7] = plan.object_quaternion[j, m]
    put_all(world, qpos, data)


def put_all(world: World, qpos: Array, data: mujoco.MjData) -> None:
    """Bring `data` into a state of the whole model."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(world.model, data)


def put_object(world: World, pose: Array, data: mujoco.MjData) -> None:
    """Move the object to a pose (7,), position and quaternion w x y z."""
    data.qpos[world.object_qpos : world.object_qpos + 7] = pose
    mujoco.mj_kinematics(world.model, data)


def motion_words(code: int, names: tuple[str, ...]) -> str:
    """A contact motion as it is written in a picture: 'roll +x', 'relocate'."""
    name = names[code]
    return f"{name[:-2]} {name[-2].replace('-', '−')}{name[-1]}" if code not in (0, RELOCATE, OFF) else name


def _arrows(plan: Plan, instant: Instant) -> tuple[Arrow, ...]:
    """The plan's forces of everything that bears force."""
    at = (instant.interval, instant.sample)
    found = []
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, plan.object_quaternion[at])
    for points, forces, colour in (
        (plan.p_OC_O[at], plan.force_W[at], AGENT_FORCE),
        (plan.support_p_O[at], plan.support_force_W[at], SUPPORT_FORCE),
    ):
        for p_O, f in zip(points, forces, strict=True):
            if np.isfinite(p_O).all() and np.linalg.norm(f) > 0:
                found.append(Arrow(plan.object_position[at] + R.reshape(3, 3) @ p_O, f, colour))
    return tuple(found)
