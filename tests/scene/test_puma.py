"""The Puma is the published one, at every size."""

import math

import mujoco
import numpy as np
import pytest

from regrasp.scene import puma
from regrasp.scene.mjcf import text


def model_of(arm: puma.Puma) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    arm.attach(spec.worldbody.add_body(name="base"), "arm")
    return mujoco.MjModel.from_xml_string(text(spec))


def product(q: np.ndarray, scale: float) -> np.ndarray:
    """The Denavit-Hartenberg product of the joints in q, written out from its definition."""
    T = np.eye(4)
    for theta, d, a, alpha in zip(q, puma.D * scale, puma.A * scale, puma.ALPHA, strict=False):
        c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
        T = T @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
    return T


@pytest.mark.parametrize("scale", [0.1, 0.3, 1.0, 2.0])
def test_forward_kinematics_is_the_denavit_hartenberg_product(scale: float) -> None:
    arm = puma.Puma.sized(scale)
    model = model_of(arm)
    data = mujoco.MjData(model)
    tip = model.geom("arm/tip").id
    rng = np.random.default_rng(3)
    for q in [np.zeros(6), puma.LOWER, puma.UPPER, *rng.uniform(puma.LOWER, puma.UPPER, (20, 6))]:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        T = product(q, scale)
        expected = T[:3, 3] + T[:3, 2] * arm.tool_length + [0, 0, arm.height]
        np.testing.assert_allclose(data.geom_xpos[tip], expected, atol=1e-12)
        np.testing.assert_allclose(data.geom_xmat[tip].reshape(3, 3), T[:3, :3], atol=1e-12)


def test_known_postures_of_the_full_size_arm() -> None:
    """Corke's zero, ready and stretched postures, computed by hand from the table."""
    d4, a2, a3, d3 = 0.4318, 0.4318, 0.0203, 0.15005
    for q, wrist in (
        ([0, 0, 0, 0, 0, 0], [a2 + a3, -d3, d4]),
        ([0, math.pi / 2, -math.pi / 2, 0, 0, 0], [a3, -d3, a2 + d4]),
        ([0, 0, -math.pi / 2, 0, 0, 0], [a2 + d4, -d3, -a3]),
    ):
        np.testing.assert_allclose(product(np.array(q), 1.0)[:3, 3], wrist, atol=1e-15)


def test_masses_and_moments_are_the_published_ones() -> None:
    model = model_of(puma.Puma.sized(1.0))
    links = [model.body(f"arm/link{i + 1}").id for i in range(6)]
    np.testing.assert_allclose(model.body_mass[links], [13.0, 17.4, 4.8, 0.82, 0.34, 0.09])
    data = mujoco.MjData(model)
    data.qpos[:] = [0.3, -0.2, 0.4, 1.0, -0.6, 0.2]
    mujoco.mj_kinematics(model, data)
    for i, body in enumerate(links):
        frame = product(data.qpos[: i + 1], 1.0)
        centre = frame[:3, :3] @ puma.CENTRE[i] + frame[:3, 3] + [0, 0, puma.HEIGHT]
        np.testing.assert_allclose(data.xipos[body], centre, atol=1e-12)
        R = data.ximat[body].reshape(3, 3)
        tensor = R @ np.diag(model.body_inertia[body]) @ R.T
        expected = frame[:3, :3] @ np.diag(puma.INERTIA[i]) @ frame[:3, :3].T
        np.testing.assert_allclose(tensor, expected, atol=1e-12)


def test_gravity_torque_scales_with_the_fourth_power_and_inertia_with_the_fifth() -> None:
    q, s = np.array([0.4, 0.3, -1.2, 0.5, 0.7, -0.2]), 0.25
    results = []
    for scale in (1.0, s):
        model = model_of(puma.Puma.sized(scale))
        data = mujoco.MjData(model)
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        mass = np.zeros((6, 6))
        mujoco.mj_fullM(model, data, mass)
        results.append((data.qfrc_bias.copy(), mass, data.geom_xpos[model.geom("arm/tip").id].copy()))
    (bias, mass, tip), (bias_small, mass_small, tip_small) = results
    np.testing.assert_allclose(bias_small, bias * s**4, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(mass_small, mass * s**5, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(tip_small, tip * s, atol=1e-12)


def test_limits_do_not_depend_on_size_and_hold_the_arm_against_gravity() -> None:
    for scale in (0.2, 0.3, 1.0):
        model = model_of(puma.Puma.sized(scale))
        np.testing.assert_array_equal(model.jnt_range, np.stack([puma.LOWER, puma.UPPER], axis=1))
        data = mujoco.MjData(model)
        data.qpos[:] = [0, 0, -math.pi / 2, 0, 0, 0]  # stretched out level: the heaviest posture
        mujoco.mj_forward(model, data)
        assert np.all(np.abs(data.qfrc_bias) < model.jnt_actfrcrange[:, 1])


def test_tool_and_tip_take_the_sizes_given() -> None:
    model = model_of(puma.Puma.sized(0.3, tool_length=0.07, tip_radius=0.02))
    tip = model.geom("arm/tip")
    assert tip.size[0] == 0.02
    assert tip.pos[2] == 0.07
