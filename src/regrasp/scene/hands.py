"""The hands and teams, added to a world: built-in ones, or a user's own file."""

import math
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.errors import InputError
from regrasp.scene import flying, mjcf, mobile, planar, puma, ur5e
from regrasp.scene.parts import LINK_COLOUR
from regrasp.scene.pose import about, multiply
from regrasp.scene.schema import ModelFile, PlanarHand, PumaHand, Scene
from regrasp.scene.teams import FlyingTeam, MobileTeam, URTeam

Array = NDArray[np.float64]

# Names of a user's model are kept apart from those of the scene by this prefix.
PREFIX = "robot/"

# A Puma finger at rest: upper arm raised, forearm down, the tool level; joint 1 turns it towards the hand's axis.
PUMA_HOME = np.radians([0.0, 40.0, -190.0, 0.0, 60.0, 0.0])
PLANAR_HOME = np.radians([60.0, -120.0, 30.0])

# A user's model says nothing of speed.
SPEED = 2.0  # rad/s or m/s

BuiltIn = PumaHand | PlanarHand | FlyingTeam | MobileTeam | URTeam


@dataclass(frozen=True)
class Finger:
    """What a hand says of one agent: the name of its tip geom in the world, its rest posture and its joint speeds."""

    tip: str
    home: Array | None
    speed: Array


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
    match scene.model:
        case ModelFile():
            tip = next(agent.tip for agent in scene.agents if agent.name == name)
            return Finger(f"{PREFIX}{tip}", None, np.array(SPEED))
        case hand:
            return Finger(f"{name}/tip", _home(hand, name), _speed(hand))


def _speed(hand: BuiltIn) -> Array:
    """Joint speeds of a built-in hand's fingers, rad/s or m/s."""
    match hand:
        case PumaHand():
            return puma.SPEED
        case PlanarHand():
            return planar.SPEED
        case FlyingTeam():
            return flying.SPEED
        case MobileTeam():
            return mobile.SPEED
        case URTeam():
            return ur5e.SPEED


def _home(hand: BuiltIn, name: str) -> Array:
    """The rest posture of a built-in hand's finger."""
    at = hand.finger_names.index(name)
    match hand:
        case PumaHand():
            return _puma_home(hand)
        case PlanarHand():
            base = hand.bases[at]
            return PLANAR_HOME if base.home is None else np.array(base.home)
        case FlyingTeam():
            return np.zeros(6)
        case MobileTeam():
            stand = hand.bases[at]
            return np.array([*stand.position, stand.angle, *(mobile.HOME if stand.home is None else stand.home)])
        case URTeam():
            return ur5e.HOME if hand.home is None else np.array(hand.home)


def _puma_home(hand: PumaHand) -> Array:
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
    if isinstance(scene.model, ModelFile):
        _attach_file(spec, scene.model, scene)
        return
    match scene.model:
        case PumaHand() as hand:
            _attach_pumas(spec, hand)
        case PlanarHand() as hand:
            _attach_planar(spec, hand)
        case FlyingTeam() as team:
            _attach_flying(spec, team)
        case MobileTeam() as team:
            _attach_mobile(spec, team)
        case URTeam() as team:
            _attach_arms(spec, team)
    _freeze(spec, scene.model, scene)


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


def _attach_flying(spec: mujoco.MjSpec, team: FlyingTeam) -> None:
    for name, at, box in zip(team.finger_names, team.bases, team.boxes, strict=True):
        middle, half = np.array(box.position), np.array(box.size)
        base = spec.worldbody.add_body(name=f"{name}/base", pos=at)
        flying.attach(base, name, middle - half - at, middle + half - at, team.tip_radius)


def _attach_mobile(spec: mujoco.MjSpec, team: MobileTeam) -> None:
    middle, half = np.array(team.room.position), np.array(team.room.size)
    for name in team.finger_names:
        base = spec.worldbody.add_body(name=f"{name}/base")
        mobile.attach(base, name, middle - half, middle + half, team.shoulder, team.tool_length, team.tip_radius)


def _attach_arms(spec: mujoco.MjSpec, team: URTeam) -> None:
    for name, pose in zip(team.finger_names, team.bases, strict=True):
        base = spec.worldbody.add_body(name=f"{name}/base", pos=pose.p, quat=pose.wxyz)
        ur5e.attach(base, name, team.tool_length, team.tip_radius)
        spec.add_exclude(bodyname1=f"{name}/base", bodyname2=f"{name}/link1")  # the shoulder stands on the column


def _freeze(spec: mujoco.MjSpec, hand: BuiltIn, scene: Scene) -> None:
    """Fixes the fingers that take no part in their rest posture: they are obstacles."""
    for name in hand.finger_names:
        if name in scene.agent_names:
            continue
        body = spec.geom(f"{name}/tip").parent
        chain = []
        while body.id != 0:
            chain.append(body)
            body = body.parent
        values = iter(_home(hand, name))
        for body in reversed(chain):
            for joint in list(body.joints):  # all at the body's origin
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


def _attach_file(spec: mujoco.MjSpec, model: ModelFile, scene: Scene) -> None:
    if not Path(model.file).is_file():
        raise InputError("model.file", f"no file {model.file}", "a path counts from the scene file's directory")
    try:
        robot = mujoco.MjSpec.from_file(model.file)
        robot.compile()
    except ValueError as error:
        raise InputError("model.file", f"MuJoCo cannot read it: {' '.join(str(error).split())}") from None
    if robot.equalities:
        raise InputError(
            "model.file", "the model has equality constraints", "agents are open chains of hinges and slides"
        )
    moving = _chain_joints(robot, scene)
    names = {joint.name for joint in moving}
    for actuator in list(robot.actuators):  # the agents' own drives stay: `replay` moves them by these
        if actuator.trntype != mujoco.mjtTrn.mjTRN_JOINT or actuator.target not in names:
            robot.delete(actuator)
    for kind in (robot.keys, robot.sensors, robot.tendons):
        for element in list(kind):
            robot.delete(element)
    for joint in list(robot.joints):  # a joint of no agent stays where it is
        if joint not in moving:
            robot.delete(joint)
    robot.assets = mjcf.embed(robot)
    for name in dir(spec.option):  # the scene's options hold, whatever the model was written with
        if not name.startswith("_"):
            setattr(robot.option, name, getattr(spec.option, name))
    base = spec.worldbody.add_body(name="robot", pos=model.pose.p, quat=model.pose.wxyz)
    spec.attach(robot, frame=base.add_frame(), prefix=PREFIX)


def _chain_joints(robot: mujoco.MjSpec, scene: Scene) -> list[mujoco.MjsJoint]:
    """The joints between the world and the agents' tips; no two agents may share one."""
    owner: dict[int, str] = {}
    joints: list[mujoco.MjsJoint] = []
    for i, agent in enumerate(scene.agents):
        field, before = f"agents.{i}.tip", len(joints)
        body = _tip(robot, field, agent.tip or "").parent
        while body.id != 0:
            for joint in body.joints:
                if joint.type == mujoco.mjtJoint.mjJNT_FREE:
                    continue  # a floating base is held where the file puts it
                if joint.type == mujoco.mjtJoint.mjJNT_BALL:
                    raise InputError(field, f"joint {joint.name!r} before it is a ball", "hinges and slides only")
                if (other := owner.setdefault(joint.id, agent.name)) != agent.name:
                    raise InputError(
                        field, f"shares joint {joint.name!r} with {other}", "each agent has its own joints"
                    )
                joints.append(joint)
            body = body.parent
        if len(joints) == before:
            raise InputError(field, f"no joint moves {agent.tip!r}", "the tip is at the end of a chain of joints")
    return joints


def _tip(robot: mujoco.MjSpec, field: str, name: str) -> mujoco.MjsGeom:
    """The tip geom called `name`; a body may stand for its only colliding geom, which then takes the body's name."""
    geom, body = robot.geom(name), robot.body(name)
    if geom is not None:
        return geom
    if body is None:
        names = [geom.name for geom in robot.geoms if geom.name] or [
            body.name for body in robot.bodies[1:] if body.name
        ]
        raise InputError(field, f"no geom or body {name!r} in the model", f"legal: {', '.join(names)}")
    solid = [geom for geom in body.geoms if geom.contype or geom.conaffinity]
    if len(solid) != 1 or solid[0].name:
        names = [geom.name for geom in solid if geom.name]
        raise InputError(field, f"body {name!r} has {len(solid)} colliding geoms", f"name the geom {', '.join(names)}")
    solid[0].name = name
    return solid[0]
