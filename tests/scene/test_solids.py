"""The object's geoms are the true shape, and so are its mass and moments."""

import mujoco
import numpy as np
import pytest

from regrasp.scene import matter, solids
from regrasp.scene.schema import Object

SHAPES = [
    Object(shape="sphere", size=(0.04,), mass=0.2),
    Object(shape="ellipsoid", size=(0.05, 0.03, 0.04), mass=0.2),
    Object(shape="capsule", size=(0.02, 0.03), mass=0.2),
    Object(shape="cylinder", size=(0.04, 0.03), rounding=0.006, mass=0.2),
    Object(shape="cylinder", size=(0.02, 0.05), rounding=0.0199, mass=0.2),
    Object(shape="box", size=(0.03, 0.04, 0.05), rounding=0.005, mass=0.2),
    Object(shape="box", size=(0.03, 0.01, 0.05), rounding=0.0099, mass=0.2),
]
NAMES = [f"{shape.shape}-{shape.rounding:g}" for shape in SHAPES]


def body_of(shape: Object) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="object")
    body.add_freejoint()
    matter.add_to(spec, body, shape, matter.matter_of(shape, {}))
    probe = spec.worldbody.add_body(name="probe", mocap=True)
    probe.add_geom(name="probe", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-4, 0, 0])
    model = spec.compile()
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
def test_union_of_geoms_is_the_shape(shape: Object) -> None:
    """Outside, the nearest geom is as far as the distance says, to the 0.02 mm allowed to a cylinder's rim."""
    model, data = body_of(shape)
    probe = model.geom("probe").id
    geoms = [g for g in range(model.ngeom) if g != probe]
    tolerance = {"cylinder": 2.1e-5, "ellipsoid": 1e-6}.get(shape.shape, 1e-7)
    rng = np.random.default_rng(5)
    reach = np.linalg.norm(shape.size) * 1.3
    points = rng.uniform(-reach, reach, (150, 3))
    if shape.shape == "box":  # the edges and corners are where the union could fail
        core = np.array(shape.size) - shape.rounding
        points = np.vstack([points, np.sign(points[:50]) * core * (1 + 1e-3) + 0.5 * points[:50]])
    away = solids.distance(*solids.kind(shape), points)
    assert np.sum(away > 3e-4) > 60
    for p, true in zip(points[away > 3e-4], away[away > 3e-4], strict=True):
        data.mocap_pos[0] = p
        mujoco.mj_kinematics(model, data)
        found = min(mujoco.mj_geomDistance(model, data, probe, g, 1.0, np.zeros(6)) for g in geoms) + 1e-4
        assert found == pytest.approx(true, abs=tolerance)


@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
def test_moments_are_those_of_the_true_shape(shape: Object) -> None:
    """Against the sum over a fine grid of points inside."""
    half = np.array({1: shape.size * 3, 3: shape.size}.get(len(shape.size), (shape.size[0],) * 2 + shape.size[-1:]))
    if shape.shape == "capsule":
        half[2] += shape.size[0]
    n = 36
    axes = [h * ((np.arange(n) + 0.5) / n * 2 - 1) for h in half]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = solids.distance(*solids.kind(shape), grid) < 0
    assert solids.volume(shape) == pytest.approx(inside.mean() * 8 * half.prod(), rel=5e-3)
    second = (grid[inside] ** 2).mean(axis=0)
    np.testing.assert_allclose(solids.inertia(shape), second.sum() - second, rtol=1e-2)


def test_moments_agree_with_closed_forms_in_the_limits() -> None:
    box = Object(shape="box", size=(0.03, 0.04, 0.05), rounding=1e-9, mass=1.2)
    np.testing.assert_allclose(
        solids.inertia(box), 1 / 3 * np.array([0.04**2 + 0.05**2, 0.03**2 + 0.05**2, 0.03**2 + 0.04**2]), rtol=1e-6
    )
    ball = Object(shape="box", size=(0.03, 0.03, 0.03), rounding=0.03 * (1 - 1e-9), mass=1.0)
    np.testing.assert_allclose(solids.inertia(ball), np.full(3, 0.4 * 0.03**2), rtol=1e-6)
    disc = Object(shape="cylinder", size=(0.03, 0.05), rounding=1e-9, mass=1.0)
    across = (3 * 0.03**2 + 0.1**2) / 12
    np.testing.assert_allclose(solids.inertia(disc), [across, across, 0.03**2 / 2], rtol=1e-6)


def test_capsule_moments_agree_with_mujoco() -> None:
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="object")
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.02, 0.03, 0], mass=0.2)
    inertia = spec.compile().body("object").inertia
    np.testing.assert_allclose(np.sort(inertia), np.sort(0.2 * solids.inertia(SHAPES[2])), rtol=1e-12)


@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
def test_body_carries_mass_and_moments(shape: Object) -> None:
    model, data = body_of(shape)
    mujoco.mj_forward(model, data)
    mass = np.zeros((6, 6))
    mujoco.mj_fullM(model, data, mass)
    np.testing.assert_allclose(np.diag(mass), [shape.mass] * 3 + [*(shape.mass * solids.inertia(shape))], rtol=1e-12)
