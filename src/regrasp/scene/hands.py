"""The hands, added to a world: Puma fingers around a palm, planar fingers, the Allegro's kind, or a robot of one's own."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene import allegro, planar, puma, robots, tips
from regrasp.scene.parts import LINK_COLOUR
from regrasp.scene.pose import about, multiply
from regrasp.scene.schema import AllegroHand, OwnModel, PlanarHand, PumaHand, Scene, Tip

Array = NDArray[np.float64]

# A Puma finger at rest: upper arm raised, forearm down, the tool level; joint 1 turns it towards the hand's axis.
PUMA_HOME = np.radians([0.0, 40.0, -190.0, 0.0, 60.0, 0.0])
PLANAR_HOME = np.radians([60.0, -120.0, 30.0])
# Bent enough to touch something above the palm, the thumb across from the fingers.
ALLEGRO_HOME = {
    "index": (0.0, 0.5, 0.8, 0.8),
    "middle": (0.0, 0.5, 0.8, 0.8),
    "ring": (0.0, 0.5, 0.8, 0.8),
    "thumb": (1.2, 0.5, 0.5, 0.6),
}


@dataclass(frozen=True)
class Finger:
    """What a hand says of one agent: the name of its tip geom in the world, its rest posture and its joint speeds.

    Of a robot of one's own, whose file says the rest, both may be None. pieces: all geoms that the tip is made of.
    """

    tip: str
    home: Array | None
    speed: Array | None
    pieces: tuple[str, ...] = ()


def fingers(scene: Scene) -> tuple[Finger, ...]:
    """The agents of the scene in order, as the hand describes them, overridden by what `agents` says."""
    specs = {agent.name: agent for agent in scene.agents}
    found = []
    for name in scene.agent_names:
        spec = specs.get(name)
        finger = _finger(scene, name)
        home = finger.home if spec is None or spec.home is None else np.array(spec.home)
        speed = finger.speed if spec is None or spec.speed is None else np.array(spec.speed)
        found.append(Finger(finger.tip, home, speed, tips.names(finger.tip, spec.tip if spec else None)))
    return tuple(found)


def _finger(scene: Scene, name: str) -> Finger:
    match scene.model:
        case PumaHand() as hand:
            return Finger(f"{name}/tip", _home(hand, name), puma.SPEED)
        case PlanarHand() as hand:
            return Finger(f"{name}/tip", _home(hand, name), planar.SPEED)
        case AllegroHand() as hand:
            return Finger(f"{name}/tip", _home(hand, name), allegro.SPEED)
        case _:
            tip = next(agent.tip_name for agent in scene.agents if agent.name == name)
            return Finger(f"{robots.PREFIX}{tip}", None, None)


def _home(hand: PumaHand | PlanarHand | AllegroHand, name: str) -> Array:
    """The rest posture of a built-in hand's finger."""
    if isinstance(hand, AllegroHand):
        given = {str(finger): angles for finger, angles in hand.home.items()}
        return np.array(given.get(name, ALLEGRO_HOME[name]))
    if isinstance(hand, PlanarHand):
        base = hand.bases[hand.finger_names.index(name)]
        return PLANAR_HOME if base.home is None else np.array(base.home)
    if hand.home is not None:
        return np.array(hand.home)
    home = PUMA_HOME.copy()
    if hand.bases is not None:
        return home
    # The arm works beside its own axis by d3; turned by this angle its plane holds the hand's axis.
    home[0] = math.asin(min(1.0, puma.D[2] * hand.scale / hand.ring))
    return home


def attach(spec: mujoco.MjSpec, scene: Scene) -> None:
    """Adds the scene's hand or model to the world `spec`, the files it needs to `spec.assets`.

    Raises InputError when a user's model cannot be used.
    """
    match scene.model:
        case PumaHand() as hand:
            _attach_pumas(spec, hand)
            _freeze(spec, hand, scene)
        case PlanarHand() as hand:
            _attach_planar(spec, hand)
            _freeze(spec, hand, scene)
        case AllegroHand() as hand:
            _attach_allegro(spec, hand)
            _freeze(spec, hand, scene)
        case OwnModel() as model:
            robots.attach(spec, model, scene)
            return
    for agent in scene.agents:
        if isinstance(agent.tip, Tip):
            tips.reshape(spec, f"{agent.name}/tip", agent.tip)


def _attach_pumas(spec: mujoco.MjSpec, hand: PumaHand) -> None:
    arm = puma.Puma.sized(hand.scale, hand.tool_length, hand.tip_radius)
    palm = spec.worldbody.add_body(name="palm", pos=hand.pose.p, quat=hand.pose.wxyz)
    if hand.palm:
        radius, half = hand.ring + 2 * puma.LINK_RADIUS * hand.scale, puma.LINK_RADIUS * hand.scale / 2
        palm.add_geom(
            name="palm",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            pos=[0, 0, -half],
            size=[radius, half, 0],
            rgba=LINK_COLOUR,
        )
    bases = _on_ring(hand) if hand.bases is None else [(base.p, base.wxyz) for base in hand.bases]
    for name, (position, turn) in zip(hand.finger_names, bases, strict=True):
        base = palm.add_body(name=f"{name}/base", pos=position, quat=turn)
        arm.attach(base, name)
        # These overlap by construction: the shoulder stands on the column; forearm and tool meet at the wrist.
        spec.add_exclude(bodyname1=f"{name}/base", bodyname2=f"{name}/link1")
        spec.add_exclude(bodyname1=f"{name}/link3", bodyname2=f"{name}/link6")


def _on_ring(hand: PumaHand) -> list[tuple[Array, Array]]:
    """Positions and attitudes, quaternions, of the bases in the palm's frame: evenly on the ring, facing its axis."""
    angles = [2 * math.pi * i / hand.fingers for i in range(hand.fingers)]
    return [
        (hand.ring * np.array([math.cos(angle), math.sin(angle), 0.0]), about(2, angle + math.pi)) for angle in angles
    ]


def _attach_planar(spec: mujoco.MjSpec, hand: PlanarHand) -> None:
    for name, at in zip(hand.finger_names, hand.bases, strict=True):
        x, z = at.position
        base = spec.worldbody.add_body(name=f"{name}/base", pos=[x, 0, z], quat=about(1, -at.angle))
        planar.attach(base, name, hand.links, hand.link_radius, hand.tip_radius)


def _attach_allegro(spec: mujoco.MjSpec, hand: AllegroHand) -> None:
    pose = hand.pose
    palm = spec.worldbody.add_body(
        name="palm", pos=pose.p + pose.R @ allegro.ORIGIN, quat=multiply(pose.wxyz, allegro.ATTITUDE)
    )
    allegro.attach(palm, hand.side == "left", hand.tip_radius)
    # These overlap by construction: the first joints are in the palm, and the thumb's second link is as short as thick.
    for name in hand.finger_names:
        spec.add_exclude(bodyname1="palm", bodyname2=f"{name}/link1")
    spec.add_exclude(bodyname1="palm", bodyname2="thumb/link2")
    spec.add_exclude(bodyname1="thumb/link1", bodyname2="thumb/link3")


def _freeze(spec: mujoco.MjSpec, hand: PumaHand | PlanarHand | AllegroHand, scene: Scene) -> None:
    """Fixes the fingers that take no part in their rest posture: they are obstacles."""
    for name in hand.finger_names:
        if name in scene.agent_names:
            continue
        for i, angle in enumerate(_home(hand, name)):
            body = spec.body(f"{name}/link{i + 1}")
            (joint,) = body.joints  # a hinge at the body's origin
            turn = np.empty(4)
            mujoco.mju_axisAngle2Quat(turn, joint.axis, angle)
            body.quat = multiply(body.quat, turn)
            spec.delete(joint)
