"""A plan in which everything moves: home poses disturbed by smooth random motions, uneven in time."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from regrasp.plan import Plan

N, M = 5, 6


@pytest.fixture(scope="session")
def restless(home_plan: Callable[[str], Plan]) -> Callable[[str], Plan]:
    """Scene name → a plan of N intervals; agent 0 is off the object in interval 2."""
    return lambda name: _restless(home_plan(name))


def _restless(plan: Plan) -> Plan:
    rng = np.random.default_rng(5)
    lengths = rng.uniform(0.3, 0.9, N)
    begin = np.concatenate([[0.0], np.cumsum(lengths)])[:-1]
    steps = np.concatenate([np.zeros((N, 1)), np.cumsum(rng.uniform(0.5, 1.5, (N, M - 1)), axis=1)], axis=1)
    time = begin[:, None] + lengths[:, None] * steps / steps[:, -1:]
    k, nq = len(plan.agent_names), len(plan.joint_names)

    def wander(dimension: int, size: float) -> np.ndarray:
        """Smooth and random (N, M, dimension)."""
        knots = np.linspace(0.0, lengths.sum(), 7)
        return CubicSpline(knots, size * rng.standard_normal((7, dimension)))(time)

    turns = Rotation.from_rotvec(wander(3, 0.3).reshape(-1, 3))
    start = Rotation.from_quat(plan.object_quaternion[0, 0], scalar_first=True)
    off = np.zeros((N, M, k, 1), dtype=bool)
    off[2, :, 0] = True
    n_W = start.as_matrix() @ plan.n_O[0, 0].T
    n_O = np.broadcast_to(((turns[0] * start).as_matrix().T @ n_W).T, (N, M, k, 3))  # in a planar hand's plane
    contact = np.where(off, np.nan, n_O)
    return dataclasses.replace(
        plan,
        time=time,
        joints=plan.joints[0, 0] + wander(nq, 0.05),
        object_position=plan.object_position[0, 0] + wander(3, 0.01),
        object_quaternion=(turns * start).as_quat(scalar_first=True).reshape(N, M, 4),
        p_OC_O=contact * 0.03 + np.where(off, np.nan, wander(3 * k, 0.002).reshape(N, M, k, 3)),
        n_O=contact,
        x_O=contact,
        force_W=np.where(off, 0.0, wander(3 * k, 1.0).reshape(N, M, k, 3)),
        **{
            name: np.repeat(getattr(plan, name)[:, :1], M, axis=1)
            for name in ("support_p_O", "support_n_W", "support_force_W")
        },
    )
