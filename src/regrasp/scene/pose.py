"""Poses as a scene file writes them: a position and a quaternion or roll-pitch-yaw angles."""

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, field_validator, model_validator

from regrasp.scene.units import Angle, Component, Coordinate, fault

Array = NDArray[np.float64]


class Strict(BaseModel):
    """An immutable part of a scene in which an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def multiply(a: Array, b: Array) -> Array:
    """The quaternion product a b, w first: the rotation b followed by a."""
    return np.array([
        a[0] * b[0] - a[1:] @ b[1:],
        *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])),
    ])  # fmt: skip


def conjugate(a: Array) -> Array:
    """The inverse of a unit quaternion."""
    return a * np.array([1.0, -1.0, -1.0, -1.0])


def about(axis: int, angle: float) -> Array:
    """The unit quaternion of a turn by `angle` rad about coordinate axis 0, 1 or 2."""
    quaternion = np.zeros(4)
    quaternion[0], quaternion[1 + axis] = math.cos(angle / 2), math.sin(angle / 2)
    return quaternion


class Pose(Strict):
    """X_AB: origin and attitude of one frame in another; no rotation given means none.

    `euler` is roll, pitch, yaw about the fixed x, y, z axes: R = Rz(yaw) Ry(pitch) Rx(roll), as in URDF.
    """

    position: tuple[Coordinate, Coordinate, Coordinate]
    quaternion: tuple[Component, Component, Component, Component] | None = None
    euler: tuple[Angle, Angle, Angle] | None = None

    @field_validator("quaternion")
    @classmethod
    def _unit(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if value is not None and abs((norm := math.hypot(*value)) - 1.0) > 1e-4:
            unit = ", ".join(f"{x / norm:.6g}" for x in value) if norm else "1, 0, 0, 0"
            raise fault(f"the quaternion has length {norm:.6g}, not 1", f"w, x, y, z; [{unit}]?")
        return value

    @model_validator(mode="after")
    def _one_rotation(self) -> "Pose":
        if self.quaternion is not None and self.euler is not None:
            raise fault("quaternion and euler are both given", "give one of them")
        return self

    @property
    def p(self) -> Array:
        """The origin, (3,), m."""
        return np.array(self.position)

    @property
    def wxyz(self) -> Array:
        """The attitude as a unit quaternion, w first."""
        if self.quaternion is not None:
            quaternion = np.array(self.quaternion)
            return quaternion / np.linalg.norm(quaternion)
        roll, pitch, yaw = self.euler or (0.0, 0.0, 0.0)
        return multiply(about(2, yaw), multiply(about(1, pitch), about(0, roll)))

    @property
    def R(self) -> Array:
        """The attitude as a rotation matrix, (3, 3)."""
        w, v = self.wxyz[0], self.wxyz[1:]
        skew = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
        return (2 * w * w - 1) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * skew
