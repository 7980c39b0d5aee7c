"""Montana, The Kinematics of Contact and Grasp (IJRR 1988), in his charts, as the oracle of the chart-free form."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from regrasp.kernels.contact import OK, advance, contact_rates
from regrasp.kernels.grids import NO_GRIDS
from regrasp.kernels.surfaces import CYLINDER, ELLIPSOID, PLANE, SPHERE


@dataclass(frozen=True)
class Chart:
    """An orthogonal chart f(u, v), f_u × f_v outwards: latitude u and longitude −v on spheres and spheroids, angle u
    and height v on cylinders, x and y on the plane."""

    kind: int
    a: float = 0.0
    c: float = 0.0

    @property
    def surface(self):
        size = {SPHERE: [self.a], ELLIPSOID: [self.a, self.a, self.c], CYLINDER: [self.a, self.c], PLANE: []}[self.kind]
        return self.kind, np.array(size + [0.0] * (4 - len(size)))

    def derivatives(self, u, v):
        """f, f_u, f_v, f_uu, f_uv, f_vv."""
        a, c = self.a, self.a if self.kind == SPHERE else self.c
        cu, su, cv, sv = math.cos(u), math.sin(u), math.cos(v), math.sin(v)
        rows = {
            PLANE: [[u, v, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0] * 3, [0.0] * 3, [0.0] * 3],
            CYLINDER: [[a * cu, a * su, v], [-a * su, a * cu, 0], [0, 0, 1], [-a * cu, -a * su, 0], [0] * 3, [0] * 3],
        }.get(
            self.kind,
            [
                [a * cu * cv, -a * cu * sv, c * su],
                [-a * su * cv, a * su * sv, c * cu],
                [-a * cu * sv, -a * cu * cv, 0.0],
                [-a * cu * cv, a * cu * sv, -c * su],
                [a * su * sv, a * su * cv, 0.0],
                [-a * cu * cv, a * cu * sv, 0.0],
            ],
        )
        return np.array(rows, dtype=float)

    def forms(self, u, v):
        """Point, Gauss frame [x y z], metric M, curvature K and torsion T (his definitions 2 and 3)."""
        f, f_u, f_v, f_uu, f_uv, f_vv = self.derivatives(u, v)
        m_u, m_v = np.linalg.norm(f_u), np.linalg.norm(f_v)
        x, y = f_u / m_u, f_v / m_v
        z = np.cross(x, y)
        # x·z_u = −x_u·z, and so on, since x·z = y·z = 0.
        K = -np.array([[z @ f_uu / m_u**2, z @ f_uv / (m_u * m_v)], [z @ f_uv / (m_u * m_v), z @ f_vv / m_v**2]])
        T = np.array([y @ f_uu / m_u**2, y @ f_uv / (m_u * m_v)])
        return f, np.stack((x, y, z), axis=1), np.diag([m_u, m_v]), K, T


def R_psi(psi):
    return np.array([[math.cos(psi), -math.sin(psi)], [-math.sin(psi), -math.cos(psi)]])


def equations(tip, obj, q, w, v):
    """Rates of (u_T, u_O, ψ), q = (u_T, v_T, u_O, v_O, ψ), for w (3,), v (2,) of the tip in its own Gauss frame."""
    _, _, M_T, K_T, T_T = tip.forms(*q[:2])
    _, _, M_O, K_O, T_O = obj.forms(*q[2:4])
    R = R_psi(q[4])
    relative = np.linalg.inv(K_T + R @ K_O @ R)
    turn = np.array([-w[1], w[0]])
    u_T = np.linalg.inv(M_T) @ relative @ (turn - R @ K_O @ R @ v)
    u_O = np.linalg.inv(M_O) @ R @ relative @ (turn + K_T @ v)
    return np.concatenate((u_T, u_O, [w[2] + T_T @ M_T @ u_T + T_O @ M_O @ u_O]))


def state(tip, obj, q):
    """p_OC, p_TC, R_OT of the chart coordinates."""
    c, G_T, *_ = tip.forms(*q[:2])
    p, G_O, *_ = obj.forms(*q[2:4])
    turn = np.eye(3)
    turn[:2, :2], turn[2, 2] = R_psi(q[4]), -1.0
    return p, c, G_O @ turn @ G_T.T


SPHEROID = Chart(ELLIPSOID, 0.03, 0.05)
PAIRS = {
    "sphere on spheroid": (Chart(SPHERE, 0.01), SPHEROID),
    "spheroid on spheroid": (Chart(ELLIPSOID, 0.012, 0.008), SPHEROID),
    "sphere on cylinder": (Chart(SPHERE, 0.01), Chart(CYLINDER, 0.03, 10.0)),
    "spheroid on cylinder": (Chart(ELLIPSOID, 0.012, 0.008), Chart(CYLINDER, 0.03, 10.0)),
    "spheroid on plane": (Chart(ELLIPSOID, 0.012, 0.008), Chart(PLANE)),
    "plane on sphere": (Chart(PLANE), Chart(SPHERE, 0.03)),
    "cylinder on spheroid": (Chart(CYLINDER, 0.01, 10.0), SPHEROID),
    "crossed cylinders": (Chart(CYLINDER, 0.01, 10.0), Chart(CYLINDER, 0.03, 10.0)),
}
pairs = pytest.mark.parametrize(("tip", "obj"), PAIRS.values(), ids=PAIRS)


def coordinates(rng):
    """Random chart coordinates away from the poles, with ψ such that two cylinders cross."""
    return np.concatenate((rng.uniform(-0.8, 0.8, size=4), rng.uniform(0.4, 1.2, size=1)))


@pairs
@pytest.mark.parametrize("seed", range(5))
def test_contact_equations(tip, obj, seed):
    rng = np.random.default_rng(seed)
    q = coordinates(rng)
    w, v = rng.normal(size=3), 0.02 * rng.normal(size=2)
    p, c, R = state(tip, obj, q)
    frame = R @ tip.forms(*q[:2])[1]  # the tip's Gauss frame in O
    w_O, v_O = frame @ w, frame[:, :2] @ v
    rates = equations(tip, obj, q, w, v)
    pdot, cdot = np.empty(3), np.empty(3)
    assert contact_rates(*obj.surface, *tip.surface, NO_GRIDS, p, c, R, w_O, v_O, pdot, cdot) == OK
    _, f_u, f_v, *_ = tip.derivatives(*q[:2])
    np.testing.assert_allclose(cdot, f_u * rates[0] + f_v * rates[1], atol=1e-14)
    _, f_u, f_v, *_ = obj.derivatives(*q[2:4])
    np.testing.assert_allclose(pdot, f_u * rates[2] + f_v * rates[3], atol=1e-14)
    # His ψ̇ is what keeps the two Gauss frames and the turning tip together.
    t = 1e-6
    forth, back = state(tip, obj, q + t * rates)[2], state(tip, obj, q - t * rates)[2]
    np.testing.assert_allclose(Rotation.from_matrix(forth @ back.T).as_rotvec() / (2.0 * t), w_O, atol=1e-8)


@pairs
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["roll", "slide", "both"])
def test_integrated_motion(tip, obj, seed, kind):
    rng = np.random.default_rng(seed)
    q, phi = coordinates(rng), rng.uniform(-3.0, 3.0)
    turn = rng.uniform(-0.4, 0.4, size=2) * (kind != "slide")
    slip = rng.uniform(-0.004, 0.004, size=2) * (kind != "roll")

    def rates(_, y):
        # φ is the angle from the object's Gauss frame to the transported axis, which does not turn with the frame.
        R = R_psi(y[4])
        c, s = math.cos(y[5]), math.sin(y[5])
        to_gauss = R @ np.array([[c, -s], [s, c]])
        dq = equations(tip, obj, y[:5], np.append(to_gauss @ turn, 0.0), to_gauss @ slip)
        _, _, M_O, _, T_O = obj.forms(*y[2:4])
        return np.append(dq, -T_O @ M_O @ dq[2:4])

    end = solve_ivp(rates, (0.0, 1.0), np.append(q, phi), method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]

    def axis(q, phi):
        return obj.forms(*q[2:4])[1] @ [math.cos(phi), math.sin(phi), 0.0]

    p, c, R = state(tip, obj, q)
    x = axis(q, phi)
    assert advance(*obj.surface, *tip.surface, NO_GRIDS, np.concatenate((turn, slip)), 400, p, c, R, x) == OK
    p_end, c_end, R_end = state(tip, obj, end[:5])
    np.testing.assert_allclose(p, p_end, atol=3e-8)
    np.testing.assert_allclose(c, c_end, atol=3e-8)
    np.testing.assert_allclose(R, R_end, atol=3e-6)
    np.testing.assert_allclose(x, axis(end, end[5]), atol=3e-6)


@pytest.mark.parametrize("seed", range(5))
def test_published_equations_of_a_ball_rolling_on_a_plane(seed):
    # Murray, Li and Sastry, A Mathematical Introduction to Robotic Manipulation (1994), section 5.6.
    rng = np.random.default_rng(seed)
    rho = 0.5
    ball, plane = Chart(SPHERE, rho), Chart(PLANE)
    q = coordinates(rng)
    u, psi = q[0], q[4]
    w_x, w_y = rng.normal(size=2)
    published = w_x * np.array(
        [0.0, 1.0 / math.cos(u), -rho * math.sin(psi), -rho * math.cos(psi), -math.tan(u)]
    ) + w_y * np.array([-1.0, 0.0, -rho * math.cos(psi), rho * math.sin(psi), 0.0])
    np.testing.assert_allclose(equations(ball, plane, q, [w_x, w_y, 0.0], np.zeros(2)), published, atol=1e-14)
    p, c, R = state(ball, plane, q)
    pdot, cdot = np.empty(3), np.empty(3)
    w_O = R @ ball.forms(*q[:2])[1] @ [w_x, w_y, 0.0]
    assert contact_rates(*plane.surface, *ball.surface, NO_GRIDS, p, c, R, w_O, np.zeros(3), pdot, cdot) == OK
    np.testing.assert_allclose(pdot, [*published[2:4], 0.0], atol=1e-14)
    _, f_u, f_v, *_ = ball.derivatives(*q[:2])
    np.testing.assert_allclose(cdot, f_u * published[0] + f_v * published[1], atol=1e-14)
