"""Which geom an agent's tip is, and what becomes of one that is a mesh."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from regrasp.errors import InputError
from regrasp.scene.load import load, validate
from regrasp.scene.world import World, build

CLAW = Path(__file__).parents[2] / "examples" / "claw.yaml"
FINGER = """<mujoco><worldbody><body name="link" pos="0 0 0.1"><joint name="j" axis="0 1 0" range="-90 90"/>
  <geom name="shaft" type="capsule" size="0.01" fromto="0 0 0 0 0 0.1"/>
  <body name="pad" pos="0 0 0.1"><geom name="heel" size="0.01" pos="0.01 0 0"/><geom size="0.012" pos="0 0 0.02"/>
    <geom name="skin" size="0.02" pos="0 0 0.05" contype="0" conaffinity="0"/></body>
  <body name="frame" pos="0 0 0.13"/></body>
  <body name="bare"><joint name="k"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>"""


def world(tmp_path: Path, text: str, tip: str) -> World:
    (tmp_path / "r.xml").write_text(text)
    pose = {"pose": {"position": [1, 0, 0.3]}}
    scene: dict[str, Any] = {
        "name": "r", "model": {"file": str(tmp_path / "r.xml")}, "agents": [{"name": "a", "tip": tip}],
        "object": {"shape": "sphere", "size": [0.03], "mass": 0.1}, "start": pose, "goal": pose,
    }  # fmt: skip
    return build(validate(scene))


@pytest.mark.parametrize(
    ("tip", "z", "said"),
    [
        ("heel", 0.0, ()),
        ("pad", 0.02, ("tip 'pad' is the geom of body 'pad', which reaches furthest of 2",)),
        ("link", -0.05, ()),
        ("frame", 0.02, ("tip 'frame' is the geom of body 'pad', which reaches furthest of 3",)),
    ],
)
def test_a_body_stands_for_the_colliding_geom_of_it_that_reaches_furthest(
    tmp_path: Path, tip: str, z: float, said: tuple[str, ...]
) -> None:
    """Of a body without one, a frame that only names the place, for one of those fixed to it."""
    made = world(tmp_path, FINGER, tip)
    data = mujoco.MjData(made.model)
    mujoco.mj_kinematics(made.model, data)
    assert data.geom_xpos[made.agents[0].tip_geom][2] == pytest.approx(0.2 + z)
    assert made.repairs == said
    assert made.model.geom(made.agents[0].tip_geom).name == f"robot/{tip}"


def test_a_body_that_nothing_collides_with_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"agents\.0\.tip: body 'bare' has no colliding geom"):
        world(tmp_path, FINGER, "bare")


def test_the_end_of_a_mesh_is_a_sphere_and_the_rest_of_it_still_collides() -> None:
    made = build(load(str(CLAW)))
    model, data = made.model, mujoco.MjData(made.model)
    mujoco.mj_kinematics(model, data)
    for agent in made.agents:
        body = model.body(agent.tip_body)
        assert model.geom_type[agent.tip_geom] == mujoco.mjtGeom.mjGEOM_SPHERE
        assert model.geom_size[agent.tip_geom, 0] == pytest.approx(0.009, abs=2e-4)  # as the mesh was drawn
        np.testing.assert_allclose(model.geom_pos[agent.tip_geom], [0, 0, 0.046], atol=3e-4)
        # The body weighs what the file says, whatever its geoms are now.
        assert body.mass[0] == pytest.approx(0.02)
        rest = model.geom(f"{model.geom(agent.tip_geom).name}/rest").id
        assert rest in agent.geoms
        centre = model.geom_pos[agent.tip_geom][2]
        # A plate pressed onto the front of the sphere, up to 60° from its pole, meets the sphere first.
        for angle in np.radians([0, 30, 60]):
            outward = np.array([np.sin(angle), 0.0, np.cos(angle)])
            mesh = _vertices(model, rest)
            assert (mesh @ outward).max() < outward[2] * centre + model.geom_size[agent.tip_geom, 0] - 1e-3
        seen = model.geom(f"{model.geom(agent.tip_geom).name}/mesh").id
        assert model.geom_contype[seen] == model.geom_conaffinity[seen] == 0
        np.testing.assert_allclose(_vertices(model, seen)[:, 2].max(), 0.055, atol=1e-6)
    assert sum("is a mesh: its end counts as a sphere of radius 8.9 mm" in said for said in made.repairs) == 3


def _vertices(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Vertices of a geom's mesh in its body's frame."""
    mesh = model.geom_dataid[geom]
    first = model.mesh_vertadr[mesh]
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, model.geom_quat[geom])
    return model.mesh_vert[first : first + model.mesh_vertnum[mesh]] @ R.reshape(3, 3).T + model.geom_pos[geom]


@pytest.mark.parametrize(("x", "y", "z"), [(0.008, 0.008, 0.03), (0.02, 0.02, 0.02)])
def test_an_end_that_is_no_sphere_is_said_to_be_rough(tmp_path: Path, x: float, y: float, z: float) -> None:
    corners = " ".join(f"{a * x} {b * y} {c * z}" for a in (-1, 1) for b in (-1, 1) for c in (-1, 1))
    text = f"""<mujoco><asset><mesh name="m" vertex="{corners}"/></asset><worldbody><body name="pad">
      <joint name="j" axis="0 1 0"/><geom type="mesh" mesh="m" pos="0 0 0.1"/></body></worldbody></mujoco>"""
    made = world(tmp_path, text, "pad")
    (said,) = made.repairs
    assert said.endswith("; better give its shape in the scene")
    tip = made.agents[0].tip_geom
    top = made.model.geom_pos[tip][2] + made.model.geom_size[tip, 0]
    assert top == pytest.approx(0.1 + z, abs=1e-5)
