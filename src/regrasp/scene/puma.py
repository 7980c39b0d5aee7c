"""The Puma 560 from its published tables, as an MJCF chain with capsule links and a spherical fingertip, of any size.

Sources, cited by their initials beside the numbers:
[AKB]  B. Armstrong, O. Khatib, J. Burdick: The explicit dynamic model and inertial parameters of the PUMA 560 arm.
       IEEE Int. Conf. Robotics and Automation, 1986, pp. 510-518.
[CAH]  P. Corke, B. Armstrong-Hélouvry: A search for consensus among model parameters reported for the PUMA 560 robot.
       IEEE Int. Conf. Robotics and Automation, 1994, pp. 1608-1613. Standard Denavit-Hartenberg frames, as here.
[C96]  P. Corke: Visual Control of Robots. Research Studies Press, 1996.
[FGL]  K. Fu, R. Gonzalez, C. Lee: Robotics. McGraw-Hill, 1987; joint ranges, their signs turned to the frames of [CAH].
"""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.forms import PumaHand
from regrasp.scene.parts import LINK_COLOUR, capsule, hinge, tip
from regrasp.scene.pose import about

Array = NDArray[np.float64]

# [CAH] T_i = Rz(θ_i) Tz(d_i) Tx(a_i) Rx(α_i); frame 0 is at the shoulder, where axes 1 and 2 meet. m, rad.
A = np.array([0.0, 0.4318, 0.0203, 0.0, 0.0, 0.0])
D = np.array([0.0, 0.0, 0.15005, 0.4318, 0.0, 0.0])
ALPHA = np.array([math.pi / 2, 0.0, -math.pi / 2, math.pi / 2, -math.pi / 2, 0.0])

# [FGL] rad.
LOWER = np.radians([-160.0, -45.0, -225.0, -110.0, -100.0, -266.0])
UPPER = np.radians([160.0, 225.0, 45.0, 170.0, 100.0, 266.0])

# At rest: upper arm raised, forearm down, the tool level; joint 1 turns it towards the hand's axis.
HOME = np.radians([0.0, 40.0, -190.0, 0.0, 60.0, 0.0])

# [C96] Table 2.21, load-referenced speed at which the amplifiers saturate, rad/s.
SPEED = np.array([1.92, 1.51, 2.40, 5.34, 5.09, 5.74])

# [AKB] largest joint torques, N m.
TORQUE = np.array([97.6, 186.4, 89.4, 24.2, 20.1, 21.3])

# [AKB] kg. They did not weigh link 1: it only turns about its own fixed axis, so its mass has no effect when the base
# stands still. MuJoCo needs one; 13.0 is what Tarn et al. report, as compared in [CAH].
MASS = np.array([13.0, 17.4, 4.8, 0.82, 0.34, 0.09])

# [CAH] centres of mass in the link's own frame i, m; link 1's, not given, is put on its axis.
CENTRE = np.array([
    [0.0, 0.0, 0.0],
    [-0.3638, 0.006, 0.2275],
    [-0.0203, -0.0141, 0.070],
    [0.0, 0.019, 0.0],
    [0.0, 0.0, 0.0],
    [0.0, 0.0, 0.032],
])  # fmt: skip

# [AKB], in the frames of [CAH]: principal moments about the centre of mass along the axes of frame i, kg m². Of link 1
# only the moment about joint 1 (its y) is published and matters. Link 3's y moment is printed as 0.086, more than any
# rigid body with the other two (0.066, 0.0125) can have; the arm is slender, so its x moment stands for both, as it
# does in Corke's listing of the [AKB] frames.
INERTIA = np.array([
    [0.35, 0.35, 0.35],
    [0.13, 0.524, 0.539],
    [0.066, 0.066, 0.0125],
    [1.8e-3, 1.3e-3, 1.8e-3],
    [0.3e-3, 0.4e-3, 0.3e-3],
    [0.15e-3, 0.15e-3, 0.04e-3],
])  # fmt: skip

# [CAH] motor inertia kg m² and viscous friction N m s/rad, both at the motor, and gear ratios.
MOTOR_INERTIA = np.array([200e-6, 200e-6, 200e-6, 33e-6, 33e-6, 33e-6])
MOTOR_FRICTION = np.array([1.48e-3, 0.817e-3, 1.38e-3, 71.2e-6, 82.6e-6, 36.7e-6])
GEAR = np.array([62.6111, 107.815, 53.7063, 76.0364, 71.923, 76.686])

# m, from the mounting surface to frame 0, as in Corke's Robotics Toolbox.
HEIGHT = 0.672

# Sizes no source gives, m at full scale: the radii of the capsules that stand for the links, and the tool with its
# spherical tip, long enough for a fingertip to reach round an object without its wrist coming near.
LINK_RADIUS = 0.05
TOOL_RADIUS = 0.03
TOOL_LENGTH = 0.3
TIP_RADIUS = 0.045


@dataclass(frozen=True)
class Puma:
    """A Puma 560 of some `scale`, its tool's length and tip radius in m.

    Lengths grow with s, masses with s³, inertias, the motors' included, with s⁵, so that gravity's time scale goes with
    √s; viscous friction with s^4.5 keeps the damping ratio at that time scale. Torque limits grow with s³, as a cross
    section times a lever does. Joint ranges and speeds do not change.
    """

    scale: float
    tool_length: float
    tip_radius: float

    @classmethod
    def sized(cls, scale: float, tool_length: float | None = None, tip_radius: float | None = None) -> "Puma":
        """A Puma whose tool is in proportion where no size is given."""
        return cls(scale, tool_length or TOOL_LENGTH * scale, tip_radius or TIP_RADIUS * scale)

    @property
    def height(self) -> float:
        """The height of D-H frame 0 above the base, m."""
        return HEIGHT * self.scale

    @property
    def tool_radius(self) -> float:
        """Radius of the tool's shaft, m: two thirds of its tip's, so that the tip stands proud of it, or in proportion."""
        return min(TOOL_RADIUS * self.scale, self.tip_radius * TOOL_RADIUS / TIP_RADIUS)

    @property
    def torque(self) -> Array:
        """Torque limits of the joints, N m."""
        return TORQUE * self.scale**3

    def attach(self, base: mujoco.MjsBody, name: str) -> None:
        """Adds the arm to the static body `base`; D-H frame 0 is `height` above the base's origin.

        Bodies and geoms are named `name`/link1…, joints `name`/joint1…, the fingertip's geom `name`/tip, its frame that
        of link 6. Body i has D-H frame i−1 turned by joint i, so that each joint's axis is its body's z.
        """
        s = self.scale
        radius = LINK_RADIUS * s
        capsule(base, f"{name}/column", np.zeros(3), np.array([0.0, 0.0, self.height - radius]), radius)
        body = base
        for i in range(6):
            before = (0.0, 0.0, self.height) if i == 0 else (s * A[i - 1], 0.0, s * D[i - 1])
            turn = about(0, 0.0 if i == 0 else ALPHA[i - 1])
            body = body.add_body(name=f"{name}/link{i + 1}", pos=before, quat=turn)
            joint = hinge(
                body,
                f"{name}/joint{i + 1}",
                np.array([0.0, 0.0, 1.0]),
                LOWER[i],
                UPPER[i],
                armature=MOTOR_INERTIA[i] * GEAR[i] ** 2 * s**5,
                damping=MOTOR_FRICTION[i] * GEAR[i] ** 2 * s**4.5,
            )
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
            joint.actfrcrange = [-self.torque[i], self.torque[i]]
            # The tables hold for frame i: a turn by α and the steps a, d away from the body's.
            c, sn = math.cos(ALPHA[i]), math.sin(ALPHA[i])
            R = np.array([[1.0, 0.0, 0.0], [0.0, c, -sn], [0.0, sn, c]])
            body.explicitinertial = True
            body.mass = MASS[i] * s**3
            body.ipos = s * (np.array([A[i], 0.0, D[i]]) + R @ CENTRE[i])
            body.iquat = about(0, ALPHA[i])
            body.inertia = INERTIA[i] * s**5
            if i in _CAPSULES:
                ends, width = _CAPSULES[i]
                capsule(body, f"{name}/link{i + 1}", s * np.array(ends[0]), s * np.array(ends[1]), s * width)
        capsule(body, f"{name}/tool", np.zeros(3), np.array([0.0, 0.0, self.tool_length]), self.tool_radius)
        tip(body, f"{name}/tip", np.array([0.0, 0.0, self.tool_length]), self.tip_radius)


# Link 0 … 5: the ends of its capsule in its body at full scale and the radius: shoulder, upper arm and forearm.
_CAPSULES = {
    0: (((0.0, 0.0, 0.0), (0.0, -D[2], 0.0)), LINK_RADIUS),
    1: (((0.0, 0.0, D[2]), (A[1], 0.0, D[2])), LINK_RADIUS),
    2: (((A[2], 0.0, D[2]), (A[2], D[3], D[2])), LINK_RADIUS),
}


def home(hand: PumaHand, name: str) -> Array:
    """Joint angles (6,) of the finger `name` at rest."""
    if hand.home is not None:
        return np.array(hand.home)
    angles = HOME.copy()
    if hand.bases is None:
        # The arm works beside its own axis by d3; turned by this angle its plane holds the hand's axis.
        angles[0] = math.asin(min(1.0, D[2] * hand.scale / hand.ring))
    return angles


def place(spec: mujoco.MjSpec, hand: PumaHand) -> None:
    """Adds palm and fingers to the world `spec`."""
    arm = Puma.sized(hand.scale, hand.tool_length, hand.tip_radius)
    palm = spec.worldbody.add_body(name="palm", pos=hand.pose.p, quat=hand.pose.wxyz)
    if hand.palm:
        radius, half = hand.ring + 2 * LINK_RADIUS * hand.scale, LINK_RADIUS * hand.scale / 2
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
