"""The certificate accepts plans worked out by hand and refuses them after one change, by the finding that names it."""

import dataclasses

import mujoco
import numpy as np
import pytest
from handmade import (
    BALL,
    TIP,
    Hold,
    Interval,
    M,
    across,
    arc,
    around,
    build,
    compose,
    relocate,
    roll,
    slide,
    stay,
    still,
)
from handmade_plans import MAKERS, TOP
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from regrasp.errors import InputError
from regrasp.plan import ARRAYS, MOTIONS, Plan
from regrasp.verify.check import check
from regrasp.verify.contacts import touching

BEYOND = {
    # array: smallest change beyond every tolerance, findings of which at least one must object
    "object_position": (5e-4, {"contact gap", "contact point", "slip", "balance", "support point", "start position"}),
    "object_quaternion": (2e-2, {"quaternions", "slip", "spin", "contact point", "start rotation", "support normal"}),
    "twist": (2e-2, {"stated rotation", "stated slide", "idle twist"}),
    "p_OC_O": (9e-4, {"contact point"}),
    "n_O": (1e-1, {"normal length", "contact normal"}),
    "x_O": (5e-2, {"contact frame", "frame transport"}),
    "force_W": (1e-4, {"balance", "free of force"}),
    "support_p_O": (4e-4, {"support point", "balance"}),
    "support_n_W": (5e-2, {"support normal", "support normal length"}),
    "support_force_W": (1e-4, {"balance"}),
    "route": (5e-3, {"route", "quaternions"}),
}
UNABLE = {MOTIONS.index("roll+y"), MOTIONS.index("roll-y")}
BELOW = dict.fromkeys(BEYOND, 1e-09) | {"joints": 1e-9}


def change(plan: Plan, name: str, index: tuple[int, ...] | slice, value: object) -> Plan:
    array = getattr(plan, name).copy()
    array[index] = value
    return dataclasses.replace(plan, **{name: array})


def refusals(plan: Plan) -> set[str]:
    return {finding.name for finding in check(plan).refusals}


def pick(data: st.DataObject, handmade, names=tuple(MAKERS)):
    name = data.draw(st.sampled_from(names))
    return handmade[name][0]


def an_entry(data: st.DataObject, array: np.ndarray) -> tuple[int, ...]:
    """An entry of an array, never one of the NaN that mean no contact."""
    entries = np.argwhere(~np.isnan(array))
    return tuple(entries[data.draw(st.integers(0, len(entries) - 1))])


@pytest.mark.parametrize("name", MAKERS)
def test_accepts_what_is_right(handmade, name):
    plan, world = handmade[name]
    certificate = check(plan)
    assert certificate.passed, "\n".join(map(str, certificate.refusals))
    assert check(plan, world) == certificate


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_refuses_one_number_changed_beyond_tolerance(handmade, data):
    plan = pick(data, handmade)
    name = data.draw(st.sampled_from([name for name in BEYOND if getattr(plan, name).size]))
    array = getattr(plan, name)
    index = an_entry(data, array)
    step, expected = BEYOND[name]
    size = step * data.draw(st.sampled_from([1.0, 3.0, 30.0])) * data.draw(st.sampled_from([-1.0, 1.0]))
    assert refusals(change(plan, name, index, array[index] + size)) & expected


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_refuses_one_joint_moved_in_contact(handmade, data):
    plan = pick(data, handmade)
    j, a = np.argwhere(touching(plan))[data.draw(st.integers(0, int(touching(plan).sum()) - 1))]
    width = plan.joints.shape[2] // plan.V.shape[1]
    m, i = data.draw(st.integers(0, M - 1)), data.draw(st.integers(0, width - 1))
    size = (5e-4 if "slide" in plan.joint_names[i] else 3e-2) * data.draw(st.sampled_from([-1.0, 1.0]))
    changed = change(plan, "joints", (j, m, width * a + i), plan.joints[j, m, width * a + i] + size)
    assert refusals(changed) & {"contact gap", "contact point", "slip", "slide by V", "rotation by V", "stated slide"}


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_accepts_one_number_changed_well_below_tolerance(handmade, data):
    plan = pick(data, handmade)
    name = data.draw(st.sampled_from([name for name in BELOW if getattr(plan, name).size]))
    array = getattr(plan, name)
    contact = np.broadcast_to(touching(plan)[:, :, None], plan.twist.shape)
    # an idle agent's twist and force must be exactly zero
    free = {"twist": contact, "force_W": np.broadcast_to(touching(plan)[:, None, :, None], plan.force_W.shape)}
    array = np.where(free.get(name, True), array, np.nan)
    index = an_entry(data, array)
    edge = name in ("object_position", "object_quaternion", "joints") and index[1] in (0, M - 1)
    size = BELOW[name] * (0.1 if edge else 1.0)  # the ends of intervals are stated twice and must be the same
    assert not refusals(change(plan, name, index, array[index] + size))


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_refuses_what_is_not_finite(handmade, data):
    plan = pick(data, handmade)
    name = data.draw(st.sampled_from([n for n, (t, _) in ARRAYS.items() if t is np.float64 and getattr(plan, n).size]))
    array = getattr(plan, name)
    flat = data.draw(st.integers(0, array.size - 1))
    index = np.unravel_index(flat, array.shape)
    bad = data.draw(st.sampled_from([np.nan, np.inf, -np.inf, 1e300]))
    if (np.isnan(array[index]) and np.isnan(bad)) or (name == "energy" and bad == 1e300):
        bad = -np.inf
    assert refusals(change(plan, name, index, bad)) & {"finite", "contact arrays"}


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_refuses_another_contact_motion_in_V(handmade, data):
    plan = pick(data, handmade)
    index = an_entry(data, plan.V)
    idle = {MOTIONS.index("relocate"), MOTIONS.index("off")}
    true = int(plan.V[index])
    codes = [c for c in range(-1, 12) if c != true and not {c, true} <= idle]
    if plan.joints.shape[2] == 3 and true == 0:
        codes = [c for c in codes if c not in UNABLE]
    expected = {"codes", "contact arrays", "roll happens", "slide happens", "rotation by V", "slide by V", "slip"}
    assert refusals(change(plan, "V", index, data.draw(st.sampled_from(codes)))) & expected


@pytest.mark.parametrize(
    ("name", "index", "value", "expected"),
    [
        ("segment", (0,), 1, "codes"),
        ("segment", (1,), 3, "codes"),
        ("energy_segment", (0,), 7, "codes"),
        ("time", (1, 0), 1.01, "continuity"),
        ("time", (0, 3), 0.7, "time order"),
        ("time", (0, 1), 0.0, "time order"),
        ("support_mode", (0, 0), 1, "support stick"),
        ("support_mode", (0, 0), 0, "free of force"),
        ("support_mode", (0, 0), 3, "codes"),
    ],
)
def test_refuses_codes_and_times_out_of_order(handmade, name, index, value, expected):
    plan = handmade["push" if name == "support_mode" else "roll"][0]
    assert expected in refusals(change(plan, name, index, value))


@pytest.mark.parametrize("name", ["carry", "roll", "slide", "relocate"])
def test_refuses_a_deleted_interval(handmade, name):
    plan = handmade[name][0]
    intervals = [n for n, (_, shape) in ARRAYS.items() if shape[0] == "N"]
    for j, expected in ((1, {"continuity", "goal position"}), (-1, {"goal position", "route"})):
        cut = dataclasses.replace(plan, **{n: np.delete(getattr(plan, n), j, axis=0) for n in intervals})
        assert refusals(cut) & expected


@pytest.mark.parametrize("name", ["carry", "roll", "slide"])
def test_refuses_a_plan_run_backwards(handmade, name):
    plan = handmade[name][0]
    flipped = {n: getattr(plan, n)[::-1, ::-1] for n, (_, shape) in ARRAYS.items() if shape[:2] == ("N", "M")}
    backwards = dataclasses.replace(plan, **flipped | {"V": plan.V[::-1], "time": plan.time})
    found = refusals(backwards)
    assert "start position" in found
    assert name == "carry" or found & {"rotation by V", "slide by V"}
    assert "time order" in refusals(dataclasses.replace(plan, time=plan.time[::-1, ::-1]))


def test_refuses_what_is_right_only_at_the_samples(handmade):
    plan = handmade["carry"][0]
    sampled = {n: getattr(plan, n)[:, ::4] for n, (_, shape) in ARRAYS.items() if shape[:2] == ("N", "M")}
    assert "spin" in refusals(dataclasses.replace(plan, **sampled))


def test_refuses_haste(handmade):
    plan = handmade["carry"][0]
    assert refusals(dataclasses.replace(plan, time=plan.time * 0.01)) == {"joint speed"}


def test_refuses_forces_that_balance_but_break_one_law(handmade):
    plan = handmade["carry"][0]
    R = Rotation.from_quat(plan.object_quaternion.reshape(-1, 4), scalar_first=True)
    inward = np.stack([R.apply(-n) for n in around(3)], axis=1).reshape(plan.force_W.shape)

    def squeezed(by: float) -> set[str]:
        return refusals(dataclasses.replace(plan, force_W=plan.force_W + by * inward))  # three equal ones cancel

    assert squeezed(1.0) == set()
    assert "normal force" in squeezed(30.0) <= {"normal force", "force correction"}
    assert "friction cone" in squeezed(-3.2) <= {"friction cone", "force correction"}
    assert "pull" in squeezed(-6.0)


def test_refuses_forces_of_an_agent_in_the_air(handmade):
    plan = handmade["relocate"][0]
    force = plan.force_W.copy()
    force[1, 4, 3], force[1, 4, 0] = force[1, 4, 3] + [0, 0, 1e-5], force[1, 4, 0] - [0, 0, 1e-5]
    assert "free of force" in refusals(dataclasses.replace(plan, force_W=force))


def single(handmade, name: str, hold: Hold, pose=still) -> Plan:
    """One interval of the named plan's world in which the last tip does `hold` while three others stay."""
    world = handmade[name][1]
    three = [stay(n, squeeze=2.0) for n in around(3)]
    return compose(world, [Interval(pose, [*three, hold])])


MISSES_GOAL = {"goal position", "goal rotation"}


@pytest.mark.parametrize(
    ("hold", "expected"),
    [
        (dataclasses.replace(slide(TOP, "slide+x", 0.004), code="stay", slip=None, twist=(0, 0, 0, 0)), "slip"),
        (dataclasses.replace(roll(TOP, "roll+x", 0.3), code="stay"), "rotation by V"),
        (dataclasses.replace(roll(TOP, "roll+x", 0.3), code="roll-x"), "roll happens"),
        (dataclasses.replace(roll(TOP, "roll+x", 0.3), code="roll+y"), "roll happens"),
        (dataclasses.replace(slide(TOP, "slide+x", 0.004), code="slide+y"), "slide happens"),
        (dataclasses.replace(slide(TOP, "slide+x", 0.004), slip=lambda u: across(TOP)[[1, 0, 2]]), "sliding direction"),
        (dataclasses.replace(slide(TOP, "slide+x", 0.004), slip=lambda u: np.zeros(3)), "sliding force"),
        (roll(TOP, "roll+x", 0.0), "roll happens"),
        (relocate(TOP, around(4, 0.5)[0], height=-0.004), "penetration"),
        (relocate(TOP, around(3, 0.3)[0]), "penetration"),  # lands in another tip
    ],
)  # fmt: skip
def test_refuses_a_motion_under_a_false_name(handmade, hold, expected):
    assert expected in refusals(single(handmade, "roll", hold))


def test_accepts_a_command_that_the_agent_cannot_follow(handmade):
    """A planar finger told to roll out of its plane meets the command in the least-squares sense: it stays."""
    plan = handmade["finger"][0]
    for code in UNABLE:
        assert not refusals(change(plan, "V", (1, 0), code))
        assert "rotation by V" in refusals(change(plan, "V", (0, 0), code))


def test_refuses_spin_about_the_normal(handmade):
    def spinning(angle: float) -> Hold:
        return dataclasses.replace(stay(TOP), tip=lambda u: (Rotation.from_rotvec(angle * u * TOP), (BALL + TIP) * TOP))

    assert refusals(single(handmade, "roll", spinning(0.0), arc)) <= MISSES_GOAL
    assert {"spin", "rotation by V"} == refusals(single(handmade, "roll", spinning(0.02), arc)) - MISSES_GOAL


@pytest.mark.parametrize(
    ("name", "changes", "expected"),
    [
        ("carry", {"object": {"shape": "sphere", "size": [BALL], "mass": 0.21}}, "model and scene"),
        ("carry", {"object": {"shape": "sphere", "size": [BALL + 1e-3], "mass": 0.2}}, "model and scene"),
        ("slide", {"friction": 0.75}, "model and scene"),
        ("carry", {"gravity": [0, 0, -9.7]}, "model and scene"),
        ("push", {"environment": [{"name": "table", "shape": "plane", "friction": 0.4}]}, "model and scene"),
        ("carry", {"goal": {"pose": {"position": [0.1, 0, 0]}}}, "goal position"),
        ("carry", {"start": {"pose": {"position": [1e-5, 0, 0]}}}, "start position"),
        ("carry", {"max_force": 3.0}, "normal force"),
        ("carry", {"start": {"pose": {"position": [0, 0, 0]}, "grasp": [
            {"agent": f"tip{i}", "point": (BALL * n).tolist()} for i, n in enumerate(around(3, 0.01))]}},
         "start points"),
        ("carry", {"start": {"pose": {"position": [0, 0, 0]}, "grasp": [
            {"agent": f"tip{i}", "joints": [*((BALL + TIP) * n), 0, 0, 1e-5]} for i, n in enumerate(around(3))]}},
         "start joints"),
        ("carry", {"start": {"pose": {"position": [0, 0, 0]}, "off": ["tip1"]}}, "start modes"),
    ],
)  # fmt: skip
def test_refuses_a_scene_made_easier(handmade, name, changes, expected):
    plan = handmade[name][0]
    assert expected in refusals(dataclasses.replace(plan, scene={**plan.scene, **changes}))


@pytest.mark.parametrize(
    ("name", "changes", "expected"),
    [
        ("carry", {"object": {"shape": "sphere", "size": [BALL], "mass": 0.21}}, "balance"),
        ("carry", {"gravity": [0, 0, -9.7]}, "balance"),
        ("slide", {"friction": 0.75}, "sliding force"),
        ("carry", {"object": {"shape": "sphere", "size": [BALL - 2e-4], "mass": 0.2}}, "contact gap"),
        ("carry", {"environment": [{"name": "wall", "shape": "box", "size": [0.001, 0.1, 0.1],
                                    "pose": {"position": [0.07, 0, 0]}}]}, "penetration"),
    ],
)  # fmt: skip
def test_refuses_in_a_consistently_changed_world(handmade, name, changes, expected):
    plan, old = handmade[name]
    world = build({**old.scene.model_dump(mode="json"), **changes})
    moved = dataclasses.replace(plan, scene=world.scene.model_dump(mode="json"), xml=world.xml)
    assert expected in refusals(moved)
    assert any(finding.name == "model and world" for finding in check(plan, world).refusals)


@pytest.mark.parametrize(
    ("name", "number", "other"),
    [
        ("carry", 'mass="0.2"', 'mass="0.1"'),
        ("carry", 'inertial pos="0.0 0.0 0.0"', 'inertial pos="0.0 0.0 0.001"'),
        ("carry", 'friction="0.7"', 'friction="0.8"'),
        ("push", 'size="0.03 0.027 0.027"', 'size="0.03 0.027 0.0275"'),
    ],
)
def test_refuses_a_model_that_is_not_the_scenes(handmade, name, number, other):
    plan = handmade[name][0]
    assert number in plan.xml
    assert refusals(dataclasses.replace(plan, xml=plan.xml.replace(number, other))) == {"model and scene"}


def test_refuses_another_models_names(handmade):
    plan = handmade["carry"][0]
    assert refusals(dataclasses.replace(plan, agent_names=("a", "b", "c"))) == {"names"}


def test_a_model_that_cannot_be_built_is_bad_input(handmade):
    plan = handmade["carry"][0]
    for broken in (plan.xml[:200], "<mujoco/>", plan.xml.replace('name="object"', 'name="thing"')):
        with pytest.raises(InputError, match=r"plan\.xml"):
            check(dataclasses.replace(plan, xml=broken))


def test_the_certificate_is_json_with_places(handmade):
    import json

    plan = handmade["roll"][0]
    certificate = check(change(plan, "p_OC_O", (1, 3, 2, 0), plan.p_OC_O[1, 3, 2, 0] + 1e-3))
    refusal = next(finding for finding in certificate.refusals if finding.name == "contact point")
    assert (refusal.interval, refusal.time, refusal.who) == (1, plan.time[1, 3], "tip2")
    assert refusal.value == pytest.approx(1e-3, rel=0.05)
    text = json.dumps(certificate.to_dict(), allow_nan=False)
    assert json.loads(text)["passed"] is False
    assert "tip2, interval 1" in str(refusal)


def test_mujoco_nearest_points_survive_the_backoff():
    """Why contacts are measured with the tip backed off: flat tips lose 0.2 mm when touching, nothing when apart."""
    xml = """<mujoco><worldbody><geom type="ellipsoid" size=".03 .04 .06"/>
    <body><freejoint/><geom type="box" size=".02 .015 .01"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    lost = {0.0: 0.0, 1e-3: 0.0}
    for _ in range(200):
        u = rng.normal(size=3)
        u /= np.linalg.norm(u)
        p, n = u * [0.03, 0.04, 0.06], u / [0.03, 0.04, 0.06]
        n /= np.linalg.norm(n)
        mujoco.mju_quatZ2Vec(data.qpos[3:7], n)
        for off in lost:
            data.qpos[:3] = p + (0.01 + off) * n
            mujoco.mj_kinematics(model, data)
            fromto = np.zeros(6)
            mujoco.mj_geomDistance(model, data, 0, 1, 1.0, fromto)
            lost[off] = max(lost[off], float(np.linalg.norm(fromto[:3] - p)))
    assert lost[1e-3] < 2e-5 < 1e-4 < lost[0.0]
