"""Equal springs at contacts, by numpy and as defined: the oracle of what contacts have to spare."""

import numpy as np
from numpy.typing import NDArray

from regrasp.planner.reserve import SOFT, Margins

Array = NDArray[np.float64]
FREE = np.ones(3)


def grasp_map(p: Array) -> Array:
    """G (6, 3 C) of point contacts about the origin."""
    return np.hstack([np.vstack([np.eye(3), np.cross(np.eye(3), at).T]) for at in p])


def shares(p: Array, shifts: Array = FREE, turns: Array = FREE) -> Array:
    """‖G_iᵀ (G Gᵀ + soft)⁻¹ D‖_F, D the axes of the disturbance; soft: SOFT I for turns about the centroid of the contacts."""
    if len(p) == 0:
        return np.zeros(0)
    cross = np.cross(np.eye(3), p.mean(axis=0)).T
    about_c = np.block(
        [[np.eye(3), np.zeros((3, 3))], [-cross, np.eye(3)]]
    )  # wrench about the origin → about the centroid
    G = grasp_map(p)
    S = about_c @ G @ G.T @ about_c.T + np.diag([0.0, 0.0, 0.0, SOFT, SOFT, SOFT])
    springs = (about_c @ G).T @ np.linalg.inv(S) @ about_c @ np.diag(np.concatenate([shifts, turns]))
    return np.linalg.norm(springs.reshape(len(p), 18), axis=1)


def to_spare(margins: Margins, mu: Array, sigma: Array, cap: Array) -> Array:
    """The grip and what puts a cone of half angle atan μ at the distance δ σ, in normal force; at most half the cap."""
    return np.minimum(margins.grip + margins.disturbance * sigma / np.sin(np.arctan(mu)), 0.5 * np.asarray(cap))
