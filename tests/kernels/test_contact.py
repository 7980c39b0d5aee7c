import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from regrasp.kernels.contact import FLAT, LOST, OK, advance, contact_rates, settle
from regrasp.kernels.grids import NO_GRIDS
from regrasp.kernels.surfaces import BOX, CAPSULE, CYLINDER, ELLIPSOID, PLANE, SPHERE, implicit, project, tangents


def size(*entries):
    return np.array([*entries, *[0.0] * (4 - len(entries))])


BALL = (SPHERE, size(0.01))
EGG = (ELLIPSOID, size(0.04, 0.03, 0.05))
THUMB = (ELLIPSOID, size(0.009, 0.011, 0.016))
CAN = (CYLINDER, size(0.03, 0.05, 0.0, 0.003))
BRICK = (BOX, size(0.04, 0.03, 0.05, 0.003))
PILL = (CAPSULE, size(0.02, 0.04))
FLOOR = (PLANE, size())
PAIRS = {
    "ball on egg": (EGG, BALL),
    "thumb on egg": (EGG, THUMB),
    "ball on can": (CAN, BALL),
    "thumb on brick": (BRICK, THUMB),
    "pill's side on egg": (EGG, PILL),
    "ball on floor": (FLOOR, BALL),
    "floor on egg": (EGG, FLOOR),
}
pairs = pytest.mark.parametrize(("surface_O", "surface_T"), PAIRS.values(), ids=PAIRS)


def normal(surface, p):
    g = np.empty(3)
    F = implicit(*surface, NO_GRIDS, np.asarray(p), g, np.empty((3, 3)))
    return F / np.linalg.norm(g), g / np.linalg.norm(g)


def contact(surface_O, surface_T, near_O, near_T, yaw=0.0):
    """The state (p_OC, p_TC, R_OT, x_O) with the points next to near_O and near_T in contact."""
    p, c, n, n_T, x, y, x_T, y_T = np.empty((8, 3))
    project(*surface_O, NO_GRIDS, np.array(near_O, dtype=float), p, n)
    project(*surface_T, NO_GRIDS, np.array(near_T, dtype=float), c, n_T)
    tangents(n, x, y)
    tangents(n_T, x_T, y_T)
    turned = np.stack((x, -y, -n), axis=1)  # the tip's normal against the object's
    R = Rotation.from_rotvec(yaw * n).as_matrix() @ turned @ np.stack((x_T, y_T, n_T))
    return p, c, R, x


def move(surface_O, surface_T, state, command, substeps):
    p, c, R, x = (a.copy() for a in state)
    status = advance(*surface_O, *surface_T, NO_GRIDS, np.asarray(command, dtype=float), substeps, p, c, R, x)
    return status, (p, c, R, x)


def path(surface_O, surface_T, state, command, substeps):
    """The states after each of so many equal parts of the motion, the start first: arrays with a leading axis."""
    states = [state]
    for _ in range(substeps):
        status, after = move(surface_O, surface_T, states[-1], np.array(command) / substeps, 1)
        assert status == OK
        states.append(after)
    return [np.array(rows) for rows in zip(*states, strict=True)]


def assert_in_contact(surface_O, surface_T, state):
    p, c, R, x = state
    gap_O, n = normal(surface_O, p)
    gap_T, n_T = normal(surface_T, c)
    assert abs(gap_O) < 1e-15
    assert abs(gap_T) < 1e-15
    np.testing.assert_allclose(R @ n_T, -n, atol=1e-9)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-13)
    assert x @ n == pytest.approx(0.0, abs=1e-14)
    assert np.linalg.norm(x) == pytest.approx(1.0, abs=1e-14)


NEAR = ([0.03, 0.02, 0.035], [0.008, -0.006, 0.007])


@pairs
@pytest.mark.parametrize("seed", range(4))
def test_rates_are_the_finite_differences_of_the_contact_of_two_moving_bodies(surface_O, surface_T, seed):
    rng = np.random.default_rng(seed)
    p, c, R, _ = contact(surface_O, surface_T, rng.normal(size=3) * 0.05, rng.normal(size=3) * 0.05, rng.uniform(0, 6))
    w = rng.normal(size=3)  # spin included
    n = normal(surface_O, p)[1]
    v = 0.02 * np.cross(n, rng.normal(size=3))
    pdot, cdot = np.empty(3), np.empty(3)
    assert contact_rates(*surface_O, *surface_T, NO_GRIDS, p, c, R, w, v, pdot, cdot) == OK

    def contact_at(t):
        # Nearest points of the two bodies: on the surfaces, joined along the normals, which oppose.
        turn = Rotation.from_rotvec(t * w).as_matrix()
        R_t, origin = turn @ R, p + t * v - turn @ R @ c
        x, y = np.empty(3), np.empty(3)
        tangents(n, x, y)

        def residual(q):
            gap_O, n_O = normal(surface_O, q[:3])
            gap_T, n_T = normal(surface_T, q[3:])
            m, apart = n_O + R_t @ n_T, origin + R_t @ q[3:] - q[:3]
            across = apart - n_O * (n_O @ apart)
            return np.array([gap_O, gap_T, *(0.01 * np.array([m @ x, m @ y])), across @ x, across @ y]) * 1e3

        return fsolve(residual, np.concatenate((p, c)), xtol=1e-12)

    t = 1e-5
    q = (contact_at(t) - contact_at(-t)) / (2.0 * t)
    np.testing.assert_allclose(pdot, q[:3], atol=1e-6 * (np.linalg.norm(pdot) + 0.01))
    np.testing.assert_allclose(cdot, q[3:], atol=1e-6 * (np.linalg.norm(cdot) + 0.01))


def test_ball_rolls_on_a_plane_in_a_straight_line():
    r, turn = BALL[1][0], np.array([0.7, -0.4])
    state = contact(FLOOR, BALL, [0.1, 0.2, 0.0], [0.003, 0.004, -0.01])
    status, (p, c, R, x) = move(FLOOR, BALL, state, [*turn, 0.0, 0.0], 50)
    y = np.cross([0.0, 0.0, 1.0], x)
    w = turn[0] * state[3] + turn[1] * y
    assert status == OK
    np.testing.assert_allclose(p, state[0] + r * np.cross(w, [0.0, 0.0, 1.0]), atol=1e-10)
    np.testing.assert_allclose(R, Rotation.from_rotvec(w).as_matrix() @ state[2], atol=1e-14)
    np.testing.assert_allclose(c, R.T @ [0.0, 0.0, -r], atol=1e-12)
    np.testing.assert_array_equal(x, state[3])


def test_ball_rolls_on_a_cylinder_along_the_helix():
    # The cylinder unrolls to a plane and both curvatures are constant in the transported frame.
    a, r = CAN[1][0], BALL[1][0]
    state = contact(CAN, BALL, [0.05, 0.0, -0.02], [0.0, 0.0, 0.01])
    axis, around = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    x, n = state[3], np.array([1.0, 0.0, 0.0])
    command = np.array([1.1, 0.8, 0.0, 0.0])
    turn = np.cross(command[0] * x + command[1] * np.cross(n, x), n)
    rise, angle = r * (turn @ axis), (turn @ around) / (1.0 / a + 1.0 / r) / a
    status, (p, _, _, x_end) = move(CAN, BALL, state, command, 200)
    spin = Rotation.from_rotvec(angle * axis)
    assert status == OK
    np.testing.assert_allclose(p, spin.apply([a, 0.0, state[0][2] + rise]), atol=1e-7)
    np.testing.assert_allclose(x_end, spin.apply(x), atol=1e-9)


def test_sphere_rolled_around_an_octant_turns_by_its_solid_angle():
    # The tip is four times smaller than the object, so it makes one full turn on every side of the octant and comes
    # back to its point; what is left is the turn of the transported frame, π/2 (Gauss–Bonnet).
    a = 0.04
    surface_O, surface_T = (SPHERE, size(a)), (SPHERE, size(a / 4.0))
    start = contact(surface_O, surface_T, [0.3, 0.5, 0.8], [0.1, -0.7, 0.3], 0.9)
    turn = 0.5 * math.pi * a * (1.0 / a + 4.0 / a)
    state = start
    for command in ([0.0, turn, 0.0, 0.0], [-turn, 0.0, 0.0, 0.0], [0.0, -turn, 0.0, 0.0]):  # along x, y, −x
        status, state = move(surface_O, surface_T, state, command, 400)
        assert status == OK
    p, c, R, x = state
    quarter = Rotation.from_rotvec(0.5 * math.pi * start[0] / a).as_matrix()
    np.testing.assert_allclose(p, start[0], atol=1e-8)
    np.testing.assert_allclose(c, start[1], atol=1e-8)
    np.testing.assert_allclose(x, quarter @ start[3], atol=1e-6)
    np.testing.assert_allclose(R, quarter @ start[2], atol=1e-6)


def test_equal_spheres_stay_mirror_images():
    # The tip is the object's mirror image in the tangent plane for ever, whatever the path.
    ball = (SPHERE, size(0.03))
    start = contact(ball, ball, [0.1, 0.2, 0.9], [0.5, -0.3, 0.2])
    rng = np.random.default_rng(0)
    state = start
    for _ in range(5):
        status, state = move(ball, ball, state, [*rng.normal(size=2), 0.0, 0.0], 100)
        assert status == OK

    def mirrored(state):
        n = state[0] / 0.03
        return (np.eye(3) - 2.0 * np.outer(n, n)) @ state[2]

    np.testing.assert_allclose(mirrored(state), mirrored(start), atol=1e-7)


def test_slide_of_sphere_on_sphere_is_a_great_circle_and_keeps_the_tip_orientation():
    a, r = 0.03, 0.01
    surface_O, surface_T = (SPHERE, size(a)), (SPHERE, size(r))
    start = contact(surface_O, surface_T, [0.3, 0.5, -0.8], [0.1, -0.7, 0.3])
    n, x = start[0] / a, start[3]
    command = np.array([0.0, 0.0, 0.02, 0.01])
    v = command[2] * x + command[3] * np.cross(n, x)
    angle = np.linalg.norm(v) / (a + r)  # the centre of the tip moves on a sphere of radius a + r
    status, (p, c, R, _) = move(surface_O, surface_T, start, command, 12)
    assert status == OK
    np.testing.assert_array_equal(R, start[2])
    np.testing.assert_allclose(p / a, math.cos(angle) * n + math.sin(angle) * v / np.linalg.norm(v), atol=1e-7)
    np.testing.assert_allclose(c, R.T @ (-r * p / a), atol=1e-11)


@pytest.mark.parametrize("command", [[0.5, 0.3, 0.0, 0.0], [0.0, 0.0, 0.01, -0.02], [0.3, -0.2, 0.01, 0.005]])
def test_second_order_on_ellipsoids(command):
    state = contact(EGG, THUMB, *NEAR, 0.4)
    exact = move(EGG, THUMB, state, command, 2048)[1]
    errors = []
    for substeps in (6, 12, 24, 48):
        end = move(EGG, THUMB, state, command, substeps)[1]
        errors.append([np.abs(a - b).max() / np.abs(b).max() for a, b in zip(end, exact, strict=True)])
    order = np.log2(np.maximum(errors[:-1], 1e-15) / np.maximum(errors[1:], 1e-15))
    assert np.all((order > 1.7) | (np.array(errors[:-1]) < 1e-12))  # a slide does not turn the tip at all
    assert np.max(errors[1]) < 2e-3


@pairs
def test_rolling_back_returns_to_the_start(surface_O, surface_T):
    state = contact(surface_O, surface_T, *NEAR, 0.4)
    command = np.array([0.3, 0.4, 0.0, 0.0])
    status, there = move(surface_O, surface_T, state, command, 100)
    assert status == OK
    status, back = move(surface_O, surface_T, there, -command, 100)
    assert status == OK
    for a, b, scale in zip(back, state, (0.01, 0.01, 1.0, 1.0), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-5 * scale)


@pairs
def test_both_contact_paths_are_equally_long_in_rolling(surface_O, surface_T):
    p, c, _, _ = path(surface_O, surface_T, contact(surface_O, surface_T, *NEAR, 0.4), [0.4, -0.5, 0.0, 0.0], 200)
    s_O, s_T = (np.linalg.norm(np.diff(a, axis=0), axis=1).sum() for a in (p, c))
    assert s_O > 1e-3
    assert s_O == pytest.approx(s_T, rel=2e-5)


motions = st.tuples(*[st.floats(-1.0, 1.0)] * 2, *[st.floats(-0.03, 0.03)] * 2).map(np.array)


@settings(deadline=None, max_examples=200)
@given(st.sampled_from(sorted(PAIRS)), motions, st.integers(0, 10**6), st.integers(1, 20))
def test_contact_holds_after_any_motion(pair, command, seed, substeps):
    surface_O, surface_T = PAIRS[pair]
    rng = np.random.default_rng(seed)
    state = contact(surface_O, surface_T, rng.normal(size=3) * 0.05, rng.normal(size=3) * 0.05, rng.uniform(0, 6))
    status, state = move(surface_O, surface_T, state, command, substeps)
    assert status == OK
    assert_in_contact(surface_O, surface_T, state)


@pairs
def test_no_motion_leaves_the_state_untouched(surface_O, surface_T):
    state = contact(surface_O, surface_T, *NEAR)
    state[2][:] += 1e-7  # not even an inaccurate state is touched
    status, end = move(surface_O, surface_T, state, np.zeros(4), 12)
    assert status == OK
    for a, b in zip(end, state, strict=True):
        np.testing.assert_array_equal(a, b)
    for rows, a in zip(path(surface_O, surface_T, state, np.zeros(4), 3), state, strict=True):
        np.testing.assert_array_equal(rows, np.broadcast_to(a, rows.shape))


def test_parts_end_where_the_whole_motion_does_and_keep_contact_on_the_way():
    state, command = contact(BRICK, THUMB, *NEAR), [0.8, 0.6, 0.01, 0.02]
    rows = path(BRICK, THUMB, state, command, 12)
    for row, end in zip(rows, move(BRICK, THUMB, state, command, 12)[1], strict=True):
        np.testing.assert_allclose(row[-1], end, atol=1e-14)
    for states in zip(*rows, strict=True):
        assert_in_contact(BRICK, THUMB, states)


@pytest.mark.parametrize("turn", [0.5, 0.9, 1.7, 3.0])
@pytest.mark.parametrize("substeps", [4, 12])
def test_ball_rolls_over_the_edge_of_a_box(turn, substeps):
    # Face, edge and face are travelled with the turn per length 1/r, 1/r + 1/e and 1/r.
    r, (h_x, _, h_z, e) = BALL[1][0], BRICK[1]
    before = 0.006
    state = contact(BRICK, BALL, [h_x - e - before, 0.0, 1.0], [0.0, 0.0, -1.0])
    n, x = np.array([0.0, 0.0, 1.0]), state[3]
    w = np.array([0.0, turn, 0.0])  # towards +x
    status, (p, _, R, _) = move(BRICK, BALL, state, [w @ x, w @ np.cross(n, x), 0.0, 0.0], substeps)
    angle = np.clip((turn - before / r) / (1.0 + e / r), 0.0, math.pi / 2.0)
    beyond = max(0.0, turn - before / r - math.pi / 2.0 * (1.0 + e / r)) * r
    expected = [h_x - e + e * math.sin(angle), 0.0, h_z - e + e * math.cos(angle) - beyond]
    if turn < before / r:
        expected[0] = h_x - e - before + turn * r
    assert status == OK
    np.testing.assert_allclose(R, Rotation.from_rotvec(w).as_matrix() @ state[2], atol=1e-12)
    np.testing.assert_allclose(p, expected, atol=2e-5)


@pytest.mark.parametrize(
    ("surface_O", "surface_T", "near_O", "near_T"),
    [
        (FLOOR, BRICK, [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]),  # face on face
        (FLOOR, BRICK, [0.0, 0.0, 0.0], [1.0, 1.0, 0.0]),  # edge on face
        (BRICK, CAN, [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]),  # cylinder's side on face
        (FLOOR, FLOOR, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    ],
)
def test_contact_along_a_line_or_a_face_is_reported(surface_O, surface_T, near_O, near_T):
    state = contact(surface_O, surface_T, near_O, near_T)
    w, v = np.array([0.1, 0.2, 0.3]), np.zeros(3)
    assert contact_rates(*surface_O, *surface_T, NO_GRIDS, *state[:3], w, v, np.empty(3), np.empty(3)) == FLAT
    status, end = move(surface_O, surface_T, state, [0.1, 0.2, 0.0, 0.0], 12)
    assert status == FLAT
    for a, b in zip(end, state, strict=True):
        np.testing.assert_array_equal(a, b)


@pairs
@pytest.mark.parametrize("angle", [1e-9, 1e-4, 0.02])
def test_settle_rolls_the_contact_to_where_the_normals_oppose(surface_O, surface_T, angle):
    p, c, R, x = contact(surface_O, surface_T, *NEAR)
    turned = Rotation.from_rotvec(angle * x).as_matrix() @ R
    n = normal(surface_O, p)[1]
    p_end, c_end = p + 1e-3 * angle * n, c.copy()
    kept = turned.copy()
    status, gap = settle(*surface_O, *surface_T, NO_GRIDS, p_end, c_end, turned)
    assert status == OK
    assert gap == pytest.approx(angle, rel=2e-3)
    np.testing.assert_array_equal(turned, kept)
    tangents(normal(surface_O, p_end)[1], x, np.empty(3))
    assert_in_contact(surface_O, surface_T, (p_end, c_end, turned, x))


def test_settle_gives_up_without_touching_the_contact():
    p, c, R, x = contact(FLOOR, BALL, [0.0, 0.0, 0.0], [0.0, 0.0, -1.0])
    before = p.copy(), c.copy()
    facing_away = Rotation.from_rotvec(math.pi * x).as_matrix() @ R
    assert settle(*FLOOR, *BALL, NO_GRIDS, p, c, facing_away)[0] == LOST
    np.testing.assert_array_equal(p, before[0])
    np.testing.assert_array_equal(c, before[1])


def test_settle_cannot_turn_a_face_onto_a_face():
    p, c, R, x = contact(FLOOR, BRICK, [0.0, 0.0, 0.0], [0.0, 0.0, -1.0])
    assert settle(*FLOOR, *BRICK, NO_GRIDS, p, c, Rotation.from_rotvec(1e-3 * x).as_matrix() @ R)[0] == FLAT
