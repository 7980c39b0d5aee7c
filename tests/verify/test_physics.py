"""The drives make MuJoCo's joints obey the impedance law; the fixture holds; the world differs as it is told to."""

import dataclasses

import mujoco
import numpy as np
import pytest
from armed import arm, armed
from scipy.spatial.transform import Rotation

from regrasp.control.impedance import Command, Gains, Impedance, gains
from regrasp.errors import InputError
from regrasp.scene.world import from_plan
from regrasp.verify.physics import PERIOD, Physics, Reality, nominal

WANTED = Gains(np.array([40.0, 25.0, 600.0]), np.array([1.5, 0.8, 20.0]))
DRIVES = {
    "none": "",
    "motor": '<motor joint="j1"/><motor joint="j2" gear="30"/><motor joint="j3" gear="-2"/>',
    "position": '<position joint="j1" kp="100" kv="3"/><position joint="j2" kp="7" kv="0.5" gear="3"/>'
    '<position joint="j3" kp="900" kv="40"/>',
    "velocity": '<velocity joint="j1" kv="5"/><velocity joint="j2" kv="0.2" gear="4"/><velocity joint="j3" kv="60"/>',
    "affine": '<general joint="j1" gainprm="3" biastype="affine" biasprm="0.7 -20 -2" gear="2"/>'
    '<general joint="j2" gainprm="-2" biastype="affine" biasprm="-1 5 -0.1"/><general joint="j3" gainprm="11"/>',
    "mixed": '<position joint="j3" kp="900" kv="40"/><motor joint="j1" gear="5"/>',
}


def commanded(physics: Physics, rng: np.random.Generator, size: float = 1.0) -> np.ndarray:
    """Puts joints and command at random, drives, and returns K e + D ė + τ_ff."""
    q, qd, target, rate = 0.3 * rng.standard_normal((4, 3))
    feedforward = size * rng.standard_normal(3)
    physics.place(q)
    physics.data.qvel[[physics.world.agents[0].dofs]] = qd
    command = Command(target, rate, feedforward)
    physics.step(command)
    K, D = physics.drives.gains.K, physics.drives.gains.D
    return K * (target - q) + D * (rate - qd) + feedforward


def driven(physics: Physics) -> np.ndarray:
    return physics.data.qfrc_actuator[physics.world.agents[0].dofs].copy()


@pytest.mark.parametrize("kind", DRIVES)
def test_joints_obey_the_impedance_law_whatever_drives_them(kind, tmp_path):
    world = arm(tmp_path, DRIVES[kind])
    physics, rng = Physics(world, nominal(world), WANTED), np.random.default_rng(0)
    np.testing.assert_allclose(physics.drives.gains.K, WANTED.K)
    np.testing.assert_allclose(physics.drives.gains.D, WANTED.D)
    for _ in range(20):
        wanted = commanded(physics, rng)
        np.testing.assert_allclose(driven(physics), wanted, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", ["none", "motor", "position", "affine"])
def test_the_joints_force_limit_is_obeyed(kind, tmp_path):
    world = arm(tmp_path, DRIVES[kind], 'actuatorfrcrange="-2 2"')
    physics, rng = Physics(world, nominal(world), WANTED), np.random.default_rng(1)
    seen = []
    for _ in range(40):
        wanted = commanded(physics, rng)
        found = driven(physics)
        assert found[0] == pytest.approx(np.clip(wanted[0], -2.0, 2.0))
        np.testing.assert_allclose(found[1:], wanted[1:], rtol=1e-9)
        seen.append(abs(wanted[0]) > 2.0)
    assert 0 < sum(seen) < 40


@pytest.mark.parametrize(
    "limit", ['<motor joint="j1" forcerange="-1 1"/>', '<motor joint="j1" ctrlrange="-0.1 0.1" gear="10"/>']
)
def test_an_actuators_own_limit_is_obeyed(limit, tmp_path):
    world = arm(tmp_path, limit)
    physics, rng = Physics(world, nominal(world), WANTED), np.random.default_rng(2)
    for _ in range(20):
        wanted = commanded(physics, rng)[0]
        assert driven(physics)[0] == pytest.approx(np.clip(wanted, -1.0, 1.0))


LIMITS = {
    "force": ('<motor joint="j1" forcerange="-3 0.5"/>', "", (-3.0, 0.5)),
    "control": ('<motor joint="j1" ctrlrange="-0.05 0.3" gear="10"/>', "", (-0.5, 3.0)),
    "joint": ("", 'actuatorfrcrange="-0.5 2"', (-0.5, 2.0)),
    "joint of a servo": ('<position joint="j1" kp="100" kv="3"/>', 'actuatorfrcrange="-20 5"', (-20.0, 5.0)),
    "target of a servo": ('<position joint="j1" kp="100" kv="3" ctrlrange="-0.2 0.1"/>', "", None),
    "none": ("", "", (-np.inf, np.inf)),
}


@pytest.mark.parametrize("kind", LIMITS)
def test_a_drive_is_short_where_it_gives_something_else_than_it_is_asked_for(kind, tmp_path):
    """Whichever limit it meets, on either side, and no other drive with it."""
    actuators, joint, bounds = LIMITS[kind]
    world = arm(tmp_path, actuators, joint)
    physics, rng = Physics(world, nominal(world), WANTED), np.random.default_rng(3)
    seen = []
    for _ in range(60):
        wanted = commanded(physics, rng)
        gives = np.clip(wanted[0], *bounds) if bounds else driven(physics)[0]
        limited = abs(gives - wanted[0]) > 1e-6
        assert physics.short.tolist() == [limited, False, False]
        seen.append(limited)
    assert any(seen) == (kind != "none")
    assert not all(seen)


def test_a_drive_that_bears_its_bodys_weight_is_not_short(tmp_path):
    world = arm(tmp_path, joint='actuatorgravcomp="true"', body='gravcomp="1"')
    physics, rng = Physics(world, nominal(world), WANTED), np.random.default_rng(4)
    for _ in range(20):
        commanded(physics, rng)
        assert np.abs(physics.data.qfrc_gravcomp).max() > 0.1
        assert not physics.short.any()


@pytest.mark.parametrize(
    ("actuators", "words"),
    [
        ('<motor joint="j1"/><motor name="second" joint="j1"/>', "2 actuators move joint"),
        ('<intvelocity joint="j2" kp="5" actrange="-1 1"/>', "not affine"),
        ('<muscle joint="j2" lengthrange="0.1 1"/>', "not affine"),
        ('<general joint="j2" gainprm="0"/>', "not affine"),
        ('<general joint="j2" gaintype="affine" gainprm="1 1 0"/>', "not affine"),
        ('<general joint="j2" dyntype="filter" dynprm="0.1"/>', "not affine"),
    ],
)
def test_drives_that_cannot_be_counted_on_are_refused(actuators, words, tmp_path):
    world = arm(tmp_path, actuators)
    with pytest.raises(InputError, match=words) as told:
        Physics(world, nominal(world), WANTED)
    assert "robot/j1" in str(told.value) or "robot/j2" in str(told.value)


@pytest.mark.parametrize(("ratio", "overshoot"), [(0.3, np.exp(-np.pi * 0.3 / np.sqrt(1 - 0.09))), (1.0, 0.0)])
def test_a_joint_answers_a_step_as_its_damping_ratio_says(ratio, overshoot, tmp_path):
    """Of a second-order system, overshoot = exp(−πζ/√(1 − ζ²)); ω = √(K/M) small against the period's rate."""
    bare = {"shape": "sphere", "size": [0.03], "mass": 1e-4}  # nothing to carry
    world = arm(tmp_path, gravity=[0, 0, 0], object=bare)
    home = np.zeros(3)
    wanted = gains(world, home, Impedance(stiffness=20.0, damping=ratio), PERIOD)
    target, way = np.array([0.02, 0.0, 0.0]), []
    held = Gains(np.array([wanted.K[0], 1e4, 1e5]), np.array([wanted.D[0], 1e2, 1e3]))  # the other joints fast
    physics = Physics(world, nominal(world), held)
    physics.place(home)
    for _ in range(1500):
        physics.step(Command(target, home, home))
        way.append(physics.q[0])
    assert way[-1] == pytest.approx(0.02, rel=2e-3)
    assert max(way) / 0.02 - 1.0 == pytest.approx(overshoot, abs=0.03)


def test_factors_of_friction_and_mass_reach_the_contacts(handmade):
    plan, _ = handmade["finger"]
    world = from_plan(plan.scene, plan.xml, plan.assets)
    reality = dataclasses.replace(nominal(world), friction=np.array([0.5, 1.2]), mass=1.7)
    wanted = gains(world, plan.joints[0, 0], Impedance(), PERIOD)
    plain, changed = Physics(world, nominal(world), wanted), Physics(world, reality, wanted)
    for physics in (plain, changed):
        q = plan.joints[0, 0] + [0.0, 0.0, 0.01]
        for direction in (1.0, -1.0):  # press into the object, from whichever side that is
            physics.place(plan.joints[0, 0] + direction * (q - plan.joints[0, 0]))
            physics.data.qpos[world.object_qpos + 2] -= 1e-4
            mujoco.mj_forward(physics.model, physics.data)
            if physics.data.ncon == 2:
                break
        assert physics.data.ncon == 2

    def coefficients(physics: Physics) -> dict[int, float]:
        surfaces = {world.agents[0].tip_geom, *map(int, world.support_geoms)}
        return {
            next(int(g) for g in contact.geom if int(g) in surfaces): contact.friction[0]
            for contact in physics.data.contact
        }

    before, after = coefficients(plain), coefficients(changed)
    tip, table = world.agents[0].tip_geom, int(world.support_geoms[0])
    assert before[tip] == pytest.approx(world.agents[0].friction)
    assert before[table] == pytest.approx(world.support_friction[0])
    assert after[tip] == pytest.approx(0.5 * before[tip])
    assert after[table] == pytest.approx(1.2 * before[table])
    body = world.object_body
    assert changed.model.body_mass[body] == pytest.approx(1.7 * 0.2)
    np.testing.assert_allclose(changed.model.body_inertia[body], 1.7 * plain.model.body_inertia[body])
    assert changed.model.body_subtreemass[0] - plain.model.body_subtreemass[0] == pytest.approx(0.7 * 0.2)
    assert not np.shares_memory(changed.model.body_mass, world.model.body_mass)
    assert world.model.body_mass[body] == pytest.approx(0.2)


def displaced(world) -> Reality:
    return dataclasses.replace(nominal(world), shift=np.array([1e-3, -2e-3, 3e-3]), turn=np.array([0.02, 0.03, -0.01]))


def test_the_fixture_holds_the_object_where_reality_has_it_until_release(tmp_path):
    """Held to 0.02 mm under its weight and 0.1 mm under nine times as much; then it falls as g t²/2."""
    pose = {"pose": {"position": [1, 0.1, 0.3], "euler": [0.4, -0.2, 0.7]}}
    world = arm(tmp_path, start=pose, goal=pose)
    reality = displaced(world)
    physics = Physics(world, reality, WANTED)
    start = world.scene.start.pose
    R = Rotation.from_rotvec(reality.turn).as_matrix() @ start.R
    rest = Command(np.zeros(3), np.zeros(3), np.zeros(3))
    for push, within in ((0.0, 2e-5), (5.0, 1e-4)):
        physics.data.xfrc_applied[world.object_body, :3] = push
        for _ in range(100):
            physics.step(rest)
        np.testing.assert_allclose(physics.p_WO, start.p + reality.shift, atol=within)
        np.testing.assert_allclose(physics.R_WO, R, atol=1e-6)
    physics.data.xfrc_applied[:] = 0.0
    for _ in range(100):
        physics.step(rest)
    physics.release()
    begin = physics.p_WO
    for _ in range(100):
        physics.step(rest)
    fallen = physics.p_WO - begin
    np.testing.assert_allclose(fallen, [0, 0, -0.5 * 9.81 * (100 * PERIOD) ** 2], atol=0.5 * 9.81 * PERIOD * 0.21)
    np.testing.assert_allclose(physics.R_WO, R, atol=1e-6)


def test_the_world_as_planned_is_the_plans(handmade):
    plan, _ = handmade["hold"]
    plan = armed(plan)
    world = from_plan(plan.scene, plan.xml, plan.assets)
    physics = Physics(world, nominal(world), gains(world, plan.joints[0, 0], Impedance(), PERIOD))
    for name in ("body_mass", "body_inertia", "geom_friction", "dof_armature", "jnt_range"):
        np.testing.assert_array_equal(getattr(physics.model, name), getattr(world.model, name))
    np.testing.assert_allclose(physics.p_WO, plan.object_position[0, 0], atol=1e-12)
    assert physics.model.opt.timestep == PERIOD
    assert physics.model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert physics.model.opt.impratio >= 10
    assert physics.model.opt.noslip_iterations >= 10


def test_a_bad_number_stays(tmp_path, monkeypatch):
    """By default MuJoCo would put the world back to its start, time and all, and go on."""
    monkeypatch.chdir(tmp_path)  # MuJoCo keeps a log of its warnings
    world = arm(tmp_path)
    physics = Physics(world, nominal(world), WANTED)
    rest = Command(np.zeros(3), np.zeros(3), np.zeros(3))
    for n in range(10):
        if n == 5:
            physics.data.qvel[world.agents[0].dofs[1]] = np.nan
        physics.step(rest)
    assert physics.data.time == pytest.approx(10 * PERIOD)
    assert not np.isfinite(physics.qd).all()
