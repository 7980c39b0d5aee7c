"""No-collision condition (paper §2): which pairs of bodies may not touch, and whether they do."""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.cores import PLANE, SEGMENT
from regrasp.kernels.distances import boxes_far, distance
from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import multiply, rotate
from regrasp.planner.hand import Hand

Array = NDArray[np.float64]


@kernel
def place(hand: Hand, first: int, last: int, R_WL: Array, p_WL: Array, R_WG: Array, p_WG: Array) -> None:
    """World poses of the geoms first … last − 1, in rows from 0, from the frames of the links (or object) that carry them."""
    for g in range(first, last):
        link, row = hand.geoms.link[g], g - first
        multiply(R_WL[link], hand.geoms.R_LG[g], R_WG[row])
        rotate(R_WL[link], hand.geoms.p_LG[g], p_WG[row])
        for a in range(3):
            p_WG[row, a] += p_WL[link, a]


@kernel
def place_agent(
    hand: Hand, i: int, R_WP: Array, p_WP: Array, R_PL: Array, p_PL: Array, R_WG: Array, p_WG: Array
) -> None:
    """World poses of agent i's geoms, in rows from 0, from the frames of its links in its base P."""
    first, last = hand.geom_start[i], hand.geom_start[i + 1]
    place(hand, first, last, R_PL, p_PL, R_WG, p_WG)
    if hand.base[i] > 0:
        for g in range(last - first):
            multiply(R_WP, R_WG[g], R_WG[g])
            rotate(R_WP, p_WG[g], p_WG[g])
            for a in range(3):
                p_WG[g, a] += p_WP[a]


@kernel
def closer(hand: Hand, a: int, R_A: Array, p_A: Array, b: int, R_B: Array, p_B: Array, clearance: float) -> bool:
    """Whether geoms a and b at these poses come closer than the clearance; bounding spheres first, then boxes."""
    geoms = hand.geoms
    reach = geoms.bound[a] + geoms.bound[b] + clearance
    dx, dy, dz = p_A[0] - p_B[0], p_A[1] - p_B[1], p_A[2] - p_B[2]
    if dx * dx + dy * dy + dz * dz > reach * reach:
        return False
    # Segments and half-spaces are as fast to measure.
    if (
        max(geoms.kind[a], geoms.kind[b]) > SEGMENT
        and geoms.kind[a] != PLANE
        and geoms.kind[b] != PLANE
        and boxes_far(geoms.core[a], geoms.radius[a], R_A, p_A, geoms.core[b], geoms.radius[b], R_B, p_B, clearance)
    ):
        return False
    d = distance(
        geoms.kind[a], geoms.core[a], geoms.radius[a], R_A, p_A,
        geoms.kind[b], geoms.core[b], geoms.radius[b], R_B, p_B,
        clearance,
    )  # fmt: skip
    return d < clearance


@kernel
def first_geom(hand: Hand, c: int) -> int:
    """The first geom of agent c, of the static bodies (c = k) or the object (c = k + 1)."""
    return hand.geom_start[c] if c <= len(hand.tip_geom) else hand.object_geom


@kernel
def object_row(hand: Hand) -> int:
    """The row of the object's first body among the poses of static bodies, arms and object (`Configurations`)."""
    return hand.object_geom - hand.geom_start[len(hand.tip_geom)]


@kernel
def moving_row(hand: Hand) -> int:
    """The first row of what moves among the poses of static bodies, arms and object."""
    return hand.arm_geom - hand.geom_start[len(hand.tip_geom)]


@kernel
def hits(hand: Hand, a: int, c: int, R_A: Array, p_A: Array, R_C: Array, p_C: Array, clearance: float) -> bool:
    """Whether any pair of block (a, c) comes closer than the clearance (own links: touches); poses in rows from 0.

    a is an agent; c an agent, k for the static bodies, k + 1 for the object (`Hand.block`).
    """
    if c == a:
        clearance = 0.0  # neighbouring links of one agent are close by construction
    first_a, first_c = hand.geom_start[a], first_geom(hand, c)
    bound = hand.geoms.bound
    for n in range(hand.block[a, c], hand.block[a, c + 1]):
        g, h = hand.pairs[n, 0], hand.pairs[n, 1]
        u, v = g - first_a, h - first_c
        reach = bound[g] + bound[h] + clearance
        dx, dy, dz = p_A[u, 0] - p_C[v, 0], p_A[u, 1] - p_C[v, 1], p_A[u, 2] - p_C[v, 2]
        if dx * dx + dy * dy + dz * dz <= reach * reach and closer(
            hand, g, R_A[u], p_A[u], h, R_C[v], p_C[v], clearance
        ):
            return True
    return False


@kernel
def stands_clear(hand: Hand, i: int, R_G: Array, p_G: Array, R_B: Array, p_B: Array, clearance: float) -> bool:
    """Whether agent i's bodies at R_G, p_G are clear of each other, the static bodies and the object.

    R_B, p_B: poses of static bodies and object (`Configurations`). The tip, which may touch, is not asked for.
    """
    k, last = len(hand.tip_geom), object_row(hand)
    return not (
        hits(hand, i, i, R_G, p_G, R_G, p_G, 0.0)
        or hits(hand, i, k, R_G, p_G, R_B, p_B, clearance)
        or hits(hand, i, k + 1, R_G, p_G, R_B[last:], p_B[last:], clearance)
    )


@kernel
def tip_hits(hand: Hand, i: int, R_G: Array, p_G: Array, R_O: Array, p_O: Array, clearance: float) -> bool:
    """Whether the tip of agent i, which is not in contact, comes closer to the object than the clearance.

    R_G, p_G: poses of the agent's geoms; R_O, p_O: poses of the object's bodies.
    """
    row = hand.tip_geom[i] - hand.geom_start[i]
    for b in range(len(hand.geoms.kind) - hand.object_geom):
        if closer(
            hand, hand.tip_geom[i], R_G[row], p_G[row], hand.object_geom + b, R_O[b], p_O[b], clearance
        ):  # fmt: skip
            return True
    return False


@kernel
def object_hits(hand: Hand, R_B: Array, p_B: Array, clearance: float) -> bool:
    """Whether the object comes closer to a static body than the clearance. R_B, p_B: static bodies, then the object's."""
    k = len(hand.tip_geom)
    first = hand.geom_start[k]
    for n in range(hand.block[k, k], hand.block[k, k + 1]):
        g, h = hand.pairs[n, 0], hand.pairs[n, 1]
        if closer(hand, g, R_B[g - first], p_B[g - first], h, R_B[h - first], p_B[h - first], clearance):
            return True
    return False
