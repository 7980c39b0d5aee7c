import numpy as np
import pytest

from regrasp.kernels.contact import FLAT, OK, advance, contact_rates
from regrasp.kernels.grids import grid_bends, grid_field, grids_of
from regrasp.kernels.sampling import sample
from regrasp.kernels.surfaces import BOX, MESH, SPHERE, implicit, project, shape_operator, tangents

R_BALL = 0.02
BRICK = np.array([0.02, 0.015, 0.01, 0.004])


def nodes(low, high, h):
    axes = [np.arange(a, b + 0.5 * h, h) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def sampled(distance, low, high, h):
    """(origin, spacing, values) of a signed distance on a grid."""
    points = nodes(low, high, h)
    return points[0, 0, 0], h, distance(points)


def ball(p):
    return np.linalg.norm(p, axis=-1) - R_BALL


def brick(p):
    q = np.abs(p) - (BRICK[:3] - BRICK[3])
    return np.linalg.norm(np.maximum(q, 0.0), axis=-1) + np.minimum(q.max(axis=-1), 0.0) - BRICK[3]


def dish(p):
    """A block with a spherical hollow of radius 30 mm and depth 7 mm in its top; exact outside but next to its rim."""
    block = np.max(np.abs(p - [0.0, 0.0, -0.01]) - [0.03, 0.03, 0.01], axis=-1)
    return np.maximum(block, 0.03 - np.linalg.norm(p - [0.0, 0.0, 0.023], axis=-1))


def box_of(size):
    return -np.array(size), np.array(size)


GRIDS = grids_of([
    sampled(ball, *box_of([0.03] * 3), 1e-3),
    sampled(brick, *box_of([0.03, 0.025, 0.02]), 5e-4),
    sampled(dish, [-0.04, -0.04, -0.03], [0.04, 0.04, 0.02], 1e-3),
])  # fmt: skip
BALL, DISH = np.array([0.0, 0.0, 0.0, 0.0]), np.array([2.0, 0.0, 0.0, 0.0])
MADE = np.array([1.0, 0.0, 0.0, BRICK[3]])


def test_cubics_are_exact_up_to_the_boundary():
    rng = np.random.default_rng(0)
    c = rng.normal(size=(4, 4, 4))

    def cubic(p):
        return np.polynomial.polynomial.polyval3d(*np.moveaxis(p, -1, 0), c)

    grids = grids_of(
        [sampled(ball, *box_of([0.03] * 3), 5e-3), sampled(cubic, [-1.0, 0.0, -0.5], [1.0, 1.5, 1.0], 0.25)]
    )
    for p in rng.uniform([-1.0, 0.0, -0.5], [1.0, 1.5, 1.0], size=(100, 3)):
        F, _ = grid_field(grids, 1, p)
        np.testing.assert_allclose(F, cubic(p), atol=1e-11)


def test_a_grid_of_three_nodes_is_refused():
    with pytest.raises(ValueError, match="at least 4"):
        grids_of([(np.zeros(3), 1.0, np.zeros((5, 3, 5)))])


def shell(count):
    """Points up to 2 mm from the ball's surface, both sides."""
    rng = np.random.default_rng(1)
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1)[:, None] * (R_BALL + rng.uniform(-0.002, 0.002, (count, 1)))


def test_value_gradient_and_curvature_converge_with_order_four_three_two():
    errors = []
    for h in (1e-3, 5e-4):
        grids = grids_of([sampled(ball, *box_of([0.03] * 3), h)])
        worst = np.zeros(3)
        for p in shell(300):
            r = np.linalg.norm(p)
            F, g = grid_field(grids, 0, p)
            across = np.cross(p, [1.0, 0.0, 0.0]) / np.linalg.norm(np.cross(p, [1.0, 0.0, 0.0]))
            turned = np.cross(p / r, across)
            H = np.array(grid_bends(grids, 0, p, across, turned))
            off = [abs(F - (r - R_BALL)), np.linalg.norm(g - p / r), np.linalg.norm(H - np.array([across, turned]) / r)]
            worst = np.maximum(worst, off)
        errors.append(worst)
    order = np.log2(errors[0] / errors[1])
    assert np.all(order > [3.5, 2.5, 1.5]), order
    assert errors[1][0] < 2e-8
    assert errors[1][2] < 0.5  # 1/m, of 50


def test_a_rounded_box_is_known_to_a_hundredth_of_the_spacing():
    p, n = sample(BOX, BRICK, GRIDS, 500)
    for point, normal in zip(p, n, strict=True):
        F, g = grid_field(GRIDS, 1, point)
        assert abs(F) < 5e-6
        assert np.linalg.norm(np.cross(g, normal)) < 0.02


def test_gradient_and_hessian_are_the_finite_differences():
    h = 1e-7
    for size, points in ((BALL, shell(30)), (DISH, sample(MESH, DISH, GRIDS, 50)[0])):
        for p in points:
            g, H = np.empty(3), np.empty((3, 3))
            implicit(MESH, size, GRIDS, p, g, H)
            for a, step in enumerate(h * np.eye(3)):
                ends = [grid_field(GRIDS, int(size[0]), p + sign * step) for sign in (1.0, -1.0)]
                assert g[a] == pytest.approx((ends[0][0] - ends[1][0]) / (2.0 * h), abs=1e-8)
                np.testing.assert_allclose(H[:, a], np.subtract(ends[0][1], ends[1][1]) / (2.0 * h), atol=2e-3)
            np.testing.assert_allclose(H, H.T, atol=1e-9)


def test_beyond_the_grid_the_distance_goes_on():
    rng = np.random.default_rng(2)
    for p in rng.uniform(-0.5, 0.5, size=(300, 3)):
        F, g = grid_field(GRIDS, 0, p)
        r = np.linalg.norm(p)
        if np.abs(p).max() > 0.03:
            assert np.linalg.norm(g) == pytest.approx(1.0, abs=1e-12)
            assert r - R_BALL - 1e-6 < F < 1.2 * (r - R_BALL)
            assert g @ p / r > 0.9
    edge = np.array([0.03, 0.012, -0.007])
    assert grid_field(GRIDS, 0, edge)[0] == pytest.approx(grid_field(GRIDS, 0, edge + [1e-9, 0.0, 0.0])[0], abs=1e-6)


def foot_of(size, p):
    foot, n = np.empty(3), np.empty(3)
    return project(MESH, size, GRIDS, np.array(p), foot, n), foot, n


def test_the_closest_point_is_on_the_surface_and_its_offset_normal():
    rng = np.random.default_rng(3)
    for size in (BALL, MADE, DISH):
        for p in rng.uniform(-0.06, 0.06, size=(100, 3)):
            d, foot, n = foot_of(size, p)
            F, g = grid_field(GRIDS, int(size[0]), foot)
            assert abs(F) < 1e-16
            np.testing.assert_allclose(n, g / np.linalg.norm(g), atol=1e-12)
            if d > 0.0:
                np.testing.assert_allclose(p - foot, d * n, atol=1e-7)
    for p in rng.uniform(-0.06, 0.06, size=(100, 3)):
        q, n = np.empty(3), np.empty(3)
        exact = project(BOX, BRICK, GRIDS, p, q, n)
        if exact > -BRICK[3]:
            d, foot, _ = foot_of(MADE, p)
            assert d == pytest.approx(exact, abs=1e-5)


def test_a_hollow_curves_the_other_way():
    n, S = np.empty(3), np.empty((3, 3))
    shape_operator(MESH, DISH, GRIDS, foot_of(DISH, [0.003, 0.001, 0.0])[1], n, S)
    np.testing.assert_allclose(np.sort(np.linalg.eigvalsh(S)), [-1.0 / 0.03, -1.0 / 0.03, 0.0], atol=0.5)


def resting(r):
    """(p, c, R, x) of a ball of radius r at the bottom of the dish."""
    _, p, n = foot_of(DISH, [0.0, 0.0, -0.005])
    x, y = np.empty(3), np.empty(3)
    tangents(n, x, y)
    return p, -r * n, np.eye(3), x


def test_a_ball_rolls_in_a_hollow_as_in_a_sphere():
    r, a = 0.01, 0.03
    p, c, R, x = resting(r)
    start = p.copy()
    turn = 0.2
    assert (
        advance(
            MESH, DISH, SPHERE, np.array([r, 0.0, 0.0, 0.0]), GRIDS, np.array([0.0, turn, 0.0, 0.0]), 10, p, c, R, x
        )
        == OK
    )
    # The contact's arc on the hollow is a θ; relative to it the ball turns by θ (a − r)/r against the way, ω = θ (a − r)/r.
    theta = turn * r / (a - r)
    assert np.linalg.norm(p - start) == pytest.approx(2.0 * a * np.sin(0.5 * theta), rel=5e-3)
    assert foot_of(DISH, p - R @ c)[0] == pytest.approx(r, abs=1e-8)


@pytest.mark.parametrize("r", [0.03001, 0.06])
def test_a_ball_larger_than_the_hollow_is_refused(r):
    p, c, R, x = resting(r)
    size = np.array([r, 0.0, 0.0, 0.0])
    rates = np.empty(3), np.empty(3)
    assert (
        contact_rates(MESH, DISH, SPHERE, size, GRIDS, p, c, R, np.array([1.0, 0.0, 0.0]), np.zeros(3), *rates) == FLAT
    )
    assert advance(MESH, DISH, SPHERE, size, GRIDS, np.array([0.0, 0.1, 0.0, 0.0]), 1, p, c, R, x) == FLAT


@pytest.mark.parametrize("count", [1, 40, 400])
def test_samples_of_a_mesh_lie_on_it_apart_and_each_face_has_its_share(count):
    p, n = sample(MESH, MADE, GRIDS, count)
    assert p.shape == n.shape == (count, 3)
    for point, normal in zip(p, n, strict=True):
        d, _, expected = foot_of(MADE, point)
        assert abs(d) < 1e-12
        np.testing.assert_allclose(normal, expected, atol=1e-9)
    np.testing.assert_array_equal(sample(MESH, MADE, GRIDS, count)[0], p)
    if count < 400:
        return
    x, y, z = BRICK[:3] - BRICK[3]
    e = BRICK[3]
    area = 8.0 * (x * y + y * z + z * x) + 4.0 * np.pi * e * (x + y + z) + 4.0 * np.pi * e * e
    away = np.linalg.norm(p[:, None] - p[None], axis=-1) + np.eye(count)
    assert away.min() > 0.4 * np.sqrt(area / count)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        share = np.mean(np.abs(np.delete(n, (a, b), axis=1)) > 0.999)
        assert share == pytest.approx(8.0 * (x, y, z)[a] * (x, y, z)[b] / area, abs=0.03)
