"""What supports leave free: the small rigid motions of a carried object that fingers can bring about.

A support bears on the object with normal n at r from the object's origin. The fingers move the object by (v, ω) without
pressing it into the support or lifting it off only if n · (v + ω × r) = 0; where it sticks, its friction holds the point, and
v + ω × r = 0.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from regrasp.plan import NONE, STICK, Plan

Array = NDArray[np.float64]

HELD = 1e-6
"""Share of the strongest constraint's stiffness above which a direction counts as held."""


def free_motions(plan: Plan) -> Array:
    """Projections (N, M, 6, 6) of displacements onto those that the plan's supports leave free at its samples."""
    N, M = plan.time.shape
    R_WO = Rotation.from_quat(plan.object_quaternion.reshape(-1, 4), scalar_first=True).as_matrix().reshape(N, M, 3, 3)
    r = np.einsum("jsab,jspb->jspa", R_WO, plan.support_p_O)
    mode = np.repeat(plan.support_mode[:, None], M, axis=1)
    return left_free(r, plan.support_n_W, mode != NONE, mode == STICK)


def left_free(r: Array, n: Array, bears: NDArray[np.bool_], sticks: NDArray[np.bool_]) -> Array:
    """Projections (…, 6, 6) of displacements (shift of the object's origin, turn) onto those P supports leave free.

    r, n (…, P, 3): where they bear and their normals; bears, sticks (…, P). Orthogonal where turns count with the distance
    of the furthest support of all.
    """
    length = float(np.max(np.linalg.norm(r[bears], axis=1), initial=0.0)) or 1.0
    # v + ω × r = (I, −[r]) (v, ω): three rows for a support that sticks, the part along n for one that slides.
    x, y, z = np.moveaxis(r / length, -1, 0)
    o = np.zeros_like(x)
    arm = np.moveaxis(np.array([[o, z, -y], [-z, o, x], [y, -x, o]]), (0, 1), (-2, -1))
    G = np.concatenate([np.broadcast_to(np.eye(3), arm.shape), arm], axis=-1)
    A = np.where(sticks[..., None, None], G, n[..., None] * np.einsum("...a,...ab->...b", n, G)[..., None, :])
    A = np.where(bears[..., None, None], A, 0.0).reshape(*r.shape[:-2], 3 * r.shape[-2], 6)
    stiffness, axes = np.linalg.eigh(A.swapaxes(-1, -2) @ A)
    free = stiffness <= HELD * np.maximum(stiffness[..., -1:], 1e-300)
    scale = np.array([1.0] * 3 + [length] * 3)
    return np.asarray((axes * free[..., None, :]) @ axes.swapaxes(-1, -2) * scale / scale[:, None])
