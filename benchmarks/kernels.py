"""Kernels, one call each, against the plain reference; every pair is first seen to compute the same."""

import math
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks import loops, reference
from benchmarks.measure import Row, versus
from regrasp.bench.searches import Job
from regrasp.kernels.basis import program
from regrasp.kernels.chains import Chains
from regrasp.kernels.cores import BOX, ELLIPSOID, SEGMENT
from regrasp.planner.balance import balance
from regrasp.planner.chain import ContactMotions
from regrasp.planner.follow import SUBSTEPS
from regrasp.planner.local import terms_of
from regrasp.planner.motions import RELOCATE, ROLL_MINUS_Y
from regrasp.planner.scan import new_scan

Array = NDArray[np.float64]
GROUP = "kernels, per call"
CASES = 32
SEEDS = 12  # from which the reference looks for all solutions


def rows(job: Job, repeats: int) -> list[Row]:
    """Every kernel that an evaluation is made of, on a scene of six-joint fingers and an ellipsoid."""
    return [*kinematics(job, repeats), contact(job, repeats), *distances(repeats), *forces(job, repeats)]


def postures(chains: Chains, home: Array, rng: np.random.Generator, spread: float) -> Array:
    """(CASES, 6): joints around rest, within the limits."""
    q = home + rng.uniform(-spread, spread, (CASES, 6))
    return np.clip(q, chains.lower[:6] + 0.1, chains.upper[:6] - 0.1)


def kinematics(job: Job, repeats: int) -> list[Row]:
    """Forward and inverse kinematics and the Jacobian."""
    hand, world = job.task.hand, job.task.world
    chains, k = hand.chains, len(job.task.names)
    rng = np.random.default_rng(0)
    Q = postures(chains, hand.home[:6], rng, 0.5)
    R, p, J = np.empty((7, 3, 3)), np.empty((7, 3)), np.empty((6, 6))
    model, data = world.model, mujoco.MjData(world.model)
    for i, agent in enumerate(world.agents):
        data.qpos[agent.qpos] = Q[i]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    Jp, Jr = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    loops.forwards(chains, Q, R, p, 1)
    loops.jacobians(chains, R, p, J, 1)
    mujoco.mj_jacGeom(model, data, Jp, Jr, world.agents[0].tip_geom)
    np.testing.assert_allclose(p[-1], data.geom_xpos[world.agents[0].tip_geom], atol=1e-12)
    np.testing.assert_allclose(J, np.vstack([Jp, Jr])[:, world.agents[0].dofs], atol=1e-12)

    def all_fingers(count: int) -> None:
        for _ in range(-(-count // k)):
            mujoco.mj_kinematics(model, data)

    def mujoco_jacobian(count: int) -> None:
        for _ in range(count):
            mujoco.mj_jacGeom(model, data, Jp, Jr, world.agents[0].tip_geom)

    return [
        versus(GROUP, "forward kinematics, one finger", lambda n: loops.forwards(chains, Q, R, p, n), all_fingers, repeats,
               f"MuJoCo's mj_kinematics, a {k}th of it"),
        versus(GROUP, "Jacobian", lambda n: loops.jacobians(chains, R, p, J, n), mujoco_jacobian, repeats,
               "MuJoCo's mj_jacGeom, its call from Python included"),
        *inverse_kinematics(job, Q, rng, repeats),
    ]  # fmt: skip


def inverse_kinematics(job: Job, Q: Array, rng: np.random.Generator, repeats: int) -> list[Row]:
    """Damped Newton and the closed form, to the tip poses of the joints Q from seeds a few degrees away."""
    hand = job.task.hand
    chains, wrists, k = hand.chains, hand.wrists, len(job.task.names)
    agents = np.arange(CASES) % k
    poses = [reference.forward(chains, s % k, Q[s]) for s in range(CASES)]
    R, p = np.array([R[-1] for R, _ in poses]), np.array([p[-1] for _, p in poses])
    seeds = Q + rng.uniform(-0.05, 0.05, Q.shape)
    newton, near, many = np.empty_like(Q), np.empty_like(Q), np.empty((CASES, 8, 6))
    found, R_L, p_L = np.zeros(CASES, np.int64), np.empty((7, 3, 3)), np.empty((7, 3))
    starts = rng.uniform(chains.lower[:6], chains.upper[:6], (SEEDS, 6))

    def plain(count: int) -> None:
        for c in range(count):
            s = c % CASES
            plainly[s] = reference.inverse(chains, agents[s], R[s], p[s], seeds[s])[1]

    def plain_all(count: int) -> None:
        for c in range(count):
            reference.inverse_all(chains, agents[c % CASES], R[c % CASES], p[c % CASES], starts)

    plainly = np.empty_like(Q)
    plain(CASES)
    loops.inverses(chains, agents, R, p, seeds, newton, R_L, p_L, CASES)
    loops.nearest(chains, wrists, agents, R, p, seeds, near, CASES)
    loops.all_solutions(chains, wrists, agents, R, p, many, found, CASES)
    np.testing.assert_allclose(newton, plainly, atol=1e-7)
    np.testing.assert_allclose(near, plainly, atol=1e-7)
    known = [(s, q) for s in range(3) for q in reference.inverse_all(chains, agents[s], R[s], p[s], starts)]
    assert known
    for s, q in known:
        turns = (many[s, : found[s]] - q) / (2.0 * np.pi)
        assert np.min(np.max(np.abs(turns - np.round(turns)), axis=1)) < 1e-6
    return [
        versus(GROUP, "inverse kinematics, damped Newton",
               lambda n: loops.inverses(chains, agents, R, p, seeds, newton, R_L, p_L, n), plain, repeats,
               "numpy, the same method"),
        versus(GROUP, "inverse kinematics, closed form, nearest",
               lambda n: loops.nearest(chains, wrists, agents, R, p, seeds, near, n), plain, repeats, "numpy, damped Newton"),
        versus(GROUP, "inverse kinematics, closed form, all",
               lambda n: loops.all_solutions(chains, wrists, agents, R, p, many, found, n), plain_all, repeats,
               f"numpy, damped Newton from {SEEDS} seeds"),
    ]  # fmt: skip


def contact(job: Job, repeats: int) -> Row:
    """A tip rolls by 0.1 rad on the ellipsoid, as in one interval."""
    hand, scan = job.task.hand, new_scan(job.task.hand, job.path, job.task.settings.local.relocation)
    starts = np.random.default_rng(0).choice(len(scan.p_O), CASES, replace=False)
    r, command = hand.size_T[0, 0], np.array([0.1, 0.05, 0.0, 0.0])
    p, n = scan.p_O[starts], scan.n_O[starts]
    x = np.cross(n, np.roll(n, 1, axis=1))
    x /= np.linalg.norm(x, axis=1)[:, None]
    c, R = -r * n, np.tile(np.eye(3), (CASES, 1, 1))
    p_end, c_end, R_end, x_end = (np.empty_like(each) for each in (p, c, R, x))
    plainly = np.empty_like(p)

    def ours(count: int) -> None:
        loops.contacts(
            hand.kind_O, hand.size_O, hand.kind_T[0], hand.size_T[0], hand.grids, command, SUBSTEPS,
            p, c, R, x, p_end, c_end, R_end, x_end, count,
        )  # fmt: skip

    def plain(count: int) -> None:
        for pass_ in range(count):
            s = pass_ % CASES
            plainly[s] = reference.contact(hand.size_O[:3], r, p[s], x[s], command, 2)

    ours(CASES)
    plain(CASES)
    np.testing.assert_allclose(p_end, plainly, atol=2e-6)
    return versus(GROUP, "contact step", ours, plain, repeats, "numpy, RK4 in as many steps")


def distances(repeats: int) -> list[Row]:
    """Pairs of bodies of some centimetres, some centimetres apart."""
    pairs = (("capsule", "capsule"), ("capsule", "ellipsoid"), ("capsule", "box"), ("box", "box"))
    return [distance(*pair, repeats) for pair in pairs]


def distance(first: str, second: str, repeats: int) -> Row:
    """CASES pairs of two kinds of bodies; a row of the reference's model for each body, each pair far from the others."""
    rng = np.random.default_rng(0)
    names, sizes = [first, second] * CASES, rng.uniform(0.01, 0.04, (2 * CASES, 3))
    R = Rotation.random(2 * CASES, random_state=1).as_matrix()
    p = np.array([[x // 2 + 0.15 * (x % 2), *rng.normal(0.0, 0.03, 2)] for x in range(2 * CASES)])
    round_ = np.array([name == "capsule" for name in names])
    kind = np.array([{"capsule": SEGMENT, "ellipsoid": ELLIPSOID, "box": BOX}[name] for name in names])
    core = np.where(round_[:, None], sizes[:, 1:2] * [0.0, 0.0, 1.0], sizes)
    radius = np.where(round_, sizes[:, 0], 0.0)
    model = reference.solids(names, sizes, R, p)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    values, plainly = np.empty(CASES), np.empty(CASES)

    def ours(count: int) -> None:
        loops.distances(kind, core, radius, R, p, math.inf, values, count)

    def plain(count: int) -> None:
        for c in range(count):
            s = c % CASES
            plainly[s] = mujoco.mj_geomDistance(model, data, 2 * s, 2 * s + 1, 10.0, None)

    ours(CASES)
    plain(CASES)
    apart = values > 1e-3
    assert np.count_nonzero(apart) > CASES // 2
    np.testing.assert_allclose(values[apart], plainly[apart], atol=2e-5)
    return versus(GROUP, f"distance {first}–{second}", ours, plain, repeats, "MuJoCo's mj_geomDistance")


def forces(job: Job, repeats: int) -> list[Row]:
    """The force programs along the arc with fingers that rest or roll, cold and warm."""
    hand, local = job.task.hand, job.task.settings.local
    n, k = len(job.path.R_WO), len(job.task.names)
    terms, scan = terms_of(hand, local), new_scan(hand, job.path, local.relocation)
    V = np.random.default_rng(0).integers(0, ROLL_MINUS_Y + 1, (n, k)).astype(np.int16)
    problem = ContactMotions(hand, job.path, scan, terms, job.grasp, V)
    P, at, all_found = problem.work.lp, problem.current.at, problem.found
    columns, data = [], []
    for j in range(n):
        P.group[:] = -2
        codes = problem.current.V[j]
        bears = ((codes < RELOCATE) & (all_found.holds[at[j]] == 1)).astype(np.uint8)
        p, normal, t = all_found.p_OC[at[j]], all_found.n_O[at[j]], all_found.t_O[at[j + 1], 0].copy()
        balance(hand, job.path, j, 0, bears, codes, p, normal, t, terms.margins, False, P)
        columns.append(np.count_nonzero(P.group != -2))
        data.append([each.copy() for each in (P.A, P.b, P.group, P.cap)])
    A, b, group, cap = (np.array([row[e] for row in data]) for e in range(4))
    room = program(P.A.shape[1], len(P.cap))
    values, pivots, plainly = np.empty(n), np.zeros(n, np.int64), np.empty(n)

    def ours(warm: bool, count: int) -> None:
        loops.programs(room, np.array(columns), A, b, group, cap, warm, values, pivots, count)

    def plain(count: int) -> None:
        for c in range(count):
            s = c % n
            n_s = columns[s]
            plainly[s] = reference.least_force(A[s, :, :n_s], b[s], group[s, :n_s], cap[s])

    plain(n)
    found = []
    for warm in (False, True):
        ours(warm, n)
        np.testing.assert_allclose(values, plainly, rtol=1e-6)
        words, note = "from the last basis" if warm else "cold", f"HiGHS by SciPy; {np.mean(pivots):.1f} pivots"
        found.append(versus(GROUP, f"force program, {words}", partial(ours, warm), plain, repeats, note))
    return found
