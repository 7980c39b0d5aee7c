import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad
from scipy.spatial import cKDTree

from regrasp.kernels.grids import NO_GRIDS
from regrasp.kernels.sampling import sample
from regrasp.kernels.surfaces import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SPHERE,
    implicit,
    project,
    shape_operator,
    tangents,
)


def size(*entries):
    return np.array([*entries, *[0.0] * (4 - len(entries))])


CLOSED = {
    "sphere": (SPHERE, size(0.03)),
    "ellipsoid": (ELLIPSOID, size(0.04, 0.03, 0.05)),
    "spheroid": (ELLIPSOID, size(0.03, 0.03, 0.01)),
    "needle": (ELLIPSOID, size(0.004, 0.006, 0.08)),
    "round ellipsoid": (ELLIPSOID, size(0.03, 0.03, 0.03)),
    "capsule": (CAPSULE, size(0.02, 0.05)),
    "cylinder": (CYLINDER, size(0.03, 0.05, 0.0, 0.004)),
    "coin": (CYLINDER, size(0.05, 0.003, 0.0, 0.003)),
    "box": (BOX, size(0.04, 0.03, 0.05, 0.004)),
    "card": (BOX, size(0.05, 0.04, 0.001, 0.0005)),
    "ball box": (BOX, size(0.03, 0.03, 0.03, 0.03)),
}
ALL = {**CLOSED, "plane": (PLANE, size())}
closed = pytest.mark.parametrize(("kind", "dimensions"), CLOSED.values(), ids=CLOSED)
every = pytest.mark.parametrize(("kind", "dimensions"), ALL.values(), ids=ALL)


def foot_of(kind, dimensions, p):
    foot, n = np.empty(3), np.empty(3)
    return project(kind, dimensions, NO_GRIDS, np.array(p, dtype=float), foot, n), foot, n


def value(kind, dimensions, p):
    g, H = np.empty(3), np.empty((3, 3))
    return implicit(kind, dimensions, NO_GRIDS, np.array(p, dtype=float), g, H), g, H


def around(kind, dimensions):
    """Points on, outside and inside a surface: samples, poles, and either side of every seam."""
    if kind == PLANE:
        return np.random.default_rng(1).normal(size=(20, 3))
    on = list(sample(kind, dimensions, NO_GRIDS, 60)[0])
    r = dimensions[3] if kind in (CYLINDER, BOX) else dimensions[dimensions > 0.0].min()
    poles = np.concatenate((np.eye(3), -np.eye(3))) * 0.3
    seams = {
        CAPSULE: np.array([dimensions[0], 0.0, dimensions[1]]),
        CYLINDER: np.array([0.6 * (dimensions[0] - r), 0.8 * (dimensions[0] - r), dimensions[1] - r]),
        BOX: dimensions[:3] - r,
    }
    if kind in seams:
        shifts = np.stack(np.meshgrid(*[[-0.1 * r, 0.1 * r, 2.0 * r]] * 3), axis=-1).reshape(-1, 3)
        poles = np.concatenate((poles, seams[kind] + shifts, -seams[kind] - shifts))
    on += [foot_of(kind, dimensions, p)[1] for p in poles]
    n = np.array([foot_of(kind, dimensions, p)[2] for p in on])
    return np.concatenate((on, on + 0.5 * r * n, on + 1e-5 * n, on - 0.3 * r * n))


@every
def test_gradient_and_hessian_are_the_finite_differences(kind, dimensions):
    for p in around(kind, dimensions):
        _, g, H = value(kind, dimensions, p)
        h = 1e-7
        dF = np.empty(3)
        dg = np.empty((3, 3))
        for i, step in enumerate(h * np.eye(3)):
            above, below = value(kind, dimensions, p + step), value(kind, dimensions, p - step)
            dF[i] = (above[0] - below[0]) / (2.0 * h)
            dg[:, i] = (above[1] - below[1]) / (2.0 * h)
        np.testing.assert_allclose(g, dF, atol=2e-7 * max(1.0, np.linalg.norm(g)), err_msg=str(p))
        np.testing.assert_allclose(H, dg, rtol=1e-6, atol=1e-5 * max(1.0, np.abs(H).max()), err_msg=str(p))
        np.testing.assert_allclose(H, H.T, rtol=0.0, atol=1e-15 * np.abs(H).max())


@every
def test_signed_distances_have_unit_gradients_and_their_sign_is_the_side(kind, dimensions):
    for p in around(kind, dimensions):
        F, g, _ = value(kind, dimensions, p)
        d = foot_of(kind, dimensions, p)[0]
        if kind == ELLIPSOID:
            assert d * F >= 0.0 or abs(d) < 1e-15
        else:
            assert d == F
            assert np.linalg.norm(g) == pytest.approx(1.0, abs=1e-15)


def principal(kind, dimensions, p):
    n, S = np.empty(3), np.empty((3, 3))
    shape_operator(kind, dimensions, NO_GRIDS, np.array(p, dtype=float), n, S)
    np.testing.assert_allclose(S @ n, 0.0, atol=1e-12 * max(1.0, np.abs(S).max()))
    np.testing.assert_allclose(n @ S, 0.0, atol=1e-12 * max(1.0, np.abs(S).max()))
    x, y = np.empty(3), np.empty(3)
    tangents(n, x, y)
    tangent = np.stack((x, y))
    return np.linalg.eigvalsh(tangent @ S @ tangent.T)


def test_principal_curvatures_of_every_patch():
    a, b, c = 0.04, 0.03, 0.05
    e = 0.004
    k = e / math.sqrt(2.0)
    m = e / math.sqrt(3.0)
    cases = [
        (SPHERE, size(0.02), [0.0, 0.012, -0.016], 50.0, 50.0),
        (ELLIPSOID, size(a, b, c), [0.0, 0.0, c], c / a**2, c / b**2),
        (ELLIPSOID, size(a, b, c), [-a, 0.0, 0.0], a / c**2, a / b**2),
        (CAPSULE, size(0.02, 0.05), [0.012, 0.016, 0.03], 0.0, 50.0),
        (CAPSULE, size(0.02, 0.05), [0.0, 0.0, -0.07], 50.0, 50.0),
        (CAPSULE, size(0.02, 0.05), [0.0, 0.02, 0.05], 0.0, 50.0),  # the seam
        (CYLINDER, size(0.05, 0.03, 0.0, e), [0.0, 0.0, 0.03], 0.0, 0.0),
        (CYLINDER, size(0.05, 0.03, 0.0, e), [0.046, 0.0, 0.03], 0.0, 0.0),  # the seam
        (CYLINDER, size(0.05, 0.03, 0.0, e), [0.0, -0.05, 0.01], 0.0, 20.0),
        (CYLINDER, size(0.05, 0.03, 0.0, e), [0.05, 0.0, 0.026], 0.0, 20.0),  # the seam
        (CYLINDER, size(0.05, 0.03, 0.0, e), [0.046 + k, 0.0, -0.026 - k], math.sqrt(0.5) / (0.046 + k), 1.0 / e),
        (BOX, size(a, b, c, e), [a, 0.01, 0.02], 0.0, 0.0),
        (BOX, size(a, b, c, e), [a, b - e, 0.0], 0.0, 0.0),  # the seam
        (BOX, size(a, b, c, e), [a - e + k, b - e + k, 0.01], 0.0, 1.0 / e),
        (BOX, size(a, b, c, e), [a - e + m, -(b - e + m), c - e + m], 1.0 / e, 1.0 / e),
        (CYLINDER, size(0.05, e, 0.0, e), [0.0, 0.05, 0.0], 20.0, 1.0 / e),  # no face is left on the side
        (CYLINDER, size(e, 0.03, 0.0, e), [0.0, 0.0, 0.03], 1.0 / e, 1.0 / e),
        (BOX, size(a, b, e, e), [a, 0.0, 0.0], 0.0, 1.0 / e),
        (PLANE, size(), [3.0, -2.0, 0.0], 0.0, 0.0),
    ]
    for kind, dimensions, p, low, high in cases:
        np.testing.assert_allclose(principal(kind, dimensions, p), [low, high], rtol=1e-11, atol=1e-9, err_msg=str(p))


@every
def test_projection_is_idempotent_and_its_offset_normal(kind, dimensions):
    for p in around(kind, dimensions):
        d, foot, n = foot_of(kind, dimensions, p)
        scale = max(np.linalg.norm(p), 0.01)
        F, g, _ = value(kind, dimensions, foot)
        assert abs(F) / np.linalg.norm(g) < 1e-15 * scale
        np.testing.assert_allclose(n, g / np.linalg.norm(g), atol=1e-11)
        np.testing.assert_allclose(p - foot, d * n, atol=1e-14 * scale)
        again, second, _ = foot_of(kind, dimensions, foot)
        assert abs(again) < 1e-15 * scale
        np.testing.assert_allclose(second, foot, atol=2e-15 * scale)
        in_place = p.copy()
        assert project(kind, dimensions, NO_GRIDS, in_place, in_place, n) == d
        np.testing.assert_array_equal(in_place, foot)


@closed
def test_signed_distance_against_brute_force(kind, dimensions):
    cloud, normals = sample(kind, dimensions, NO_GRIDS, 4000)
    tree = cKDTree(cloud)
    rng = np.random.default_rng(2)
    box = np.abs(cloud).max(axis=0)
    half = box * rng.uniform(-1.5, 1.5, size=(200, 3))
    special = [
        np.zeros(3),
        *(0.3 * np.diag(box)),
        *(3.0 * np.diag(box)),
        *(-1e-9 * np.diag(box)),
        1e3 * box,
        1e-12 * box,
    ]
    for p in np.concatenate((half, special)):
        d, foot, _ = foot_of(kind, dimensions, p)
        # The foot lies on the surface (so |d| is no less than the distance) and no point of the cloud is nearer.
        assert abs(d) <= tree.query(p)[0] * (1.0 + 1e-12)
        assert np.linalg.norm(p - foot) == pytest.approx(abs(d), rel=1e-12, abs=1e-16)
        assert abs(value(kind, dimensions, foot)[0]) < 1e-13
        beyond = np.max(np.sum((p - cloud) * normals, axis=1))  # over the tangent planes of a convex body
        assert d * beyond > 0.0 or abs(d) < 1e-3


@settings(deadline=None, max_examples=300)
@given(
    st.tuples(*[st.floats(0.002, 0.2)] * 3),
    st.tuples(*[st.one_of(st.floats(-0.3, 0.3), st.sampled_from([0.0, 1e-300, -1e-20, 1e-9]))] * 3),
)
def test_ellipsoid_foot_is_stationary_and_global_for_any_point(axes, p):
    p, a2 = np.array(p), np.array(axes) ** 2
    d, foot, n = foot_of(ELLIPSOID, size(*axes), p)
    scale = max(np.abs(p).max(), max(axes))
    assert np.sum(foot**2 / a2) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(p - foot, d * n, atol=1e-12 * scale)
    # With p − foot = t foot/a², the foot is the global minimum when t ≥ −a_min² (the Hessian of the Lagrangian).
    t = d / np.linalg.norm(foot / a2)
    assert t >= -a2.min() * (1.0 + 1e-12)


@settings(deadline=None, max_examples=300)
@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda n: np.linalg.norm(n) > 1e-3))
def test_tangents_are_right_handed_everywhere(n):
    n = np.array(n) / np.linalg.norm(n)
    x, y = np.empty(3), np.empty(3)
    tangents(n, x, y)
    np.testing.assert_allclose(np.stack((x, y, n)) @ np.stack((x, y, n)).T, np.eye(3), atol=2e-15)
    np.testing.assert_allclose(np.cross(x, y), n, atol=2e-15)


@pytest.mark.parametrize("n", [*np.eye(3), *-np.eye(3)])
def test_tangents_follow_a_box_and_do_not_jump_by_round_off_on_its_faces(n):
    x, y, x_near, y_near = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    tangents(n, x, y)
    assert sorted(np.abs(x)) == [0.0, 0.0, 1.0]
    for shift in np.concatenate((np.eye(3), -np.eye(3))):
        near = n + 1e-9 * shift
        tangents(near / np.linalg.norm(near), x_near, y_near)
        np.testing.assert_allclose((x_near, y_near), (x, y), atol=3e-9)


def ellipsoid_area(dimensions, theta):
    """Area between the angles theta and π − theta from the z axis."""
    a, b, c = dimensions[:3]

    def element(phi, theta):
        s, t = math.sin(theta), math.cos(theta)
        return s * math.sqrt(((b * c * math.cos(phi)) ** 2 + (a * c * math.sin(phi)) ** 2) * s * s + (a * b * t) ** 2)

    return 8.0 * dblquad(element, theta, math.pi / 2.0, 0.0, math.pi / 2.0, epsabs=1e-10)[0]


def areas(kind, dimensions):
    """Area of the whole surface and of a part of it, and the test that tells whether a point (p, n) is in that part."""
    a, b, c, e = dimensions
    if kind == SPHERE:
        return 4.0 * math.pi * a**2, 2.0 * math.pi * a**2, lambda p, n: np.abs(p[:, 2]) < a / 2.0
    if kind == CAPSULE:
        return 4.0 * math.pi * a * (a + b), 4.0 * math.pi * a * b, lambda p, n: np.abs(p[:, 2]) < b
    if kind == CYLINDER:
        caps, rim = 2.0 * math.pi * (a - e) ** 2, 4.0 * math.pi * e * (math.pi / 2.0 * (a - e) + e)
        return caps + 4.0 * math.pi * a * (b - e) + rim, caps, lambda p, n: np.abs(n[:, 2]) > 1.0 - 1e-12
    if kind == BOX:
        x, y, z = dimensions[:3] - e
        faces = 8.0 * (x * y + y * z + z * x)
        rounded = 4.0 * math.pi * e * (x + y + z) + 4.0 * math.pi * e**2
        return faces + rounded, faces, lambda p, n: np.abs(n).max(axis=1) > 1.0 - 1e-12
    whole, band = ellipsoid_area(dimensions, 0.0), ellipsoid_area(dimensions, math.pi / 3.0)
    return whole, band, lambda p, n: np.abs(p[:, 2]) < c / 2.0


@closed
@pytest.mark.parametrize("count", [1, 7, 100, 1000])
def test_samples_lie_on_the_surface_apart_and_without_holes(kind, dimensions, count):
    points, normals = sample(kind, dimensions, NO_GRIDS, count)
    assert points.shape == normals.shape == (count, 3)
    for p, n in zip(points, normals, strict=True):
        F, g, _ = value(kind, dimensions, p)
        assert abs(F) < 1e-14 * np.linalg.norm(g)
        np.testing.assert_allclose(n, g / np.linalg.norm(g), atol=1e-9)
    np.testing.assert_array_equal(sample(kind, dimensions, NO_GRIDS, count)[0], points)
    if count >= 100:
        spacing = math.sqrt(areas(kind, dimensions)[0] / count)
        tree = cKDTree(points)
        assert tree.query(sample(kind, dimensions, NO_GRIDS, 7777)[0])[0].max() < 1.1 * spacing
        if kind != BOX:  # whose patches each have a lattice of their own, so that points may be close across a seam
            assert tree.query(points, 2)[0][:, 1].min() > 0.4 * spacing


@closed
def test_each_region_has_its_share_of_samples_by_area(kind, dimensions):
    count = 4000
    points, normals = sample(kind, dimensions, NO_GRIDS, count)
    whole, part, within = areas(kind, dimensions)
    assert np.mean(within(points, normals)) == pytest.approx(part / whole, abs=0.003)
    octants = np.bincount((points > 0.0) @ [1, 2, 4], minlength=8) / count
    np.testing.assert_allclose(octants, 0.125, atol=0.0015)


@pytest.mark.parametrize(("kind", "count"), [(PLANE, 10), (SPHERE, 0), (17, 10)])
def test_sampling_refuses_what_has_no_samples(kind, count):
    with pytest.raises(ValueError, match="cannot sample"):
        sample(kind, size(0.1, 0.1, 0.1), NO_GRIDS, count)
