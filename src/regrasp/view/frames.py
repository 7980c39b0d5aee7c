"""Which instants of a plan tell its story, and the state of the world at them."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.plan import OFF, RELOCATE, Plan
from regrasp.scene.world import World

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Instant:
    """Sample `sample` of interval `interval` of a plan."""

    interval: int
    sample: int


def choose(plan: Plan, count: int) -> tuple[Instant, ...]:
    """At most `count` instants: the first, the last, and from every stretch between the one where most happens.

    A relocation tells more than a change of supports, that more than an agent's change of motion.
    """
    N, M = plan.time.shape
    if count == 1:
        return (Instant(N // 2, M // 2),)
    V, supports = plan.V, plan.support_mode
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


def put(world: World, plan: Plan, instant: Instant, data: mujoco.MjData) -> None:
    """Bring `data` into the plan's state at an instant: joints, object, kinematics."""
    j, m = instant.interval, instant.sample
    data.qpos[:] = world.start
    data.qpos[np.concatenate([agent.qpos for agent in world.agents])] = plan.joints[j, m]
    put_object(world, np.concatenate([plan.object_position[j, m], plan.object_quaternion[j, m]]), data)


def put_object(world: World, pose: Array, data: mujoco.MjData) -> None:
    """Move the object to a pose (7,), position and quaternion w x y z."""
    data.qpos[world.object_qpos : world.object_qpos + 7] = pose
    mujoco.mj_kinematics(world.model, data)


def motion_words(code: int, names: tuple[str, ...]) -> str:
    """A contact motion as it is written in a picture: 'roll +x', 'relocate'."""
    name = names[code]
    return f"{name[:-2]} {name[-2].replace('-', '−')}{name[-1]}" if code not in (0, RELOCATE, OFF) else name
