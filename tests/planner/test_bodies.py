"""Objects and fixed bodies of several convex parts: distances, rest, contact patches and whole plans, against MuJoCo."""

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from regrasp.planner.collision import closer, object_row, tip_hits
from regrasp.planner.configurations import bodies_along
from regrasp.planner.method import plan_scene
from regrasp.planner.path import nominal_path
from regrasp.planner.supports import gap, moved_onto, patch_of, touching
from regrasp.planner.surroundings import gaps_at
from regrasp.planner.task import Settings, Task, prepare
from regrasp.scene.load import parse
from regrasp.verify.check import check
from tests.scene import shapes

GRAVITY = np.array([0.0, 0.0, -9.81])
DUMBBELL = {
    "shape": "union",
    "mass": 0.2,
    "resolution": 0.002,
    "parts": [
        {"shape": "sphere", "size": [0.03], "pose": {"position": [-0.035, 0, 0]}},
        {"shape": "box", "size": [0.025, 0.03, 0.03], "rounding": 0.006, "pose": {"position": [0.035, 0, 0]}},
        {"shape": "capsule", "size": [0.018, 0.03], "pose": {"position": [0, 0, 0], "euler": [0, np.pi / 2, 0]}},
    ],
}
BRACKET = {"shape": "mesh", "file": "bracket.stl", "rounding": 0.006, "resolution": 0.002, "mass": 0.2}
TABLE = {"name": "table", "shape": "box", "size": [0.15, 0.15, 0.01], "pose": {"position": [0, 0, -0.01]}}
WEDGE = {
    "name": "wedge",
    "shape": "mesh",
    "file": "wedge.stl",
    "pose": {"position": [0.02, 0.0, -0.02], "euler": [0, 0, 0.3]},
}


@pytest.fixture(scope="module", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the meshes are: a bracket with its middle at the origin, and a wedge 40 mm high."""
    made = tmp_path_factory.mktemp("meshes")
    bracket = shapes.bracket(0.07, 0.026, 0.05)
    bracket.apply_translation([-0.028, 0.0, -0.028])
    shapes.file(made, bracket, "bracket.stl")
    wedge = shapes.box(0.12, 0.08, 0.04)
    wedge.vertices[wedge.vertices[:, 2] > 0.0, 0] *= 0.5
    shapes.file(made, wedge, "wedge.stl")
    return made


def task(folder: Path, thing: dict, environment: list[dict], supports: list[str]) -> Task:
    scene = {
        "name": "bodies",
        "model": {"hand": "puma", "fingers": 3, "palm": False, "pose": {"position": [0, 0, -0.1]}},
        "object": thing, "environment": environment, "supports": supports,
        "start": {"pose": {"position": [0.0, 0.0, 0.2]}}, "goal": {"pose": {"position": [0.0, 0.0, 0.21]}},
    }  # fmt: skip
    return prepare(parse(yaml.safe_dump(scene), "bodies.yaml", folder), Settings())


def nearest(t: Task, geoms: list[int], R: np.ndarray, p: np.ndarray) -> float:
    """Least distance of the object at a pose from the geoms, by MuJoCo."""
    data, at = mujoco.MjData(t.world.model), t.world.object_qpos
    data.qpos[:] = t.world.start
    data.qpos[at : at + 3] = p
    mujoco.mju_mat2Quat(data.qpos[at + 3 : at + 7], np.ascontiguousarray(R).ravel())
    mujoco.mj_kinematics(t.world.model, data)
    return min(
        mujoco.mj_geomDistance(t.world.model, data, g, int(o), 0.1, None) for g in geoms for o in t.world.object_geoms
    )


@pytest.mark.parametrize(("thing", "tolerance"), [(DUMBBELL, 1e-6), (BRACKET, 6e-5)], ids=["union", "mesh"])
def test_gaps_are_mujocos(folder: Path, thing: dict, tolerance: float) -> None:
    """From a box and a mesh. The mesh object's geoms lack 0.02 mm of the ball that its parts are swept by, and 0.01 mm."""
    t = task(folder, thing, [TABLE, WEDGE], ["table", "wedge"])
    around, seen = t.router.around, 0
    for R in Rotation.random(30, rng=np.random.default_rng(0)).as_matrix():
        p = np.array([0.01, 0.0, 0.09])
        gaps = np.empty(len(around.kind))
        gaps_at(around, R, p, 0.06, gaps)
        for b, geom in enumerate(t.world.support_geoms):
            true = nearest(t, [int(geom)], R, p)
            if 0.0 < true < 0.06:
                assert gaps[b] == pytest.approx(true, abs=tolerance)
                seen += 1
    assert seen > 20


def test_a_dumbbell_rests_on_a_table_on_both_its_ends(folder: Path) -> None:
    """Three ways of resting have contacts on several parts, of which the patch is the hull."""
    t = task(folder, DUMBBELL, [TABLE], ["table"])
    (support,) = t.supports
    p = moved_onto(t.hand, support, np.eye(3), np.array([0.0, 0.0, 0.2]))
    assert p[2] == pytest.approx(0.03, abs=1e-9)
    contacts = touching(t.hand, support, np.eye(3), p)
    assert len(contacts) == 5
    assert sorted(round(float(p_O[0]), 4) for p_O, _ in contacts) == [-0.035, 0.016, 0.016, 0.054, 0.054]
    found = patch_of(t.hand, support, np.eye(3), p)
    assert found is not None
    assert len(found.polygon) == 5
    np.testing.assert_allclose(found.polygon[:, 2], 0.0, atol=1e-9)
    assert np.ptp(found.polygon[:, 0]) == pytest.approx(0.035 + 0.054, abs=1e-6)


def test_a_mesh_stands_on_a_mesh(folder: Path) -> None:
    """The bracket's flat side on the wedge's top: it bears on the face that they share, with its normal."""
    t = task(folder, BRACKET, [WEDGE], ["wedge"])
    (support,) = t.supports
    R = Rotation.from_euler("z", 0.3).as_matrix()
    p = moved_onto(t.hand, support, R, np.array([0.02, 0.0, 0.1]))
    assert gap(t.hand, support, R, p) == pytest.approx(0.0, abs=1e-8)
    assert p[2] == pytest.approx(0.028, abs=2e-5)
    contacts = touching(t.hand, support, R, p)
    assert len(contacts) >= 4
    for p_O, n_W in contacts:
        np.testing.assert_allclose(n_W, [0.0, 0.0, 1.0], atol=1e-3)
        assert (R @ p_O + p)[2] == pytest.approx(0.0, abs=3e-5)


def test_a_tip_meets_every_part(folder: Path) -> None:
    """A tip beside any part is told from one that is clear of all, as MuJoCo tells."""
    t = task(folder, DUMBBELL, [], [])
    poses = np.repeat(np.eye(3)[None], 3, axis=0), np.array([[0.0, 0.0, 0.2]] * 3)
    R_WB, p_WB = bodies_along(t.hand, nominal_path(*poses, 1, 2, GRAVITY, t.hand, ()))
    row, tip = object_row(t.hand), int(t.hand.tip_geom[0])
    assert len(R_WB[0]) - row == 3
    R_G, p_G = np.zeros((tip + 1, 3, 3)), np.zeros((tip + 1, 3))
    R_G[:] = np.eye(3)
    radius = t.hand.size_T[0, 0]
    for x, height in ((-0.035, 0.03), (0.035, 0.03)):
        for over in (-1e-4, 1e-4):
            p_G[tip] = [x, 0.0, 0.2 + height + radius + over]
            assert tip_hits(t.hand, 0, R_G, p_G, R_WB[0, row:], p_WB[0, row:], 0.0) == (over < 0.0)
    p_G[tip] = [0.0, 0.0, 0.2 + 0.018 + radius - 1e-4]  # between the ends: on the bar
    assert tip_hits(t.hand, 0, R_G, p_G, R_WB[0, row:], p_WB[0, row:], 0.0)
    assert not closer(t.hand, tip, np.eye(3), p_G[tip] + 1.0, t.hand.object_geom, np.eye(3), np.zeros(3), 0.0)


@pytest.mark.parametrize("thing", [DUMBBELL, BRACKET], ids=["union", "mesh"])
def test_a_concave_object_is_moved_and_turned_and_the_plan_certified(folder: Path, thing: dict) -> None:
    """Three fingers, six freedoms; judged on MuJoCo's geoms for the union, on the triangulated surface for the mesh."""
    scene = {
        "name": "concave", "model": {"hand": "puma", "fingers": 3}, "object": thing,
        "start": {"pose": {"position": [0, 0, 0.135]}},
        "goal": {"pose": {"position": [0.008, -0.006, 0.143], "euler": [0.15, -0.1, 0.2]}},
    }  # fmt: skip
    outcome = plan_scene(parse(yaml.safe_dump(scene), "concave.yaml", folder), 0, Settings())
    assert outcome.plan is not None, outcome.failure
    assert check(outcome.plan).refusals == ()
