"""A robot of one's own, added to a world: the agents' chains stay movable, all else of it stands still."""

import collections

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.errors import InputError
from regrasp.scene import collisions, couplings, ends, models, tips
from regrasp.scene.forms import OwnModel
from regrasp.scene.pose import multiply
from regrasp.scene.schema import Scene, Tip

Array = NDArray[np.float64]

PREFIX = "robot/"
"""Names of a robot of one's own are kept apart from those of the scene by this."""
SPEED = 2.0
"""Of a joint whose file says nothing of speed, rad/s or m/s."""
REPAIR, LIMIT, POSTURE = "repair ", "speed of ", "rest of "
"""Names of custom texts and numbers of the world's model: each repair, each joint's speed limit, where it rests."""


def attach(spec: mujoco.MjSpec, model: OwnModel, scene: Scene) -> None:
    """Adds the robot of a scene to the world `spec`, the files it needs to `spec.assets`.

    What was repaired and how fast its joints may move is kept with it, so that it outlives its files. Raises InputError
    where the robot cannot be read or does not have what the scene's agents ask for.
    """
    found = models.read(model)
    robot, repairs = found.spec, list(found.repairs)
    for i, agent in enumerate(scene.agents):
        if isinstance(agent.tip, Tip):
            repairs += tips.give(robot, f"agents.{i}.tip", agent.tip_name, agent.tip)
        else:
            repairs += ends.prepare(robot, f"agents.{i}.tip", agent.tip_name)
            repairs += tips.smooth(robot, f"agents.{i}.tip", agent.tip_name)
    robot.compile()  # gives what was added its number
    chains = _chains(robot, scene)
    moving = list({joint.id: joint for chain in chains for joint in chain}.values())
    repairs += couplings.settle(robot, chains)
    _require_known(robot, model.posture, moving, chains)
    _strip(robot, moving, model.posture)
    repairs += _part_neighbours(robot, _home(robot, chains, scene))
    for name in dir(spec.option):  # the scene's options hold, whatever the model was written with
        if not name.startswith("_"):
            setattr(robot.option, name, getattr(spec.option, name))
    base = spec.worldbody.add_body(name="robot", pos=model.pose.p, quat=model.pose.wxyz)
    for i, repair in enumerate(repairs):
        spec.add_text(name=f"{REPAIR}{i}", data=repair)
    for joint in moving:
        if joint.name in model.posture:
            spec.add_numeric(name=f"{POSTURE}{PREFIX}{joint.name}", data=[model.posture[joint.name]], size=1)
        if joint.name in found.speeds:
            spec.add_numeric(name=f"{LIMIT}{PREFIX}{joint.name}", data=[found.speeds[joint.name]], size=1)
    spec.attach(robot, frame=base.add_frame(), prefix=PREFIX)


def repairs(model: mujoco.MjModel) -> tuple[str, ...]:
    """What `attach` put right in the robot of a world's model, each in a sentence."""
    said = []
    for i in range(model.ntext):
        if (mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, i) or "").startswith(REPAIR):
            start = model.text_adr[i]
            said.append(bytes(model.text_data[start : start + model.text_size[i] - 1]).decode())
    return tuple(said)


def speeds(model: mujoco.MjModel, joints: NDArray[np.int64]) -> Array:
    """Speed limits of joints (n,), rad/s or m/s, where the robot's file gives them, else SPEED."""
    given = {model.numeric(i).name: float(model.numeric_data[model.numeric_adr[i]]) for i in range(model.nnumeric)}
    return np.array([given.get(f"{LIMIT}{model.joint(int(j)).name}", SPEED) for j in joints])


def postures(model: mujoco.MjModel, joints: NDArray[np.int64]) -> Array:
    """Where joints (n,) rest, rad or m, as the scene says, else at the model's zero."""
    given = {model.numeric(i).name: float(model.numeric_data[model.numeric_adr[i]]) for i in range(model.nnumeric)}
    return np.array([
        given.get(f"{POSTURE}{model.joint(int(j)).name}", model.qpos0[model.jnt_qposadr[j]]) for j in joints
    ])  # fmt: skip


def _chains(robot: mujoco.MjSpec, scene: Scene) -> list[list[mujoco.MjsJoint]]:
    """The joints between the world and each agent's tip, base to tip; those that agents share only if their wrist moves."""
    chains = []
    for i, agent in enumerate(scene.agents):
        field = f"agents.{i}.tip"
        joints: list[mujoco.MjsJoint] = []
        body = robot.geom(agent.tip_name).parent
        while body.id != 0:
            for joint in reversed(list(body.joints)):
                if joint.type == mujoco.mjtJoint.mjJNT_FREE:
                    continue  # a floating base is held where the file puts it
                if joint.type == mujoco.mjtJoint.mjJNT_BALL:
                    raise InputError(field, f"joint {joint.name!r} before it is a ball", "hinges and slides only")
                joints.append(joint)
            body = body.parent
        if not joints:
            raise InputError(field, f"no joint moves {agent.tip_name!r}", "the tip is at the end of a chain of joints")
        chains.append(joints[::-1])
    users = collections.Counter(joint.id for chain in chains for joint in chain)
    own = [[joint for joint in chain if users[joint.id] == 1] for chain in chains]
    for i, agent in enumerate(scene.agents):
        if not own[i]:
            raise InputError(f"agents.{i}.tip", f"no joint moves {agent.tip_name!r} alone", "one agent for each finger")
    assert isinstance(scene.model, OwnModel)
    return own if scene.model.wrist == "fixed" else chains


def _require_known(
    robot: mujoco.MjSpec, posture: dict[str, float], moving: list[mujoco.MjsJoint], chains: list[list[mujoco.MjsJoint]]
) -> None:
    """Raises InputError for a posture of what is no joint, is an agent's own, or is out of its range."""
    users = collections.Counter(joint.name for chain in chains for joint in chain)
    model = robot.compile()
    names = {model.joint(j).name: j for j in range(model.njnt)}
    for name, value in posture.items():
        if name not in names:
            legal = ", ".join(joint for joint in names if users[joint] != 1)
            raise InputError(f"model.posture.{name}", "no such joint", f"legal: {legal or 'none'}")
        if users[name] == 1:
            raise InputError(f"model.posture.{name}", "is an agent's own joint", "the agent's home")
        lower, upper = model.jnt_range[names[name]]
        if model.jnt_limited[names[name]] and not lower <= value <= upper:
            raise InputError(
                f"model.posture.{name}", f"{value:g} is out of its range", f"legal: {lower:.4g} to {upper:.4g}"
            )


def _strip(robot: mujoco.MjSpec, moving: list[mujoco.MjsJoint], posture: dict[str, float]) -> None:
    """Leaves of a robot what a plan and its replay use: the agents' joints with their drives, bodies and geoms.

    A joint of no agent is frozen at its posture, or its value nearest to zero, a floating base where the file has it.
    """
    names = {joint.name for joint in moving}
    for actuator in list(robot.actuators):
        if actuator.trntype != mujoco.mjtTrn.mjTRN_JOINT or actuator.target not in names:
            robot.delete(actuator)
    for kind in (robot.keys, robot.sensors, robot.tendons):
        for element in list(kind):
            robot.delete(element)
    model = robot.compile()
    for joint in list(robot.joints):
        if joint in moving:
            continue
        if joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            _freeze(robot, joint, posture.get(joint.name, _rest(model, joint.id)))
        robot.delete(joint)


def _freeze(robot: mujoco.MjSpec, joint: mujoco.MjsJoint, value: float) -> None:
    """Moves the joint's body, which has no other joint, to where the joint has this value (rad or m)."""
    body = joint.parent
    if value == 0.0 or len(body.joints) > 1:
        return
    if body.alt.type != mujoco.mjtOrientation.mjORIENTATION_QUAT:  # euler angles and the like, which come before quat
        degree, sequence = body.compiler.degree, body.compiler.eulerseq
        body.quat = robot.resolve_orientation(degree=degree, sequence=sequence, orientation=body.alt)
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    turn = np.array([1.0, 0.0, 0.0, 0.0])
    shift = value * np.array(joint.axis)
    if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
        mujoco.mju_axisAngle2Quat(turn, joint.axis, value)
        turned = np.empty(3)
        mujoco.mju_rotVecQuat(turned, joint.pos, turn)
        shift = joint.pos - turned
    moved = np.empty(3)
    mujoco.mju_rotVecQuat(moved, shift, body.quat)
    body.pos, body.quat = body.pos + moved, multiply(body.quat, turn)


def _rest(model: mujoco.MjModel, joint: int) -> float:
    """The value of a joint in its range that is nearest to zero."""
    lower, upper = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.inf, np.inf)
    return float(np.clip(model.qpos0[model.jnt_qposadr[joint]], lower, upper))


def _home(robot: mujoco.MjSpec, chains: list[list[mujoco.MjsJoint]], scene: Scene) -> dict[str, float]:
    """Joint → its value at rest; where the scene's count does not fit, that is told later."""
    assert isinstance(scene.model, OwnModel)
    home: dict[str, float] = dict(scene.model.posture)
    users = collections.Counter(joint.id for chain in chains for joint in chain)
    for agent, whole in zip(scene.agents, chains, strict=True):
        chain = [joint for joint in whole if users[joint.id] == 1]
        if agent.home is not None and len(agent.home) == len(chain):
            home |= {joint.name: value for joint, value in zip(chain, agent.home, strict=True)}
    return home


def _part_neighbours(robot: mujoco.MjSpec, home: dict[str, float]) -> list[str]:
    """Excludes the collision of bodies that overlap at rest and are neighbours or neighbours but one in a chain.

    Who draws a link's hull rarely keeps it clear of the next; a URDF has no word for it. Where others overlap, the
    posture is wrong, and stays so.
    """
    for i, body in enumerate(robot.bodies):
        body.name = body.name or f"body{i}"
    model = robot.compile()
    data = mujoco.MjData(model)
    for j in range(model.njnt):
        data.qpos[model.jnt_qposadr[j]] = home.get(model.joint(j).name, _rest(model, j))
    data.qpos[:] = couplings.coupling(model, np.arange(model.njnt)).expand(data.qpos)
    mujoco.mj_kinematics(model, data)
    said = []
    for a, b, depth in collisions.overlaps(model, data):
        if collisions.apart(model, a, b) > collisions.NEIGHBOURS:
            continue
        first, second = model.body(a).name, model.body(b).name
        robot.add_exclude(bodyname1=first, bodyname2=second)
        said.append(
            f"bodies {first!r} and {second!r}, neighbours, overlap by {1e3 * depth:.1f} mm at rest: never collide"
        )
    return said
