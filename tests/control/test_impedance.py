"""Gains follow from levers and inertias, measured here by moving the model and by its kinetic energy."""

import dataclasses

import mujoco
import numpy as np
import pytest

from regrasp.control.controller import agent_joints
from regrasp.control.impedance import Impedance, gains
from regrasp.errors import InputError
from regrasp.scene.load import load
from regrasp.scene.world import World, build
from regrasp.settings import read


@pytest.fixture(scope="module", params=["fig2-planar", "fig3-puma3"])
def world(request) -> World:
    return build(load(request.param))


def postures(world: World) -> list[np.ndarray]:
    rng = np.random.default_rng(2)
    home = np.concatenate([agent.home for agent in world.agents])
    return [home, *(home + 0.4 * rng.standard_normal((3, len(home))))]


def levers(world: World, q: np.ndarray) -> np.ndarray:
    """Way of the tip per way of each joint, (nq,), by central differences."""
    model, data = world.model, mujoco.MjData(world.model)
    addresses = np.concatenate([agent.qpos for agent in world.agents])
    tips = np.concatenate([[agent.tip_geom] * len(agent.qpos) for agent in world.agents])
    out = np.empty(len(q))
    for j, (address, tip) in enumerate(zip(addresses, tips, strict=True)):
        places = []
        for h in (1e-5, -1e-5):
            data.qpos[:] = world.start
            data.qpos[addresses] = q
            data.qpos[address] += h
            mujoco.mj_kinematics(model, data)
            places.append(data.geom_xpos[tip].copy())
        out[j] = np.linalg.norm(places[0] - places[1]) / 2e-5
    return out


def inertias(world: World, q: np.ndarray) -> np.ndarray:
    """Twice the kinetic energy of each joint's own unit rate, (nq,)."""
    model, data = world.model, mujoco.MjData(world.model)
    data.qpos[:] = world.start
    data.qpos[np.concatenate([agent.qpos for agent in world.agents])] = q
    out = []
    for dof in np.concatenate([agent.dofs for agent in world.agents]):
        data.qvel[:] = 0.0
        data.qvel[dof] = 1.0
        mujoco.mj_forward(model, data)
        mujoco.mj_energyVel(model, data)
        out.append(2.0 * data.energy[1])
    return np.array(out)


def test_stiffness_is_that_of_the_tip_at_the_joints_lever(world):
    settings = Impedance(stiffness=450.0, lever=0.25)
    for q in postures(world):
        K = gains(world, q, settings).K
        lever = levers(world, q)
        for mine in agent_joints(world):
            counted = np.maximum(lever[mine], 0.25 * lever[mine].max())
            np.testing.assert_allclose(K[mine], 450.0 * counted**2, rtol=1e-6)


@pytest.mark.parametrize("ratio", [0.3, 1.0, 2.0])
def test_every_joints_own_mode_has_the_damping_ratio(world, ratio):
    """M q̈ + D q̇ + K q = 0 has the ratio D / 2√(KM); what the joint damps itself counts."""
    own = world.model.dof_damping[np.concatenate([agent.dofs for agent in world.agents])]
    for q in postures(world):
        found = gains(world, q, Impedance(damping=ratio))
        wanted = 2.0 * ratio * np.sqrt(found.K * inertias(world, q))
        np.testing.assert_allclose(found.D + own, np.maximum(wanted, own), rtol=1e-6)


def test_joints_that_damp_themselves_enough_are_not_driven_forward(world):
    model = mujoco.MjModel.from_xml_string(world.xml, dict(world.assets))
    model.dof_damping[:] = 1e3
    viscous = dataclasses.replace(world, model=model)
    assert np.all(gains(viscous, postures(world)[0], Impedance()).D == 0.0)


@pytest.mark.parametrize("name", ["stiffness", "damping", "lever"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
def test_impossible_impedances_are_refused(name, value):
    with pytest.raises(InputError, match=name):
        read(Impedance, {name: value}, "control.impedance")
