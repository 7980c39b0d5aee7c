"""Perturbed trials: the plan executed in worlds that differ from the planned one within stated ranges."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from regrasp.plan import NONE, Plan
from regrasp.scene.world import World
from regrasp.settings import demand
from regrasp.verify.physics import Reality

Array = NDArray[np.float64]


SHIFTS, TURNS = ("x", "y", "z"), ("rx", "ry", "rz")
SAME = 1e-6
"""Directions that differ by less are one."""


@dataclass(frozen=True)
class Perturbation:
    """Ranges, ± uniform: friction and mass: parts of the planned value. position, m, and rotation, rad: of the object at
    the start, along and about every axis in which the scene lets it move. timing: s, of each contact change.
    Standard deviations of each measurement, per axis: noise_position, m, noise_rotation, rad.
    """

    friction: float = 0.2
    mass: float = 0.2
    position: float = 2e-3
    rotation: float = math.radians(2.0)
    timing: float = 0.02
    noise_position: float = 1e-3
    noise_rotation: float = math.radians(1.0)

    def __post_init__(self) -> None:
        for name, high in (("friction", 1.0), ("mass", 1.0)):
            if not 0.0 <= getattr(self, name) < high:
                raise ValueError(f"{name} is {getattr(self, name)}, legal: 0 to {high:g}")
        demand(self, from_zero=("position", "rotation", "timing", "noise_position", "noise_rotation"))


def draw(plan: Plan, world: World, ranges: Perturbation, rng: np.random.Generator) -> Reality:
    """A world within the ranges. Every tip and support has its own friction."""
    shift = rng.uniform(-ranges.position, ranges.position, 3)
    turn = rng.uniform(-ranges.rotation, ranges.rotation, 3)
    shift, turn = possible(plan, world, shift, turn)
    surfaces = len(world.agents) + len(world.support_geoms)
    return Reality(
        friction=rng.uniform(1.0 - ranges.friction, 1.0 + ranges.friction, surfaces),
        mass=float(rng.uniform(1.0 - ranges.mass, 1.0 + ranges.mass)),
        shift=shift,
        turn=turn,
        delay=ranges.timing,
        noise=(ranges.noise_position, ranges.noise_rotation),
    )


def possible(plan: Plan, world: World, shift: Array, turn: Array) -> tuple[Array, Array]:
    """The part of a displacement that the object can have at the start: in the scene's freedoms, along its supports and
    about their common normal. A sphere turns about any axis; what stands on supports of different normals does not turn.
    """
    frozen = [np.eye(3)[[axis not in world.scene.freedoms for axis in axes]] for axes in (SHIFTS, TURNS)]
    normals = plan.support_n_W[0, 0, plan.support_mode[0] != NONE]
    held = np.empty((0, 3))
    if len(normals) and world.scene.object.shape != "sphere":
        agree = np.allclose(normals, normals[0], atol=SAME)
        held = np.eye(3) - np.outer(normals[0], normals[0]) * agree
    return _without(shift, np.concatenate([frozen[0], normals])), _without(turn, np.concatenate([frozen[1], held]))


def _without(vector: Array, directions: Array) -> Array:
    """The part of a vector (3,) across all the directions (n, 3)."""
    return np.asarray(vector - np.linalg.pinv(directions, rcond=SAME) @ (directions @ vector))


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Wilson's score interval of a success rate (E. B. Wilson 1927), 95 %."""
    interval = binomtest(successes, trials).proportion_ci(0.95, "wilson")
    return float(interval.low), float(interval.high)
