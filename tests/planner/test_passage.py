"""Free motions of relocating agents: the whole way is clear by MuJoCo's distances."""

import dataclasses

import numpy as np
import pytest
from arcs import NAMES, Arc, Oracle, arc, between, height

from regrasp.planner.chain import ContactMotions
from regrasp.planner.configurations import Grasp, normal_at
from regrasp.planner.measured import measured_grasp
from regrasp.planner.motions import MOTION_COUNT, ONTO, RELOCATE, STAY
from regrasp.planner.passage import LEAP, ROUND, WAYS, free_motion, leaps
from regrasp.planner.pieces import rest_at
from regrasp.planner.relocation import choose
from regrasp.planner.scan import new_scan
from regrasp.planner.terms import moves_freely


def relocating(a: Arc, i: int, j: int) -> ContactMotions:
    """The problem in which agent i relocates in interval j, onto the best of 32 candidates, while the others stay."""
    problem = a.problem(np.full((len(a.path.R_WO), len(a.task.names)), STAY, np.int16))
    V = problem.snapshot()
    V[j, i] = ONTO + choose(*problem.model, problem.current, j, i, np.random.default_rng(0).random(32))
    problem.reset(V)
    return problem


@pytest.mark.parametrize("name", NAMES)
def test_a_relocating_agents_whole_way_is_clear(name: str) -> None:
    """At every sample and three points between, on the cubic spline that the plan means."""
    a = arc(name)
    oracle, m = Oracle(a.task), a.path.R_WO.shape[1] - 1
    found = 0
    for i, agent in enumerate(a.task.world.agents):
        for j in (0, 2):
            problem = relocating(a, i, j)
            if problem.current.behind[j, i] or problem.current.way[j, i] < 0:
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


@pytest.mark.parametrize("name", NAMES)
def test_a_body_leaps_if_it_goes_farther_than_the_limit_between_two_rows(name: str) -> None:
    """Centres of all geoms of an agent, by MuJoCo's kinematics, for small, middling and wild motions."""
    a = arc(name)
    oracle, rng, verdicts = Oracle(a.task), np.random.default_rng(0), []
    for i, agent in enumerate(a.task.world.agents):
        mine = a.joints(i)
        n_a, geoms = mine.stop - mine.start, int(a.hand.geom_start[i + 1] - a.hand.geom_start[i])
        scratch = np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3)), np.empty((geoms, 3, 3)), np.empty((geoms, 3))
        for size in (0.0, 0.05, 0.2, 0.4, 0.8, 1.5):
            q = np.clip(a.hand.home[mine] + size * rng.normal(size=(4, n_a)), agent.lower, agent.upper)
            places = []
            for row in q:
                joints = a.hand.home.copy()
                joints[mine] = row
                oracle.put(a.path.R_WO[0, 0], a.path.p_WO[0, 0], joints)
                places.append(oracle.data.geom_xpos[agent.geoms].copy())
            far = np.max(np.linalg.norm(np.diff(places, axis=0), axis=-1))
            verdicts.append(leaps(a.hand, a.path, 0, i, q, *scratch))
            assert verdicts[-1] == (far > LEAP)
    assert {True, False} == set(verdicts)


def test_only_round_an_object_that_stands_still_are_further_ways_tried() -> None:
    """Of all free motions in a random plan: by one of the ROUND ways only where the object does not move."""
    still, moving = set(), set()
    for name in ("book-shelf", "wall-pivot", "fig4-relocation"):
        a = arc(name)
        pose = a.path.R_WO[0, 0], a.path.p_WO[0, 0]
        for path, ways in ((a.path, moving), (rest_at(a.task, pose, 4, None), still)):
            n = len(path.R_WO)
            scan = new_scan(a.hand, path, a.task.settings.local.relocation)
            problem = ContactMotions(
                a.hand, path, scan, a.terms, a.grasp, np.full((n, len(a.task.names)), STAY, np.int16)
            )
            rng = np.random.default_rng(0)
            for _ in range(60):
                V = np.full((n, len(a.task.names)), STAY, np.int16)
                V[1, rng.integers(len(a.task.names))] = ONTO + rng.integers(len(scan.p_O))
                problem.reset(V)
                ways |= set(problem.current.way[1].tolist())
    assert max(moving) < WAYS
    assert WAYS <= max(still) < WAYS + ROUND


def test_a_tip_that_begins_in_the_air_close_to_the_object_takes_hold_again() -> None:
    """Also from nearer than tips otherwise keep off the object, and no nearer than the clearance on its way."""
    a = arc("fig4-relocation")
    pose, k = (a.path.R_WO[0, 0], a.path.p_WO[0, 0]), len(a.task.names)
    for i in np.flatnonzero(a.grasp.holds).tolist():
        n = np.empty(3)
        normal_at(a.hand, a.grasp.p_OC[i].copy(), n)
        back = pose[0], pose[1] - 0.0025 * pose[0] @ n
        bears = np.arange(k) != i
        grasp = measured_grasp(a.task, back, a.grasp.q, bears, 0.003, a.terms.clearance)
        assert isinstance(grasp, Grasp)
        assert not grasp.holds[i]
        close = dataclasses.replace(a, path=rest_at(a.task, back, 1, grasp), grasp=grasp)
        taken = 0
        for c in range(0, len(close.scan().p_O), 5):
            V = np.full((1, k), STAY, np.int16)
            V[0, i] = ONTO + c
            problem = close.problem(V)
            if problem.current.behind[0, i] or problem.current.way[0, i] < 0:
                continue
            taken += 1
            q = close.motion(problem).joints[0]
            oracle = Oracle(a.task)
            for row in q[: len(q) - len(q) // 4 - 1]:
                oracle.put(*back, row)
                away = height(a, back[0].T @ (oracle.tip(i)[1] - back[1])) - a.hand.size_T[i, 0]
                assert away >= a.terms.clearance
        assert taken > 0


@pytest.mark.parametrize("name", ["fig4-relocation", "puma4-obstacles", "book-shelf"])
def test_what_is_remembered_of_a_way_is_what_is_found_anew(name: str) -> None:
    """Agents move one after the other, so that of most ways a part is known: what they meet is the same from nothing."""
    a = arc(name)
    rng = np.random.default_rng(3)
    problem = a.problem(np.full((len(a.path.R_WO), len(a.task.names)), STAY, np.int16))
    hand, path, scan, terms, found, work = problem.model
    n, k = problem.current.V.shape
    q = np.empty((path.R_WO.shape[1], int(np.diff(hand.chains.start)[0])))
    met: set[int] = set()
    for _ in range(60):
        V = problem.snapshot()
        j, i, code = int(rng.integers(n)), int(rng.integers(k)), int(rng.integers(MOTION_COUNT))
        V[j, i] = ONTO + rng.integers(len(scan.p_O)) if code >= RELOCATE else code
        problem.reset(V)
        now = problem.current
        for at, agent in np.ndindex(n, k):
            holds = int(found.holds[now.at[at, agent]])
            if not moves_freely(int(V[at, agent]), holds) or now.behind[at, agent]:
                continue
            move = at, agent, now.at[at], now.at[at + 1], terms.high, terms.clearance, q
            anew, _ = free_motion(hand, path, found, work.ways, work.key_way, False, *move)
            again, known = free_motion(hand, path, found, work.ways, work.key_way, True, *move)
            assert known
            assert anew == again == now.way[at, agent]
            met.add(anew)
    assert -1 in met
    assert len(met) > 1
