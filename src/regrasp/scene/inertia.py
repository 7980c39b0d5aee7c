"""Masses and inertias that no body can have, put right by the least change."""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST_MASS, LEAST_INERTIA = 1e-3, 1e-6
"""kg and kg m²: of a body that moves and has none."""
THINNEST = 1e-3
"""Least second moment of a body along any axis, as a part of the largest."""


def repair(robot: mujoco.MjSpec) -> list[str]:
    """Repairs the inertias of a robot in place and tells each repair in a sentence."""
    said = []
    for body in robot.bodies[1:]:
        if body.explicitinertial:
            said += _given(body)
        elif body.joints and not _heavy(body):
            body.explicitinertial = True
            body.mass, body.ipos, body.iquat = LEAST_MASS, [0, 0, 0], [1, 0, 0, 0]
            body.inertia = [LEAST_INERTIA] * 3
            body.fullinertia = [math.nan, 0, 0, 0, 0, 0]
            said.append(f"body {body.name!r} moves and has no mass: given {LEAST_MASS:g} kg, {LEAST_INERTIA:g} kg m²")
    return said


def physical(inertia: Array) -> Array:
    """The inertia (3, 3) nearest to a symmetric one that a body can have.

    An inertia about the centre of mass is I = tr(Σ) 1 − Σ with the second moments of the mass Σ = ½ tr(I) 1 − I ⪰ 0 (Wensing,
    Kim & Slotine 2018), of which the triangle inequalities of its principal values are one part: negative values of Σ are
    raised.
    """
    moments, axes = np.linalg.eigh(np.trace(inertia) / 2 * np.eye(3) - inertia)
    if moments.max() <= 0.0:
        return LEAST_INERTIA * np.eye(3)
    if moments.min() >= 0.0 and moments.sum() - moments.max() > 0.0:
        return inertia
    moments = np.maximum(moments, THINNEST * moments.max())
    second = axes * moments @ axes.T
    return np.trace(second) * np.eye(3) - second


def _given(body: mujoco.MjsBody) -> list[str]:
    """Repairs of a mass and inertia that the file states."""
    said = []
    if not body.mass > 0.0 and body.joints and not _heavy(body):
        said.append(f"body {body.name!r} moves and has mass {body.mass:g}: given {LEAST_MASS:g} kg")
        body.mass = LEAST_MASS
    full = not math.isnan(body.fullinertia[0])
    if full:
        xx, yy, zz, xy, xz, yz = body.fullinertia
        before = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        before = np.diag(body.inertia)
    if not np.all(np.isfinite(before)) or (not before.any() and body.mass > 0.0):
        before = np.zeros((3, 3))
    if not body.mass > 0.0:
        return said
    after = physical(before)
    if after is before:
        return said
    if full:
        body.fullinertia = [after[0, 0], after[1, 1], after[2, 2], after[0, 1], after[0, 2], after[1, 2]]
    else:
        body.inertia = np.diag(after)
    if not before.any():
        return [*said, f"body {body.name!r} has no inertia: given {LEAST_INERTIA:g} kg m²"]
    values = ", ".join(f"{value:.3g}" for value in np.linalg.eigvalsh(before))
    now = ", ".join(f"{value:.3g}" for value in np.linalg.eigvalsh(after))
    return [*said, f"body {body.name!r} has principal inertias no body can have, {values} kg m²: made {now}"]


def _heavy(body: mujoco.MjsBody) -> bool:
    """Whether a body, or what is fixed to it, has mass given or from its geoms."""
    if body.explicitinertial and body.mass > 0.0:
        return True
    if any(_weighs(geom) for geom in body.geoms) and not body.explicitinertial:
        return True
    return any(_heavy(child) for child in body.bodies if not child.joints)


def _weighs(geom: mujoco.MjsGeom) -> bool:
    if geom.type in (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD):
        return False
    return bool(geom.density > 0.0 if math.isnan(geom.mass) else geom.mass > 0.0)
