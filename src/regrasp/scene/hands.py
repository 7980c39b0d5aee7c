"""The robot, added to a world: a built-in hand or team, or a robot of one's own."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene import allegro, flying, mobile, planar, puma, robots, tips, ur5e
from regrasp.scene.forms import AllegroHand, BuiltIn, FlyingTeam, MobileTeam, OwnModel, PlanarHand, PumaHand, URTeam
from regrasp.scene.pose import multiply
from regrasp.scene.schema import Scene, Tip

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mechanism:
    """A kind of built-in hand or team.

    place: adds it to a world, where the tip of agent NAME is the geom NAME/tip; home: joint values of an agent at rest; speed:
    rad/s or m/s of an agent's joints.
    """

    place: Callable[[mujoco.MjSpec, Any], None]
    home: Callable[[Any, str], Array]
    speed: Array


MECHANISMS: dict[type[BuiltIn], Mechanism] = {
    PumaHand: Mechanism(puma.place, puma.home, puma.SPEED),
    PlanarHand: Mechanism(planar.place, planar.home, planar.SPEED),
    AllegroHand: Mechanism(allegro.place, allegro.home, allegro.SPEED),
    FlyingTeam: Mechanism(flying.place, flying.home, flying.SPEED),
    MobileTeam: Mechanism(mobile.place, mobile.home, mobile.SPEED),
    URTeam: Mechanism(ur5e.place, ur5e.home, ur5e.SPEED),
}


@dataclass(frozen=True)
class Finger:
    """What a hand says of one agent: the name of its tip geom in the world, its rest posture and its joint speeds.

    Of a robot of one's own, whose file says the rest, both may be None.
    """

    tip: str
    home: Array | None
    speed: Array | None


def fingers(scene: Scene) -> tuple[Finger, ...]:
    """The agents of the scene in order, as the hand describes them, overridden by what `agents` says."""
    specs = {agent.name: agent for agent in scene.agents}
    found = []
    for name in scene.agent_names:
        spec = specs.get(name)
        finger = _finger(scene, name)
        home = finger.home if spec is None or spec.home is None else np.array(spec.home)
        speed = finger.speed if spec is None or spec.speed is None else np.array(spec.speed)
        found.append(Finger(finger.tip, home, speed))
    return tuple(found)


def _finger(scene: Scene, name: str) -> Finger:
    if isinstance(scene.model, OwnModel):
        tip = next(agent.tip_name for agent in scene.agents if agent.name == name)
        return Finger(f"{robots.PREFIX}{tip}", None, None)
    mechanism = MECHANISMS[type(scene.model)]
    return Finger(f"{name}/tip", mechanism.home(scene.model, name), mechanism.speed)


def attach(spec: mujoco.MjSpec, scene: Scene) -> None:
    """Adds the scene's hand or model to the world `spec`, the files it needs to `spec.assets`.

    Raises InputError when a user's model cannot be used.
    """
    if isinstance(scene.model, OwnModel):
        robots.attach(spec, scene.model, scene)
        return
    MECHANISMS[type(scene.model)].place(spec, scene.model)
    _freeze(spec, scene.model, scene)
    for agent in scene.agents:
        if isinstance(agent.tip, Tip):
            tips.reshape(spec, f"{agent.name}/tip", agent.tip)


def _freeze(spec: mujoco.MjSpec, hand: BuiltIn, scene: Scene) -> None:
    """Fixes the agents that take no part in their rest posture: they are obstacles."""
    home = MECHANISMS[type(hand)].home
    for name in hand.finger_names:
        if name in scene.agent_names:
            continue
        body = spec.geom(f"{name}/tip").parent
        chain = []
        while body.id != 0:
            chain.append(body)
            body = body.parent
        values = iter(home(hand, name))
        for body in reversed(chain):
            for joint in list(body.joints):  # all at the body's origin
                if not joint.name.startswith(f"{name}/"):
                    continue  # of the arm that carries the hand
                value = next(values)
                if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
                    way = np.empty(3)
                    mujoco.mju_rotVecQuat(way, value * joint.axis, body.quat)
                    body.pos = body.pos + way
                else:
                    turn = np.empty(4)
                    mujoco.mju_axisAngle2Quat(turn, joint.axis, value)
                    body.quat = multiply(body.quat, turn)
                spec.delete(joint)
