"""The UR5e from its published tables, as an MJCF chain with capsule links and a tool with a spherical tip.

Universal Robots, "DH Parameters for calculations of kinematics and dynamics" (support article): lengths, masses, centres of
mass. Joint ranges, speeds and torques: UR5e technical details. The inertias, which that article calls negligible, are those
of the capsules; the motors', seen through their gears, are not published and are of the size of the links' own.
"""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.forms import URTeam
from regrasp.scene.parts import capsule, hinge, tip
from regrasp.scene.pose import about

Array = NDArray[np.float64]

# T_i = Rz(θ_i) Tz(d_i) Tx(a_i) Rx(α_i), m, rad.
A = np.array([0.0, -0.425, -0.3922, 0.0, 0.0, 0.0])
D = np.array([0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996])
ALPHA = np.array([math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0])

RANGE = np.array([2.0, 2.0, 1.0, 2.0, 2.0, 2.0]) * math.pi  # to both sides, rad; the elbow meets its own link beyond
SPEED = np.full(6, math.pi)  # rad/s
TORQUE = np.array([150.0, 150.0, 150.0, 28.0, 28.0, 28.0])  # N m
MASS = np.array([3.761, 8.058, 2.846, 1.37, 1.3, 0.365])  # kg
# In the link's own frame i, m.
CENTRE = np.array([
    [0.0, -0.02561, 0.00193],
    [0.2125, 0.0, 0.11336],
    [0.15, 0.0, 0.0265],
    [0.0, -0.0018, 0.01634],
    [0.0, 0.0018, 0.01634],
    [0.0, 0.0, -0.001159],
])  # fmt: skip
ARMATURE = np.array([0.5, 0.5, 0.5, 0.1, 0.1, 0.1])  # kg m²
DAMPING = np.array([5.0, 5.0, 5.0, 1.0, 1.0, 1.0])  # N m s/rad

UPPER_ARM, FOREARM = CENTRE[1, 2], CENTRE[2, 2]  # m along joint 2's axis, in which the tubes stand beside the shoulder
TOOL = 0.7  # of the tip's radius: the radius of the tool

# Body i − 1 of the chain has D-H frame i − 1 turned by joint i: capsules there, ends in m, and their radius.
_CAPSULES = (
    (((0.0, 0.0, D[0]), (0.0, -UPPER_ARM, D[0]), 0.06),),
    (
        ((0.0, 0.0, UPPER_ARM), (A[1], 0.0, UPPER_ARM), 0.055),
        ((A[1], 0.0, UPPER_ARM), (A[1], 0.0, FOREARM), 0.055),
    ),
    (((0.0, 0.0, FOREARM), (A[2], 0.0, FOREARM), 0.045),),
    (((0.0, 0.0, 0.05), (0.0, 0.0, D[3]), 0.042),),
    (((0.0, 0.0, 0.0), (0.0, 0.0, D[4]), 0.042),),
    (),
)

# The arm drawn back, the tool level and pointing ahead.
HOME = np.radians([0.0, -125.0, 140.0, -15.0, 90.0, 0.0])


def attach(base: mujoco.MjsBody, name: str, tool_length: float, tip_radius: float) -> None:
    """Adds the arm to the static body `base`, as `links` says, with a tool.

    The fingertip's geom is `name`/tip. tool_length: from the flange to the tip's centre, m.
    """
    body = links(base, name)
    point = np.array([0.0, 0.0, D[5] + tool_length])
    capsule(body, f"{name}/tool", np.zeros(3), point, TOOL * tip_radius)
    tip(body, f"{name}/tip", point, tip_radius)


def links(base: mujoco.MjsBody, name: str) -> mujoco.MjsBody:
    """Adds the bare arm to the static body `base`, its first axis along the base's z, stretching along its x when θ_1 = 0.

    Bodies and geoms are named `name`/link1…, joints `name`/joint1…. Returns the last body; its flange is at D[5] along z.
    """
    capsule(base, f"{name}/column", np.zeros(3), np.array([0.0, 0.0, D[0] - 0.06]), 0.06)
    body = base
    for i in range(6):
        # Without a turn the published frames have the arm stretch along −x.
        turn = about(2, math.pi) if i == 0 else about(0, ALPHA[i - 1])
        before = np.zeros(3) if i == 0 else np.array([A[i - 1], 0.0, D[i - 1]])
        body = body.add_body(name=f"{name}/link{i + 1}", pos=before, quat=turn)
        joint = hinge(
            body, f"{name}/joint{i + 1}", np.array([0.0, 0.0, 1.0]), -RANGE[i], RANGE[i], ARMATURE[i], DAMPING[i]
        )
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.actfrcrange = [-TORQUE[i], TORQUE[i]]
        for part, (start, end, radius) in enumerate(_CAPSULES[i]):
            geom = f"{name}/link{i + 1}" + ("" if part == 0 else f"/{part + 1}")
            capsule(body, geom, np.array(start), np.array(end), radius)
        _weigh(body, i)
    return body


def _weigh(body: mujoco.MjsBody, i: int) -> None:
    """Mass and centre of link i + 1; its moments are those of a rod of its length."""
    c, s = math.cos(ALPHA[i]), math.sin(ALPHA[i])
    R = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    radius, length = 0.05, max(abs(A[i]), 0.1)
    across = MASS[i] * (length**2 / 12 + radius**2 / 4)
    body.explicitinertial = True
    body.mass = MASS[i]
    body.ipos = np.array([A[i], 0.0, D[i]]) + R @ CENTRE[i]
    body.inertia = [MASS[i] * radius**2 / 2 if A[i] else across, across, across]


def place(spec: mujoco.MjSpec, team: URTeam) -> None:
    """Adds the arms to the world `spec`."""
    for name, pose in zip(team.finger_names, team.bases, strict=True):
        base = spec.worldbody.add_body(name=f"{name}/base", pos=pose.p, quat=pose.wxyz)
        attach(base, name, team.tool_length, team.tip_radius)
        spec.add_exclude(bodyname1=f"{name}/base", bodyname2=f"{name}/link1")  # the shoulder stands on the column


def home(team: URTeam, name: str) -> Array:
    """Joint angles (6,) of an arm at rest."""
    return HOME if team.home is None else np.array(team.home)
