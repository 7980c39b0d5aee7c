"""The choice between relocations: of the candidates compared the one with the least objective, judged by HiGHS."""

import dataclasses

import numpy as np
import pytest
import springs
from arcs import NAMES, SMALL, Arc, arc, made
from scipy.optimize import linprog

from regrasp.kernels.surfaces import tangents
from regrasp.planner.chain import Change, ContactMotions
from regrasp.planner.configurations import standing
from regrasp.planner.motions import OFF, ONTO, RELOCATE, STAY
from regrasp.planner.relocation import NEIGHBOURS, choose, hopeless, objective
from regrasp.planner.reserve import Margins
from regrasp.planner.scan import BARRED, Relocation, outlook_of
from regrasp.planner.supports import SLIDE, STICK
from regrasp.scene.load import load


def least_force(a: Arc, j: int, s: int, contacts: list[tuple[int, np.ndarray, np.ndarray]], margins: Margins) -> float:
    """Σ of normal forces in weights by HiGHS, eight edges per contact; inf without equilibrium.

    Each of an agent's edges bears an eighth of what it has to spare at least; who sticks shares a disturbance.

    Supports cost nothing; one that slides bears force on the ray against its slip, with all of μ.
    """
    columns, cost, caps, least = [], [], [], []
    use = 1.0 - margins.friction
    agents = [i for i, _, _ in contacts]
    stuck = a.path.support_p_O[j, s, a.path.support_mode[j] == STICK]
    points = np.array([*(p for _, p, _ in contacts), *stuck]).reshape(-1, 3)
    sigma = springs.shares((points - a.hand.p_OM_O) / a.hand.radius, a.hand.shifts, a.hand.turns)[: len(agents)]
    spared = [*springs.to_spare(margins, a.hand.mu[agents], sigma, a.hand.cap[agents]), *np.zeros(len(stuck))]
    spots = [(p, -n, a.hand.mu[i], 1.0, a.hand.cap[i]) for i, p, n in contacts]
    for slot, mode in enumerate(a.path.support_mode[j]):
        p, n = a.path.support_p_O[j, s, slot], a.path.support_n_O[j, s, slot]
        if mode == SLIDE:
            f = n + a.path.support_mu[slot] * a.path.support_t_O[j, s, slot]
            columns.append([*f, *np.cross(p - a.hand.p_OM_O, f) / a.hand.radius])
            cost.append(0.0)
            least.append(0.0)
            caps.append((-1, np.inf))
        elif mode == STICK:
            spots.append((p, n, a.path.support_mu[slot], 0.0, np.inf))
    for number, (p, inward, mu, weight, cap) in enumerate(spots):
        x, y = np.empty(3), np.empty(3)
        tangents(-inward if weight else inward, x, y)
        for angle in np.arange(8) * np.pi / 4:
            f = inward + use * mu * (np.cos(angle) * x + np.sin(angle) * y)
            columns.append([*f, *np.cross(p - a.hand.p_OM_O, f) / a.hand.radius])
            cost.append(weight)
            least.append(spared[number] / 8)
            caps.append((number, cap))
    rows = [[float(owner == number) for owner, _ in caps] for number in range(len(spots))]
    limits = [spot[4] for spot in spots]
    finite = np.isfinite(limits)
    result = linprog(
        cost, A_ub=np.array(rows)[finite], b_ub=np.array(limits)[finite], A_eq=np.array(columns).T,
        b_eq=[*a.path.up_O[j, s], 0.0, 0.0, 0.0], bounds=[(low, None) for low in least], method="highs",
    )  # fmt: skip
    return result.fun if result.success else np.inf


def few_candidates(name: str) -> Arc:
    """The first arc of a scene with 30 points to stand on, each twice."""
    local = dataclasses.replace(SMALL.local, relocation=Relocation(candidates=30))
    big = arc(name)
    return dataclasses.replace(
        big, task=dataclasses.replace(big.task, settings=dataclasses.replace(SMALL, local=local))
    )


def staying(a: Arc) -> ContactMotions:
    """The problem in which nobody moves."""
    return a.problem(np.full((len(a.path.R_WO), len(a.task.names)), STAY, np.int16))


def stands(problem: ContactMotions, j: int, i: int, c: int) -> int:
    """Agent i's configuration on candidate c at the end of interval j, 0 for none."""
    hand, path, scan, terms, found, _ = problem.model
    return standing(hand, path, scan, found, j + 1, i, c, terms.clearance)


def bearing(problem: ContactMotions, j: int, end: int, but: int) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """(agent, contact point, normal) of all that bear in interval j, but one, at its start (end = 0) or end (1)."""
    s, found = problem.current, problem.found
    agents = [b for b in range(s.V.shape[1]) if b != but and s.V[j, b] < RELOCATE and found.holds[s.at[j, b]]]
    return [(b, found.p_OC[s.at[j + end, b]], found.n_O[s.at[j + end, b]]) for b in agents]


def truth(problem: ContactMotions, a: Arc, j: int, i: int, c: int) -> tuple[float, float]:
    """The objective: least forces; what is lost of the coming way, and the part of the agents that are stuck afterwards."""
    hand, path, scan, terms, found, _ = problem.model
    m = path.R_WO.shape[1] - 1
    contacts = [*bearing(problem, j, 1, i), (i, scan.p[scan.row[i, j + 1, c]], scan.n[scan.row[i, j + 1, c]])]
    force = least_force(a, j, m, contacts, terms.margins)
    kept = outlook_of(hand, path, scan, found.R_WB, found.p_WB, j + 1, i, c, terms.clearance, terms.commands)
    stuck = [
        np.isinf(least_force(a, j, m, contacts[:b] + contacts[b + 1 :], terms.margins)) for b in range(len(contacts))
    ]
    return force, terms.outlook * (1.0 - kept + np.mean(stuck))


def replaced(problem: ContactMotions, j: int, i: int, c: int) -> int:
    """Candidate c, or the first of the NEIGHBOURS after it on which agent i can stand; −1 for none."""
    count = len(problem.model[2].p_O)
    return next((n % count for n in range(c, c + NEIGHBOURS) if stands(problem, j, i, n % count)), -1)


def value_of(problem: ContactMotions, j: int, i: int, c: int) -> float:
    """The planner's objective of a candidate on which agent i can stand."""
    return objective(*problem.model, problem.current, j, i, c, stands(problem, j, i, c), np.inf)


@pytest.mark.parametrize("name", NAMES)
def test_the_objective_of_every_candidate_is_that_of_highs(name: str) -> None:
    """A bound leaves it as it is, or turns it into inf where it is not below."""
    a, j = few_candidates(name), 0
    held = 0
    for i in range(len(a.task.names)):
        problem = staying(a)
        for c in range(len(problem.model[2].p_O)):
            there = stands(problem, j, i, c)
            if not there:
                continue
            force, lost = truth(problem, a, j, i, c)
            expected = force + lost
            value = objective(*problem.model, problem.current, j, i, c, there, np.inf)
            assert value == pytest.approx(expected, rel=1e-6)
            if np.isfinite(expected):
                held += 1
                for bound in (0.5 * force, value, value + 1e-6):
                    cut = objective(*problem.model, problem.current, j, i, c, there, bound)
                    assert cut == pytest.approx(value, rel=1e-9) or (cut == np.inf and value >= bound)
                    assert cut == np.inf or force < bound
    assert held > 10


@pytest.mark.parametrize("name", NAMES)
def test_the_best_of_the_candidates_compared_is_chosen(name: str) -> None:
    """Of all of them, and of a sample; in place of one that is barred the next counts on which the agent can stand."""
    a, j, rng = few_candidates(name), 1, np.random.default_rng(0)
    compared = swapped = 0
    for i in range(len(a.task.names)):
        problem = staying(a)
        count = len(problem.model[2].p_O)
        sample = problem.model[3].sample
        everything = (np.arange(count) + 0.5) / count
        for u in (everything, *rng.random((10, sample))):
            asked = [replaced(problem, j, i, int(v * count)) for v in u]
            swapped += np.sum(np.array(asked) != (u * count).astype(int))
            values = {c: value_of(problem, j, i, c) for c in asked if c >= 0}
            chosen = choose(*problem.model, problem.current, j, i, u)
            if not values:
                assert chosen == int(u[0] * count)
            elif np.isinf(min(values.values())):
                assert chosen == next(c for c in asked if c >= 0)
            else:
                compared += 1
                assert values[chosen] == pytest.approx(min(values.values()), rel=1e-9)
    assert compared > 5
    assert swapped > 0


@pytest.mark.parametrize("name", NAMES)
def test_what_is_hopeless_is_above_the_bound_wherever_the_agent_goes(name: str) -> None:
    """The energies with every candidate exceed the bound, whatever else changes before; and no bound at all is hopeless."""
    a, rng = few_candidates(name), np.random.default_rng(0)
    hand, path, _, terms, *_ = staying(a).model
    n, k = len(path.R_WO), len(a.task.names)
    seen = [0, 0]
    for _ in range(12):
        V = np.where(rng.random((n, k)) < 0.3, a.random(rng), STAY).astype(np.int16)
        problem = a.problem(np.where(V >= ONTO, STAY, V))
        i, j = rng.integers(k), rng.integers(n)
        first = rng.integers(j + 1)
        other = problem.snapshot()
        other[first, i] = rng.choice([STAY, OFF])
        energies = []
        for c in range(len(problem.model[2].p_O)):
            other[j, i] = ONTO + c
            energies.append(problem.evaluate(Change(other, i, first, j), np.inf))
        assert not hopeless(hand, path, terms, problem.found, problem.work, problem.current, first, j, i, np.inf)
        for bound in (0.1, 0.5 * problem.energy(), problem.energy(), problem.energy() + 3.0, min(energies)):
            lost = hopeless(hand, path, terms, problem.found, problem.work, problem.current, first, j, i, bound)
            assert not lost or min(energies) > bound
            seen[lost] += 1
    assert min(seen) > 5


def test_where_nothing_holds_or_nobody_stands_there_is_a_choice_nonetheless() -> None:
    """Without the others the first candidate on which the agent can stand; without any the first that was drawn."""
    a, j, i = few_candidates("fig3-puma3"), 0, 0
    V = np.full((len(a.path.R_WO), 3), STAY, np.int16)
    V[:, 1:] = OFF
    problem = a.problem(V)
    scan = problem.model[2]
    count = len(scan.p_O)
    free = [c for c in range(count) if stands(problem, j, i, c)]
    u = (np.array([free[-1], *free]) + 0.5) / count
    assert all(value_of(problem, j, i, c) == np.inf for c in free)
    assert choose(*problem.model, problem.current, j, i, u) == free[-1]
    problem = a.problem(V)
    problem.model[2].row[i, j + 1] = BARRED
    assert choose(*problem.model, problem.current, j, i, u) == free[-1]
    problem.model[2].row[i, j + 1] = BARRED
    barred = next(c for c in range(count) if c not in free)
    assert choose(*problem.model, problem.current, j, i, np.array([(barred + 0.5) / count])) == barred


@pytest.mark.parametrize("name", NAMES)
def test_a_relocating_agent_bears_no_force_and_then_its_part(name: str) -> None:
    """The forces of its interval are the least of the others' at its two ends, those of the next with it on its candidate."""
    a, j = few_candidates(name), 1
    m, held = a.path.R_WO.shape[1] - 1, 0
    for i in range(len(a.task.names)):
        problem = staying(a)
        V = problem.snapshot()
        V[j, i] = ONTO + choose(*problem.model, problem.current, j, i, np.random.default_rng(i).random(8))
        problem.reset(V)
        if problem.current.behind[j, i]:
            continue
        for interval, but in ((j, i), (j + 1, -1)):
            ends = [
                least_force(a, interval, m * end, bearing(problem, interval, end, but), a.terms.margins)
                for end in (0, 1)
            ]
            assert problem.current.e[interval] == np.any(np.isinf(ends))
            if np.all(np.isfinite(ends)):
                held += interval == j
                assert problem.current.f[interval] == pytest.approx(np.mean(ends), rel=1e-6)
        motion = a.motion(problem)
        assert motion.V[j, i] == RELOCATE
        assert np.all(np.isnan(motion.p_OC_O[j, :, i]))
    assert held > 0 or name == "fig3-puma3"  # two of three Puma fingers hold no egg


def test_how_an_agent_retires_does_not_depend_on_what_it_did_before() -> None:
    """Its joints are those of a new start where the matrix before had it relocate in the same interval."""
    a, i, j = arc("fig2-planar"), 1, 0
    problem = staying(a)
    V = problem.snapshot()
    V[j, i] = ONTO + choose(*problem.model, problem.current, j, i, np.random.default_rng(0).random(8))
    problem.reset(V)
    assert not problem.current.behind[j, i]
    problem.current.way[j, i] = problem.trial.way[j, i] = 2  # it passed over the object
    V[j, i] = OFF
    problem.reset(V)
    assert problem.current.way[j, i] >= 0
    np.testing.assert_array_equal(a.motion(problem).joints, a.motion(a.problem(V)).joints)


def test_made_again_the_arc_is_the_same() -> None:
    """What is remembered of candidates does not leak from one arc to another."""
    one, other = arc("fig3-puma3"), made(load("fig3-puma3"))
    np.testing.assert_array_equal(one.grasp.q, other.grasp.q)
    np.testing.assert_array_equal(one.path.R_WO, other.path.R_WO)
