"""Parts that every built-in mechanism is made of: capsule links, spherical tips, hinges and slides."""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LINK_COLOUR = (0.62, 0.66, 0.72, 1.0)
TIP_COLOUR = (0.25, 0.28, 0.33, 1.0)

WATER = 1000.0  # kg/m³, as printed plastic nearly has


def capsule(body: mujoco.MjsBody, name: str, start: Array, end: Array, radius: float, density: float = WATER) -> None:
    """A capsule from `start` to `end` (in the body's frame, m), kg/m³; massless where the body's inertia is given."""
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[*start, *end],
        size=[radius, 0, 0],
        density=density,
        rgba=LINK_COLOUR,
    )


def tip(body: mujoco.MjsBody, name: str, centre: Array, radius: float) -> None:
    """The spherical fingertip; its frame T has the attitude of the body."""
    body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=centre, size=[radius, 0, 0], rgba=TIP_COLOUR)


def hinge(
    body: mujoco.MjsBody, name: str, axis: Array, lower: float, upper: float, armature: float, damping: float
) -> mujoco.MjsJoint:
    """A hinge at the body's origin with range [lower, upper] rad, motor inertia kg m², viscous friction N m s/rad.

    Without limits where `upper` is infinite.
    """
    return _joint(body, name, mujoco.mjtJoint.mjJNT_HINGE, axis, lower, upper, armature, damping)


def slide(
    body: mujoco.MjsBody, name: str, axis: Array, lower: float, upper: float, armature: float, damping: float
) -> mujoco.MjsJoint:
    """A slide with range [lower, upper] m, motor inertia as a mass, kg, viscous friction N s/m."""
    return _joint(body, name, mujoco.mjtJoint.mjJNT_SLIDE, axis, lower, upper, armature, damping)


def _joint(
    body: mujoco.MjsBody, name: str, kind: mujoco.mjtJoint, axis: Array, lower: float, upper: float, armature: float,
    damping: float,
) -> mujoco.MjsJoint:  # fmt: skip
    bounded = math.isfinite(upper)
    return body.add_joint(
        name=name,
        type=kind,
        axis=axis,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE if bounded else mujoco.mjtLimited.mjLIMITED_FALSE,
        range=[lower, upper] if bounded else [0.0, 0.0],
        armature=armature,
        damping=[damping, 0, 0],
    )
