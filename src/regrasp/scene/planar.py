"""The planar finger of the paper's Fig. 2: three hinges about −y, capsule links in the plane y = 0, a spherical tip."""

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.scene.forms import PlanarHand
from regrasp.scene.parts import capsule, hinge, tip
from regrasp.scene.pose import about

Array = NDArray[np.float64]

LIMIT = math.radians(150.0)  # to both sides: a link folds nearly back on the one before
SPEED = np.array([2.0, 3.0, 4.0])  # rad/s
ARMATURE = 1e-4  # kg m², a small geared motor
DAMPING = 1e-2  # N m s/rad
HOME = np.radians([60.0, -120.0, 30.0])


def attach(base: mujoco.MjsBody, name: str, links: Sequence[float], link_radius: float, tip_radius: float) -> None:
    """Adds the finger to the static body `base`: it stretches along the base's x, positive angles turn it towards z.

    Bodies and geoms are named `name`/link1…, joints `name`/joint1…, the tip's geom `name`/tip. The links have the
    density of water.
    """
    body, before = base, 0.0
    for i, length in enumerate(links):
        body = body.add_body(name=f"{name}/link{i + 1}", pos=[before, 0, 0])
        hinge(body, f"{name}/joint{i + 1}", np.array([0.0, -1.0, 0.0]), -LIMIT, LIMIT, ARMATURE, DAMPING)
        capsule(body, f"{name}/link{i + 1}", np.zeros(3), np.array([length, 0.0, 0.0]), link_radius)
        before = length
    tip(body, f"{name}/tip", np.array([before, 0.0, 0.0]), tip_radius)


def place(spec: mujoco.MjSpec, hand: PlanarHand) -> None:
    """Adds the fingers to the world `spec`."""
    for name, at in zip(hand.finger_names, hand.bases, strict=True):
        x, z = at.position
        base = spec.worldbody.add_body(name=f"{name}/base", pos=[x, 0, z], quat=about(1, -at.angle))
        attach(base, name, hand.links, hand.link_radius, hand.tip_radius)


def home(hand: PlanarHand, name: str) -> Array:
    """Joint angles (3,) of the finger `name` at rest."""
    base = hand.bases[hand.finger_names.index(name)]
    return HOME if base.home is None else np.array(base.home)
