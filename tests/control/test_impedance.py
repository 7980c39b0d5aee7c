"""Gains follow from levers and inertias, measured here by moving the model and by its kinetic energy; the control period
bounds them."""

import dataclasses

import mujoco
import numpy as np
import pytest

from regrasp.control.controller import agent_joints
from regrasp.control.impedance import STEADY, Gains, Impedance, gains
from regrasp.errors import InputError
from regrasp.scene.load import load, validate
from regrasp.scene.world import World, build
from regrasp.settings import read

FAST = 1e-4
"""s, a control period that bounds nothing here."""


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
        K = gains(world, q, settings, FAST).K
        lever = levers(world, q)
        for mine in agent_joints(world):
            counted = np.maximum(lever[mine], 0.25 * lever[mine].max())
            np.testing.assert_allclose(K[mine], 450.0 * counted**2, rtol=1e-6)


@pytest.mark.parametrize("ratio", [0.3, 1.0, 2.0])
def test_every_joints_own_mode_has_the_damping_ratio(world, ratio):
    """M q̈ + D q̇ + K q = 0 has the ratio D / 2√(KM), M with the object at the tip; what the joint damps itself counts."""
    own = world.model.dof_damping[np.concatenate([agent.dofs for agent in world.agents])]
    for q in postures(world):
        found = gains(world, q, Impedance(damping=ratio), FAST)
        carried = world.scene.object.mass * levers(world, q) ** 2
        wanted = 2.0 * ratio * np.sqrt(found.K * (inertias(world, q) + carried))
        np.testing.assert_allclose(found.D + own, np.maximum(wanted, own), rtol=1e-6)


def test_joints_that_damp_themselves_enough_are_not_driven_forward(world):
    model = mujoco.MjModel.from_xml_string(world.xml, dict(world.assets))
    model.dof_damping[:] = 1e3
    viscous = dataclasses.replace(world, model=model)
    assert np.all(gains(viscous, postures(world)[0], Impedance(), FAST).D == 0.0)


ARM = """<mujoco><worldbody>
  <body name="a">
    <joint name="j1" axis="0 1 0"/> <geom type="capsule" fromto="0 0 0 {length} 0 0" size="0.01" mass="0.4"/>
    <body name="b" pos="{length} 0 0"> <joint name="j2" axis="0 1 0"/> {more}
      <geom name="tip" pos="{reach} 0 0" size="0.01" mass="{tip}"/>
    </body>
  </body>
</worldbody></mujoco>"""


def arm(directory, length: float = 0.2, reach: float = 0.1, tip: float = 0.1, more: str = "") -> World:
    """Two hinges in the x-z plane and what `more` adds after them."""
    path = directory / "arm.xml"
    path.write_text(ARM.format(length=length, reach=reach, tip=tip, more=more))
    pose = {"pose": {"position": [1, 0, 0]}}
    return build(validate({
        "name": "arm", "model": {"file": str(path)}, "object": {"shape": "sphere", "size": [0.03], "mass": 0.1},
        "agents": [{"name": "arm", "tip": "tip"}], "start": pose, "goal": pose,
    }))  # fmt: skip


@pytest.mark.parametrize("reach", [0.1, 0.0])
def test_slides_and_hinges_do_not_count_for_each_other(reach, tmp_path):
    """A slide of lever 1 says nothing of hinges with levers in metres; a hinge through the tip's centre has its radius."""
    more = '<joint name="s" type="slide" axis="1 0 0"/><joint name="spin" axis="1 0 0"/>'
    world = arm(tmp_path, reach=reach, more=more)
    K = gains(world, np.zeros(4), Impedance(stiffness=100.0, lever=0.25), FAST).K
    longest = 0.2 + reach
    np.testing.assert_allclose(K, 100.0 * np.array([longest, max(reach, 0.25 * longest), 1.0, 0.25 * longest]) ** 2)


def test_hinges_that_cannot_move_the_tip_count_with_its_radius(handmade_tip):
    K = gains(handmade_tip, np.zeros(6), Impedance(stiffness=100.0), 1e-6).K
    np.testing.assert_allclose(K, [100.0] * 3 + [100.0 * 0.01**2] * 3)


@pytest.fixture
def handmade_tip(tmp_path) -> World:
    """A sphere of 10 mm on three slides and three hinges through its centre."""
    axes = ("1 0 0", "0 1 0", "0 0 1")
    joints = "".join(f'<joint type="{kind}" axis="{axis}"/>' for kind in ("slide", "hinge") for axis in axes)
    path = tmp_path / "tip.xml"
    geom = '<geom name="tip" size="0.01" mass="0.05"/>'
    path.write_text(f"<mujoco><worldbody><body>{joints}{geom}</body></worldbody></mujoco>")
    pose = {"pose": {"position": [1, 0, 0]}}
    return build(validate({
        "name": "tip", "model": {"file": str(path)}, "object": {"shape": "sphere", "size": [0.03], "mass": 0.1},
        "agents": [{"name": "tip", "tip": "tip"}], "start": pose, "goal": pose,
    }))  # fmt: skip


def mass_matrix(world: World, q: np.ndarray) -> np.ndarray:
    """By the kinetic energy of pairs of joint rates, (nq, nq); all agents."""
    model, data = world.model, mujoco.MjData(world.model)
    data.qpos[:] = world.start
    data.qpos[np.concatenate([agent.qpos for agent in world.agents])] = q
    dofs = np.concatenate([agent.dofs for agent in world.agents])

    def energy(*moving: int) -> float:
        data.qvel[:] = 0.0
        data.qvel[list(moving)] = 1.0
        mujoco.mj_forward(model, data)
        mujoco.mj_energyVel(model, data)
        return float(data.energy[1])

    own = np.array([energy(dof) for dof in dofs])
    pairs = np.array([[energy(a, b) for b in dofs] for a in dofs]) - own - own[:, None]
    return np.where(np.eye(len(dofs)), 2.0 * np.diag(own), pairs)


def growth(M: np.ndarray, found: Gains, period: float) -> float:
    """|z| of M q̈ = −K q − D q̇ held over each period: v' = v − T M⁻¹ (K q + D v), q' = q + T v'."""
    n, inverse = len(M), np.linalg.inv(M)
    A, B = period * inverse * found.K, period * inverse * found.D
    step = np.block([[np.eye(n) - period * A, period * (np.eye(n) - B)], [-A, np.eye(n) - B]])
    return float(np.abs(np.linalg.eigvals(step)).max())


LIGHT = {
    "as built": {},
    "a tip of a milligram": {"tip": 1e-6},
    "a short light tip": {"tip": 1e-5, "reach": 0.011},
    "a heavy tip on a light arm": {"tip": 5.0, "length": 0.02},
    "a spin about the tip": {"more": '<joint name="spin" axis="1 0 0"/>'},
    "a slide along the light tip": {"more": '<joint name="spin" type="slide" axis="1 0 0"/>', "tip": 1e-4},
}


@pytest.mark.parametrize("case", LIGHT)
@pytest.mark.parametrize("ratio", [0.3, 1.0])
@pytest.mark.parametrize("stiffness", [600.0, 1e6])
def test_the_sampled_law_is_stable_however_light_or_stiff_a_joint_is_asked_to_be(case, ratio, stiffness, tmp_path):
    """And without the bound it is not: the same joints at gains made for a far shorter period."""
    world = arm(tmp_path, **LIGHT[case])
    q, period = np.array([0.3, -0.4, 0.1][: len(world.agents[0].qpos)]), 0.002
    settings = Impedance(stiffness=stiffness, damping=ratio)
    found, M = gains(world, q, settings, period), mass_matrix(world, q)
    assert growth(M, found, period) < 1.0
    free = 1.0 / np.diag(np.linalg.inv(M))
    assert np.all(np.sqrt(found.K / free) * period <= STEADY * (1 + 1e-9))
    fastest = np.linalg.eigvals(np.linalg.solve(M, np.diag(found.D))).real.max()
    assert fastest * period <= 1.0 + 1e-9
    frequencies = np.linalg.eigvals(np.linalg.solve(M, np.diag(found.K))).real
    assert frequencies.max() * period**2 <= len(M) * STEADY**2
    if stiffness == 1e6:
        assert growth(M, gains(world, q, settings, 1e-9), period) > 1.0


def test_the_built_in_fingers_are_as_stiff_as_they_are_asked_to_be(world):
    """At 500 Hz the bound leaves them alone; at 50 Hz it counts, and they stay stable."""
    for q in postures(world)[:1]:
        np.testing.assert_array_equal(gains(world, q, Impedance(), 0.002).K, gains(world, q, Impedance(), FAST).K)
        slow = gains(world, q, Impedance(), 0.02)
        assert np.all(slow.K < gains(world, q, Impedance(), FAST).K)
        assert growth(mass_matrix(world, q), slow, 0.02) < 1.0


@pytest.mark.parametrize("name", ["stiffness", "damping", "lever"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
def test_impossible_impedances_are_refused(name, value):
    with pytest.raises(InputError, match=name):
        read(Impedance, {name: value}, "control.impedance")
