"""Force equilibrium (paper §3): the contacts of one configuration as columns of the force LP, and its solution."""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.basis import Program
from regrasp.kernels.forces import EDGES, friction_edges, ray
from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import cross, minus, rotate, triple
from regrasp.kernels.simplex import OPTIMAL, solve
from regrasp.kernels.surfaces import frame
from regrasp.planner.hand import Hand
from regrasp.planner.motions import is_sliding, whole
from regrasp.planner.path import Path
from regrasp.planner.reserve import Margins, shares, spare
from regrasp.planner.supports import SLIDE, STICK

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@kernel
def contact_columns(
    hand: Hand,
    i: int,
    code: int,
    p_OC: Array,
    n: Array,
    t: Array,
    margins: Margins,
    least: float,
    lp: Program,
    first: int,
) -> int:
    """Write agent i's contact into the LP, in O about the centre of mass; returns the number of columns written.

    What the contact bears at least, a normal force of `least`, is taken off the load.

    n is the object's outward normal; t the slip direction of a sliding contact, whose force lies on the boundary ray of
    the true cone. Rolling and resting contacts leave a part of μ unused, so that plans keep off the edge of their cones.
    """
    p, n_in = minus(p_OC, hand.p_OM_O), (-n[0], -n[1], -n[2])
    count = EDGES
    if is_sliding(code):
        ray(p, n_in, triple(t), hand.mu[i], hand.radius, lp.A, first)
        count = 1
        for row in range(6):
            lp.b[row] -= least * lp.A[row, first]
    else:
        x, y = frame(triple(n))
        friction_edges(p, n_in, x, y, (1.0 - margins.friction) * hand.mu[i], hand.radius, lp.A, first)
        turn, s = cross(p, n_in), least / hand.radius
        for a in range(3):
            lp.b[a] -= least * n_in[a]
            lp.b[3 + a] -= s * turn[a]
    for c in range(first, first + count):
        lp.cost[c] = 1.0
        lp.group[c] = i
    return count


@kernel
def support_columns(hand: Hand, path: Path, j: int, s: int, margins: Margins, lp: Program, first: int) -> int:
    """Write the passive contacts at sample s of interval j into the LP: they bear force and cost no effort."""
    at = first
    for column in range(path.support_mode.shape[1]):
        mode = path.support_mode[j, column]
        if mode != STICK and mode != SLIDE:
            continue
        n = triple(path.support_n_O[j, s, column])
        p = minus(path.support_p_O[j, s, column], hand.p_OM_O)
        count = 1
        if mode == SLIDE:
            ray(p, n, triple(path.support_t_O[j, s, column]), path.support_mu[column], hand.radius, lp.A, at)
        else:
            x, y = frame(n)
            friction_edges(p, n, x, y, (1.0 - margins.friction) * path.support_mu[column], hand.radius, lp.A, at)
            count = EDGES
        for c in range(at, at + count):
            lp.cost[c] = 0.0
            lp.group[c] = -1
        at += count
    return at - first


@kernel
def spares(
    hand: Hand, path: Path, j: int, s: int, bears: NDArray[np.uint8], codes: NDArray[np.int16], p_OC: Array,
    margins: Margins, lp: Program,
) -> None:  # fmt: skip
    """lp.least (k,): the normal force, in weights, that each agent has to spare, 0 for those that do not bear.

    Supports on which the object sticks share the disturbance. A contact that slides counts for nothing, as it resists along
    its normal only; it has its grip to spare.
    """
    k, slots = len(bears), path.support_mode.shape[1]
    p, sticks, share, least = lp.arm, lp.sticks, lp.sigma, lp.least
    sticks[:] = 0
    for i in range(k):
        if bears[i] and not is_sliding(whole(codes[i])):
            sticks[i] = 1
            for a in range(3):
                p[i, a] = (p_OC[i, a] - hand.p_OM_O[a]) / hand.radius
            rotate(path.R_WO[j, s], p[i], p[i])
    for column in range(slots):
        if path.support_mode[j, column] == STICK:
            sticks[k + column] = 1
            for a in range(3):
                p[k + column, a] = (path.support_p_O[j, s, column, a] - hand.p_OM_O[a]) / hand.radius
            rotate(path.R_WO[j, s], p[k + column], p[k + column])
    shares(p, sticks, hand.shifts, hand.turns, share)
    for i in range(k):
        least[i] = spare(margins, hand.mu[i], share[i], hand.cap[i]) if bears[i] else 0.0


@kernel
def balance(
    hand: Hand,
    path: Path,
    j: int,
    s: int,
    bears: NDArray[np.uint8],
    codes: NDArray[np.int16],
    p_OC: Array,
    n: Array,
    t: Array,
    margins: Margins,
    warm: bool,
    lp: Program,
) -> tuple[bool, float, int]:
    """The force LP at sample s of interval j: (whether there is equilibrium, Σ of the normal forces, pivots it took).

    warm: start from the basis of the last program. bears (k,): which agents press on the object; codes (k,): their contact
    motions; p_OC, n, t (k, 3) in O.

    What an agent has to spare it bears at least, evenly on the columns of its contact: as the mean of a cone's edges is its
    normal, a rolling contact's cone is moved up its normal by it. These lower bounds are taken off the variables before
    the solution, and what they bear off the load and the caps; afterwards they are put on: y = 0 stays dual feasible.
    """
    columns = whole(0)
    for a in range(3):
        lp.b[a] = path.up_O[j, s, a]
        lp.b[3 + a] = 0.0
    least = lp.least
    spares(hand, path, j, s, bears, codes, p_OC, margins, lp)
    for i in range(len(bears)):
        cap = min(hand.cap[i], margins.slide) if is_sliding(whole(codes[i])) else hand.cap[i]
        lp.cap[i] = cap - least[i]
        if bears[i]:
            count = contact_columns(hand, i, whole(codes[i]), p_OC[i], n[i], t[i], margins, least[i], lp, columns)
            least[i] /= count
            columns += count
    columns += support_columns(hand, path, j, s, margins, lp, columns)
    status, value, pivots = solve(lp, columns, warm)
    for c in range(columns):
        if lp.group[c] >= 0:
            lp.solution[c] += least[lp.group[c]]
            value += least[lp.group[c]]
    return status == OPTIMAL, value, pivots
