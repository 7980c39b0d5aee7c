"""Distances of convex bodies: MuJoCo and hand-made cases as oracles, and what must hold of any distance."""

import itertools

import mujoco
import numpy as np
import pytest
from scipy.optimize import minimize

from regrasp.kernels.cores import BOX, CYLINDER, ELLIPSOID, PLANE, POINT, SEGMENT, support
from regrasp.kernels.distances import bounds_far, distance

KINDS = {"point": POINT, "segment": SEGMENT, "box": BOX, "cylinder": CYLINDER, "ellipsoid": ELLIPSOID, "plane": PLANE}
SOLIDS = [k for k in KINDS if k != "plane"]
PAIRS = list(itertools.combinations_with_replacement(SOLIDS, 2))

Body = tuple[int, np.ndarray, float, np.ndarray, np.ndarray]


def rotation(rng: np.random.Generator) -> np.ndarray:
    """A random rotation, often one that lines edges and faces up or nearly does."""
    R, quat = np.zeros(9), rng.normal(size=4)
    match rng.integers(4):
        case 0:
            quat = np.array([1.0, 0, 0, 0])
        case 1:
            quat = np.array([1.0, 1, 0, 0])
        case 2:
            quat = np.array([1.0, 0, 0, 0]) + 10.0 ** rng.uniform(-9, -3) * quat
    mujoco.mju_quat2Mat(R, quat / np.linalg.norm(quat))
    return R.reshape(3, 3)


def body(rng: np.random.Generator, name: str, needle: bool = False) -> Body:
    """A body of some centimetres; a needle is up to a thousand times longer than thin."""
    a, b, c = 0.1 * 10.0 ** rng.uniform(-3, 0, 3) if needle else rng.uniform(0.02, 0.1, 3)
    core = {"point": [0, 0, 0], "segment": [0, 0, c], "cylinder": [a, a, c], "plane": [0, 0, 0]}.get(name, [a, b, c])
    radius = rng.uniform(0.005, 0.02) if name in ("point", "segment") else 0.0
    return KINDS[name], np.array(core, dtype=float), radius, rotation(rng), rng.normal(size=3) * 0.05


def moved(A: Body, p: np.ndarray, R: np.ndarray | None = None) -> Body:
    return (*A[:3], A[3] if R is None else R @ A[3], (A[4] if R is None else R @ A[4]) + p)


def d(A: Body, B: Body, limit: float = np.inf) -> float:
    return distance(*A, *B, limit)


def apart(rng: np.random.Generator, A: Body, B: Body, gap: float) -> tuple[Body, np.ndarray]:
    """B pushed along a random direction until it is `gap` away from A (bisection), and the direction."""
    u = rng.normal(size=3) if rng.random() < 0.7 else np.eye(3)[rng.integers(3)]
    u /= np.linalg.norm(u)
    low, high = 0.0, 5.0
    for _ in range(60):
        mid = (low + high) / 2
        low, high = (low, mid) if d(A, moved(B, A[4] - B[4] + mid * u)) > gap else (mid, high)
    return moved(B, A[4] - B[4] + high * u), u


class MujocoOracle:
    """mj_geomDistance of two bodies, each the only geom of a mocap body."""

    SIZES = {
        POINT: lambda c, r: ("sphere", [r]),
        SEGMENT: lambda c, r: ("capsule", [r, c[2]]),
        BOX: lambda c, r: ("box", c),
        CYLINDER: lambda c, r: ("cylinder", [c[0], c[2]]),
        ELLIPSOID: lambda c, r: ("ellipsoid", c),
        PLANE: lambda c, r: ("plane", [1, 1, 1]),
    }

    def distance(self, A: Body, B: Body) -> float:
        geoms = ""
        for kind, core, radius, R, p in (A, B):
            name, size = self.SIZES[kind](core, radius)
            quat = np.zeros(4)
            mujoco.mju_mat2Quat(quat, R.ravel())
            numbers = [" ".join(repr(float(x)) for x in v) for v in (size, p, quat)]
            geoms += '<body pos="{1}" quat="{2}"><geom type="{t}" size="{0}"/></body>'.format(*numbers, t=name)
        if PLANE in (A[0], B[0]):  # planes must be static
            geoms = geoms.replace("<body", "<body mocap='true'")
        model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
        model.opt.ccd_tolerance, model.opt.ccd_iterations = 1e-12, 500
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        return mujoco.mj_geomDistance(model, data, 0, 1, 100.0, None)


@pytest.mark.parametrize(("a", "b"), [*PAIRS, *(("plane", k) for k in SOLIDS)])
def test_mujoco_agrees(a: str, b: str) -> None:
    rng, oracle = np.random.default_rng(1), MujocoOracle()
    for _ in range(40):
        A, B = body(rng, a), body(rng, b)
        B, _ = apart(rng, A, B, 10.0 ** rng.uniform(-4, -0.5))
        assert d(A, B) == pytest.approx(oracle.distance(A, B), abs=2e-7)


def bracket(A: Body, B: Body) -> float:
    """The distance from below, by the dual: max over unit directions u of the gap between the supporting planes."""

    def separation(x: np.ndarray) -> float:
        u = x / np.linalg.norm(x)
        a = np.array(support(A[0], A[1], A[3], tuple(u)))
        b = np.array(support(B[0], B[1], B[3], tuple(-u)))
        return -float(u @ (B[4] + b - A[4] - a))

    starts = [B[4] - A[4], *(s * R[:, i] for R in (A[3], B[3]) for i in range(3) for s in (1, -1))]
    best = sorted(starts, key=separation)[:3]
    options = {"xatol": 1e-10, "fatol": 1e-13, "maxiter": 4000, "maxfev": 4000}
    return -min(minimize(separation, x, method="Nelder-Mead", options=options).fun for x in best) - A[2] - B[2]


@pytest.mark.parametrize(("a", "b"), [("segment", "cylinder"), ("box", "ellipsoid"), ("cylinder", "cylinder")])
def test_separating_planes_prove_the_distance(a: str, b: str) -> None:
    """No oracle's code: every separating plane is a lower bound, and the best one must reach the distance (duality)."""
    rng = np.random.default_rng(2)
    for _ in range(8):
        A, B = body(rng, a), body(rng, b)
        B, _ = apart(rng, A, B, rng.uniform(0.01, 0.1))
        low = bracket(A, B)
        assert low <= d(A, B) + 1e-8
        assert low >= d(A, B) - 1e-5  # Nelder–Mead on a kinked function: what it reaches


@pytest.mark.parametrize(("a", "b"), PAIRS)
@pytest.mark.parametrize("needle", [False, True])
def test_a_distance_is_symmetric_invariant_and_lipschitz(a: str, b: str, needle: bool) -> None:
    rng = np.random.default_rng(3)
    for _ in range(60):
        A, B = body(rng, a, needle), body(rng, b, needle)
        B, _ = apart(rng, A, B, rng.choice([0.0, 1e-9, 1e-6, 1e-3, 0.1]))
        gap = d(A, B)
        assert d(B, A) == pytest.approx(gap, abs=1e-7)
        R, p = rotation(rng), rng.normal(size=3)
        assert d(moved(A, p, R), moved(B, p, R)) == pytest.approx(gap, abs=1e-7)
        step = rng.normal(size=3) * 10.0 ** rng.uniform(-6, -2)
        nearer = d(A, moved(B, step))
        if min(gap, nearer) > -A[2] - B[2]:
            assert abs(nearer - gap) <= np.linalg.norm(step) + 1e-7


@pytest.mark.parametrize(("a", "b"), PAIRS)
def test_overlapping_cores_are_as_deep_as_they_say(a: str, b: str) -> None:
    """Where even the cores overlap, a shift by less than the value's excess can't be needed to part them: it is enough."""
    rng = np.random.default_rng(4)
    if a in ("point", "segment") and b in ("point", "segment"):
        pytest.skip("cores without volume")
    for _ in range(60):
        A, B = body(rng, a), body(rng, b)
        B, u = apart(rng, A, B, -A[2] - B[2])
        A, B = moved(A, np.zeros(3)), moved(B, (A[4] - B[4]) * rng.choice([1e-6, 0.1, 0.7, 1.0]))
        value = d(A, B)
        assert value <= -A[2] - B[2]
        depth = -value - A[2] - B[2]
        ways = [w / np.linalg.norm(w) for w in [u, *rng.normal(size=(200, 3))]]
        needed = min(
            w @ (A[4] - B[4] + support(A[0], A[1], A[3], tuple(w)) - np.array(support(B[0], B[1], B[3], tuple(-w))))
            for w in ways
        )
        assert depth <= 3 * needed + 1e-9  # an upper bound of the depth, and not a wild one
        assert d(A, moved(B, 1.001 * (depth + 1e-9) * u)) > value
