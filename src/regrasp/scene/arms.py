"""Arms that carry a built-in hand: an arm in the world, with the palm on its flange where the scene wants it at the start."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.errors import InputError
from regrasp.scene import robots, ur5e
from regrasp.scene.forms import Carrier
from regrasp.scene.pose import about, multiply

Array = NDArray[np.float64]

NAME = "arm"
SEEDS, STEPS = 10, 60
"""Postures from which the start is sought, and steps from each."""
MET = 1e-9
"""m and rad, of the palm."""
DAMPING = 1e-6


def carry(spec: mujoco.MjSpec, carrier: Carrier, p_WP: Array, wxyz_WP: Array, mount: float) -> mujoco.MjsBody:
    """Adds the arm to the world `spec`; returns the body of a palm on it, `mount` m past the flange, which stands at X_WP.

    A wrist that moves keeps its joints, and how they rest and how fast they go is kept with the model; a fixed one has none.
    Raises InputError where the arm cannot bring the palm there.
    """
    q = posture(carrier, p_WP, wxyz_WP, mount)
    base = spec.worldbody.add_body(name=f"{NAME}/base", pos=carrier.pose.p, quat=carrier.pose.wxyz)
    body = ur5e.links(base, NAME)
    spec.add_exclude(bodyname1=f"{NAME}/base", bodyname2=f"{NAME}/link1")  # the shoulder stands on the column
    palm = body.add_body(name="palm", pos=[0.0, 0.0, ur5e.D[5] + mount])
    for i in range(6):
        joint = spec.joint(f"{NAME}/joint{i + 1}")
        if carrier.wrist == "fixed":
            joint.parent.quat = multiply(joint.parent.quat, about(2, q[i]))
            spec.delete(joint)
        else:
            spec.add_numeric(name=f"{robots.POSTURE}{joint.name}", data=[q[i]], size=1)
            spec.add_numeric(name=f"{robots.LIMIT}{joint.name}", data=[ur5e.SPEED[i]], size=1)
    return palm


def posture(carrier: Carrier, p_WP: Array, wxyz_WP: Array, mount: float) -> Array:
    """Joints (6,) that bring the palm to X_WP, of those found the nearest to the arm's own rest."""
    spec = mujoco.MjSpec()
    base = spec.worldbody.add_body(pos=carrier.pose.p, quat=carrier.pose.wxyz)
    ur5e.links(base, NAME).add_site(name="palm", pos=[0.0, 0.0, ur5e.D[5] + mount])
    model = spec.compile()
    data, rng, found = mujoco.MjData(model), np.random.default_rng(0), []
    for seed in (ur5e.HOME, *(ur5e.HOME + rng.uniform(-2.0, 2.0, (SEEDS, 6)))):
        q = _met(model, data, seed, p_WP, wxyz_WP)
        if q is not None and np.all(np.abs(q) <= ur5e.RANGE):
            found.append(q)
    if not found:
        place = np.round(p_WP, 3).tolist()
        raise InputError(
            "model.arm", f"cannot bring the palm to model.pose, its knuckles to {place}", "another pose of either"
        )
    return min(found, key=lambda q: float(np.max(np.abs(q - ur5e.HOME))))


def _met(model: mujoco.MjModel, data: mujoco.MjData, q: Array, p_WP: Array, wxyz_WP: Array) -> Array | None:
    """Joints near the arm's rest that bring the site to X_WP, from q by damped least squares."""
    J, e, there = np.empty((6, model.nv)), np.empty(6), np.empty(4)
    for _ in range(STEPS):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mju_mat2Quat(there, data.site_xmat[0])
        turn = multiply(wxyz_WP, there * [1.0, -1.0, -1.0, -1.0])
        mujoco.mju_quat2Vel(e[3:], turn, 1.0)
        e[:3] = p_WP - data.site_xpos[0]
        if np.linalg.norm(e) < MET:
            return np.asarray(ur5e.HOME + (q - ur5e.HOME + np.pi) % (2 * np.pi) - np.pi)
        mujoco.mj_jacSite(model, data, J[:3], J[3:], 0)
        q = q + np.clip(J.T @ np.linalg.solve(J @ J.T + DAMPING * np.eye(6), e), -0.5, 0.5)
    return None
