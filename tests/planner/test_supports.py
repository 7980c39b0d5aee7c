"""Passive contacts: where bodies lie on flat surfaces, and how they move over them."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp.planner.task import Settings, Task, prepare
from regrasp.planner.path import nominal_path
from regrasp.planner.supports import SEPARATE, SLIDE, STICK, TOUCH, touching
from regrasp.scene.load import validate

OBJECTS = {
    "sphere": {"shape": "sphere", "size": [0.03], "mass": 0.2},
    "ellipsoid": {"shape": "ellipsoid", "size": [0.05, 0.03, 0.02], "mass": 0.2},
    "capsule": {"shape": "capsule", "size": [0.02, 0.03], "mass": 0.2},
    "box": {"shape": "box", "size": [0.03, 0.02, 0.04], "rounding": 0.004, "mass": 0.2},
    "cylinder": {"shape": "cylinder", "size": [0.03, 0.04], "rounding": 0.004, "mass": 0.2},
}
TILT = [0.3, -0.2, 0.5]
TABLES = {
    "plane": {"name": "table", "shape": "plane", "pose": {"position": [0.01, 0, 0.05], "euler": TILT}, "friction": 0.4},
    "box": {
        "name": "table", "shape": "box", "size": [0.15, 0.2, 0.03], "friction": 0.4,
        "pose": {"position": [0.01, 0, 0.05], "euler": TILT},
    },
    "level": {"name": "table", "shape": "plane", "pose": {"position": [0, 0, 0.05]}, "friction": 0.4},
}  # fmt: skip
GRAVITY = np.array([0.0, 0.0, -9.81])


def task(shape: str, table: str) -> Task:
    scene = {
        "name": "support", "model": {"hand": "puma", "fingers": 3}, "object": OBJECTS[shape],
        "environment": [TABLES[table]], "supports": ["table"],
        "start": {"pose": {"position": [0, 0, 0.2]}}, "goal": {"pose": {"position": [0, 0, 0.2]}},
    }  # fmt: skip
    return prepare(validate(scene), Settings())


def surface(shape: str, p_O: np.ndarray) -> float:
    """Distance from the surface, or for the ellipsoid the value of its quadric."""
    size, edge = np.array(OBJECTS[shape]["size"]), OBJECTS[shape].get("rounding", 0.0)
    if shape == "sphere":
        return float(np.linalg.norm(p_O) - size[0])
    if shape == "ellipsoid":
        return float(np.sum((p_O / size) ** 2) - 1.0)
    if shape == "capsule":
        return float(np.linalg.norm(p_O - [0, 0, np.clip(p_O[2], -size[1], size[1])]) - size[0])
    if shape == "box":
        return float(np.linalg.norm(p_O - np.clip(p_O, edge - size, size - edge)) - edge)
    radial = np.hypot(p_O[0], p_O[1])
    foot = np.array([min(radial, size[0] - edge), np.clip(p_O[2], edge - size[1], size[1] - edge)])
    return float(np.linalg.norm([radial, p_O[2]] - foot) - edge)


@pytest.mark.parametrize("table", ["plane", "box"])
@pytest.mark.parametrize("shape", OBJECTS)
def test_touching_points_lie_on_both_surfaces(shape: str, table: str) -> None:
    """At any attitude, flat on a face, on an edge or a corner: snapped onto the support the object touches it and goes
    nowhere below (MuJoCo), at points of both surfaces, with the support's normal."""
    t = task(shape, table)
    support, model = t.supports[0], t.world.model
    data = mujoco.MjData(model)
    R_WS = Rotation.from_euler("xyz", TILT).as_matrix()
    np.testing.assert_allclose(support.n_W, R_WS[:, 2], atol=1e-12)
    turns = [*Rotation.random(8, rng=np.random.default_rng(0)).as_matrix()]
    turns += [R_WS @ R for R in Rotation.create_group("O").as_matrix()[:12]]
    turns += [R_WS @ Rotation.from_euler("x", a).as_matrix() for a in (1e-12, 1e-7, np.pi / 4)]
    at = t.world.object_qpos
    for R in turns:
        R, p = t.router.grid.snapped((R, support.p_W + 0.01 * support.axes_W[0] + 0.1 * support.n_W), 0)
        contacts = touching(support, t.hand.kind_O, t.hand.size_O, R, p)
        assert contacts
        for p_O, n_W in contacts:
            assert surface(shape, p_O) == pytest.approx(0.0, abs=1e-9)
            assert support.n_W @ (R @ p_O + p - support.p_W) == pytest.approx(0.0, abs=TOUCH)
            np.testing.assert_array_equal(n_W, support.n_W)
        data.qpos[at : at + 3] = p
        mujoco.mju_mat2Quat(data.qpos[at + 3 : at + 7], R.ravel())
        mujoco.mj_kinematics(model, data)
        gaps = [
            mujoco.mj_geomDistance(model, data, int(t.world.support_geoms[0]), int(g), 0.1, None)
            for g in t.world.object_geoms
        ]
        # MuJoCo's rounded cylinder has a rim of capsules, fine to 0.02 mm.
        assert min(gaps) == pytest.approx(0.0, abs=3e-5 if shape == "cylinder" else 1e-6)


@pytest.mark.parametrize(
    ("shape", "euler", "count"),
    [
        ("box", [0, 0, 0.3], 4), ("box", [0.4, 0, 0], 2), ("box", [0.4, 0.3, 0], 1), ("cylinder", [0, 0, 0], 4),
        ("cylinder", [np.pi / 2, 0, 0], 2), ("cylinder", [0.4, 0, 0], 1), ("capsule", [np.pi / 2, 0, 1], 2),
        ("capsule", [0.1, 0, 0], 1), ("sphere", [1, 2, 3], 1), ("ellipsoid", [1, 2, 3], 1),
    ],
)  # fmt: skip
def test_faces_edges_and_corners_have_their_number_of_contacts(shape: str, euler: list[float], count: int) -> None:
    t = task(shape, "level")
    R, p = t.router.grid.snapped((Rotation.from_euler("xyz", euler).as_matrix(), np.array([0.0, 0.0, 0.2])), 0)
    assert len(touching(t.supports[0], t.hand.kind_O, t.hand.size_O, R, p)) == count


def test_beyond_the_edge_of_a_box_nothing_carries() -> None:
    t = task("sphere", "box")
    support = t.supports[0]
    for part, count in ((0.99, 1), (1.01, 0)):
        p = support.p_W + part * support.half[0] * support.axes_W[0] + 0.03 * support.n_W
        assert len(touching(support, t.hand.kind_O, t.hand.size_O, np.eye(3), p)) == count


N, M = 3, 6
U = np.linspace(0.0, 1.0, N * M + 1)


def path(shape: str, R: np.ndarray, p: np.ndarray):
    t = task(shape, "level")
    return nominal_path(R, p, N, M, GRAVITY, t.supports, t.hand.kind_O, t.hand.size_O)


def turned(axis: str, angle: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(np.multiply.outer(angle, np.eye(3)["xyz".index(axis)])).as_matrix()


def test_a_ball_that_rolls_or_rests_sticks() -> None:
    for way in (0.0, 0.02):
        p = np.stack([way * U, 0 * U, 0.08 + 0 * U], axis=1)
        rolled = path("sphere", turned("y", way * U / 0.03), p)
        assert np.all(rolled.support_mode == STICK)
    np.testing.assert_array_equal(rolled.support_mu, [0.4])


def test_a_box_that_tips_over_its_edge_sticks_there() -> None:
    """The rounded edge rolls: its axis moves on by radius times angle."""
    angle, r = 0.1 + 0.3 * U, 0.004
    R = turned("y", angle)
    edge_O = np.array([0.026, 0.0, -0.036])
    axis = np.stack([r * angle, 0 * U, 0.05 + r + 0 * U], axis=1)
    rolled = path("box", R, axis - R @ edge_O)
    assert rolled.support_mode.shape == (N, 2)
    assert np.all(rolled.support_mode == STICK)


@pytest.mark.parametrize("shape", ["box", "sphere", "cylinder"])
def test_what_is_pushed_slides_and_friction_opposes_it(shape: str) -> None:
    way = np.array([0.02, -0.01, 0.0])
    R = np.tile(turned("z", np.array(0.7)), (len(U), 1, 1))
    top = {"box": 0.09, "sphere": 0.08, "cylinder": 0.09}[shape]
    pushed = path(shape, R, np.array([0, 0, top]) + U[:, None] * way)
    assert np.all(pushed.support_mode == SLIDE)
    t_W = np.einsum("jsab,jspb->jspa", pushed.R_WO, pushed.support_t_O)
    np.testing.assert_allclose(t_W, np.broadcast_to(-way / np.linalg.norm(way), t_W.shape), atol=1e-9)


def test_a_box_that_turns_on_the_spot_slides_about_its_middle() -> None:
    """Friction at each corner is against ω × r there."""
    R = turned("z", 0.2 * U)
    spun = path("box", R, np.tile([0.0, 0.0, 0.09], (len(U), 1)))
    assert spun.support_mode.shape == (N, 4)
    assert np.all(spun.support_mode == SLIDE)
    t_W = np.einsum("jsab,jspb->jspa", spun.R_WO, spun.support_t_O)
    r_W = np.einsum("jsab,jspb->jspa", spun.R_WO, spun.support_p_O)
    v = np.cross([0.0, 0.0, 1.0], r_W)
    np.testing.assert_allclose(t_W, -v / np.linalg.norm(v, axis=-1, keepdims=True), atol=1e-9)


def test_a_ball_that_spins_on_the_spot_sticks() -> None:
    """Its touching point is on the axis and does not move."""
    spun = path("sphere", turned("z", 0.5 * U), np.tile([0.0, 0.0, 0.08], (len(U), 1)))
    assert np.all(spun.support_mode == STICK)


def test_what_is_lifted_separates_from_the_interval_on_in_which_it_leaves() -> None:
    up = np.maximum(0.0, U - 1 / N)
    p = np.stack([0 * U, 0 * U, 0.09 + 0.01 * up], axis=1)
    lifted = path("box", np.tile(np.eye(3), (len(U), 1, 1)), p)
    assert np.all(lifted.support_mode[0] == STICK)
    assert np.all(lifted.support_mode[1:] == SEPARATE)
