"""What supports leave free, against the mechanics of a box on its faces, edges and corners."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp.control.freedoms import left_free

HALF = np.array([0.03, 0.02, 0.05])
BOTTOM = HALF * np.array([[1, 1, -1], [1, -1, -1], [-1, -1, -1], [-1, 1, -1]])
UP = np.array([0.0, 0.0, 1.0])
ALL, NONE = np.ones(4, bool), np.zeros(4, bool)


def freedom(r, n, bears, sticks) -> int:
    return int(np.linalg.matrix_rank(left_free(r, n, bears, sticks), tol=1e-9))


def cases(rng: np.random.Generator):
    """Corners of a box, turned anyhow, with every pattern of contact."""
    for _ in range(200):
        R = Rotation.random(rng=rng).as_matrix()
        bears = rng.random(4) < 0.7
        yield BOTTOM @ R.T, np.tile(R @ UP, (4, 1)), bears, bears & (rng.random(4) < 0.5)


def test_it_is_a_projection_that_moves_no_support():
    rng = np.random.default_rng(0)
    for r, n, bears, sticks in cases(rng):
        P = left_free(r, n, bears, sticks)
        np.testing.assert_allclose(P @ P, P, atol=1e-12 / HALF.min())
        v, w = np.split(P @ rng.standard_normal(6), 2)
        at = v + np.cross(w, r)
        np.testing.assert_allclose(at[sticks], 0.0, atol=1e-9)
        np.testing.assert_allclose(np.sum(at * n, axis=1)[bears], 0.0, atol=1e-9)


def test_motions_that_supports_allow_pass_unchanged():
    rng = np.random.default_rng(1)
    for r, n, bears, sticks in cases(rng):
        rows = [np.concatenate([n[p], np.cross(r[p], n[p])]) for p in range(4) if bears[p]]
        rows += [np.concatenate([e, np.cross(r[p], e)]) for p in range(4) if sticks[p] for e in np.eye(3)]
        _, s, V = np.linalg.svd(np.array(rows).reshape(-1, 6))
        rank = int(np.sum(s > 1e-9 * s.max(initial=0.0)))
        for motion in V[rank:]:
            np.testing.assert_allclose(left_free(r, n, bears, sticks) @ motion, motion, atol=1e-7)


@pytest.mark.parametrize(
    ("bears", "sticks", "count"),
    [
        (NONE, NONE, 6),  # in the air
        (ALL, NONE, 3),  # slides and turns on a face
        (ALL, ALL, 0),
        (np.array([True, True, False, False]), np.array([True, True, False, False]), 1),  # pivots about an edge
        (np.array([True, False, False, False]), np.array([True, False, False, False]), 3),  # turns about a corner
    ],
)
def test_the_freedoms_of_a_box(bears, sticks, count):
    n = np.tile(UP, (4, 1))
    assert freedom(BOTTOM, n, bears, sticks) == count


def test_a_pivot_turns_about_its_edge():
    bears = np.array([True, True, False, False])
    P = left_free(BOTTOM, np.tile(UP, (4, 1)), bears, bears)
    edge = BOTTOM[0] - BOTTOM[1]
    turn = np.concatenate([np.cross(BOTTOM[0], edge), edge])  # v = −ω × r
    np.testing.assert_allclose(P @ turn, turn, atol=1e-12)
