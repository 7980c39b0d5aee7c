"""What unions and meshes are made of: parts, mass, centre of mass, and the world built of them."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from regrasp.scene import hulls, matter
from regrasp.scene.load import parse
from regrasp.scene.schema import MeshObject, Object, Piece, Scene, UnionObject
from regrasp.scene.world import build, from_plan
from tests.scene import shapes


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


def dumbbell(**given: float) -> UnionObject:
    """Two balls at ±0.04 on a bar along x; the one at +0.04 is larger."""
    return UnionObject(
        shape="union",
        parts=(
            Piece(shape="sphere", size=(0.02,), pose={"position": (-0.04, 0, 0)}),
            Piece(shape="sphere", size=(0.025,), pose={"position": (0.04, 0, 0)}),
            Piece(shape="capsule", size=(0.01, 0.04), pose={"position": (0, 0, 0), "euler": (0, np.pi / 2, 0)}),
        ),
        resolution=0.0015,
        **given,
    )


def test_density_times_volume_is_the_mass() -> None:
    box = Object(shape="box", size=(0.03, 0.04, 0.05), rounding=0.0001, density=1000.0)
    assert matter.matter_of(box, {}).mass == pytest.approx(1000 * 8 * 0.03 * 0.04 * 0.05, rel=1e-4)


def test_centre_of_mass_of_a_union_lies_where_that_of_its_solid_does() -> None:
    """Against sums over random points in the solid."""
    found = matter.matter_of(dumbbell(density=2000.0), {})
    rng = np.random.default_rng(0)
    low, high = np.array([-0.07, -0.03, -0.03]), np.array([0.07, 0.03, 0.03])
    points = rng.uniform(low, high, (400_000, 3))
    inside = np.linalg.norm(points - [-0.04, 0, 0], axis=1) < 0.02
    inside |= np.linalg.norm(points - [0.04, 0, 0], axis=1) < 0.025
    inside |= (np.hypot(points[:, 1], points[:, 2]) < 0.01) & (np.abs(points[:, 0]) < 0.04)
    mass = 2000 * np.prod(high - low) * inside.mean()
    assert found.mass == pytest.approx(mass, rel=0.01)
    centre = points[inside].mean(axis=0)
    np.testing.assert_allclose(found.centre, centre, atol=3e-4)
    arms = points[inside] - centre
    second = mass * (arms.T @ arms) / len(arms)
    np.testing.assert_allclose(found.inertia, np.trace(second) * np.eye(3) - second, atol=0.02 * np.trace(second))


def scene_with(thing: UnionObject | MeshObject, tmp_path: Path) -> Scene:
    text = f"""
name: thing
model: {{hand: puma, fingers: 3}}
object: {thing.model_dump_json(exclude_defaults=True)}
start: {{pose: {{position: [0, 0, 0.2]}}}}
goal: {{pose: {{position: [0, 0, 0.22]}}}}
"""
    return parse(text, "thing.yaml", tmp_path)


def test_the_world_of_a_union_has_its_mass_and_its_parts(tmp_path: Path) -> None:
    world = build(scene_with(dumbbell(mass=0.3), tmp_path))
    assert world.object_kind == matter.MESH
    assert len(world.matter.parts) == len(world.object_geoms) == 3
    np.testing.assert_allclose(world.model.body_ipos[world.object_body], world.matter.centre, atol=1e-12)
    assert world.model.body_mass[world.object_body] == 0.3
    grid = world.object_grid
    assert grid is not None
    node = np.array([12, 20, 17])
    p = grid.origin + grid.spacing * node
    ends = np.linalg.norm(p - [[-0.04, 0, 0], [0.04, 0, 0]], axis=1) - [0.02, 0.025]
    bar = np.linalg.norm(p - [np.clip(p[0], -0.04, 0.04), 0, 0]) - 0.01
    assert grid.values[tuple(node)] == pytest.approx(min(*ends, bar), abs=1e-12)


def test_a_convex_mesh_is_one_part_whose_geom_is_the_rounded_solid(tmp_path: Path) -> None:
    shapes.file(tmp_path, shapes.box(60, 40, 50), "box.stl")
    thing = MeshObject(shape="mesh", file="box.stl", scale=0.001, rounding=0.004, resolution=0.002, density=800.0)
    world = build(scene_with(thing, tmp_path))
    assert len(world.matter.parts) == 1
    (part,) = world.matter.parts
    np.testing.assert_allclose(np.max(part.vertices + part.p_OP, axis=0), [0.026, 0.016, 0.021], atol=2e-5)
    assert world.matter.mass == pytest.approx(800 * 0.06 * 0.04 * 0.05, rel=1e-6)
    np.testing.assert_allclose(
        np.diag(world.matter.inertia),
        world.matter.mass / 3 * np.array([0.02**2 + 0.025**2, 0.03**2 + 0.025**2, 0.03**2 + 0.02**2]),
        rtol=1e-5,
    )
    geom = int(world.object_geoms[0])
    data = mujoco.MjData(world.model)
    mujoco.mj_kinematics(world.model, data)
    first = world.model.mesh_vertadr[world.model.geom_dataid[geom]]
    count = world.model.mesh_vertnum[world.model.geom_dataid[geom]]
    corners = world.model.mesh_vert[first : first + count] @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    np.testing.assert_allclose(np.ptp(corners, axis=0), [0.06, 0.04, 0.05], atol=2e-5)


def test_a_plan_needs_no_source_file(tmp_path: Path) -> None:
    """The world is built again from what a plan stores, with the files gone."""
    path = Path(shapes.file(tmp_path, shapes.box(60, 40, 50), "box.stl"))
    thing = MeshObject(shape="mesh", file="box.stl", scale=0.001, rounding=0.004, resolution=0.002, mass=0.2)
    world = build(scene_with(thing, tmp_path))
    path.unlink()
    again = from_plan(world.scene.model_dump(mode="json"), world.xml, world.assets)
    np.testing.assert_array_equal(again.object_grid.values, world.object_grid.values)
    np.testing.assert_array_equal(again.model.mesh_vert, world.model.mesh_vert)
    np.testing.assert_array_equal(again.matter.skin.vertices, world.matter.skin.vertices)


def test_parts_cover_a_concave_mesh_and_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = shapes.bracket()
    parts = hulls.parts_of(np.array(mesh.vertices), np.array(mesh.faces))
    assert len(parts) > 1
    inside, _ = mesh.sample(500, return_index=True, seed=1)
    for p in inside:
        assert any(np.all(hull_planes(points) @ np.append(p, 1.0) < 2e-3) for points, _ in parts)
    monkeypatch.setitem(__import__("sys").modules, "coacd", None)  # a second time nothing is cut
    again = hulls.parts_of(np.array(mesh.vertices), np.array(mesh.faces))
    for (points, _), (others, _) in zip(parts, again, strict=True):
        np.testing.assert_array_equal(points, others)


def hull_planes(points: np.ndarray) -> np.ndarray:
    from scipy.spatial import ConvexHull

    return ConvexHull(points).equations


def test_reduced_hulls_say_how_far_what_they_lack_reaches() -> None:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(3000, 3))
    ball *= 0.03 / np.linalg.norm(ball, axis=1, keepdims=True)
    kept, excess = hulls.reduced(ball)
    assert len(kept) == hulls.CORNERS
    beyond = np.max(hull_planes(kept) @ np.column_stack([ball, np.ones(len(ball))]).T)
    assert beyond == pytest.approx(excess, rel=1e-9)
    assert excess < 1e-3
    corners = 0.02 * np.array(list(np.ndindex(2, 2, 2)), float)
    kept, excess = hulls.reduced(np.vstack([corners, rng.uniform(0, 0.02, (100, 3))]))
    assert len(kept) == 8
    assert excess == pytest.approx(0.0, abs=1e-12)
