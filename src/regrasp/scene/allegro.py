"""A hand with the joint frames, ranges and fingertips of the Allegro hand, its links capsules, its palm a box.

Sources, cited by their initials beside the numbers:
[URDF] SimLab: allegro_hand_description_right.urdf and _left.urdf, Allegro hand v3, 2016.
[UM]   Wonik Robotics: Allegro Hand User's Manual v3.0.
"""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene import arms
from regrasp.scene.forms import AllegroHand
from regrasp.scene.parts import LINK_COLOUR, capsule, hinge, tip
from regrasp.scene.pose import about, multiply

Array = NDArray[np.float64]

FINGERS = ("index", "middle", "ring", "thumb")

# The palm's frame P of [URDF] has its z along the stretched fingers, its x out of the palm and lies at the knuckle of the
# middle finger. [URDF] box of the palm: half sizes and centre in P, m.
PALM_SIZE = np.array([0.0204, 0.0565, 0.0475])
PALM_CENTRE = np.array([-0.0093, 0.0, -0.0475])

# The hand as a scene places it: at the centre of the palm's face, z out of the palm, x along the stretched fingers. P there.
ORIGIN = np.array([0.0475, 0.0, -0.0111])
ATTITUDE = np.array([0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)])

# [URDF] joint 1 of each finger of the right hand in P: m, and roll, pitch, yaw, rad. The left one is its mirror image in y.
BASES = {
    "index": ((0.0, 0.0435, -0.001542), (-math.radians(5.0), 0.0, 0.0)),
    "middle": ((0.0, 0.0, 0.0007), (0.0, 0.0, 0.0)),
    "ring": ((0.0, -0.0435, -0.001542), (math.radians(5.0), 0.0, 0.0)),
    "thumb": ((-0.0182, 0.019333, -0.045987), (0.0, -math.radians(95.0), -math.pi / 2)),
}

# [URDF] joints 2 … 4 in the link before, then the tip's centre in the last link, m: of a finger, of the right thumb.
STEPS = np.array([[0.0, 0.0, 0.0164], [0.0, 0.0, 0.054], [0.0, 0.0, 0.0384], [0.0, 0.0, 0.0267]])
THUMB_STEPS = np.array([[-0.027, 0.005, 0.0399], [0.0, 0.0, 0.0177], [0.0, 0.0, 0.0514], [0.0, 0.0, 0.0423]])

# [URDF] axes in the link's own frame: abduction and three flexions; the thumb rolls and turns first. The left hand's
# thumb turns the other way about the first two.
AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
THUMB_AXES = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])

# [URDF] rad.
LOWER, UPPER = np.array([-0.47, -0.196, -0.174, -0.227]), np.array([0.47, 1.61, 1.709, 1.618])
THUMB_LOWER, THUMB_UPPER = np.array([0.263, -0.105, -0.189, -0.162]), np.array([1.396, 1.163, 1.644, 1.719])

TIP_RADIUS = 0.012  # [URDF] m
TORQUE = 0.7  # [UM] N m, largest
SPEED = np.full(4, 2.0)  # rad/s; [UM] has three times as much

# Sizes no source gives, m: links half as thick as [URDF]'s boxes are, the last one thinner, so that the tip stands proud.
LINK_RADIUS = 0.0098
LAST_RADIUS = 0.0085
# kg/m³: with it the fingers weigh what [UM]'s 1.08 kg leave beside 0.42 kg of palm.
DENSITY = 2900.0
ARMATURE = 1e-4  # kg m², a small geared motor
DAMPING = 1e-2  # N m s/rad

# m from an arm's flange to P along z: the palm begins 1 cm past the flange.
MOUNT = 0.105

# At rest: bent enough to touch something above the palm, the thumb across from the fingers.
HOME = {
    "index": (0.0, 0.5, 0.8, 0.8),
    "middle": (0.0, 0.5, 0.8, 0.8),
    "ring": (0.0, 0.5, 0.8, 0.8),
    "thumb": (1.2, 0.5, 0.3, 0.4),
}


def attach(palm: mujoco.MjsBody, mirrored: bool, tip_radius: float) -> None:
    """Adds the palm's box and the four fingers to the static body `palm`, whose frame is P.

    Bodies and geoms are named index/link1…, joints index/joint1…, the tips' geoms index/tip; thumb, middle, ring likewise.
    mirrored: the left hand.
    """
    side = np.array([1.0, -1.0, 1.0]) if mirrored else np.ones(3)
    palm.add_geom(name="palm", type=mujoco.mjtGeom.mjGEOM_BOX, pos=side * PALM_CENTRE, size=PALM_SIZE, rgba=LINK_COLOUR)
    for name in FINGERS:
        position, (roll, pitch, yaw) = BASES[name]
        turn = multiply(about(2, yaw), multiply(about(1, pitch), about(0, roll)))
        # A mirror image in y turns the other way about x and z.
        turn = np.array([1.0, *side[[1, 0, 1]]]) * turn
        _finger(palm, name, side * position, turn, side, tip_radius)


def _finger(palm: mujoco.MjsBody, name: str, position: Array, turn: Array, side: Array, tip_radius: float) -> None:
    thumb = name == "thumb"
    steps = side * (THUMB_STEPS if thumb else STEPS)
    axes = THUMB_AXES * side[[1, 0, 1]] if thumb else AXES
    lower, upper = limits(name)
    body = palm
    for i in range(4):
        body = body.add_body(name=f"{name}/link{i + 1}", pos=position, quat=turn)
        joint = hinge(body, f"{name}/joint{i + 1}", axes[i], lower[i], upper[i], ARMATURE, DAMPING)
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.actfrcrange = [-TORQUE, TORQUE]
        capsule(body, f"{name}/link{i + 1}", np.zeros(3), steps[i], LINK_RADIUS if i < 3 else LAST_RADIUS, DENSITY)
        position, turn = steps[i], about(0, 0.0)
    tip(body, f"{name}/tip", steps[3], tip_radius)


def limits(name: str) -> tuple[Array, Array]:
    """Joint ranges of a finger, rad."""
    return (THUMB_LOWER, THUMB_UPPER) if name == "thumb" else (LOWER, UPPER)


def place(spec: mujoco.MjSpec, hand: AllegroHand) -> None:
    """Adds the hand to the world `spec`."""
    pose = hand.pose
    place, turn = pose.p + pose.R @ ORIGIN, multiply(pose.wxyz, ATTITUDE)
    if hand.arm is None:
        palm = spec.worldbody.add_body(name="palm", pos=place, quat=turn)
    else:
        palm = arms.carry(spec, hand.arm, place, turn, MOUNT)
    attach(palm, hand.side == "left", hand.tip_radius)
    # These overlap by construction: the first joints are in the palm, and the thumb's second link is as short as thick.
    for name in hand.finger_names:
        spec.add_exclude(bodyname1="palm", bodyname2=f"{name}/link1")
    spec.add_exclude(bodyname1="palm", bodyname2="thumb/link2")
    spec.add_exclude(bodyname1="thumb/link1", bodyname2="thumb/link3")


def home(hand: AllegroHand, name: str) -> Array:
    """Joint angles (4,) of the finger `name` at rest."""
    given = {str(finger): angles for finger, angles in hand.home.items()}
    return np.array(given.get(name, HOME[name]))
