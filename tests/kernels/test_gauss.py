import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from regrasp.kernels.contact import FLAT, OK
from regrasp.kernels.gaps import gap
from regrasp.kernels.gauss import support_point
from regrasp.kernels.grids import grids_of
from regrasp.kernels.sampling import sample
from regrasp.kernels.surfaces import BOX, CAPSULE, CYLINDER, ELLIPSOID, MESH, SPHERE, implicit, project


def size(*entries):
    return np.array([*entries, *[0.0] * (4 - len(entries))])


def egg_grid():
    """The distance to an ellipsoid's surface on a grid of 1 mm."""
    axes = [np.arange(-30, 31) * 1e-3] * 3
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = np.empty(points.shape[:3])
    foot, n = np.empty(3), np.empty(3)
    for at in np.ndindex(values.shape):
        values[at] = project(ELLIPSOID, size(0.015, 0.018, 0.024), grids_of(()), points[at], foot, n)
    return points[0, 0, 0], 1e-3, values


GRIDS = grids_of([egg_grid()])
SURFACES = {
    "sphere": (SPHERE, size(0.012)),
    "ellipsoid": (ELLIPSOID, size(0.009, 0.011, 0.016)),
    "capsule": (CAPSULE, size(0.01, 0.012)),
    "cylinder": (CYLINDER, size(0.02, 0.01, 0.0, 0.003)),
    "box": (BOX, size(0.01, 0.012, 0.015, 0.003)),
    "mesh": (MESH, size(0.0)),
}
surfaces = pytest.mark.parametrize(("kind", "dimensions"), SURFACES.values(), ids=SURFACES)
DIRECTIONS = [*np.eye(3), *-np.eye(3), *(np.random.default_rng(0).normal(size=(60, 3)))]


@surfaces
def test_the_support_point_has_the_normal_and_no_point_is_further(kind, dimensions):
    cloud, _ = sample(kind, dimensions, GRIDS, 500)
    for d in DIRECTIONS:
        n = d / np.linalg.norm(d)
        p = np.array(support_point(kind, dimensions, GRIDS, n))
        g = np.empty(3)
        F = implicit(kind, dimensions, GRIDS, p, g, np.empty((3, 3)))
        assert abs(F) / np.linalg.norm(g) < 1e-15
        np.testing.assert_allclose(g / np.linalg.norm(g), n, atol=1e-9)
        assert n @ p >= np.max(cloud @ n) - 1e-15


@pytest.mark.parametrize(
    ("name", "n", "expected"),
    [
        ("capsule", [1.0, 0.0, 0.0], [0.01, 0.0, 0.0]),
        ("cylinder", [0.0, 0.0, -1.0], [0.0, 0.0, -0.01]),
        ("cylinder", [0.0, 1.0, 0.0], [0.0, 0.02, 0.0]),
        ("box", [0.0, -1.0, 0.0], [0.0, -0.012, 0.0]),
        ("box", [0.6, 0.8, 0.0], [0.007 + 0.0018, 0.009 + 0.0024, 0.0]),
    ],
)
def test_of_a_face_an_edge_or_a_line_it_is_the_middle(name, n, expected):
    kind, dimensions = SURFACES[name]
    for tilt in (np.zeros(3), 1e-9 * np.array([1.0, -1.0, 1.0])):
        np.testing.assert_allclose(support_point(kind, dimensions, GRIDS, np.array(n) + tilt), expected, atol=1e-7)


OBJECTS = {
    "egg": (ELLIPSOID, size(0.04, 0.03, 0.05)),
    "brick": (BOX, size(0.04, 0.03, 0.05, 0.006)),
    "mesh": (MESH, size(0.0)),
}


def measured(obj, tip, R, p):
    """Least distance between two bodies that are apart, by a general optimiser over points of the two surfaces."""
    a, b = np.empty(3), np.empty(3)

    def apart(z):
        project(*obj, GRIDS, z[:3].copy(), a, np.empty(3))
        project(*tip, GRIDS, z[3:].copy(), b, np.empty(3))
        return np.sum((a - R @ b - p) ** 2)

    best = np.inf
    c, n = np.empty(3), np.empty(3)
    project(*obj, GRIDS, p, c, n)
    found = minimize(apart, np.concatenate((c, R.T @ (c - p))), method="Nelder-Mead",
                     options={"xatol": 1e-9, "fatol": 1e-20, "maxiter": 6000, "maxfev": 6000})  # fmt: skip
    best = min(best, np.sqrt(found.fun))
    return best


@pytest.mark.parametrize("obj", OBJECTS.values(), ids=OBJECTS)
@surfaces
def test_the_gap_is_the_least_distance(obj, kind, dimensions):
    rng = np.random.default_rng(1)
    points, normals = sample(*obj, GRIDS, 12)
    for q, n in zip(points, normals, strict=True):
        R = Rotation.random(random_state=rng).as_matrix()
        c = np.array(support_point(kind, dimensions, GRIDS, -R.T @ n))
        p = q + rng.uniform(1e-4, 3e-3) * n - R @ c
        p_OC, p_TC, n_O = np.empty(3), np.empty(3), np.empty(3)
        status, g = gap(*obj, kind, dimensions, GRIDS, R, p, p_OC, p_TC, n_O)
        assert status == OK
        np.testing.assert_allclose(R @ p_TC + p - p_OC, g * n_O, atol=1e-9)
        assert g == pytest.approx(np.linalg.norm(R @ c + p - q), rel=1e-6)
        assert g <= measured(obj, (kind, dimensions), R, p) * (1.0 + 1e-6)


@surfaces
def test_an_overlap_is_as_deep_as_it_was_made(kind, dimensions):
    egg = OBJECTS["egg"]
    points, normals = sample(*egg, GRIDS, 12)
    for q, n in zip(points, normals, strict=True):
        R = Rotation.random(random_state=3).as_matrix()
        p = q - 1e-4 * n - R @ np.array(support_point(kind, dimensions, GRIDS, -R.T @ n))
        status, g = gap(*egg, kind, dimensions, GRIDS, R, p, np.empty(3), np.empty(3), np.empty(3))
        assert status == OK
        assert g == pytest.approx(-1e-4, rel=1e-6)


def test_two_faces_are_flat_and_as_far_apart_as_they_are():
    box = SURFACES["box"]
    p = np.array([0.04 + 0.01 + 5e-4, 0.0, 0.0])
    status, g = gap(*OBJECTS["brick"], *box, GRIDS, np.eye(3), p, np.empty(3), np.empty(3), np.empty(3))
    assert status == FLAT
    assert g == pytest.approx(5e-4, abs=1e-15)
