"""Giving way: fingers that go with an object that something pushes, and keep holding it.

A pushed object takes the fingertips along against their springs; where these resist more than friction bears, contacts
slip and let go. So the targets go with the object, as a rigid body, as soon as it is further from where they would have it
than a short leash: it is pulled back with what the springs make of the leash, no more, and where the push ends it stays.
Strain between the fingers is resisted as ever. The forces fed forward go along too: what the fingers do to each other turns
with the object, and the wrench that carries it stays.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from regrasp.settings import demand

Array = NDArray[np.float64]
Pose = tuple[Array, Array]
"""Position (3,) and rotation (3, 3) of the object."""


@dataclass(frozen=True)
class Leash:
    """How fingers give way. shift, m, and turn, rad: how far the object gets from where they would have it before they do.
    grip: factor on what they do to each other meanwhile, as far as no finger's largest force is exceeded.
    """

    shift: float = 3.5e-3
    turn: float = 0.07
    grip: float = 4.0

    def __post_init__(self) -> None:
        demand(self, from_zero=("shift", "turn", "grip"))


def beyond(leash: Leash, moved: Array) -> Array:
    """The part of a displacement (6,) that is beyond the leash."""
    out = moved.copy()
    for part, length in ((slice(0, 3), leash.shift), (slice(3, 6), leash.turn)):
        out[part] *= max(0.0, 1.0 - length / max(float(np.linalg.norm(moved[part])), 1e-12))
    return out


def displaced(pose: Pose, moved: Array) -> Pose:
    """The pose moved by a displacement (6,)."""
    return pose[0] + moved[:3], Rotation.from_rotvec(moved[3:]).as_matrix() @ pose[1]


def grasp_map(r: Array) -> Array:
    """G (6, 3 m): force and torque of forces at r (m, 3) from the object's origin."""
    x, y, z = r.T
    o = np.zeros(len(r))
    cross = np.array([[o, -z, y], [z, o, -x], [-y, x, o]])
    return np.concatenate([np.tile(np.eye(3), len(r)), cross.transpose(0, 2, 1).reshape(3, -1)])


def carried(force: Array, p: Array, before: Pose, now: Pose, grip: float) -> tuple[Array, Array]:
    """Forces f' (m, 3) and where they act on an object moved from one pose to another; force, p (m, 3): before.

    f' = s R f + G'⁺ (G f − s G' R f), R the object's turn, s the grip: forces without a wrench, which is what fingers do to
    each other, turn with it and grow; the wrench about its origin, which carries its weight, stays the same.
    """
    R = now[1] @ before[1].T
    r = p - before[0]
    turned, there = grip * force @ R.T, r @ R.T
    G = grasp_map(there)
    missing = grasp_map(r) @ force.ravel() - G @ turned.ravel()
    return turned + (np.linalg.pinv(G, rcond=1e-6) @ missing).reshape(-1, 3), there + now[0]
