"""The plain reference of the kernels: the same work written with numpy, SciPy and MuJoCo as its equations say it."""

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from regrasp.kernels.chains import HINGE, Chains

Array = NDArray[np.float64]
SOLIDS = {
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
}


def forward(chains: Chains, a: int, q: Array) -> tuple[list[Array], list[Array]]:
    """X_WL of chain a's links, then of its tip frame: (R, p)."""
    R, p = chains.R_WB[a], chains.p_WB[a]
    turns, places = [], []
    for i, value in enumerate(q):
        joint = chains.start[a] + i
        p = p + R @ chains.p_PJ[joint]
        R = R @ chains.R_PJ[joint]
        if chains.kind[joint] == HINGE:
            R = R @ exp(value * chains.axis[joint])
        else:
            p = p + R @ (value * chains.axis[joint])
        turns.append(R)
        places.append(p)
    return [*turns, R @ chains.R_LT[a]], [*places, p + R @ chains.p_LT[a]]


def jacobian(chains: Chains, a: int, R: list[Array], p: list[Array]) -> Array:
    """(6, n): velocity of the tip frame's origin, then angular velocity, in W, of a chain of hinges."""
    axes = [R[i] @ chains.axis[chains.start[a] + i] for i in range(len(R) - 1)]
    return np.array([[*np.cross(u, p[-1] - x), *u] for u, x in zip(axes, p[:-1], strict=True)]).T


def exp(w: Array) -> Array:
    """Rodrigues' formula."""
    angle = float(np.linalg.norm(w))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = w / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def inverse(chains: Chains, a: int, R_WT: Array, p_WT: Array, q: Array) -> tuple[float, Array]:
    """Damped Newton from q to the tip pose: (what is left of it, joints)."""
    error = np.inf
    for _ in range(60):
        R, p = forward(chains, a, q)
        turn = Rotation.from_matrix(R_WT @ R[-1].T).as_rotvec()
        e = np.array([*(p_WT - p[-1]), *turn])
        error = float(np.linalg.norm(e))
        if error < 1e-10:
            break
        J = jacobian(chains, a, R, p)
        step = J.T @ np.linalg.solve(J @ J.T + 1e-2 * error**2 * np.eye(6), e)
        q = q + step * min(1.0, 0.25 / float(np.max(np.abs(step))))
    return error, q


def inverse_all(chains: Chains, a: int, R_WT: Array, p_WT: Array, seeds: Array) -> list[Array]:
    """The different joints within the limits that damped Newton finds from many seeds, angles at their turn in the limits."""
    joints = slice(chains.start[a], chains.start[a + 1])
    lower, upper = chains.lower[joints], chains.upper[joints]
    middle = 0.5 * (lower + upper)
    found: list[Array] = []
    for seed in seeds:
        error, q = inverse(chains, a, R_WT, p_WT, seed)
        q = middle + (q - middle + np.pi) % (2.0 * np.pi) - np.pi
        if error < 1e-8 and np.all((q >= lower) & (q <= upper)) and all(np.max(np.abs(q - o)) > 1e-5 for o in found):
            found.append(q)
    return found


def shape_operator(semi_axes: Array, p: Array) -> tuple[Array, Array]:
    """Outward normal and shape operator of an ellipsoid F = Σ x²/a² − 1 at p: n = ∇F/|∇F|, S = P ∇²F P / |∇F|."""
    gradient, hessian = 2.0 * p / semi_axes**2, np.diag(2.0 / semi_axes**2)
    length = np.linalg.norm(gradient)
    n = gradient / length
    P = np.eye(3) - np.outer(n, n)
    return n, P @ hessian @ P / length


def contact_rates(semi_axes: Array, r: float, state: Array, command: Array) -> Array:
    """Montana's equations, (S_O + S_T) ṗ = ω × n + S_T v and ẋ = −(ẋ carried along): a ball of radius r on an ellipsoid.

    state: contact point p_OC, x_O. command: ω_x, ω_y, v_x, v_y in the contact frame.
    """
    p, x = state[:3], state[3:]
    n, S_O = shape_operator(semi_axes, p)
    P = np.eye(3) - np.outer(n, n)
    x = P @ x / np.linalg.norm(P @ x)
    y = np.cross(n, x)
    w, v = command[0] * x + command[1] * y, command[2] * x + command[3] * y
    S_T = P / r
    pdot = np.linalg.solve(S_O + S_T + np.outer(n, n), np.cross(w, n) + S_T @ v)  # n nᵀ: no way along the normal
    return np.array([*pdot, *(-(x @ (S_O @ pdot)) * n)])


def contact(semi_axes: Array, r: float, p: Array, x: Array, command: Array, steps: int) -> Array:
    """The contact point p_OC after a motion, by RK4 in `steps` steps."""
    state, h = np.array([*p, *x]), 1.0 / steps

    def f(state: Array) -> Array:
        return contact_rates(semi_axes, r, state, command)

    for _ in range(steps):
        a = f(state)
        b = f(state + 0.5 * h * a)
        c = f(state + 0.5 * h * b)
        state = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + f(state + h * c))
    return state[:3]


def least_force(A: Array, b: Array, group: NDArray[np.int64], cap: Array) -> float:
    """min Σ λ over the columns with a group, Aλ = b, λ ≥ 0, Σ of group g ≤ cap_g, by HiGHS; inf without equilibrium."""
    capped = np.flatnonzero(np.isfinite(cap))
    rows = (group == capped[:, None]).astype(float)
    found = linprog((group >= 0).astype(float), A_ub=rows, b_ub=cap[capped], A_eq=A, b_eq=b, method="highs")
    return float(found.fun) if found.status == 0 else np.inf


def solids(names: list[str], sizes: Array, R: Array, p: Array) -> mujoco.MjModel:
    """A model of static geoms at poses R (N, 3, 3), p (N, 3); a capsule's size is its radius and half length."""
    spec = mujoco.MjSpec()
    for name, size, turn, place in zip(names, sizes, R, p, strict=True):
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, turn.ravel())
        spec.worldbody.add_geom(type=SOLIDS[name], size=size, pos=place, quat=quat)
    return spec.compile()
