"""The force LP of a configuration with normal forces to spare, against HiGHS in another formulation."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import springs
from arcs import Arc, arc
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from regrasp.kernels.basis import program
from regrasp.kernels.forces import EDGES, contact_forces
from regrasp.kernels.sampling import sample
from regrasp.kernels.surfaces import tangents
from regrasp.plan import NONE, SLIDE, STICK
from regrasp.planner.balance import balance, is_sliding, spares
from regrasp.planner.motions import SLIDE_MINUS_Y
from regrasp.planner.reserve import Margins

ZERO = np.int64(0)
FACET = np.cos(np.pi / EDGES)


@dataclass(frozen=True)
class Contacts:
    """A random grasp: which agents bear, their motions, contact points, normals and slip directions in O."""

    bears: np.ndarray
    codes: np.ndarray
    p: np.ndarray
    n: np.ndarray
    t: np.ndarray


def random_contacts(a: Arc, rng: np.random.Generator) -> Contacts:
    """Agents anywhere on the object, two or more of them bearing, about a third of them sliding."""
    k = len(a.task.names)
    points, normals = sample(a.hand.kind_O, a.hand.size_O, a.hand.grids, 60)
    chosen = rng.integers(60, size=k)
    n = normals[chosen]
    t = np.cross(n, rng.normal(size=(k, 3)))
    bears = np.ones(k, np.uint8)
    bears[rng.integers(k)] = rng.random() < 0.6
    codes = np.where(rng.random(k) < 0.3, SLIDE_MINUS_Y, rng.integers(0, 5, k)).astype(np.int16)
    return Contacts(bears, codes, points[chosen], n, t / np.linalg.norm(t, axis=1, keepdims=True))


def solved(a: Arc, c: Contacts, margins: Margins) -> tuple[bool, float, np.ndarray]:
    """Verdict, value and the agents' and supports' forces in O (k + P, 3), in weights, of the planner's LP."""
    k, slots = len(c.bears), a.path.support_mode.shape[1]
    lp = program(EDGES * (k + slots), k)
    held, value, _ = balance(a.hand, a.path, ZERO, ZERO, c.bears, c.codes, c.p, c.n, c.t, margins, False, lp)
    counts = [(1 if is_sliding(code) else EDGES) * int(bears) for code, bears in zip(c.codes, c.bears, strict=True)]
    counts += [{STICK: EDGES, SLIDE: 1}.get(int(mode), 0) for mode in a.path.support_mode[0]]
    starts = np.cumsum([0, *counts])
    f = np.zeros((k + slots, 3))
    contact_forces(lp.A, lp.solution, starts, 1.0, f)
    return held, value, f


def to_spare(a: Arc, c: Contacts, margins: Margins) -> np.ndarray:
    """(k,): what each agent in contact has to spare; agents that don't slide and supports that stick share a disturbance."""
    slides = np.array([bool(is_sliding(code)) for code in c.codes])
    sticks = np.flatnonzero((c.bears == 1) & ~slides)
    supports = a.path.support_p_O[0, 0, a.path.support_mode[0] == STICK]
    p = (np.vstack([c.p[sticks], supports]) - a.hand.p_OM_O) / a.hand.radius
    sigma = np.zeros(len(c.bears))
    sigma[sticks] = springs.shares(p, a.hand.shifts, a.hand.turns)[: len(sticks)]
    return np.where(c.bears == 1, springs.to_spare(margins, a.hand.mu, sigma, a.hand.cap), 0.0)


def highs(a: Arc, c: Contacts, margins: Margins) -> float:
    """The least Σ f_n by HiGHS, inf without equilibrium: the forces themselves are the variables, cones are facets.

    A rolling force lies in the cone with its tip at s times the inward normal, s what the agent has to spare, a sliding one
    on its ray between s and the largest force for sliding.
    """
    spots, spared = [], to_spare(a, c, margins)
    for i in np.flatnonzero(c.bears):
        slides = bool(is_sliding(c.codes[i]))
        cap = min(a.hand.cap[i], margins.slide) if slides else a.hand.cap[i]
        spots.append((c.p[i], -c.n[i], c.t[i], slides, a.hand.mu[i], spared[i], cap))
    agents = len(spots)
    for slot in np.flatnonzero(a.path.support_mode[0]):
        p, n, t = (array[0, 0, slot] for array in (a.path.support_p_O, a.path.support_n_O, a.path.support_t_O))
        spots.append((p, n, t, a.path.support_mode[0, slot] == SLIDE, a.path.support_mu[slot], 0.0, np.inf))
    size = 3 * len(spots)
    A_eq, b_eq, A_ub, b_ub, cost = [], [], [], [], np.zeros(size)

    def row(i: int, v: np.ndarray) -> np.ndarray:
        whole = np.zeros(size)
        whole[3 * i : 3 * i + 3] = v
        return whole

    G = np.hstack([np.vstack([np.eye(3), np.cross(s[0] - a.hand.p_OM_O, np.eye(3)).T]) for s in spots])
    A_eq += list(G)
    b_eq += [*a.path.up_O[0, 0], 0.0, 0.0, 0.0]
    for i, (_, n, t, slides, mu, least, cap) in enumerate(spots):
        x, y = np.empty(3), np.empty(3)
        tangents(-n if i < agents else n, x, y)
        A_ub += [row(i, -n)]
        b_ub += [-least]
        if np.isfinite(cap):
            A_ub += [row(i, n)]
            b_ub += [cap]
        if i < agents:
            cost[3 * i : 3 * i + 3] = n
        if slides:
            A_eq += [row(i, t - mu * n), row(i, np.cross(n, t))]
            b_eq += [0.0, 0.0]
            continue
        for e in range(EDGES):
            angle = (2 * e + 1) * np.pi / EDGES
            facet = np.cos(angle) * x + np.sin(angle) * y - FACET * (1.0 - margins.friction) * mu * n
            A_ub += [row(i, facet)]
            b_ub += [facet @ n * least]
    result = linprog(
        cost, np.array(A_ub), b_ub, np.array(A_eq), b_eq, bounds=(None, None), method="highs-ds",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10, "presolve": False},
    )  # fmt: skip
    assert result.status in (0, 2), result.message
    return result.fun if result.status == 0 else np.inf


@pytest.mark.parametrize("name", ["fig4-relocation", "fig2-planar"])
@pytest.mark.parametrize(
    ("grip", "disturbance", "slide"), [(0.0, 0.0, np.inf), (0.1, 0.0, 1.0), (0.0, 0.1, 0.2), (0.3, 0.2, 0.8)]
)
def test_the_least_forces_with_some_to_spare_are_those_of_highs(
    name: str, grip: float, disturbance: float, slide: float
) -> None:
    """Verdict and Σ f_n; every agent in contact presses with what it has to spare at least, and the forces hold the object."""
    a, rng = arc(name), np.random.default_rng(0)
    count = [0, 0]
    for _ in range(150):
        c, margins = random_contacts(a, rng), Margins(float(rng.choice([0.0, 0.3])), grip, disturbance, slide)
        held, value, f = solved(a, c, margins)
        expected = highs(a, c, margins)
        assert held == np.isfinite(expected)
        count[held] += 1
        if not held:
            continue
        assert value == pytest.approx(expected, abs=1e-7)
        k = len(c.bears)
        normal = -np.sum(f[:k] * c.n, axis=1)
        assert np.all(normal >= to_spare(a, c, margins) - 1e-9)
        assert np.all(normal <= a.hand.cap + 1e-9)
        assert np.all(normal[[bool(is_sliding(code)) for code in c.codes]] <= slide + 1e-9)
        assert np.all(f[:k][c.bears == 0] == 0.0)
        assert normal.sum() == pytest.approx(value, abs=1e-9)
        np.testing.assert_allclose(f.sum(axis=0), a.path.up_O[0, 0], atol=1e-8)
        arms = np.vstack([c.p, a.path.support_p_O[0, 0]]) - a.hand.p_OM_O
        np.testing.assert_allclose(np.cross(arms, f).sum(axis=0), 0.0, atol=1e-8)
    assert min(count) > 5


@pytest.mark.parametrize(
    "rising",
    [
        [Margins(0.1, grip, 0.0, 1.0) for grip in (0.0, 0.05, 0.2, 0.6)],
        [Margins(0.1, 0.05, disturbance, 1.0) for disturbance in (0.0, 0.05, 0.15, 0.4)],
        [Margins(0.1, 0.05, 0.05, slide) for slide in (np.inf, 1.0, 0.3, 0.05)],
    ],
    ids=["grip", "disturbance", "slide"],
)
def test_stricter_margins_never_cost_less_and_never_hold_more(rising: list[Margins]) -> None:
    """The cones for more to spare lie inside those for less, the rays for a lower limit inside those for a higher one."""
    a, rng = arc("fig4-relocation"), np.random.default_rng(1)
    lost = 0
    for _ in range(100):
        c = random_contacts(a, rng)
        values = [solved(a, c, margins)[1] for margins in rising]
        assert np.all(np.diff([v for v in values if v < np.inf]) >= -1e-9)
        assert np.all(np.diff(np.isinf(values).astype(int)) >= 0)
        lost += values[0] < np.inf and values[-1] == np.inf
    assert lost > 0


def test_of_any_reserve_an_agent_keeps_half_its_limit_at_most() -> None:
    """More than that to spare costs and holds the same; the agents press with half their limits at least."""
    whole, rng = arc("fig4-relocation"), np.random.default_rng(2)
    weak = replace(whole.hand, cap=np.array([4.0, 3.0, 4.0, 3.0]))
    a, held = replace(whole, task=replace(whole.task, hand=weak)), 0
    for _ in range(100):
        c = random_contacts(a, rng)
        c.p[2:], c.n[2:] = -c.p[:2], -c.n[:2]  # pairs that press against each other
        c.bears[:] = 1
        one, other = (solved(a, c, Margins(0.1, grip, 0.0, np.inf)) for grip in (2.0, 1e3))
        assert one[:2] == other[:2]
        if one[0]:
            held += 1
            normal = -np.sum(one[2][:4] * c.n, axis=1)
            assert np.all(normal >= 0.5 * weak.cap - 1e-9)
    assert held > 5


def test_what_shares_a_disturbance() -> None:
    """Agents that bear and don't slide, and supports on which the object sticks."""
    a, margins = arc("fig2-planar"), Margins(0.3, 0.05, 0.1, 0.5)
    c = random_contacts(a, np.random.default_rng(3))
    p = (np.vstack([c.p, a.path.support_p_O[0, 0]]) - a.hand.p_OM_O) / a.hand.radius

    def shared(codes: list[int], mode: int) -> np.ndarray:
        """δ σ of the agents, from what they have to spare; agent 2 does not bear."""
        path = replace(a.path, support_mode=np.full_like(a.path.support_mode, mode))
        lp, bears = program(EDGES * 4, 3), np.array([1, 1, 0], np.uint8)
        spares(a.hand, path, ZERO, ZERO, bears, np.array(codes, np.int16), c.p, margins, lp)
        assert lp.least[2] == 0.0
        return (lp.least[:2] - margins.grip) * np.sin(np.arctan(a.hand.mu[:2]))

    axes = a.hand.shifts, a.hand.turns
    two, three = 0.1 * springs.shares(p[:2], *axes), 0.1 * springs.shares(p[[0, 1, 3]], *axes)
    np.testing.assert_allclose(shared([0, 0, 0], NONE), two, rtol=1e-9)
    np.testing.assert_allclose(shared([0, 0, 0], SLIDE), two, rtol=1e-9)
    np.testing.assert_allclose(shared([0, 0, 0], STICK), three[:2], rtol=1e-9)
    # In a plane one contact bears two components of force, and no torque.
    np.testing.assert_allclose(shared([0, SLIDE_MINUS_Y, 0], SLIDE), [0.1 * np.sqrt(2.0), 0.0], atol=1e-12)


def test_the_plane_of_disturbances_is_that_of_the_world() -> None:
    """However the frame O lies in it: the same contacts told in another O have the same to spare."""
    a, margins, rng = arc("fig2-planar"), Margins(0.3, 0.05, 0.1, 0.5), np.random.default_rng(4)
    bears, codes = np.ones(3, np.uint8), np.zeros(3, np.int16)
    for _ in range(10):
        c, R = random_contacts(a, rng), Rotation.random(random_state=rng).as_matrix()
        turned = replace(
            a.path,
            R_WO=a.path.R_WO @ R.T,
            support_p_O=a.path.support_p_O @ R.T,
            support_mode=a.path.support_mode * 0 + STICK,
        )
        one, other = program(EDGES * 4, 3), program(EDGES * 4, 3)
        straight = replace(a.path, support_mode=turned.support_mode)
        spares(a.hand, straight, ZERO, ZERO, bears, codes, c.p, margins, one)
        assert not a.hand.p_OM_O.any()
        spares(a.hand, turned, ZERO, ZERO, bears, codes, c.p @ R.T, margins, other)
        np.testing.assert_allclose(other.least, one.least, rtol=1e-9)
