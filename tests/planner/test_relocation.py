"""Relocation: free candidates, free ways and the choice between them, judged by MuJoCo's distances and HiGHS."""

import dataclasses

import numpy as np
import pytest
import springs
from arcs import SMALL, Arc, Oracle, arc, between, height, made
from scipy.optimize import linprog

from regrasp.kernels.surfaces import tangents
from regrasp.planner.motions import OFF, RELOCATE, STAY
from regrasp.planner.relocation import FREE, WAYS, Relocation, candidate_free, free_motion, outlook_of, scan_contacts
from regrasp.planner.reserve import Margins
from regrasp.planner.supports import SLIDE, STICK
from regrasp.scene.load import load

NAMES = ("fig3-puma3", "fig4-relocation", "fig2-planar")


def relocating(a: Arc, i: int, j: int):
    """The problem in which agent i relocates in interval j while the others stay."""
    V = np.full((len(a.path.R_WO), len(a.task.names)), STAY, np.int8)
    V[j, i] = RELOCATE
    return a.problem(V)


@pytest.mark.parametrize("name", NAMES)
def test_free_candidates_are_touched_and_clear(name: str) -> None:
    """On a candidate that is FREE the agent's tip touches to 1e-6 m, its links keep the clearance from what is fixed
    and from the object, and no joint leaves its range."""
    a = arc(name)
    problem = relocating(a, 0, 0)
    oracle, clearance, world = Oracle(a.task), a.terms.clearance, a.task.world
    j, free = 2, 0
    for i, agent in enumerate(world.agents):
        others = {int(g) for b in world.agents if b is not agent for g in b.geoms}
        pairs = [
            p for p in world.collision_pairs if not others & set(p.tolist()) and set(p.tolist()) & set(agent.geoms)
        ]
        own = [set(p.tolist()) <= set(agent.geoms) for p in pairs]
        scan = problem.scan
        for c in range(len(scan.p_O)):
            if not candidate_free(a.hand, a.path, scan, problem.current, j, i, c, clearance):
                continue
            assert scan.status[i, j, c] == FREE
            free += 1
            q = a.hand.home.copy()
            q[a.joints(i)] = scan.q[i, j, c, : len(agent.joints)]
            assert np.all((q[a.joints(i)] >= agent.lower - 1e-12) & (q[a.joints(i)] <= agent.upper + 1e-12))
            R_WO, p_WO = a.path.R_WO[j, 0], a.path.p_WO[j, 0]
            oracle.put(R_WO, p_WO, q)
            centre = R_WO.T @ (oracle.tip(i)[1] - p_WO)
            assert height(a, centre) == pytest.approx(a.hand.size_T[i, 0], abs=1e-6)
            assert np.linalg.norm(centre - scan.p[i, j, c]) == pytest.approx(a.hand.size_T[i, 0], abs=1e-6)
            for pair, itself in zip(pairs, own, strict=True):
                assert oracle.apart(*pair) >= (0.0 if itself else clearance) - 1e-6
    assert free > 10


@pytest.mark.parametrize("name", NAMES)
def test_a_relocating_agents_whole_way_is_clear(name: str) -> None:
    """At every sample and three points between, on the cubic spline that the plan means."""
    a = arc(name)
    oracle, m = Oracle(a.task), a.path.R_WO.shape[1] - 1
    found = 0
    for i, agent in enumerate(a.task.world.agents):
        for j in (0, 2):
            problem = relocating(a, i, j)
            if problem.current.chosen[j, i] < 0:
                continue
            found += 1
            motion = a.motion(problem)
            q = between(motion, j, 3)
            mine = {int(g) for g in agent.geoms}
            for s, row in enumerate(q):
                # The object moves by a step of constant twist between two samples: R blends to second order.
                u, low = s % 4 / 4, min(s // 4, m - 1)
                u = 1.0 if s == len(q) - 1 else u
                U, _, Vt = np.linalg.svd((1 - u) * a.path.R_WO[j, low] + u * a.path.R_WO[j, low + 1])
                p = (1 - u) * a.path.p_WO[j, low] + u * a.path.p_WO[j, low + 1]
                oracle.put(U @ Vt, p, row)
                assert oracle.clear(mine) > 0.0
                assert oracle.folded() > -1e-4
                assert height(a, (U @ Vt).T @ (oracle.tip(i)[1] - p)) >= a.hand.size_T[i, 0] - 1e-6
                if 4 * (m // 4) < s < len(q) - 1 - 4 * (m // 4):
                    assert height(a, (U @ Vt).T @ (oracle.tip(i)[1] - p)) >= a.hand.size_T[i, 0] + a.terms.clearance
    assert found > 0


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


@pytest.mark.parametrize("name", ["fig3-puma3", "fig4-relocation", "fig2-planar"])
def test_the_chosen_candidate_has_the_least_objective_with_a_free_way(name: str) -> None:
    """Brute force over a small set: forces by HiGHS plus what is lost of the coming way and the part of the agents that
    could not be relocated next; every way is tried."""
    settings = dataclasses.replace(
        SMALL, local=dataclasses.replace(SMALL.local, relocation=Relocation(candidates=30, tries=60))
    )
    big = arc(name)
    a = Arc(dataclasses.replace(big.task, settings=settings), big.path, big.grasp)
    terms, j, m = a.terms, 0, big.path.R_WO.shape[1] - 1
    k = len(a.task.names)
    compared = 0
    for i in range(k):
        problem = relocating(a, i, j)
        state, scan, work = problem.current, problem.scan, problem.work
        if np.any(state.lost[j, [b for b in range(k) if b != i]]):
            continue
        bears = np.array([b != i for b in range(k)], np.uint8)
        score = np.zeros(len(scan.p_O))
        scan_contacts(a.hand, a.path, scan, state, j, i, bears, terms.clearance, terms.margins, work.lp, score)
        truth = np.full(len(score), np.inf)
        others = [(b, state.p_OC[j + 1, b], state.n_O[j, 1, b]) for b in range(k) if b != i]
        for c in range(len(score)):
            if not candidate_free(a.hand, a.path, scan, state, j + 1, i, c, terms.clearance):
                score[c] = np.inf
                continue
            here = (i, scan.p[i, j + 1, c], scan.n[i, j + 1, c])
            truth[c] = least_force(a, j, m, [*others, here], terms.margins)
        np.testing.assert_allclose(score, truth, rtol=1e-6)
        for c in np.flatnonzero(score < np.inf):
            kept = outlook_of(a.hand, a.path, scan, state, j + 1, i, c, terms.clearance)
            score[c] += terms.outlook * (1.0 - kept)
            stand = [*others, (i, scan.p[i, j + 1, c], scan.n[i, j + 1, c])]
            stuck = [np.isinf(least_force(a, j, m, stand[:b] + stand[b + 1 :], terms.margins)) for b in range(k)]
            score[c] += terms.outlook * np.mean(stuck)
        n_a = a.joints(i).stop - a.joints(i).start
        q = np.zeros((m + 1, n_a))
        reachable = [
            c for c in np.flatnonzero(score < np.inf)
            if any(
                free_motion(
                    a.hand, a.path, state, j, i, bool(state.holds[j, i]), True, scan.p[i, j + 1, c],
                    scan.n[i, j + 1, c], scan.q[i, j + 1, c, :n_a], np.int64(way), terms.high, terms.clearance, q,
                )
                for way in range(WAYS)
            )
        ]  # fmt: skip
        chosen = state.chosen[j, i]
        assert (chosen >= 0) == bool(reachable)
        if reachable:
            compared += 1
            assert chosen in reachable
            assert score[chosen] == min(score[reachable])
    assert compared > 0


def test_how_an_agent_retires_does_not_depend_on_what_it_did_before() -> None:
    """Its joints are those of a new start where the matrix before had it relocate in the same interval."""
    a, i, j = arc("fig2-planar"), 1, 0
    problem = relocating(a, i, j)
    assert problem.current.chosen[j, i] >= 0
    problem.current.way[j, i] = problem.trial.way[j, i] = 2  # it passed over the object
    V = problem.snapshot()
    V[j, i] = OFF
    problem.reset(V)
    assert not problem.current.lost[j, i]
    np.testing.assert_array_equal(a.motion(problem).joints, a.motion(a.problem(V)).joints)


def test_a_relocating_agent_bears_no_force() -> None:
    a = arc("fig4-relocation")
    for i in range(4):
        problem = relocating(a, i, 2)
        motion = a.motion(problem)
        assert np.all(motion.force_W[2, :, i] == 0.0)
        assert np.all(np.isnan(motion.p_OC_O[2, :, i]))


def test_made_again_the_arc_is_the_same() -> None:
    """What is remembered of candidates does not leak from one arc to another."""
    one, other = arc("fig3-puma3"), made(load("fig3-puma3"))
    np.testing.assert_array_equal(one.grasp.q, other.grasp.q)
    np.testing.assert_array_equal(one.path.R_WO, other.path.R_WO)
