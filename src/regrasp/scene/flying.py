"""A tip that flies freely in a box: three slides and three hinges through its centre, so that it rolls in any direction."""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.forms import FlyingTeam
from regrasp.scene.parts import hinge, slide, tip

Array = NDArray[np.float64]

AXES = np.eye(3)
# The second of the three hinges is kept from the quarter turn at which the first and the third are in line.
GIMBAL = math.radians(80.0)
SPEED = np.array([0.3, 0.3, 0.3, 3.0, 3.0, 3.0])  # m/s, rad/s
CARRIED = 0.1  # kg that each drive moves besides the tip; about the tip's axes as a ball of the tip's size
DAMPING = 2.0  # N s/m, and times the tip's radius squared N m s/rad


def attach(base: mujoco.MjsBody, name: str, low: Array, high: Array, tip_radius: float) -> None:
    """Adds the tip to the static body `base`, in whose axes it goes from `low` to `high` (3,), m.

    Joints `name`/x, y, z, then about z, y, x: `name`/rz, ry, rx; body `name`/ball, geom `name`/tip.
    """
    body = base.add_body(name=f"{name}/ball")
    for letter, axis, a, b in zip("xyz", AXES, low, high, strict=True):
        slide(body, f"{name}/{letter}", axis, a, b, CARRIED, DAMPING)
    for i in (2, 1, 0):
        limit = GIMBAL if i == 1 else math.inf
        square = tip_radius**2
        hinge(body, f"{name}/r{'xyz'[i]}", AXES[i], -limit, limit, 0.4 * CARRIED * square, DAMPING * square)
    tip(body, f"{name}/tip", np.zeros(3), tip_radius)


def place(spec: mujoco.MjSpec, team: FlyingTeam) -> None:
    """Adds the tips to the world `spec`."""
    for name, at, box in zip(team.finger_names, team.bases, team.boxes, strict=True):
        middle, half = np.array(box.position), np.array(box.size)
        base = spec.worldbody.add_body(name=f"{name}/base", pos=at)
        attach(base, name, middle - half - at, middle + half - at, team.tip_radius)


def home(team: FlyingTeam, name: str) -> Array:
    """Joint values (6,) of a tip at rest: where its base is."""
    return np.zeros(6)
