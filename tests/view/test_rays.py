"""Rays against MuJoCo's own single-ray intersection, over every shape and from all sides."""

import mujoco
import numpy as np
import pytest

from regrasp.view.rays import cast, shapes

TETRAHEDRON = "0 0 0  0.3 0 0  0 0.3 0  0 0 0.3"
MODEL = f"""
<mujoco>
  <asset><mesh name="tetrahedron" vertex="{TETRAHEDRON}"/></asset>
  <worldbody>
    <geom type="plane" size="0.8 0.6 0.1" pos="0 0 -0.5" euler="10 20 0"/>
    <geom type="sphere" size="0.1" pos="0.3 0 0"/>
    <geom type="capsule" size="0.05 0.1" pos="-0.3 0.1 0" euler="30 50 0"/>
    <geom type="ellipsoid" size="0.1 0.05 0.15" pos="0 0.3 0.1" euler="10 80 20"/>
    <geom type="cylinder" size="0.07 0.1" pos="0 -0.3 0" euler="60 10 0"/>
    <geom type="box" size="0.1 0.05 0.08" pos="0 0 0.3" euler="20 30 40"/>
    <geom type="mesh" mesh="tetrahedron" pos="0 0 -0.2" euler="15 25 35"/>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def world() -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


def hit(world, origin, rays):
    geom, distance, normal = np.empty(len(rays), np.int64), np.empty(len(rays)), np.zeros((len(rays), 3))
    cast(shapes(*world, (0,)), origin, rays, geom, distance, normal)
    return geom, distance, normal


@pytest.mark.parametrize("seed", range(6))
def test_hits_are_those_of_mujoco(world, seed):
    rng = np.random.default_rng(seed)
    origin = rng.normal(size=3)
    origin *= 1.5 / np.linalg.norm(origin)
    rays = rng.uniform(-0.6, 0.6, (500, 3)) - origin
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    geom, distance, _ = hit(world, origin, rays)
    found = np.zeros(1, np.int32)
    wanted = [(mujoco.mj_ray(*world, origin, ray, None, 1, -1, found), int(found[0])) for ray in rays]
    reach, ids = map(np.array, zip(*wanted, strict=True))
    assert len(set(ids)) >= 6
    assert np.array_equal(geom, ids)
    assert np.allclose(distance[ids >= 0], reach[ids >= 0], rtol=0, atol=1e-9)


def test_normals_are_those_of_the_surface(world):
    """Two neighbouring hits on one smooth piece differ by a step along the surface, at right angles to its normal."""
    rng = np.random.default_rng(0)
    origin = np.array([0.6, -0.9, 0.8])
    rays = rng.uniform(-0.5, 0.5, (2000, 3)) - origin
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    geom, distance, normal = hit(world, origin, rays)
    for side in np.linalg.qr(rng.normal(size=(3, 3)))[0]:
        beside = rays + 1e-6 * side
        beside /= np.linalg.norm(beside, axis=1, keepdims=True)
        geom2, distance2, normal2 = hit(world, origin, beside)
        same = (geom == geom2) & (geom >= 0) & (np.linalg.norm(normal - normal2, axis=1) < 1e-3)
        # Where a ray grazes, a small turn of it is a long step on the surface.
        same &= np.abs(np.sum(normal * rays, axis=1)) > 0.1
        assert len(set(geom[same])) == 7
        step = distance2[same, None] * beside[same] - distance[same, None] * rays[same]
        assert np.abs(np.sum(step * normal[same], axis=1)).max() < 1e-8
    assert np.allclose(np.linalg.norm(normal[geom >= 0], axis=1), 1)
