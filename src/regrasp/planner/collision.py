"""No-collision condition (paper §2): which pairs of bodies may not touch, and whether they do."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from regrasp.kernels.distances import distance
from regrasp.kernels.rotations import multiply, rotate
from regrasp.planner.hand import Hand

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def place(hand: Hand, first: int, last: int, R_WL: Array, p_WL: Array, R_WG: Array, p_WG: Array) -> None:
    """World poses of the geoms first … last − 1 from the frames of the links (or the object) that carry them."""
    for g in range(first, last):
        link = hand.geoms.link[g]
        multiply(R_WL[link], hand.geoms.R_LG[g], R_WG[g])
        rotate(R_WL[link], hand.geoms.p_LG[g], p_WG[g])
        for a in range(3):
            p_WG[g, a] += p_WL[link, a]


@njit(cache=True, nogil=True)
def closer(hand: Hand, a: int, b: int, R_WG: Array, p_WG: Array, clearance: float) -> bool:
    """Whether geoms a and b come closer than the clearance; bounding spheres first."""
    geoms = hand.geoms
    reach = geoms.bound[a] + geoms.bound[b] + clearance
    dx = p_WG[a, 0] - p_WG[b, 0]
    dy = p_WG[a, 1] - p_WG[b, 1]
    dz = p_WG[a, 2] - p_WG[b, 2]
    if dx * dx + dy * dy + dz * dz > reach * reach:
        return False
    d = distance(
        geoms.kind[a], geoms.core[a], geoms.radius[a], R_WG[a], p_WG[a],
        geoms.kind[b], geoms.core[b], geoms.radius[b], R_WG[b], p_WG[b],
        clearance,
    )  # fmt: skip
    return d < clearance


@njit(cache=True, nogil=True)
def block_hit(hand: Hand, a: int, c: int, R_WG: Array, p_WG: Array, clearance: float) -> bool:
    """Whether any pair of block (a, c) comes closer than the clearance (own links: touches).

    a is an agent, or k for the object; c an agent, k for the static bodies, k + 1 for the object (`Hand.block`).
    """
    if c == a and a < len(hand.tip_geom):
        clearance = 0.0  # neighbouring links of one agent are close by construction
    for n in range(hand.block[a, c], hand.block[a, c + 1]):
        if closer(hand, hand.pairs[n, 0], hand.pairs[n, 1], R_WG, p_WG, clearance):
            return True
    return False


@njit(cache=True, nogil=True)
def tip_hit(hand: Hand, i: int, R_WG: Array, p_WG: Array, clearance: float) -> bool:
    """Whether the tip of agent i, which is not in contact, comes closer to the object than the clearance."""
    return closer(hand, hand.tip_geom[i], hand.object_geom, R_WG, p_WG, clearance)
