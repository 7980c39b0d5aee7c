"""Joints that follow others: what MJCF and URDF say of them, and what no plan can have."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from regrasp.errors import InputError
from regrasp.scene.doctor import examine
from regrasp.scene.load import validate
from regrasp.scene.world import World, build, from_plan

FINGER = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="one"><joint name="a" axis="0 1 0" range="-1 1" ref="0.1"/><geom size="0.01"/>
  <body name="two" pos="0 0 0.1"><joint name="b" axis="0 1 0" range="-0.5 1"/><geom size="0.01"/>
  <body name="three" pos="0 0 0.1"><joint name="c" axis="0 1 0" range="-2 2"/><geom size="0.01"/>
  <geom name="tip" size="0.012" pos="0 0 0.1"/></body></body></body>
  <body name="other" pos="0.3 0 0"><joint name="d" axis="0 1 0" range="-1 1"/><geom size="0.01"/>
  <geom name="tip2" size="0.012" pos="0 0 0.1"/></body>
</worldbody>{}</mujoco>"""

LINK = """<link name="{0}"><inertial><mass value="0.1"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><sphere radius="0.01"/></geometry></collision></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="0 0 0.1"/>
<axis xyz="0 1 0"/><limit lower="0" upper="1" effort="1" velocity="1"/>{3}</joint>"""


def world(path: Path, text: str, tips: tuple[str, ...] = ("tip", "tip2"), home: list[float] | None = None) -> World:
    path.write_text(text)
    agents = [{"name": tip, "tip": tip} for tip in tips]
    pose = {"pose": {"position": [0, 0, 0.6]}}
    return build(validate({
        "name": "r", "model": {"file": str(path)}, "agents": [{**agents[0], "home": home}, *agents[1:]],
        "object": {"shape": "sphere", "size": [0.03], "mass": 0.1}, "start": pose, "goal": pose,
    }))  # fmt: skip


def test_followers_of_followers_follow_the_free_one(tmp_path: Path) -> None:
    """Joint c = 0.2 + 2 b and b = −0.5 (a − 0.1): one freedom, and what the model's own constraint asks of it."""
    bonds = "".join(
        f'<joint joint1="{y}" joint2="{x}" polycoef="{a} {b} 0 0 0"/>'
        for y, x, a, b in (("c", "b", 0.2, 2.0), ("b", "a", 0.0, -0.5))
    )
    made = world(tmp_path / "r.xml", FINGER.format(f"<equality>{bonds}</equality>"))
    agent = made.agents[0]
    assert agent.freedom == 1
    assert made.agents[1].freedom == 1
    data = mujoco.MjData(made.model)
    for turn in (-0.7, 0.0, 0.4):
        q = agent.coupling.expand(np.array([turn, 9.0, 9.0]))
        np.testing.assert_allclose(q, [turn, -0.5 * (turn - 0.1), 0.2 - (turn - 0.1)])
        data.qpos[agent.qpos] = q
        mujoco.mj_forward(made.model, data)
        np.testing.assert_allclose(data.efc_pos[: data.ne], 0.0, atol=1e-12)
    np.testing.assert_allclose(agent.home, agent.coupling.expand(agent.home), atol=1e-15)
    assert from_plan(made.scene.model_dump(mode="json"), made.xml, made.assets).agents[0].freedom == 1


def test_the_ranges_of_followers_bound_their_master(tmp_path: Path) -> None:
    bonds = '<equality><joint joint1="b" joint2="a" polycoef="0.1 -.5 0 0 0"/></equality>'
    agent = world(tmp_path / "r.xml", FINGER.format(bonds)).agents[0]
    lower, upper = agent.coupling.narrowed(agent.lower, agent.upper)
    for master in np.linspace(-1.5, 1.5, 301):
        q = agent.coupling.expand(np.array([master, 0.0, 0.0]))
        inside = np.all((q >= agent.lower - 1e-12) & (q <= agent.upper + 1e-12))
        assert inside == (lower[0] - 1e-12 <= master <= upper[0] + 1e-12)


def test_a_tendon_that_couples_two_joints_is_as_good_as_their_constraint(tmp_path: Path) -> None:
    """1.5 (a − 0.1) − 0.5 c = 0.05, which MuJoCo's own residual of the tendon says too."""
    tendon = '<tendon><fixed name="t"><joint joint="a" coef="1.5"/><joint joint="c" coef="-.5"/></fixed></tendon>'
    text = FINGER.format(tendon + '<equality><tendon tendon1="t" polycoef="0.05 0 0 0 0"/></equality>')
    made = world(tmp_path / "r.xml", text)
    agent = made.agents[0]
    assert agent.freedom == 2
    assert "tendon 't' makes joint 'c' follow 'a'" in made.repairs
    theirs = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(theirs)
    data.qpos[:3] = agent.coupling.expand(np.array([0.3, 0.1, 0.0]))
    mujoco.mj_forward(theirs, data)
    np.testing.assert_allclose(data.efc_pos[: data.ne], 0.0, atol=1e-12)


def test_a_tendon_that_only_drives_is_left_out_and_said_so(tmp_path: Path) -> None:
    tendon = '<tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="b" coef="1"/></fixed></tendon>'
    made = world(tmp_path / "r.xml", FINGER.format(tendon + '<actuator><motor tendon="t"/></actuator>'))
    assert made.agents[0].freedom == 3
    assert any(said.startswith("tendon 't' is left out: 'a', 'b' move each by itself") for said in made.repairs)


def test_a_urdfs_mimic_joint_follows(tmp_path: Path) -> None:
    text = "".join([
        '<robot name="r">', *map(LINK.format, ("base", "l1", "l2")), JOINT.format("j1", "base", "l1", ""),
        JOINT.format("j2", "l1", "l2", '<mimic joint="j1" multiplier="0.5" offset="0.1"/>'), "</robot>",
    ])  # fmt: skip
    agent = world(tmp_path / "r.urdf", text, ("l2",)).agents[0]
    assert agent.freedom == 1
    np.testing.assert_allclose(agent.coupling.expand(np.array([0.6, 0.0])), [0.6, 0.4])


def test_a_followers_own_drive_is_left_out(tmp_path: Path) -> None:
    more = (
        '<equality><joint joint1="b" joint2="a"/></equality><actuator><motor joint="b"/><motor joint="a"/></actuator>'
    )
    made = world(tmp_path / "r.xml", FINGER.format(more))
    assert made.model.nu == 1
    assert "joint 'b' follows 'a': its own drive is left out" in made.repairs


@pytest.mark.parametrize(
    ("bond", "reason"),
    [
        ('<joint joint1="a" joint2="b" polycoef="0 1 0.5 0 0"/>', "couples 'a' and 'b' by a curve"),
        ('<joint joint1="a" joint2="d"/>', "couples 'a' and 'd', not of one chain"),
        ('<joint joint1="a" joint2="b" polycoef="0.1 0 0 0 0"/>', "couples 'a' and 'b' with a ratio of 0"),
        ('<joint joint1="a"/>', "holds 'a' where it is"),
        ('<joint joint1="a" joint2="b"/><joint joint1="b" joint2="a"/>', "couple 'a' in a ring"),
        ('<joint joint1="c" joint2="a"/><joint joint1="c" joint2="b"/>', "two equality constraints move 'c'"),
    ],
)
def test_other_bonds_are_refused_with_a_remedy(tmp_path: Path, bond: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason) as error:
        world(tmp_path / "r.xml", FINGER.format(f"<equality>{bond}</equality>"))
    assert error.value.hint


def test_a_home_that_tears_a_coupling_is_refused_with_the_right_value(tmp_path: Path) -> None:
    bonds = '<equality><joint joint1="b" joint2="a" polycoef="0.1 -.5 0 0 0"/></equality>'
    with pytest.raises(InputError, match=r"agents\.0\.home: value 2 is 0\.3, but 'robot/b' follows 'robot/a' \(0\.1\)"):
        world(tmp_path / "r.xml", FINGER.format(bonds), home=[0.1, 0.3, 0.0])


def test_a_coupling_is_no_symptom(tmp_path: Path) -> None:
    (tmp_path / "r.xml").write_text(FINGER.format('<equality><joint joint1="b" joint2="a"/></equality>'))
    assert not any("equality" in symptom.what for symptom in examine(str(tmp_path / "r.xml")).symptoms)
