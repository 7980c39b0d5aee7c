"""Fig. 2: with a static surface that carries part of the load, one finger breaks contact and the remaining two hold on."""

import numpy as np

from regrasp.planner.chain import ContactMotions, anneal
from regrasp.planner.local import random_motions, terms_of
from regrasp.planner.method import opening
from regrasp.planner.motions import OFF
from regrasp.planner.scan import new_scan
from regrasp.planner.task import Settings, prepare
from regrasp.scene.load import load


def test_one_finger_breaks_contact_and_two_hold_on_with_the_table() -> None:
    """Some finger may retire half-way through an annealed motion, and the two others with the table still balance the ball."""
    settings = Settings()
    task = prepare(load("fig2-planar"), settings)
    rng = np.random.default_rng(0)
    path, grasp = opening(task, rng)
    terms, scan = terms_of(task.hand, settings.local), new_scan(task.hand, path, settings.local.relocation)
    n, k = len(path.R_WO), len(task.names)

    def problem(V: np.ndarray) -> ContactMotions:
        return ContactMotions(task.hand, path, scan, terms, grasp, V)

    violations, supported = [], []
    for i in range(3 * k):
        if i % k == 0:
            V = anneal(problem(random_motions(n, k, len(scan.p_O), rng)), settings.local.annealing, rng).best
        retired = V.copy()
        retired[n // 2 :, i % k] = OFF
        end = problem(retired)
        violations.append(end.current.c.sum() + end.current.e.sum())
        supported.append(end.grasp(n).holds.sum() == k - 1)
    assert min(violations) == 0
    assert supported[int(np.argmin(violations))]
    assert np.all(path.support_mode > 0)
