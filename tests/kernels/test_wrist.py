"""Closed-form inverse kinematics: every solution is reached, none is missed, and the nearest is the branch's own."""

import dataclasses

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from regrasp.kernels.chains import SLIDE, Chains, forward, jacobian
from regrasp.kernels.inverse import inverse
from regrasp.kernels.wrist import INTERSECTING, NONE, PARALLEL, Wrists, solve_all, solve_near, wrists_of
from regrasp.planner.arrays import chains_from
from regrasp.scene.puma import Puma

SEEDS = st.integers(0, 2**32 - 1)
KINDS = ["puma", "parallel", "intersecting"]


def unit(v: np.ndarray) -> np.ndarray:
    """v, or every row of it, at length 1."""
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def chain_of(axes: np.ndarray, anchors: np.ndarray, rng: np.random.Generator, kind: list[int] | None = None) -> Chains:
    """The chain with these axes at zero in its base: random link frames, base and tip, no limits."""
    n = len(axes)
    anchors = anchors + rng.normal(size=(n, 1)) * axes  # anywhere on its axis
    R, R_WB, R_LT = (Rotation.random(m, rng).as_matrix() for m in (n, 1, 1))
    R_before, p_before = np.concatenate([np.eye(3)[None], R[:-1]]), np.concatenate([np.zeros((1, 3)), anchors[:-1]])
    return Chains(
        start=np.array([0, n]),
        kind=np.array(kind or [0] * n),
        R_PJ=R_before.transpose(0, 2, 1) @ R,
        p_PJ=np.einsum("irc,ir->ic", R_before, anchors - p_before),
        axis=np.einsum("irc,ir->ic", R, axes),
        lower=np.full(n, -np.inf),
        upper=np.full(n, np.inf),
        R_WB=R_WB,
        p_WB=rng.normal(size=(1, 3)),
        R_LT=R_LT,
        p_LT=rng.normal(size=(1, 3)),
        free=np.array([n]),
        master=np.arange(n),
        gain=np.ones(n),
        offset=np.zeros(n),
    )


def geometry(name: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Axes and points on them of a random arm with a spherical wrist, whose axes are skew at will."""
    axes, anchors = unit(rng.normal(size=(6, 3))), rng.uniform(-1, 1, (6, 3))
    while min(np.linalg.norm(np.cross(axes[[0, 3, 4]], axes[[1, 4, 5]]), axis=1)) < 0.5:
        axes = unit(rng.normal(size=(6, 3)))
    anchors[4] = anchors[5] = anchors[3]
    if name == "parallel":
        axes[2] = rng.choice([-1, 1]) * axes[1]
    else:
        anchors[1] = anchors[0]
    return axes, anchors


def puma(scale: float = 0.25, rng: np.random.Generator | None = None) -> Chains:
    """The scene's Puma finger, somewhere; with an rng anywhere."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    base = spec.worldbody.add_body(
        pos=[0.3, -0.2, 0.1], quat=Rotation.random(None, rng or 0).as_quat(scalar_first=True)
    )
    Puma.sized(scale).attach(base, "finger")
    model = spec.compile()
    return chains_from(model, [list(range(6))], [model.geom("finger/tip").id])


def arm(name: str, rng: np.random.Generator) -> tuple[Chains, Wrists]:
    chains = puma(rng=rng) if name == "puma" else chain_of(*geometry(name, rng), rng)
    wrists = wrists_of(chains)
    assert wrists.kind[0] == (INTERSECTING if name == "intersecting" else PARALLEL)
    return chains, wrists


def place(chains: Chains, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    R_WL, p_WL = np.empty((len(q) + 1, 3, 3)), np.empty((len(q) + 1, 3))
    forward(chains, 0, q, R_WL, p_WL)
    return R_WL[-1].copy(), p_WL[-1].copy()


def random_joints(chains: Chains, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(np.maximum(chains.lower, -np.pi), np.minimum(chains.upper, np.pi))


def miss(chains: Chains, q: np.ndarray, R_WT: np.ndarray, p_WT: np.ndarray) -> float:
    R, p = place(chains, q)
    return max(abs(R - R_WT).max(), abs(p - p_WT).max())


def free(chains: Chains) -> Chains:
    """The same arm without limits."""
    return dataclasses.replace(chains, lower=np.full(6, -np.inf), upper=np.full(6, np.inf))


def all_of(chains: Chains, wrists: Wrists, R_WT: np.ndarray, p_WT: np.ndarray) -> np.ndarray:
    """solve_all, with what must hold of every answer checked."""
    Q = np.full((8, 6), np.nan)
    Q = Q[: solve_all(chains, wrists, 0, R_WT, p_WT, Q)]
    assert (chains.lower <= Q).all()
    assert (chains.upper >= Q).all()
    for q in Q:
        assert miss(chains, q, R_WT, p_WT) < 2e-10  # REACH
    return Q


def near(chains: Chains, wrists: Wrists, R_WT: np.ndarray, p_WT: np.ndarray, seed: np.ndarray) -> np.ndarray | None:
    """solve_near, with what must hold of every answer checked."""
    q = seed.copy()
    if not solve_near(chains, wrists, 0, R_WT, p_WT, q):
        np.testing.assert_array_equal(q, seed)
        return None
    assert (q >= chains.lower).all()
    assert (q <= chains.upper).all()
    assert abs(q - seed).max() <= np.pi + 1e-12
    assert miss(chains, q, R_WT, p_WT) < 2e-10  # REACH
    return q


def apart(Q: np.ndarray, q: np.ndarray) -> np.ndarray:
    """max |Δq| from q, whole turns left out, of every row."""
    return abs((Q - q + np.pi) % (2 * np.pi) - np.pi).max(axis=-1)


def regularity(chains: Chains, wrists: Wrists, q: np.ndarray) -> float:
    """Least singular value of the Jacobian at the wrist centre, lengths in arm lengths: 0 at a singularity."""
    J = centre_jacobian(chains, wrists, q)
    J[:3] /= wrists.reach[0, 1]
    return float(np.linalg.svd(J)[1][-1])


def centre_jacobian(chains: Chains, wrists: Wrists, q: np.ndarray) -> np.ndarray:
    R_WL, p_WL, J = np.empty((7, 3, 3)), np.empty((7, 3)), np.empty((6, 6))
    forward(chains, 0, q, R_WL, p_WL)
    jacobian(chains, 0, R_WL, p_WL, p_WL[6] + R_WL[6] @ wrists.p_TC[0], J)
    return J


@pytest.mark.parametrize("name", KINDS)
@settings(max_examples=100, deadline=None)
@given(number=SEEDS)
def test_the_nearest_of_all_solutions_is_found(name: str, number: int) -> None:
    """From a step away the joints it came from, where they are regular; always what a search of all solutions finds."""
    rng = np.random.default_rng(number)
    chains, wrists = arm(name, rng)
    q = random_joints(chains, rng)
    R, p = place(chains, q)
    seed = q + rng.uniform(-0.1, 0.1, 6)
    found = near(free(chains), wrists, R, p, seed)
    assert found is not None
    assert miss(chains, found, R, p) < 1e-11
    assert abs(found - seed).max() <= abs(q - seed).max() + 1e-6
    assert abs(found - seed).max() == pytest.approx(apart(all_of(free(chains), wrists, R, p), seed).min(), abs=1e-6)
    if regularity(chains, wrists, q) > 0.1:
        np.testing.assert_allclose(found, q, atol=1e-11)


@pytest.mark.parametrize("name", KINDS)
@settings(max_examples=50, deadline=None)
@given(number=SEEDS)
def test_all_solutions_are_distinct_and_the_pose_s_own_is_among_them(name: str, number: int) -> None:
    rng = np.random.default_rng(number)
    chains, wrists = arm(name, rng)
    q = random_joints(chains, rng)
    R, p = place(chains, q)
    Q = all_of(free(chains), wrists, R, p)
    assert len(Q) in (2, 4, 6, 8)
    assert max(miss(chains, x, R, p) for x in Q) < 1e-11
    assert abs(Q).max() <= np.pi + 1e-12
    for i in range(len(Q)):
        assert (apart(Q[i + 1 :], Q[i]) > 1e-7).all()
    assert apart(Q, q).min() < 1e-6
    within = all_of(chains, wrists, R, p)
    assert apart(within, q).min() < 1e-6
    # Limits leave out and turn; they change nothing else.
    assert all(apart(Q, x).min() < 1e-6 for x in within)


def test_a_puma_has_eight_solutions_where_it_reaches_freely() -> None:
    chains = free(puma())
    Q = all_of(chains, wrists_of(chains), *place(chains, np.array([0.3, 0.4, -0.9, 0.6, 0.8, -0.4])))
    assert len(Q) == 8
    for angles in Q.T[[0, 2, 4]]:  # two shoulders, two elbows, two signs of the wrist's bend for every one
        assert len(np.unique(np.round(angles, 6))) > 1


@pytest.mark.parametrize("name", KINDS)
def test_damped_least_squares_finds_no_solution_that_is_missing(name: str) -> None:
    rng = np.random.default_rng(1)
    R_WL, p_WL, met = np.empty((7, 3, 3)), np.empty((7, 3)), 0
    for _ in range(5):
        chains, wrists = arm(name, rng)
        chains = free(chains)
        R, p = place(chains, rng.uniform(-np.pi, np.pi, 6))
        Q, seen = all_of(chains, wrists, R, p), set()
        for _ in range(60):
            q = rng.uniform(-np.pi, np.pi, 6)
            if inverse(chains, 0, R, p, q, R_WL, p_WL)[0] < 1e-10:
                assert apart(Q, q).min() < 1e-5
                seen.add(int(apart(Q, q).argmin()))
        met += len(seen)
    assert met > 10


@pytest.mark.parametrize("name", KINDS)
def test_along_a_path_both_methods_agree(name: str) -> None:
    rng = np.random.default_rng(2)
    R_WL, p_WL, steps = np.empty((7, 3, 3)), np.empty((7, 3)), 0
    for _ in range(30):
        chains, wrists = arm(name, rng)
        chains = free(chains)
        q, speed = rng.uniform(-np.pi, np.pi, 6), rng.uniform(-0.05, 0.05, 6)
        closed, damped = q.copy(), q.copy()
        while regularity(chains, wrists, q) > 0.03 and steps < 600:
            R, p = place(chains, q)
            assert solve_near(chains, wrists, 0, R, p, closed)
            assert inverse(chains, 0, R, p, damped, R_WL, p_WL)[0] < 1e-10
            np.testing.assert_allclose(closed, q, atol=1e-10)
            np.testing.assert_allclose(damped, closed, atol=1e-7)
            q, steps = q + speed, steps + 1
    assert steps > 100


def aligned(rng: np.random.Generator) -> tuple[Chains, Wrists, float]:
    """An arm with a skew wrist whose axes 4 and 6 can come in line, and the θ_5 where they do."""
    axes, anchors = geometry("parallel", rng)
    bend = rng.uniform(-3, 3)
    axes[5] = Rotation.from_rotvec(-bend * axes[4]).apply(axes[3])
    chains = chain_of(axes, anchors, rng)
    return chains, wrists_of(chains), bend


@pytest.mark.parametrize("gap", [0.0, 1e-13, 1e-9, -1e-9, 1e-6, -1e-4])
@pytest.mark.parametrize("skew", [False, True])
def test_a_singular_wrist_reaches_its_pose_and_keeps_the_angle_that_is_free(skew: bool, gap: float) -> None:
    rng, kept = np.random.default_rng(3), 0
    for _ in range(30):
        chains, wrists, bend = aligned(rng) if skew else (free(puma(rng=rng)), None, 0.0)
        wrists = wrists or wrists_of(chains)
        q = rng.uniform(-2, 2, 6)
        q[4] = bend + gap
        R, p = place(chains, q)
        seed = q + rng.uniform(-0.05, 0.05, 6)
        found = near(chains, wrists, R, p, seed)
        assert found is not None
        assert miss(chains, found, R, p) < 1e-11
        if abs(gap) < 1e-12 and abs(found[:3] - q[:3]).max() < 1e-6:
            assert found[3] == seed[3]
            assert found[3] + found[5] == pytest.approx(q[3] + q[5], abs=1e-5)
            kept += 1
    assert kept > 15 or abs(gap) >= 1e-12


@pytest.mark.parametrize("name", KINDS[:2])
def test_a_path_through_a_singular_wrist_is_followed_straight(name: str) -> None:
    """The branch whose θ_4 turns by half on the way has its θ_5 nearer to the seed's for a while."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        chains, wrists, bend = aligned(rng) if name == "parallel" else (free(puma(rng=rng)), None, 0.0)
        wrists = wrists or wrists_of(chains)
        q = rng.uniform(-2, 2, 6)
        found = q.copy()
        found[4] = bend - 0.1
        if regularity(chains, wrists, found) < 0.02:
            continue
        for gap in [-0.08, -0.05, -0.02, -1e-6, 0.0, 3e-8, 0.03, 0.06, 0.1]:
            q[4] = bend + gap
            found = near(chains, wrists, *place(chains, q), found)
            np.testing.assert_allclose(found, q, atol=1e-6)


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("folded", [False, True])
def test_the_edge_of_reach(name: str, folded: bool) -> None:
    """At the stretched and at the folded elbow: just inside, on the edge, out by round-off, out.

    The folded Puma is the hard one: its wrist centre is 0.12 mm from axis 2, hence near the shoulder's fold as well, and
    1e-8 m are a long way there.
    """
    rng, tried = np.random.default_rng(5), 0
    while tried < 20:
        chains, wrists = arm(name, rng)
        chains = free(chains)
        q = rng.uniform(-2, 2, 6)
        q[2] = np.arctan2(wrists.elbow[0, 0], wrists.elbow[0, 1]) + np.pi * folded
        J = centre_jacobian(chains, wrists, q)[:3, :3]
        U, sigma, _ = np.linalg.svd(J / wrists.reach[0, 1])
        assert sigma[2] < 1e-12
        if sigma[1] < 0.1 or regularity(chains, wrists, q + np.eye(6)[2]) < 0.02:
            continue
        tried += 1
        R, p = place(chains, q)
        turn = Rotation.from_rotvec(q[0] * wrists.axis[0, 0])
        f = p + R @ wrists.p_TC[0] - wrists.origin[0] - turn.apply(wrists.link[0, 0])
        across = turn.apply(wrists.axis[0, 1])
        if name != "intersecting":
            f -= (f @ across) * across
        out = U[:, 2] * np.sign(U[:, 2] @ f) * (-1 if folded else 1)
        seed = q + rng.uniform(-0.02, 0.02, 6)
        for step in (-1e-4, -1e-8, 0.0, 1e-13):
            found = near(chains, wrists, R, p + step * out, seed)
            assert found is not None
            assert miss(chains, found, R, p + step * out) < (1e-11 if step <= 0 else 1e-10)
        far = near(chains, wrists, R, p + 1e-6 * out, seed)
        assert far is None or abs(far - seed).max() > 0.1  # nothing, or another shoulder's
        Q = all_of(chains, wrists, R, p - 1e-8 * out)
        if not (folded and name == "puma"):
            assert (apart(Q, q) < 0.02).sum() == 2  # an elbow on either side


@pytest.mark.parametrize("kind", [PARALLEL, INTERSECTING])
@pytest.mark.parametrize("gap", [0.0, 1e-14, 1e-9])
def test_a_wrist_centre_on_the_first_axis_keeps_that_joint(kind: int, gap: float) -> None:
    """Axes z, y and y or x from one shoulder: joints 2 and 3 put the wrist centre on z (or `gap` from it)."""
    rng = np.random.default_rng(6)
    axes = np.r_[np.eye(3)[[2, 1, 1 if kind == PARALLEL else 0]], Rotation.random(None, rng).as_matrix()]
    l_23, l_3c = (np.array([0.1, 0, 0.5]), np.array([0.2, 0, 0.4])) if kind == PARALLEL else (
        np.array([0, 0.2, 0.5]), np.array([0.1, 0.3, 0.4])
    )  # fmt: skip
    chains = chain_of(axes, np.array([0 * l_23, 0 * l_23, l_23, *[l_23 + l_3c] * 3]), rng)
    wrists = wrists_of(chains)
    assert wrists.kind[0] == kind
    for _ in range(30):
        q = rng.uniform(-2, 2, 6)
        if kind == INTERSECTING:  # the turn about x that takes the centre's y to 0
            q[2] = np.arctan2(0.3, 0.4) + np.arcsin(0.2 / 0.5)
        w = l_23 + Rotation.from_rotvec(q[2] * axes[2]).apply(l_3c)
        assert w[1] == pytest.approx(0, abs=1e-15)
        q[1] = np.arctan2(gap, 1) - np.arctan2(w[0], w[2])
        R, p = place(chains, q)
        seed = q + rng.uniform(-0.02, 0.02, 6)
        found = near(chains, wrists, R, p, seed)
        assert found is not None
        assert miss(chains, found, R, p) < 1e-11
        if gap < 1e-12:
            assert found[0] == seed[0]
            assert near(chains, wrists, R, p, q) == pytest.approx(q, abs=1e-6)
        assert len(all_of(chains, wrists, R, p)) in (2, 4, 6, 8)


def test_limits_choose_turns_and_leave_out() -> None:
    """Joint 6 of the Puma turns ±266°: an angle at its end is 94° from the other end, and no turn away from it."""
    rng, chains = np.random.default_rng(7), puma()
    wrists, middle = wrists_of(chains), (chains.lower + chains.upper) / 2
    np.testing.assert_allclose(np.degrees(chains.upper[5]), 266)
    for _ in range(200):
        q = random_joints(chains, rng)
        q[4], q[5] = rng.uniform(0.3, 1.5), np.radians(rng.uniform(180, 266)) * rng.choice([-1, 1])
        R, p = place(chains, q)
        if regularity(chains, wrists, q) < 0.1:
            continue
        seed = np.clip(q + rng.uniform(-0.03, 0.03, 6), chains.lower, chains.upper)
        np.testing.assert_allclose(near(chains, wrists, R, p, seed), q, atol=1e-11)
        Q = all_of(chains, wrists, R, p)
        assert (abs(Q - middle) <= np.pi + 1e-12).all()
        own = Q[apart(Q, q).argmin()]
        assert own[5] == pytest.approx(q[5] - 2 * np.pi * np.sign(q[5]))


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("over", [0.0, 1e-11, 1e-3])
def test_the_nearest_solution_beyond_a_limit_is_refused(name: str, over: float) -> None:
    rng, tried = np.random.default_rng(8), 0
    while tried < 20:
        chains, wrists = arm(name, rng)
        q, k = rng.uniform(-2, 2, 6), rng.integers(6)
        if regularity(chains, wrists, q) < 0.1:
            continue
        tried += 1
        lower, upper = np.full(6, -3.0), np.full(6, 3.0)
        limit, side = (lower, -1) if rng.random() < 0.5 else (upper, 1)
        limit[k] = q[k]
        R, p = place(chains, q + side * over * np.eye(6)[k])
        seed = np.clip(q + rng.uniform(-0.01, 0.01, 6), lower, upper)
        found = near(dataclasses.replace(chains, lower=lower, upper=upper), wrists, R, p, seed)
        assert (found is None) == (over == 1e-3)
        within = all_of(dataclasses.replace(chains, lower=lower, upper=upper), wrists, R, p)
        assert (apart(within, q) < 0.01).any() == (over < 1e-3)


def test_one_limit_alone_and_none() -> None:
    rng = np.random.default_rng(9)
    chains, wrists = arm("parallel", rng)
    R, p = place(chains, rng.uniform(-2, 2, 6))
    Q = all_of(chains, wrists, R, p)
    for lower, upper in ((5.0, np.inf), (-np.inf, -5.0)):
        bounded = dataclasses.replace(chains, lower=np.full(6, lower), upper=np.full(6, upper))
        turned = all_of(bounded, wrists, R, p)
        assert len(turned) == len(Q)
        assert (abs(turned) <= 5 + 2 * np.pi + 1e-12).all()


def test_arms_without_a_closed_form_are_told() -> None:
    rng = np.random.default_rng(10)
    for name in ("parallel", "intersecting"):
        axes, anchors = geometry(name, rng)
        assert wrists_of(chain_of(axes, anchors, rng)).kind[0] != NONE
        assert wrists_of(chain_of(axes, anchors, rng, [0, 0, 0, 0, 0, SLIDE])).kind[0] == NONE
        assert wrists_of(chain_of(axes[:5], anchors[:5], rng)).kind[0] == NONE
        assert wrists_of(chain_of(axes[[0, *range(6)]], anchors[[0, *range(6)]], rng)).kind[0] == NONE
        for k in (3, 4, 5):  # a wrist whose axes miss one another by a millimetre
            off = anchors + 1e-3 * np.eye(6)[:, [k]] * unit(np.cross(axes[k], rng.normal(size=3)))
            assert wrists_of(chain_of(axes, off, rng)).kind[0] == NONE
        tilted = axes.copy()
        tilted[2] = Rotation.from_rotvec(1e-3 * unit(np.cross(axes[2], rng.normal(size=3)))).apply(axes[2])
        assert wrists_of(chain_of(tilted, anchors, rng)).kind[0] == (NONE if name == "parallel" else INTERSECTING)
        off = anchors + 1e-3 * np.eye(6)[:, [0]] * unit(np.cross(axes[0], axes[1]))
        assert wrists_of(chain_of(axes, off, rng)).kind[0] == (NONE if name == "intersecting" else PARALLEL)
        flat = axes.copy()
        flat[4] = flat[3]
        assert wrists_of(chain_of(flat, anchors, rng)).kind[0] == NONE  # a wrist of two axes
        short = anchors.copy()
        short[3:] = short[2]
        assert wrists_of(chain_of(axes, short, rng)).kind[0] == NONE  # an elbow without a forearm
    chains = puma()
    tilted = dataclasses.replace(chains, axis=chains.axis + 1e-3 * np.eye(6)[:, [1]] * np.array([1.0, 0, 0]))
    assert wrists_of(tilted).kind[0] == INTERSECTING  # its first two axes still meet in the shoulder
    assert wrists_of(dataclasses.replace(tilted, p_PJ=chains.p_PJ + 1e-3 * np.eye(6)[:, [1]])).kind[0] == NONE
    q, R, p = np.zeros(6), *place(chains, np.zeros(6))
    none = wrists_of(dataclasses.replace(chains, kind=np.array([0, 0, 0, 0, 0, SLIDE])))
    assert not solve_near(chains, none, 0, R, p, q)
    assert solve_all(chains, none, 0, R, p, np.empty((8, 6))) == 0


def test_a_chain_among_others_is_solved_as_alone() -> None:
    """Fingers of two and three joints beside a Puma: only the Puma has a closed form, and it stays its own."""
    rng, alone = np.random.default_rng(11), puma()
    flat = [chain_of(np.tile([0.0, 1.0, 0.0], (n, 1)), rng.normal(size=(n, 3)), rng) for n in (2, 3)]
    parts = [flat[0], alone, flat[1]]
    rest = {f.name: np.concatenate([getattr(c, f.name) for c in parts]) for f in dataclasses.fields(Chains)[1:]}
    chains = Chains(start=np.array([0, 2, 8, 11]), **rest)
    wrists = wrists_of(chains)
    np.testing.assert_array_equal(wrists.kind, [NONE, PARALLEL, NONE])
    for _ in range(20):
        q = random_joints(alone, rng)
        R, p = place(alone, q)
        a, b = q + 0.01, q + 0.01
        assert solve_near(chains, wrists, 1, R, p, a) == solve_near(alone, wrists_of(alone), 0, R, p, b)
        np.testing.assert_array_equal(a, b)
