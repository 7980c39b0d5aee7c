"""Plans written by hand do in physics what they say; what goes wrong there is seen and told."""

import dataclasses
import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
import pytest
from armed import armed, limp
from handmade import BALL, TIP, WEIGHT, Interval, after, arc, around, build, compose, free_tips, line, scene, stay

from regrasp.control.controller import Control, agent_joints
from regrasp.control.tension import Release
from regrasp.plan import FIRST_SLIDE, OFF, STAY, Plan
from regrasp.verify.execution import EVERY, LOST, NEAR, Execution, geom_names
from regrasp.verify.physics import PERIOD, Physics, Reality, nominal
from regrasp.verify.replay import MODES, Bench, agreement

TICK = EVERY * PERIOD
FREE = ("hold", "carry", "roll", "slide", "relocate", "rim")
WITHIN = {name: (3e-4, np.radians(0.3)) for name in FREE} | {
    "push": (1e-3, np.radians(0.1)),
    "relocate": (3e-4, np.radians(0.5)),
    "finger": (1e-3, np.radians(1.0)),
}
"""m, rad, at the goal, open loop; on the way two and a half times as much."""


STIFF = Control(release=Release(between=0.0, sliding=0.0))
"""The impedance law alone: no strain is let go, so that forces and slides are what the joints say."""


def executed(plan: Plan, mode: str = "open", control: Control | None = None, **reality: object) -> Execution:
    bench = Bench(armed(plan), control or Control())
    return bench.run(mode, dataclasses.replace(nominal(bench.world), **reality), np.random.default_rng(0))


@pytest.fixture(scope="module")
def runs(handmade) -> dict[str, Execution]:
    """Every handmade plan executed open loop, as planned."""
    return {name: executed(plan) for name, (plan, _) in handmade.items()}


@pytest.mark.parametrize("name", WITHIN)
def test_a_plan_in_closed_form_is_what_happens(runs, handmade, name):
    run, (plan, world) = runs[name], handmade[name]
    assert run.trouble is None
    assert not run.touches
    assert not run.strained.any()
    assert np.all(run.off[-1] < WITHIN[name])
    assert np.all(run.off.max(axis=0) < 2.5 * np.array(WITHIN[name]))
    at = world.object_qpos
    np.testing.assert_allclose(run.qpos[-1, at : at + 3], plan.object_position[-1, -1], atol=WITHIN[name][0])
    last = run.qpos[-1, np.concatenate([agent.qpos for agent in world.agents])]
    assert np.abs(last - plan.joints[-1, -1]).max() < 0.02
    if name != "push":  # whose single tip meets the table's friction in jerks
        correlation, gain = agreement(run)
        assert correlation > 0.99
        assert gain == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("name", WITHIN)
def test_records_are_evenly_spaced_on_the_plans_clock(runs, handmade, name):
    run, (plan, _) = runs[name], handmade[name]
    assert 0.0 <= run.time[0] < TICK
    np.testing.assert_allclose(np.diff(run.time), TICK)
    assert run.time[-1] == pytest.approx(plan.time[-1, -1] + 0.5, abs=2 * TICK)  # and the hold
    inside = run.time < plan.time[-1, -1]
    expected = np.searchsorted(plan.time[:, 0], run.time[inside] + 1e-9, side="right") - 1
    assert np.abs(run.interval[inside] - expected).sum() <= len(plan.time)
    assert run.seconds == pytest.approx(run.time[-1] + 0.85, abs=2 * TICK)


@pytest.mark.parametrize("name", FREE)
def test_at_rest_the_measured_forces_balance_the_weight(runs, handmade, name):
    """Newton's third law of the bookkeeping: Σ f = −m g to a part in a thousand, and no moment about the centre."""
    run, (_, world) = runs[name], handmade[name]
    weight = world.scene.object.mass * 9.81
    np.testing.assert_allclose(run.force_W[-5:].sum(axis=1), np.tile([0, 0, weight], (5, 1)), atol=1e-3 * weight)


def test_forces_are_those_on_the_object_whichever_geom_comes_first(handmade):
    """MuJoCo sorts a pair by shape: a capsule comes after the ball, a sphere of the hand before it."""
    plan, _ = handmade["hold"]
    root = ElementTree.fromstring(plan.xml)
    for geom in root.iter("geom"):
        if "tip" in geom.get("name", ""):
            geom.set("type", "capsule")
            geom.set("size", "0.01 0.005")  # the same surface where it touches
    run = executed(dataclasses.replace(plan, xml=ElementTree.tostring(root, encoding="unicode")))
    assert run.trouble is None
    np.testing.assert_allclose(run.force_W[-1].sum(axis=0), [0, 0, WEIGHT], atol=1e-3 * WEIGHT)
    assert np.all(np.sum(run.force_W[-1] * run.planned_W[-1], axis=1) > 0.0)


@pytest.mark.parametrize("name", FREE)
def test_at_rest_every_tip_presses_as_its_impedance_says(handmade, name):
    """f = f_d + K (q_d − q) of a free-flying tip's slides: the planned force, less what the contact gives way."""
    plan, world = handmade[name]
    run = executed(plan, control=STIFF)
    bench = Bench(armed(plan), Control())
    slides = [mine.start + np.arange(3) for mine in agent_joints(world)]
    for i, (agent, mine) in enumerate(zip(world.agents, slides, strict=True)):
        way = plan.joints[-1, -1, mine] - run.qpos[-1, agent.qpos[:3]]
        wanted = plan.force_W[-1, -1, i] + bench.gains.K[mine] * way
        np.testing.assert_allclose(run.force_W[-1, i], wanted, atol=2e-3 * WEIGHT)
        assert run.force_W[-1, i] @ plan.force_W[-1, -1, i] > 0.5 * np.sum(plan.force_W[-1, -1, i] ** 2)


def test_a_relocating_tip_is_off_the_object(runs, handmade):
    """Between its take-off and its landing, give or take a tenth of a second."""
    run, (plan, _) = runs["relocate"], handmade["relocate"]
    begin, end = plan.time[1, [0, -1]]
    off = (run.time > begin + 0.1) & (run.time < end - 0.1)
    assert off.sum() * TICK > 0.5
    assert not run.force_W[off, 3].any()
    assert np.all(np.linalg.norm(run.force_W[run.time < begin - 0.02, 3], axis=1) > 0.0)
    assert np.all(np.linalg.norm(run.force_W[run.time > end + 0.1, 3], axis=1) > 0.0)


def test_slip_is_the_way_that_a_tip_slides_where_the_plan_has_it_stay(runs, handmade):
    """The plan slides by 6 mm and across that by 5 mm; told that it rolls or stays, the record holds them against the tip."""
    plan, _ = handmade["slide"]
    assert np.all(runs["slide"].slip[-1] < 1.5e-3)
    accused = executed(
        dataclasses.replace(plan, V=np.where(plan.V >= FIRST_SLIDE, STAY, plan.V).astype(np.int8)), control=STIFF
    )
    assert accused.slip[-1, 3] == pytest.approx(np.hypot(0.006, 0.005), abs=1e-3)
    halfway = accused.slip[np.searchsorted(accused.time, 1.0), 3]
    assert halfway == pytest.approx(0.006, abs=1e-3)
    np.testing.assert_allclose(accused.slip[-1, :3], executed(plan, control=STIFF).slip[-1, :3], atol=1e-9)


def test_with_too_little_friction_the_object_slips_through_the_fingers(handmade):
    """Three tips with twice its weight each would hold it with μ = 1/6; the slip is the way of the tips on the ball."""
    plan, world = handmade["hold"]
    held, lost = (executed(plan, friction=np.full(3, mu / 0.7)) for mu in (0.25, 0.15))
    assert held.trouble is None
    assert held.slip[-1].max() < 1e-4
    assert lost.trouble is not None
    assert (lost.trouble.what, lost.trouble.body) == ("dropped", "object")
    at = world.object_qpos
    way = [agent.qpos[:3] for agent in world.agents]
    for i, mine in enumerate(way):
        between = lost.qpos[:, mine] - lost.qpos[:, at : at + 3]
        slid = np.linalg.norm(np.diff(between, axis=0), axis=1).sum()
        assert slid > 2e-3
        speed = np.linalg.norm(between[-1] - between[-2]) / TICK
        assert abs(lost.slip[-1, i] - slid) < 1.2 * speed * TICK  # the sum's step


def test_without_forces_the_object_falls(handmade):
    """It counts as dropped when it is LOST radii below its path: after √(2 LOST R / g)."""
    run = executed(limp(handmade["hold"][0]))
    assert run.trouble is not None
    assert (run.trouble.what, run.trouble.body) == ("dropped", "object")
    assert run.trouble.time == pytest.approx(np.sqrt(2 * LOST * BALL / 9.81), abs=1.1 * TICK)
    assert run.time[-1] < run.trouble.time


def test_an_object_that_turns_over_is_dropped_too(handmade):
    """Held at a turn of 40° it goes on, at 52° it ends: 45° is the limit."""
    plan = handmade["hold"][0]
    still = Bench(armed(plan), Control())
    turned = dataclasses.replace(nominal(still.world), turn=np.array([0.0, 0.0, 0.9]))
    run = still.run("open", turned, np.random.default_rng(0))
    assert run.trouble is not None
    assert run.trouble.what == "dropped"
    run = still.run("open", dataclasses.replace(turned, turn=np.array([0.0, 0.0, 0.7])), np.random.default_rng(0))
    assert run.trouble is None
    assert run.off[-1, 1] == pytest.approx(0.7, abs=1e-3)


@pytest.mark.parametrize(("step", "time"), [(100, -0.65), (700, 0.55)])
def test_numbers_gone_bad_are_told_with_time_and_body(step, time, handmade, monkeypatch, tmp_path, capfd):
    """A NaN in a tip's rate; MuJoCo would by default put everything back to the start and go on, and write a log."""
    monkeypatch.chdir(tmp_path)
    plan, world = handmade["hold"]
    taken, real = [0], Physics.step

    def planted(physics: Physics, command) -> None:
        taken[0] += 1
        if taken[0] == step:
            physics.data.qvel[world.agents[1].dofs[4]] = np.nan
        real(physics, command)

    monkeypatch.setattr(Physics, "step", planted)
    run = executed(plan)
    assert run.trouble is not None
    assert run.trouble.body == "robot/tip1"
    assert run.trouble.time == pytest.approx(time, abs=1.5 * TICK)
    assert taken[0] - step <= EVERY
    assert np.isfinite(run.qpos).all()
    assert np.isfinite(run.error).all()
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")


def test_whoever_listens_to_mujocos_warnings_gets_them_back(handmade):
    heard: list[str] = []
    mujoco.set_mju_user_warning(heard.append)
    try:
        executed(handmade["hold"][0])
        model = mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
        )
        data = mujoco.MjData(model)
        data.qvel[0] = np.nan
        mujoco.mj_step(model, data)
    finally:
        mujoco.set_mju_user_warning(None)
    assert len(heard) == 1


def test_tips_that_are_too_light_for_their_stiffness_are_driven_all_the_same(handmade):
    """Hinges of 2e-6 kg m², as the handmade plans have them: the period bounds their gains."""
    plan, _ = handmade["carry"]
    for mode in MODES:
        run = Bench(plan, Control()).run(mode, nominal(handmade["carry"][1]), np.random.default_rng(0))
        assert run.trouble is None
        assert np.all(run.off[-1] < WITHIN["carry"])


def contacts_of(plan: Plan, tip: dict[str, str], thing: dict[str, str]) -> Plan:
    """The plan with other settings for the contacts of tips and object."""
    root = ElementTree.fromstring(plan.xml)
    for geom in root.iter("geom"):
        for prefix, settings in (("robot/tip", tip), ("object", thing)):
            if geom.get("name", "").startswith(prefix):
                for key, value in settings.items():
                    geom.set(key, value)
    return dataclasses.replace(plan, xml=ElementTree.tostring(root, encoding="unicode"))


@pytest.mark.parametrize("condim", [3, 4, 6])
def test_forces_and_slip_are_read_whatever_the_contacts_dimension(condim, handmade):
    """At rest the forces bear the weight; a plan that slides, told that it stays, is accused of its slides."""
    for name in ("hold", "slide"):
        plan = handmade[name][0]
        plan = dataclasses.replace(plan, V=np.where(plan.V >= FIRST_SLIDE, STAY, plan.V).astype(np.int8))
        run = executed(contacts_of(plan, {"condim": f"{condim}"}, {"condim": f"{condim}"}), control=STIFF)
        assert run.trouble is None
        np.testing.assert_allclose(run.force_W[-1].sum(axis=0), [0, 0, WEIGHT], atol=1e-3 * WEIGHT)
        assert np.all(run.slip[-1, :3] < 5e-4)
        if name == "slide":
            assert run.slip[-1, 3] == pytest.approx(np.hypot(0.006, 0.005), abs=1e-3)


def test_without_friction_forces_are_normal_and_the_slip_is_the_way(handmade):
    """condim 1: the ball falls through the fingers, which slip over it as it goes; every force is along its normal."""
    plan, world = handmade["hold"]
    run = executed(contacts_of(plan, {"condim": "1"}, {"condim": "1"}))
    assert run.trouble is not None
    assert run.trouble.what == "dropped"
    at = world.object_qpos
    touching = np.linalg.norm(run.force_W, axis=2) > 0.0
    assert touching[: len(touching) // 2].all()
    for i, agent in enumerate(world.agents):
        between = run.qpos[:, at : at + 3] - run.qpos[:, agent.qpos[:3]]
        across = np.linalg.norm(np.cross(run.force_W[:, i], between), axis=1)
        assert np.all(across <= 0.05 * np.linalg.norm(run.force_W[:, i], axis=1) * np.linalg.norm(between, axis=1))
        middle = len(run.time) // 2
        fallen = np.linalg.norm(between[middle] - between[0])
        speed = np.linalg.norm(between[middle] - between[middle - 1])
        assert fallen > 5e-4
        assert 0.5 * fallen < run.slip[middle, i] < fallen + 1.5 * speed


def low(plan: Plan, share: float) -> Plan:
    """The relocation of agent 3 with its flight pulled down by a share of its height over its ends."""
    joints = plan.joints.copy()
    centre, tip = plan.object_position[1], slice(18, 21)
    arm = joints[1, :, tip] - centre
    height, rest = np.linalg.norm(arm, axis=1, keepdims=True), BALL + TIP
    joints[1, :, tip] = centre + arm / height * (rest + (1.0 - share) * (height - rest))
    return dataclasses.replace(plan, joints=joints)


def test_a_relocating_tip_that_brushes_the_object_is_noted(handmade):
    """Away from take-off and landing; the plan's own flight over the ball is no touch."""
    plan, _ = handmade["relocate"]
    run = executed(low(plan, 1.03))
    assert [(touch.first, touch.second) for touch in run.touches] == [("tip3", "object")]
    begin, end = plan.time[1, [0, -1]]
    assert begin + NEAR <= run.touches[0].time <= end - NEAR
    assert run.force_W[(run.time > begin + NEAR) & (run.time < end - NEAR), 3].any()  # and what it presses is told


def test_a_finger_that_is_off_the_object_all_the_time_must_not_touch_it(handmade):
    plan, _ = handmade["relocate"]
    bare = {name: getattr(plan, name).copy() for name in ("p_OC_O", "n_O", "x_O", "force_W")}
    for name, array in bare.items():
        array[:, :, 3] = 0.0 if name == "force_W" else np.nan
    run = executed(dataclasses.replace(plan, V=np.where(np.arange(4) == 3, OFF, plan.V).astype(np.int8), **bare))
    assert ("tip3", "object") in [(touch.first, touch.second) for touch in run.touches]


def test_links_are_called_by_their_bodies_and_tips_by_their_agents(handmade):
    world = handmade["finger"][1]
    names, rank = geom_names(world, world.model)
    agent = world.agents[0]
    assert names[agent.tip_geom] == agent.name
    links = [names[geom] for geom in agent.geoms if geom != agent.tip_geom]
    assert links
    assert all(name.startswith(f"{agent.name}/link") for name in links)
    assert {names[geom] for geom in world.object_geoms} == {"object"}
    assert [names[geom] for geom in world.support_geoms] == ["table"]
    assert [set(rank[geoms]) for geoms in (agent.geoms, world.object_geoms, world.support_geoms)] == [{0}, {1}, {2}]


def test_a_contact_that_the_plan_does_not_have_is_noted(tmp_path):
    """A post that the ball's path passes 1.5 mm too near: touched where the distance of the centres is R + ρ."""
    three = [stay(n, squeeze=2.0) for n in around(3)]
    post = np.array([0.02, 0.0, 0.02 + BALL + 0.01 - 1.5e-3])
    R, p = after(arc, line)(1.0)
    data = scene(
        free_tips(tmp_path / "post.xml", 3), 3,
        environment=[{"name": "post", "shape": "sphere", "size": [0.01], "pose": {"position": post.tolist()}}],
        goal={"pose": {"position": p.tolist(), "quaternion": R.as_quat(scalar_first=True).tolist()}},
    )  # fmt: skip
    run = executed(compose(build(data), [Interval(arc, three), Interval(after(arc, line), three)]))
    u = np.linspace(0, 1, 2001)
    meets = u[np.argmax([np.linalg.norm(arc(x)[1] - post) < BALL + 0.01 for x in u])]
    assert 0.5 < meets < 1.0
    assert (run.touches[0].first, run.touches[0].second) == ("object", "post")
    assert run.touches[0].time == pytest.approx(meets, abs=0.03)


@pytest.mark.parametrize(("limit", "strained"), [(10.0, False), (0.1, True)])
def test_a_drive_at_its_limit_is_recorded(limit, strained, handmade):
    """The finger presses the ball on the table with two weights at a lever of some 15 cm: 0.2 to 0.3 N m at the base."""
    plan, _ = handmade["finger"]
    root = ElementTree.fromstring(plan.xml)
    joint = next(each for each in root.iter("joint") if each.get("name") == plan.joint_names[0])
    joint.set("actuatorfrcrange", f"{-limit} {limit}")
    run = executed(dataclasses.replace(plan, xml=ElementTree.tostring(root, encoding="unicode")))
    assert run.strained.any() == strained


def test_feedback_puts_a_displaced_object_in_its_place(handmade):
    plan, _ = handmade["carry"]
    off = {"shift": np.array([1e-3, 0.5e-3, -1.5e-3]), "turn": np.array([0.02, -0.02, 0.03])}
    alone, seen = (executed(plan, mode, **off) for mode in ("open", "feedback"))
    assert np.all(alone.off[-1] > [8e-4, 0.02])
    assert np.all(seen.off[-1] < 0.1 * alone.off[-1])


def test_measured_noise_stays_out_of_the_objects_pose(handmade):
    """Of 1 mm and 1° per measurement a small part is left, as the integrator leaves it."""
    run = executed(handmade["hold"][0], "feedback", noise=(1e-3, np.radians(1.0)))
    assert run.trouble is None
    spread = run.error[len(run.time) // 3 :].std(axis=0)
    assert np.all(spread[:3] < 0.3e-3)
    assert np.all(spread[3:] < np.radians(0.3))
    blurred = executed(handmade["hold"][0], "feedback", noise=(0.0, np.radians(1.0)))
    clear = executed(handmade["hold"][0], "feedback")
    turns = [each.error[len(each.time) // 3 :, 3:].std() for each in (blurred, clear)]
    assert turns[0] > 10.0 * turns[1]


def test_late_contacts_shift_when_a_tip_takes_off(handmade):
    """Timing errors reach the execution: the flight begins and ends earlier or later, by at most the bound."""
    plan, _ = handmade["relocate"]
    bench = Bench(armed(plan), Control())
    reality: Reality = dataclasses.replace(nominal(bench.world), delay=0.05)
    flights = []
    for seed in range(3):
        run = bench.run("open", reality, np.random.default_rng(seed))
        assert run.trouble is None
        flights.append(run.time[~run.bears[:, 3]][[0, -1]])
    assert len({tuple(flight) for flight in flights}) == 3
    assert np.abs(np.array(flights) - plan.time[1, [0, -1]]).max() <= 0.05 + 1.5 * TICK


def test_the_same_execution_twice_is_the_same(handmade, runs):
    again = executed(handmade["carry"][0])
    for each in dataclasses.fields(again):
        if isinstance(value := getattr(again, each.name), np.ndarray):
            assert np.array_equal(value, getattr(runs["carry"], each.name)), each.name


@pytest.mark.parametrize("name", ["rim", "hold"])
def test_the_fingers_come_from_where_they_touch_nothing(handmade, name):
    """Free at the standoff; where the approach ends every tip touches the object, to a tenth of a millimetre."""
    plan, world = handmade[name]
    bench = Bench(armed(plan), Control())
    physics = Physics(bench.world, nominal(bench.world), bench.gains)
    found = []
    for row in (0, bench.reference.touch):
        physics.place(bench.reference.q[row])
        mujoco.mj_fwdPosition(physics.model, physics.data)
        tips = [agent.tip_geom for agent in world.agents]
        gaps = [
            min(
                mujoco.mj_geomDistance(physics.model, physics.data, tip, int(geom), 1.0, None)
                for geom in world.object_geoms
            )
            for tip in tips
        ]
        found.append(gaps)
    np.testing.assert_allclose(found[0], Control().phases.standoff, atol=3e-4)
    np.testing.assert_allclose(found[1], 0.0, atol=1e-4)
