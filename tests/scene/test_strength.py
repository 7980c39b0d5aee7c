"""How hard an agent can press, from the limits of its joints."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from regrasp.scene.couplings import Coupling
from regrasp.scene.load import validate
from regrasp.scene.strength import normal_force
from regrasp.scene.world import MAX_FORCE, build

ARM = """<mujoco><worldbody><body name="one" euler="30 0 0"><joint name="a" axis="0 1 0" actuatorfrcrange="-2 2"/>
<geom type="capsule" size="0.01" fromto="0 0 0 0.1 0 0" mass="0.2"/>
<body name="two" pos="0.1 0 0"><joint name="b" axis="0 0 1"/>
<geom type="capsule" size="0.01" fromto="0 0 0 0.1 0.02 0" mass="0.1"/>
<body name="three" pos="0.1 0.02 0"><joint name="c" type="slide" axis="1 0 0"/>
<geom name="tip" size="0.01" pos="0.03 0 0.02" mass="0.05"/>
</body></body></body></worldbody><actuator>{drives}</actuator></mujoco>"""
DRIVES = '<position joint="b" kp="5" forcerange="-1.5 1" gear="2"/><motor joint="c" gear="10" ctrlrange="-1 1.5"/>'
HOME = np.array([0.3, -0.4, 0.02])


def free(n: int) -> Coupling:
    return Coupling(np.arange(n), np.ones(n), np.zeros(n))


def arm() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ARM.format(drives=DRIVES))


def test_no_force_of_the_friction_cone_asks_more_of_the_joints_than_they_have() -> None:
    """Limits: of a its own, 2 N m; of b its servo's, 2 × 1 N m; of c its motor's, 10 × 1 N. The weight takes its share."""
    model, mu = arm(), 0.6
    tip = model.geom("tip").id
    found = normal_force(model, HOME, np.arange(3), free(3), tip, mu)
    assert found is not None
    data = mujoco.MjData(model)
    data.qpos[:] = HOME
    mujoco.mj_forward(model, data)
    J = np.zeros((3, 3))
    mujoco.mj_jac(model, data, J, None, data.geom_xpos[tip], model.geom_bodyid[tip])
    limit = np.array([2.0, 2.0, 10.0])
    rng = np.random.default_rng(0)
    most = 0.0
    for _ in range(3000):
        n = rng.normal(size=3)
        n /= np.linalg.norm(n)
        t = np.cross(n, rng.normal(size=3))
        force = found * (n + mu * t / np.linalg.norm(t))
        most = max(most, float(np.max((np.abs(J.T @ force) + np.abs(data.qfrc_bias)) / limit)))
    assert 0.95 < most <= 1.0


def test_no_limit_no_answer_and_a_limit_of_zero_is_none() -> None:
    """URDF files with effort="0" mean that nobody filled it in; MuJoCo takes such a range for no limit."""
    model = mujoco.MjModel.from_xml_string(
        ARM.format(drives='<position joint="b" kp="5"/>').replace('actuatorfrcrange="-2 2"', "")
    )
    assert normal_force(model, HOME, np.arange(3), free(3), model.geom("tip").id, 0.6) is None


@pytest.mark.parametrize(
    ("said", "agent", "force"),
    [({}, {}, None), ({"max_force": 3.0}, {}, 3.0), ({"max_force": 3.0}, {"max_force": 4.0}, 4.0)],
)
def test_the_agent_says_then_the_scene_then_the_model(
    tmp_path: Path, said: dict[str, float], agent: dict[str, float], force: float | None
) -> None:
    pose = {"pose": {"position": [1, 0, 0.3]}}
    scene = {
        "name": "arm", "model": {"file": str(tmp_path / "arm.xml")}, "agents": [{"name": "a", "tip": "tip", **agent}],
        "object": {"shape": "sphere", "size": [0.03], "mass": 0.1}, "start": pose, "goal": pose, **said,
    }  # fmt: skip
    (tmp_path / "arm.xml").write_text(ARM.format(drives=DRIVES))
    world = build(validate(scene))
    found = world.agents[0]
    model = normal_force(arm(), np.zeros(3), np.arange(3), free(3), arm().geom("tip").id, found.friction)
    assert found.max_force == pytest.approx(force or model)
    (tmp_path / "arm.xml").write_text(ARM.format(drives="").replace('actuatorfrcrange="-2 2"', ""))
    assert build(validate(scene)).agents[0].max_force == (force or MAX_FORCE)
