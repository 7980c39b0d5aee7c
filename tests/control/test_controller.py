"""Feed-forward is what MuJoCo's inverse dynamics and the power of the contact forces ask for; steps move tips as told."""

import dataclasses

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp.control.controller import Control, Controller, agent_joints
from regrasp.control.feedback import Feedback, displacement
from regrasp.control.reference import Phases, Reference, reference, solve_step
from regrasp.scene.load import load, validate
from regrasp.scene.world import World, build

FREE = """<mujoco><worldbody>
  <body name="a" {body}>
    <joint name="j1" axis="0 1 0" damping="0.3"/> <joint name="j2" axis="0 0 1" {joint}/>
    <geom name="link" type="capsule" fromto="0 0 0 0.2 0 0" size="0.01" mass="0.4"/>
    <body name="b" pos="0.2 0 0" {body}>
      <joint name="j3" axis="0 1 0" {joint}/> <joint name="j4" type="slide" axis="1 0 0"/>
      <geom name="tip" pos="0.15 0 0" size="0.01" mass="0.2"/>
    </body>
  </body>
</worldbody></mujoco>"""


def own_world(directory, body: str = "", joint: str = "") -> World:
    path = directory / "arm.xml"
    path.write_text(FREE.format(body=body, joint=joint))
    return build(validate({
        "name": "arm", "model": {"file": str(path)}, "object": {"shape": "sphere", "size": [0.03], "mass": 0.1},
        "agents": [{"name": "arm", "tip": "tip"}],
        "start": {"pose": {"position": [1, 0, 0]}}, "goal": {"pose": {"position": [1, 0, 0]}},
    }))  # fmt: skip


def table(world: World, q, qd, force, where) -> Reference:
    """One row; the object at its start."""
    pose = world.scene.start.pose
    k = len(world.agents)
    return Reference(
        0.002, 0.0, 0, 0, 0, np.zeros(1, int), q[None], qd[None], np.array([pose.p]), np.array([pose.R]),
        np.ones((1, k), bool), np.zeros((1, k), bool), force[None], where[None], np.zeros((1, k, 3)),
        np.eye(6)[None],
    )  # fmt: skip


def place(world: World, q: np.ndarray, qd: np.ndarray | float = 0.0) -> mujoco.MjData:
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.start
    data.qpos[np.concatenate([agent.qpos for agent in world.agents])] = q
    data.qvel[np.concatenate([agent.dofs for agent in world.agents])] = qd
    mujoco.mj_forward(world.model, data)
    return data


def unforced(world: World, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """Joint forces that keep the rates steady without any contact, by inverse dynamics (nq,)."""
    model = mujoco.MjModel.from_xml_string(world.xml, dict(world.assets))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = place(dataclasses.replace(world, model=model), q, qd)
    data.qacc[:] = 0.0
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse[np.concatenate([agent.dofs for agent in world.agents])].copy()


def check_feedforward(world: World, rng: np.random.Generator) -> None:
    q = np.concatenate([agent.home for agent in world.agents])
    q = q + 0.2 * rng.standard_normal(len(q))
    qd = 0.5 * rng.standard_normal(len(q))
    data = place(world, q)
    force = 5.0 * rng.standard_normal((len(world.agents), 3))
    where = data.geom_xpos[[agent.tip_geom for agent in world.agents]] + 0.01 * rng.standard_normal(force.shape)
    command = Controller(world, table(world, q, qd, force, where), Control(), np.ones(len(q))).command(0, q, qd)
    np.testing.assert_array_equal(command.q, q)
    np.testing.assert_array_equal(command.qd, qd)
    pressing = command.feedforward - unforced(world, q, qd)
    for _ in range(6):
        rate, h, power = rng.standard_normal(len(q)), 1e-6, 0.0
        ends = [place(world, q + sign * h * rate) for sign in (1.0, -1.0)]
        for i, agent in enumerate(world.agents):
            local = data.xmat[agent.tip_body].reshape(3, 3).T @ (where[i] - data.xpos[agent.tip_body])
            way = [end.xpos[agent.tip_body] + end.xmat[agent.tip_body].reshape(3, 3) @ local for end in ends]
            power += force[i] @ (way[0] - way[1]) / (2.0 * h)
        assert pressing @ rate == pytest.approx(power, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("name", ["fig2-planar", "fig3-puma3"])
def test_feedforward_is_gravity_motion_and_the_power_of_the_contact_forces(name):
    """τ_ff − τ_inverse does the work that f does at the point where it acts, for every joint rate."""
    check_feedforward(build(load(name)), np.random.default_rng(6))


@pytest.mark.parametrize(
    ("body", "joint"),
    [("", ""), ('gravcomp="1"', ""), ("", 'stiffness="3" springref="0.5"'), ('gravcomp="0.5"', 'stiffness="2"')],
)
def test_feedforward_of_a_users_model_counts_what_the_model_does_by_itself(body, joint, tmp_path):
    """Springs in the joints and bodies whose weight the model takes away."""
    check_feedforward(own_world(tmp_path, body, joint), np.random.default_rng(7))


def test_who_is_off_the_object_presses_on_nothing():
    world, rng = build(load("fig3-puma3")), np.random.default_rng(8)
    q = np.concatenate([agent.home for agent in world.agents])
    force, where = rng.standard_normal((2, len(world.agents), 3))
    row = table(world, q, 0 * q, force, where)
    row.bears[0, 1] = False
    mine = agent_joints(world)[1]
    torque = Controller(world, row, Control(), np.ones(len(q))).command(0, q, 0 * q).feedforward
    np.testing.assert_allclose(torque[mine], unforced(world, q, 0 * q)[mine], atol=1e-9)
    other = agent_joints(world)[0]
    assert np.abs(torque[other] - unforced(world, q, 0 * q)[other]).max() > 1e-3


def motion(world: World, i: int, q: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How the tip of agent i is shifted and turned by the joint change of `solve_step` at its joints q."""
    model, agent, data = world.model, world.agents[i], mujoco.MjData(world.model)
    data.qpos[:] = world.start
    poses, change = [], np.zeros(len(q))
    for _ in range(2):
        data.qpos[agent.qpos] = q + change
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        poses.append((data.geom_xpos[agent.tip_geom].copy(), data.geom_xmat[agent.tip_geom].reshape(3, 3).copy()))
        J = np.empty((6, model.nv))
        mujoco.mj_jac(model, data, J[:3], J[3:], poses[0][0], agent.tip_body)
        change = solve_step(J[:, agent.dofs], step, model.geom_rbound[agent.tip_geom])
    (p0, R0), (p1, R1) = poses
    return p1 - p0, Rotation.from_matrix(R1 @ R0.T).as_rotvec()


SMALL = 2.0 ** -np.arange(4)


@pytest.mark.parametrize("seed", range(4))
def test_six_joints_make_a_small_step_of_the_tip(seed):
    """The shift to second order: its relative error falls with the step. The damping keeps a part of the turn."""
    world, rng = build(load("fig3-puma3")), np.random.default_rng(seed)
    q = world.agents[0].home + 0.1 * rng.standard_normal(6)
    shift, turn = rng.standard_normal((2, 3))
    step = np.concatenate([4e-3 * shift / np.linalg.norm(shift), 0.1 * turn / np.linalg.norm(turn)])
    found = [motion(world, 0, q, h * step) for h in SMALL]
    errors = np.array([np.linalg.norm(p - h * step[:3]) / (4e-3 * h) for h, (p, _) in zip(SMALL, found, strict=True)])
    assert errors[0] < 0.3
    np.testing.assert_allclose(errors[1:] / errors[:-1], 0.5, atol=0.1)
    assert np.linalg.norm(found[-1][1] - SMALL[-1] * step[3:]) < 0.1 * 0.1 * SMALL[-1]


@pytest.mark.parametrize("seed", range(4))
def test_three_joints_keep_the_position_and_give_up_the_turn(seed):
    """In its plane a finger of three joints goes where it shall, whatever turn is asked, even one out of the plane."""
    world, rng = build(load("fig2-planar")), np.random.default_rng(seed)
    q = world.agents[0].home + 0.2 * rng.standard_normal(3)
    shift = rng.standard_normal(3) * [1, 0, 1]
    step = np.concatenate([4e-3 * shift / np.linalg.norm(shift), 0.1 * rng.standard_normal(3)])
    errors = np.array([np.linalg.norm(motion(world, 0, q, h * step)[0] - h * step[:3]) / (4e-3 * h) for h in SMALL])
    assert errors[0] < 0.1
    assert np.all(errors[1:] < 0.6 * errors[:-1])


def test_a_straight_arm_is_asked_for_a_small_step_only():
    """Along a stretched finger no joint moves the tip: the damping keeps the joints where they are."""
    world = build(load("fig2-planar"))
    agent, data = world.agents[0], mujoco.MjData(world.model)
    data.qpos[:] = world.start
    data.qpos[agent.qpos] = [0.3, 0.0, 0.0]
    mujoco.mj_kinematics(world.model, data)
    mujoco.mj_comPos(world.model, data)
    J = np.empty((6, world.model.nv))
    mujoco.mj_jac(world.model, data, J[:3], J[3:], data.geom_xpos[agent.tip_geom], agent.tip_body)
    along = data.geom_xpos[agent.tip_geom] - data.xanchor[agent.joints[0]]
    step = np.concatenate([4e-3 * along / np.linalg.norm(along), np.zeros(3)])
    assert np.abs(solve_step(J[:, agent.dofs], step, 0.012)).max() < 1e-6


def test_what_is_seen_moves_the_fingertips_with_the_object(restless):
    """A displaced object, all fingers off it: after the smoothing their tips are displaced as its points are."""
    plan, world = restless("fig3-puma3"), build(load("fig3-puma3"))
    ref = reference(plan, world, 0.02, Phases())
    eyes = Controller(world, ref, Control(feedback=Feedback(period=0.02, smoothing=0.02)), np.ones(ref.q.shape[1]))
    shift, turn = np.array([2e-3, -1e-3, 1.5e-3]), Rotation.from_rotvec([0.0, 0.02, 0.01])
    seen = ref.p_WO[0] + shift, turn.as_matrix() @ ref.R_WO[0]
    plain = eyes.command(0, ref.q[0], ref.qd[0]).q
    np.testing.assert_array_equal(plain, ref.q[0])
    eyes.update(0, seen)
    moved = eyes.command(0, ref.q[0], ref.qd[0]).q
    before, after = place(world, plain), place(world, moved)
    for agent in world.agents:
        p = before.geom_xpos[agent.tip_geom]
        wanted = seen[0] + turn.apply(p - ref.p_WO[0]) - p
        np.testing.assert_allclose(after.geom_xpos[agent.tip_geom] - p, wanted, atol=0.05 * np.linalg.norm(wanted))


def test_an_object_on_its_path_is_left_alone(restless):
    plan, world = restless("fig3-puma3"), build(load("fig3-puma3"))
    ref = reference(plan, world, 0.02, Phases())
    eyes = Controller(world, ref, Control(feedback=Feedback()), np.ones(ref.q.shape[1]))
    for row in range(0, len(ref), 7):
        command = eyes.command(row, ref.q[row], ref.qd[row])
        assert np.abs(command.q - ref.q[row]).max() < 1e-12
        eyes.update(row, (ref.p_WO[row], ref.R_WO[row]))


def test_before_the_object_is_carried_nothing_winds_up(restless):
    """Loaded against an object that is held elsewhere, the fingers keep their targets."""
    plan, world = restless("fig3-puma3"), build(load("fig3-puma3"))
    ref = reference(plan, world, 0.02, Phases())
    eyes = Controller(world, ref, Control(feedback=Feedback()), np.ones(ref.q.shape[1]))
    for row in range(ref.touch, ref.start):
        command = eyes.command(row, ref.q[row], ref.qd[row])
        np.testing.assert_allclose(command.q, ref.q[row], atol=1e-12)
        eyes.update(row, (ref.p_WO[row] + 2e-3, ref.R_WO[row]))


def test_an_object_left_behind_is_pushed_on(restless):
    """Carried and lagging, it is sent ahead: the tips are displaced against the error."""
    plan, world = restless("fig3-puma3"), build(load("fig3-puma3"))
    ref = reference(plan, world, 0.02, Phases())
    eyes, row = Controller(world, ref, Control(feedback=Feedback(rate=5.0)), np.ones(ref.q.shape[1])), ref.start
    lag = np.array([0.0, -2e-3, 0.0])
    assert displacement(ref.p_WO[row], ref.R_WO[row], ref.p_WO[row] + lag, ref.R_WO[row])[1] == -2e-3
    q = ref.q[row]
    eyes.command(row, q, 0 * q)
    for _ in range(5):
        eyes.update(row, (ref.p_WO[row] + lag, ref.R_WO[row]))
    before, after = place(world, q), place(world, eyes.command(row, q, 0 * q).q)
    for agent in world.agents:
        way = after.geom_xpos[agent.tip_geom] - before.geom_xpos[agent.tip_geom]
        np.testing.assert_allclose(way, -5.0 * 0.02 * 5 * lag, atol=1e-4)
