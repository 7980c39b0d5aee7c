"""Free motions of relocating agents: the whole way is clear by MuJoCo's distances."""

import numpy as np
import pytest
from arcs import NAMES, Arc, Oracle, arc, between, height

from regrasp.planner.chain import ContactMotions
from regrasp.planner.motions import ONTO, STAY
from regrasp.planner.relocation import choose


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
