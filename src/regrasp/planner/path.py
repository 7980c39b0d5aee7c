"""The object's nominal path over one arc: its poses, the load on the contacts, the supports that touch it."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from regrasp.kernels.records import Record
from regrasp.planner.supports import SEPARATE, SLIDE, STICK, Support, touching
from regrasp.planner.turns import angle, from_rotvec, rotvec

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Path(Record):
    """n intervals of m steps each; sample s = 0 … m of interval j; P support slots.

    R_WO (n, m + 1, 3, 3), p_WO (n, m + 1, 3): object poses. up_O (n, m + 1, 3): what the contact forces must add up to, in
    units of the weight. support_mode (n, P): separate, stick or slide; support_p_O, support_n_O, support_t_O
    (n, m + 1, P, 3): contact point, normal into the object, direction of sliding friction on the object; support_mu (P,);
    support_of (P,): which support a slot belongs to.
    """

    R_WO: Array
    p_WO: Array
    up_O: Array
    support_mode: Ints
    support_p_O: Array
    support_n_O: Array
    support_t_O: Array
    support_mu: Array
    support_of: Ints


@njit(cache=True, nogil=True)
def pose_at(path: Path, j: int) -> tuple[Array, Array]:
    """Object pose of configuration j = 0 … n."""
    n, samples = path.R_WO.shape[0], path.R_WO.shape[1]
    if j < n:
        return path.R_WO[j, 0], path.p_WO[j, 0]
    return path.R_WO[n - 1, samples - 1], path.p_WO[n - 1, samples - 1]


Pose = tuple[Array, Array]


def interpolate(start: Pose, goal: Pose, u: Array) -> tuple[Array, Array]:
    """Poses (R, p) at u in [0, 1] on the straight, constant-twist path: p linear, R geodesic."""
    R = from_rotvec(u[:, None] * rotvec(goal[0] @ start[0].T)) @ start[0]
    return R, start[1] + u[:, None] * (goal[1] - start[1])


def distance(start: Pose, goal: Pose, radius: float) -> float:
    """Length of the straight path, m: |Δp| + radius · angle; a metric on poses, so an admissible estimate."""
    return float(np.linalg.norm(goal[1] - start[1]) + radius * angle(goal[0] @ start[0].T))


def nominal_path(
    R_WO: Array,
    p_WO: Array,
    n: int,
    m: int,
    gravity: Array,
    supports: tuple[Support, ...],
    kind_O: int,
    size_O: Array,
) -> Path:
    """The Path along n·m + 1 given poses.

    A support slot bears force in an interval only if the object touches there at every sample of it. Its mode follows
    from the velocity of the object's material point relative to the surface (paper §2): below 1 % of the fastest point of
    the object it sticks, else it slides, and friction opposes the motion.
    """
    index = np.arange(n)[:, None] * m + np.arange(m + 1)[None, :]
    R, p = R_WO[index], p_WO[index]
    g = float(np.linalg.norm(gravity))
    up_W = -gravity / g if g > 0.0 else np.zeros(3)
    up_O = np.einsum("jsba,b->jsa", R, up_W)
    contacts = [[touching(support, kind_O, size_O, R_WO[s], p_WO[s]) for s in range(n * m + 1)] for support in supports]
    slots = [(a, b) for a, per in enumerate(contacts) for b in range(max((len(c) for c in per), default=0))]
    P = len(slots)
    mode = np.zeros((n, P), np.int64)
    point, normal, slip = np.zeros((n, m + 1, P, 3)), np.zeros((n, m + 1, P, 3)), np.zeros((n, m + 1, P, 3))
    normal[..., 2] = 1.0
    radius = float(np.max(size_O[:3]))
    for column, (a, b) in enumerate(slots):
        for j in range(n):
            here = [contacts[a][i] for i in index[j]]
            if any(len(c) <= b for c in here):
                continue
            point[j, :, column] = [c[b][0] for c in here]
            n_W = np.array([c[b][1] for c in here])
            normal[j, :, column] = np.einsum("sba,sb->sa", R[j], n_W)
            v = point_velocity(R[j], p[j], point[j, :, column])
            v -= np.einsum("sa,sa->s", v, n_W)[:, None] * n_W
            speed = np.linalg.norm(v, axis=1)
            fastest = np.linalg.norm(p[j, -1] - p[j, 0]) + radius * angle(R[j, -1] @ R[j, 0].T)
            if np.all(speed <= 0.01 * fastest):
                mode[j, column] = STICK
            elif np.all(speed > 0.0):
                mode[j, column] = SLIDE
                slip[j, :, column] = np.einsum("sba,sb->sa", R[j], -v / speed[:, None])
            else:
                mode[j, column] = SEPARATE
    mu = np.array([supports[a].mu for a, _ in slots])
    return Path(R, p, up_O, mode, point, normal, slip, mu, np.array([a for a, _ in slots], np.int64))


def point_velocity(R: Array, p: Array, p_O: Array) -> Array:
    """Velocity per interval of the object's material point at p_O(s), at each sample, from the interval's twist (W)."""
    m = len(R) - 1
    turn = rotvec(R[1:] @ np.swapaxes(R[:-1], 1, 2)) * m
    shift = np.diff(p, axis=0) * m
    # Samples take the mean of the steps on either side; the ends the only one they have.
    omega = np.vstack([turn[:1], 0.5 * (turn[1:] + turn[:-1]), turn[-1:]])
    v = np.vstack([shift[:1], 0.5 * (shift[1:] + shift[:-1]), shift[-1:]])
    return v + np.cross(omega, np.einsum("sab,sb->sa", R, p_O))
