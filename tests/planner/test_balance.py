"""The force LP of a configuration with a least normal force, against HiGHS in another formulation."""

from dataclasses import dataclass

import numpy as np
import pytest
from arcs import Arc, arc
from scipy.optimize import linprog

from regrasp.kernels.basis import program
from regrasp.kernels.forces import EDGES, contact_forces
from regrasp.kernels.sampling import sample
from regrasp.kernels.surfaces import tangents
from regrasp.planner.balance import balance, is_sliding
from regrasp.planner.motions import SLIDE_MINUS_Y
from regrasp.planner.supports import SLIDE, STICK

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
    points, normals = sample(a.hand.kind_O, a.hand.size_O, 60)
    chosen = rng.integers(60, size=k)
    n = normals[chosen]
    t = np.cross(n, rng.normal(size=(k, 3)))
    bears = np.ones(k, np.uint8)
    bears[rng.integers(k)] = rng.random() < 0.6
    codes = np.where(rng.random(k) < 0.3, SLIDE_MINUS_Y, rng.integers(0, 5, k)).astype(np.int8)
    return Contacts(bears, codes, points[chosen], n, t / np.linalg.norm(t, axis=1, keepdims=True))


def solved(a: Arc, c: Contacts, margin: float, grip: float) -> tuple[bool, float, np.ndarray]:
    """Verdict, value and the agents' and supports' forces in O (k + P, 3), in weights, of the planner's LP."""
    k, slots = len(c.bears), a.path.support_mode.shape[1]
    lp = program(EDGES * (k + slots), k)
    held, value, columns = balance(a.hand, a.path, ZERO, ZERO, c.bears, c.codes, c.p, c.n, c.t, margin, grip, lp)
    counts = [(1 if is_sliding(code) else EDGES) * int(bears) for code, bears in zip(c.codes, c.bears, strict=True)]
    counts += [{STICK: EDGES, SLIDE: 1}.get(int(mode), 0) for mode in a.path.support_mode[0]]
    starts = np.cumsum([0, *counts])
    assert starts[-1] == columns
    f = np.zeros((k + slots, 3))
    contact_forces(lp.A, lp.solution, starts, 1.0, f)
    return held, value, f


def highs(a: Arc, c: Contacts, margin: float, grip: float) -> float:
    """The least Σ f_n by HiGHS, inf without equilibrium: the forces themselves are the variables, cones are facets.

    A rolling force lies in the cone with its tip at grip times the inward normal, a sliding one on its ray from grip on.
    """
    spots = [
        (c.p[i], -c.n[i], c.t[i], bool(is_sliding(c.codes[i])), a.hand.mu[i], grip, a.hand.cap[i])
        for i in np.flatnonzero(c.bears)
    ]
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
            facet = np.cos(angle) * x + np.sin(angle) * y - FACET * (1.0 - margin) * mu * n
            A_ub += [row(i, facet)]
            b_ub += [facet @ n * least]
    result = linprog(
        cost, np.array(A_ub), b_ub, np.array(A_eq), b_eq, bounds=(None, None), method="highs-ds",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10, "presolve": False},
    )  # fmt: skip
    assert result.status in (0, 2), result.message
    return result.fun if result.status == 0 else np.inf


@pytest.mark.parametrize("name", ["fig4-relocation", "fig2-planar"])
@pytest.mark.parametrize("grip", [0.0, 0.1, 0.4])
def test_the_least_forces_with_a_grip_are_those_of_highs(name: str, grip: float) -> None:
    """Verdict and Σ f_n; every bearing agent presses with the grip at least, and the forces hold the object."""
    a, rng = arc(name), np.random.default_rng(0)
    count = [0, 0]
    for _ in range(150):
        c, margin = random_contacts(a, rng), rng.choice([0.0, 0.3])
        held, value, f = solved(a, c, margin, grip)
        expected = highs(a, c, margin, grip)
        assert held == np.isfinite(expected)
        count[held] += 1
        if not held:
            continue
        assert value == pytest.approx(expected, abs=1e-7)
        k = len(c.bears)
        normal = -np.sum(f[:k] * c.n, axis=1)
        assert np.all(normal[c.bears == 1] >= grip - 1e-12)
        assert np.all(normal <= a.hand.cap + 1e-9)
        assert np.all(f[:k][c.bears == 0] == 0.0)
        assert normal.sum() == pytest.approx(value, abs=1e-9)
        np.testing.assert_allclose(f.sum(axis=0), a.path.up_O[0, 0], atol=1e-8)
        arms = np.vstack([c.p, a.path.support_p_O[0, 0]]) - a.hand.p_OM_O
        np.testing.assert_allclose(np.cross(arms, f).sum(axis=0), 0.0, atol=1e-8)
    assert min(count) > 5


def test_more_grip_never_costs_less_and_never_holds_more() -> None:
    """The cones for more grip lie inside those for less."""
    a, rng = arc("fig4-relocation"), np.random.default_rng(1)
    lost = 0
    for _ in range(100):
        c = random_contacts(a, rng)
        values = [solved(a, c, 0.1, grip)[1] for grip in (0.0, 0.05, 0.2, 0.6)]
        assert np.all(np.diff([v for v in values if v < np.inf]) >= -1e-9)
        assert values == sorted(values)
        lost += values[0] < np.inf and values[-1] == np.inf
    assert lost > 0


def test_a_grip_beyond_the_largest_force_is_no_equilibrium() -> None:
    a = arc("fig4-relocation")
    c = random_contacts(a, np.random.default_rng(2))
    assert not solved(a, c, 0.1, 1.01 * float(np.max(a.hand.cap)))[0]
