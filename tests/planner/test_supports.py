"""Passive contacts: where bodies lie on others, how they move over them, and what forces these can bear."""

import itertools
import time

import mujoco
import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from regrasp.kernels.features import TOUCH
from regrasp.planner.path import nominal_path
from regrasp.planner.supports import SEPARATE, SLIDE, STICK, gap, moved_onto, patch_of, touching
from regrasp.planner.task import Settings, Task, prepare
from regrasp.scene.load import validate

OBJECTS = {
    "sphere": {"shape": "sphere", "size": [0.03], "mass": 0.2},
    "ellipsoid": {"shape": "ellipsoid", "size": [0.05, 0.03, 0.02], "mass": 0.2},
    "capsule": {"shape": "capsule", "size": [0.02, 0.03], "mass": 0.2},
    "box": {"shape": "box", "size": [0.03, 0.02, 0.04], "rounding": 0.004, "mass": 0.2},
    "cylinder": {"shape": "cylinder", "size": [0.03, 0.04], "rounding": 0.004, "mass": 0.2},
}
TILT = [0.3, -0.2, 0.5]
SHAPES = {
    "plane": {}, "box": {"size": [0.15, 0.2, 0.03]}, "sphere": {"size": [0.06]}, "capsule": {"size": [0.02, 0.08]},
    "cylinder": {"size": [0.05, 0.03]},
}  # fmt: skip
TABLES = {
    shape: {
        "name": "table", "shape": shape, **size, "friction": 0.4,
        "pose": {"position": [0.01, 0, 0.05], "euler": TILT},
    } for shape, size in SHAPES.items()
}  # fmt: skip
TABLES["level"] = {"name": "table", "shape": "plane", "pose": {"position": [0, 0, 0.05]}, "friction": 0.4}
TABLES["block"] = {
    "name": "table", "shape": "box", "size": [0.1, 0.1, 0.05], "friction": 0.4, "pose": {"position": [0.0, 0, 0.0]},
}  # fmt: skip
GRAVITY = np.array([0.0, 0.0, -9.81])


def task(shape: str, table: str, supports: object = ("table",)) -> Task:
    scene = {
        "name": "support", "model": {"hand": "puma", "fingers": 3}, "object": OBJECTS[shape],
        "environment": [TABLES[table]], "supports": supports,
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


@pytest.mark.parametrize("table", SHAPES)
@pytest.mark.parametrize("shape", OBJECTS)
def test_touching_points_lie_on_both_surfaces(shape: str, table: str) -> None:
    """At any attitude, flat on a face, on an edge or a corner: moved onto the support the object touches it and goes
    nowhere below (MuJoCo), at points of its surface; on a face or a plane with the face's normal."""
    t = task(shape, table)
    support, model = t.supports[0], t.world.model
    data = mujoco.MjData(model)
    R_WS, p_WS = t.hand.geoms.R_LG[support.geom], t.hand.geoms.p_LG[support.geom]
    top = {"plane": 0.0, "box": 0.03, "sphere": 0.06, "capsule": 0.1, "cylinder": 0.03}[table]
    turns = [*Rotation.random(8, rng=np.random.default_rng(0)).as_matrix()]
    turns += [R_WS @ R for R in Rotation.create_group("O").as_matrix()[:12]]
    turns += [R_WS @ Rotation.from_euler("x", a).as_matrix() for a in (1e-12, 1e-7, np.pi / 4)]
    at = t.world.object_qpos
    for R in turns:
        p = moved_onto(t.hand, support, R, p_WS + R_WS @ [0.01, 0.0, top + 0.1])
        contacts = touching(t.hand, support, R, p)
        assert contacts
        assert gap(t.hand, support, R, p) == pytest.approx(0.0, abs=1e-9)
        for p_O, n_W in contacts:
            assert surface(shape, p_O) == pytest.approx(0.0, abs=1e-9)
            if table in ("plane", "box"):
                assert R_WS[:, 2] @ (R @ p_O + p - p_WS) == pytest.approx(top, abs=TOUCH)
                np.testing.assert_allclose(n_W, R_WS[:, 2], atol=1e-12)
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
    R = Rotation.from_euler("xyz", euler).as_matrix()
    p = moved_onto(t.hand, t.supports[0], R, np.array([0.0, 0.0, 0.2]))
    assert len(touching(t.hand, t.supports[0], R, p)) == count


def test_a_ball_that_leaves_a_table_rolls_over_its_edge() -> None:
    """Beyond the edge the normal leads from the edge to the ball's centre."""
    t = task("sphere", "block")
    for over in (-0.001, 0.0, 0.01, 0.02):
        R, p = np.eye(3), moved_onto(t.hand, t.supports[0], np.eye(3), np.array([0.1 + over, 0.02, 0.1]))
        ((p_O, n_W),) = touching(t.hand, t.supports[0], R, p)
        edge = np.array([min(p[0], 0.1), 0.02, 0.05])
        np.testing.assert_allclose(n_W, (p - edge) / 0.03, atol=1e-9)
        np.testing.assert_allclose(p_O + p, edge, atol=1e-9)
    assert not touching(t.hand, t.supports[0], R, p + 3e-5 * n_W)


def least_tilt(contacts: list[tuple[np.ndarray, np.ndarray]], R: np.ndarray) -> int:
    """Status of the linear program for normal forces alone that bear the weight at the object's centre: 0 if there are any."""
    p, n = (np.array([each[a] for each in contacts]) for a in (0, 1))
    wrench = np.vstack([n.T, np.cross(p @ R.T, n).T])
    return int(linprog(np.ones(len(p)), A_eq=wrench, b_eq=[0, 0, 1, 0, 0, 0]).status)


@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_what_overhangs_by_more_than_half_tips(yaw: float) -> None:
    """The block carries a box whose centre is over it, and no other (the program is infeasible: status 2)."""
    t = task("box", "block")
    R = Rotation.from_euler("z", yaw).as_matrix()
    for over in (-0.02, -0.001, 0.001, 0.02):
        contacts = touching(t.hand, t.supports[0], R, np.array([0.1 + over, 0.01, 0.09]))
        assert least_tilt(contacts, R) == (0 if over < 0.0 else 2)


def test_the_patch_of_a_face_half_over_an_edge() -> None:
    t = task("box", "block")
    found = patch_of(t.hand, t.supports[0], np.eye(3), np.array([0.1, 0.0, 0.09]))
    np.testing.assert_array_equal(found.n_W, [0, 0, 1])
    flat = [[x, y, 0.05] for x in (0.074, 0.1) for y in (-0.016, 0.016)]
    np.testing.assert_allclose(sorted(map(tuple, found.polygon)), flat, atol=1e-12)


N, M = 3, 6
U = np.linspace(0.0, 1.0, N * M + 1)


def path(shape: str, R: np.ndarray, p: np.ndarray, table: str = "level"):
    t = task(shape, table)
    return nominal_path(R, p, N, M, GRAVITY, t.hand, t.supports)


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


def test_a_box_that_tips_off_a_face_bears_on_its_edge_from_the_start() -> None:
    """The first sample lies flat; only the corners of the edge that stays are there at every sample."""
    angle, r = 0.2 * U, 0.004
    R = turned("y", angle)
    axis = np.stack([r * angle, 0 * U, 0.05 + r + 0 * U], axis=1)
    tipped = path("box", R, axis - R @ [0.026, 0.0, -0.036])
    assert tipped.support_slot.tolist() == [1, 3]
    assert np.all(tipped.support_mode == STICK)


def test_a_cylinder_that_tips_off_its_face_bears_on_its_rim_from_the_start() -> None:
    angle, r = 0.2 * U, 0.004
    R = turned("y", angle)
    axis = np.stack([r * angle, 0 * U, 0.05 + r + 0 * U], axis=1)
    tipped = path("cylinder", R, axis - R @ [0.026, 0.0, -0.036])
    assert np.all(np.sum(tipped.support_mode == STICK, axis=1) == 1)
    low = np.einsum("jsab,jsb->jsa", tipped.R_WO, tipped.support_p_O[:, :, 0]) + tipped.p_WO
    np.testing.assert_allclose(low[..., 2], 0.05, atol=1e-6)
    np.testing.assert_allclose(low[..., 1], 0.0, atol=1e-9)


def test_a_box_that_tips_over_the_edge_of_a_block_bears_on_that_edge() -> None:
    """The block's edge carries at its ends under the box, which do not slip while the face turns about them."""
    angle = 0.2 * U
    R = turned("y", angle)
    tipped = path("box", R, np.array([0.1, 0.0, 0.05]) - R @ [0.01, 0.0, -0.04], "block")
    assert tipped.support_slot.tolist() == [1, 3]
    assert np.all(tipped.support_mode == STICK)
    for j, column in itertools.product(range(N), range(2)):
        p_W = np.einsum("sab,sb->sa", tipped.R_WO[j], tipped.support_p_O[j, :, column]) + tipped.p_WO[j]
        np.testing.assert_allclose(np.abs(p_W), np.tile([0.1, 0.016, 0.05], (M + 1, 1)), atol=1e-9)
        n_W = np.einsum("sab,sb->sa", tipped.R_WO[j], tipped.support_n_O[j, :, column])
        np.testing.assert_allclose(n_W, tipped.R_WO[j, :, :, 2], atol=1e-9)


@pytest.mark.parametrize("yaw", [0.0, 0.3])
def test_what_is_pushed_over_an_edge_slides_at_points_that_wander(yaw: float) -> None:
    """No two columns of an interval are the same contact, all slide against the motion, on the block and on the box."""
    R = np.tile(turned("z", np.array(yaw)), (len(U), 1, 1))
    pushed = path("box", R, np.array([0.06, 0.0, 0.09]) + U[:, None] * [0.05, 0.01, 0.0], "block")
    slides = pushed.support_mode == SLIDE
    assert np.all(slides.sum(axis=1) >= 4)
    p_W = np.einsum("jsab,jspb->jspa", pushed.R_WO, pushed.support_p_O) + pushed.p_WO[:, :, None]
    t_W = np.einsum("jsab,jspb->jspa", pushed.R_WO, pushed.support_t_O)
    for j in range(N):
        here = p_W[j][:, slides[j]]
        np.testing.assert_allclose(here[..., 2], 0.05, atol=1e-9)
        assert np.max(here[..., 0]) <= 0.1 + 1e-9
        np.testing.assert_allclose(
            t_W[j][:, slides[j]], np.broadcast_to([-0.98058068, -0.19611614, 0], here.shape), atol=1e-6
        )
        assert np.max(np.linalg.norm(np.diff(here, axis=0), axis=-1)) < 0.01
        for a, b in itertools.combinations(range(here.shape[1]), 2):
            assert np.max(np.linalg.norm(here[[0, -1], a] - here[[0, -1], b], axis=-1)) > 1e-6


def test_all_bodies_may_carry() -> None:
    """`auto` is every body of the environment, and the palm."""
    t = task("box", "block", "auto")
    assert [support.name for support in t.supports] == ["table", "palm"]
    assert t.world.scene.supports == "auto"


def test_paths_past_many_supports_are_fast() -> None:
    """360 samples of a box among six supports, all near, take milliseconds."""
    t = task("box", "block")
    p = np.array([0.06, 0.0, 0.09]) + np.linspace(0, 1, 361)[:, None] * [0.08, 0.01, 0.0]
    R = np.tile(turned("z", np.array(0.3)), (361, 1, 1))
    supports = t.supports * 6
    nominal_path(R, p, 30, 12, GRAVITY, t.hand, supports)
    taken = []
    for _ in range(5):
        start = time.perf_counter()
        nominal_path(R, p, 30, 12, GRAVITY, t.hand, supports)
        taken.append(time.perf_counter() - start)
    assert min(taken) < 0.1
