"""The plan's contact forces: one convex program for the whole plan instead of a linear one per sample.

The forces of the search (paper §3) are vertices of linear programs: least in sum, but they jump in time and leave contacts
without load. A plan's forces are to be carried out, so they are small, evenly shared and smooth,

  min Σ |f_i|² + ω Σ |Δf_i|² + P Σ lack_i

over all instants and contacts, Δ from one instant to the next, subject to G f + w = 0, to
|f_t| ≤ (1 − margin) μ (f_n − s_i + lack_i) where a contact rests or rolls, f = f_n (−n + μ v̂) where it slides,
s_i − lack_i ≤ f_n ≤ f_max, 0 ≤ lack_i ≤ s_i; s_i is what an agent has to spare (`planner.reserve`), f_max less for one that
slides. Units: the object's weight; torques over its radius.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from regrasp.planner.cones import Nodes, nodes_of, solve, spares
from regrasp.planner.contacts import Contacts, bases, excess, residual, wrenches
from regrasp.planner.outcome import Failure
from regrasp.planner.reserve import Margins
from regrasp.settings import demand

Array = NDArray[np.float64]

WITHIN = 5e-7
"""Weights by which a force may pass its cone and limits, for round-off of the program; half of what `check` allows."""
BALANCED = 1e-8
"""Wrench residual, in weights, above which forces do not hold the object."""
SINGULAR = 1e-6
"""Singular value of the grasp map, relative to the largest, below which a direction can't be corrected."""


@dataclass(frozen=True)
class Loads:
    """Settings of the plan's forces.

    smoothness ω: weight of the changes of the forces from interval to interval against their size.
    """

    smoothness: float = 1.0

    def __post_init__(self) -> None:
        demand(self, from_zero=("smoothness",))


def between(contacts: Contacts, nodes: Nodes, at_nodes: Array, margin: float) -> Array:
    """Forces (N, M, C, 3) at all samples: linear between the nodes, then changed least so that they balance exactly."""
    N, M, C = contacts.p_W.shape[:3]
    ray, basis, free = bases(contacts, margin)
    in_W = np.einsum("bcae,bce->bca", nodes.basis, at_nodes)
    # At a node the columns are the node's: a contact that bears only after it has none there.
    known = nodes.of >= 0
    free[known] &= nodes.free[nodes.of[known]].any(axis=-1, keepdims=True)
    f = np.zeros((N, M, C, 3))
    for j in range(N):
        s = np.flatnonzero(known[j])
        right = np.clip(np.searchsorted(s, np.arange(M)), 1, len(s) - 1)
        u = ((np.arange(M) - s[right - 1]) / (s[right] - s[right - 1]))[:, None, None]
        a, b = nodes.of[j, s[right - 1]], nodes.of[j, s[right]]
        f[j] = (1.0 - u) * in_W[a] + u * in_W[b]
        size = (1.0 - u) * at_nodes[a][..., :1] + u * at_nodes[b][..., :1]
        f[j] = np.where(ray[j, :, :, None], size * basis[j, ..., 0], f[j])
    G = wrenches(contacts.p_W, np.where(free[..., None, :], basis, 0.0))
    G = np.moveaxis(G, 2, 3).reshape(N, M, 6, 3 * C)
    # Gᵀ (G Gᵀ)⁺ is G⁺, and 6 by 6; its squared singular values lose digits, which the second time brings back.
    G_T = np.swapaxes(G, -1, -2)
    inverse = G_T @ np.linalg.pinv(G @ G_T, rcond=SINGULAR**2, hermitian=True)
    for _ in range(2):
        x = -inverse @ residual(contacts, f)[..., None]
        f = f + np.einsum("nmcae,nmce->nmca", basis, np.where(free, x[..., 0].reshape(N, M, C, 3), 0.0))
    return f


def failure(contacts: Contacts, nodes: Nodes, margins: Margins, settings: Loads) -> Failure:
    """Where the program has no solution: the nodes are tied together by the objective only, so one fails by itself."""
    remedy = "more friction, a larger max_force, another agent or a smaller planner.local.energy.friction_margin"
    for b, j in enumerate(nodes.source[:, 0]):
        one = replace(
            nodes, source=nodes.source[b : b + 1], ray=nodes.ray[b : b + 1], basis=nodes.basis[b : b + 1],
            free=nodes.free[b : b + 1], inward=nodes.inward[b : b + 1], p=nodes.p[b : b + 1],
            gap=np.zeros(0), span=np.ones(1),
        )  # fmt: skip
        if solve(contacts, one, margins, settings.smoothness) is None:
            return Failure(
                "equilibrium", place(contacts, int(j)), "object", "no contact forces hold the object", remedy
            )
    return Failure(
        "equilibrium", "the whole way", "object", "the program of the contact forces does not converge", remedy
    )


def place(contacts: Contacts, j: int) -> str:
    """Interval j in words, counted without hand-overs as the failures of the search are."""
    here = contacts.moves & (contacts.segment == contacts.segment[j])
    return f"segment {contacts.segment[j] + 1}, interval {np.sum(here[: j + 1])} of {np.sum(here)}"


def forces(contacts: Contacts, margins: Margins, settings: Loads) -> Array | Failure:
    """The forces (N, M, C, 3) of all contacts, in weights, or where there are none that hold the object."""
    dense = np.zeros(len(contacts.mode), bool)
    while True:
        nodes = nodes_of(contacts, margins.friction, dense)
        at_nodes = solve(contacts, nodes, margins, settings.smoothness)
        if at_nodes is None:
            return failure(contacts, nodes, margins, settings)
        f = between(contacts, nodes, at_nodes, margins.friction)
        # Between its ends an interval's forces may pass a cone: then the program has them at every sample. In a hand-over
        # they are in between two that hold, and the object stands still.
        wrong = (excess(contacts, f) > WITHIN) & contacts.moves & ~dense
        if not np.any(wrong):
            break
        dense |= wrong
    sound = np.all(excess(contacts, f) <= WITHIN) and np.all(np.abs(residual(contacts, f)) <= BALANCED)
    return f if sound else failure(contacts, nodes, margins, settings)


def most_lacking(contacts: Contacts, f: Array, margins: Margins) -> tuple[float, float, tuple[int, int]]:
    """The agent that lacks most of the normal force that it has to spare, at the ends of intervals.

    What it has to spare there under forces f (N, M, C, 3) and what it is to have (`reserve.spare`), in weights, and its
    interval and agent. It has f_n − |f_t| / ((1 − margin) μ), or f_n where it slides.
    """
    nodes = nodes_of(contacts, margins.friction, np.zeros(len(contacts.mode), bool))
    j, s = nodes.source.T
    normal = np.sum(f[j, s] * nodes.inward, axis=-1)
    across = np.linalg.norm(f[j, s] - normal[..., None] * nodes.inward, axis=-1)
    use = np.where(nodes.ray, np.inf, (1.0 - margins.friction) * contacts.mu)
    has, asked = normal - across / use, spares(contacts, nodes, margins)
    lack = np.where(nodes.free[..., 0] & contacts.grips, asked - has, -np.inf)
    b, i = np.unravel_index(int(np.argmax(lack)), lack.shape)
    return float(has[b, i]), float(asked[b, i]), (int(j[b]), int(i))
