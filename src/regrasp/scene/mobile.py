"""An arm on a mobile platform: it drives in any direction and turns; shoulder, roll and bend carry the tool.

Six joints: two slides and a hinge about the platform's axis, then the shoulder, which raises the arm, the roll about the
forearm, and the bend that raises the tool. So the tip moves in any way unless the arm is upright, the roll a quarter turn
off level, or the tool in line with the forearm's axis upright. Sizes and masses are those of a small holonomic platform
(0.5 m wide, 60 kg) with a light arm; parts have the density of water, MuJoCo's default.
"""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.forms import MobileTeam
from regrasp.scene.parts import LINK_COLOUR, capsule, hinge, slide, tip

Array = NDArray[np.float64]

# Sizes, m.
PLATFORM_RADIUS, PLATFORM_LOW, PLATFORM_TOP = 0.25, 0.05, 0.35
TURRET_RADIUS = 0.06
ARM, FOREARM = 0.3, 0.2
ARM_RADIUS, TOOL_RADIUS = 0.04, 0.025

UP = np.array([0.0, -1.0, 0.0])  # turns +x towards +z
ALONG = np.array([1.0, 0.0, 0.0])
# Shoulder, roll, bend: rad, N m, motor inertia kg m², friction N m s/rad.
LOWER = np.radians([-30.0, -150.0, -120.0])
UPPER = np.radians([75.0, 150.0, 120.0])
TORQUE = np.array([150.0, 40.0, 40.0])
ARMATURE = np.array([0.5, 0.1, 0.1])
DAMPING = np.array([5.0, 1.0, 1.0])
HOME = np.radians([10.0, 0.0, 50.0])
SPEED = np.array([0.8, 0.8, 1.0, 1.5, 2.5, 2.5])  # m/s, rad/s
FORCE, TURN = 400.0, 150.0  # N, N m of the platform's drives
FRICTION = 50.0  # N s/m, N m s/rad of the platform


def attach(
    base: mujoco.MjsBody, name: str, low: Array, high: Array, shoulder: float,
    tool_length: float, tip_radius: float,
) -> None:  # fmt: skip
    """Adds the robot to the static body `base` on the floor, whose axes it drives along from `low` to `high`, m.

    Joints `name`/x, y, yaw, shoulder, roll, bend; bodies `name`/platform, arm, forearm, tool; geom `name`/tip.
    shoulder: m above the floor.
    """
    body = base.add_body(name=f"{name}/platform")
    for i, letter in enumerate("xy"):
        _limited(slide(body, f"{name}/{letter}", np.eye(3)[i], low[i], high[i], 0.0, FRICTION), FORCE)
    _limited(hinge(body, f"{name}/yaw", np.eye(3)[2], -math.inf, math.inf, 0.0, FRICTION), TURN)
    middle, half = (PLATFORM_LOW + PLATFORM_TOP) / 2, (PLATFORM_TOP - PLATFORM_LOW) / 2
    body.add_geom(
        name=f"{name}/platform", type=mujoco.mjtGeom.mjGEOM_CYLINDER, pos=[0, 0, middle],
        size=[PLATFORM_RADIUS, half, 0], rgba=LINK_COLOUR,
    )  # fmt: skip
    capsule(body, f"{name}/turret", np.array([0, 0, PLATFORM_TOP]), np.array([0, 0, shoulder]), TURRET_RADIUS)
    before = np.array([0.0, 0.0, shoulder])
    for i, (part, axis, length, radius) in enumerate((
        ("shoulder", UP, ARM, ARM_RADIUS), ("roll", ALONG, FOREARM, ARM_RADIUS), ("bend", UP, tool_length, TOOL_RADIUS),
    )):  # fmt: skip
        link = ("arm", "forearm", "tool")[i]
        body = body.add_body(name=f"{name}/{link}", pos=before)
        _limited(hinge(body, f"{name}/{part}", axis, LOWER[i], UPPER[i], ARMATURE[i], DAMPING[i]), TORQUE[i])
        before = np.array([length, 0.0, 0.0])
        capsule(body, f"{name}/{link}", np.zeros(3), before, radius)
    tip(body, f"{name}/tip", before, tip_radius)


def _limited(joint: mujoco.MjsJoint, most: float) -> None:
    joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
    joint.actfrcrange = [-most, most]


def place(spec: mujoco.MjSpec, team: MobileTeam) -> None:
    """Adds the robots to the world `spec`."""
    middle, half = np.array(team.room.position), np.array(team.room.size)
    for name in team.finger_names:
        base = spec.worldbody.add_body(name=f"{name}/base")
        attach(base, name, middle - half, middle + half, team.shoulder, team.tool_length, team.tip_radius)


def home(team: MobileTeam, name: str) -> Array:
    """Joint values (6,) of the robot `name` at rest."""
    stand = team.bases[team.finger_names.index(name)]
    return np.array([*stand.position, stand.angle, *(HOME if stand.home is None else stand.home)])
