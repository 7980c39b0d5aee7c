"""The object's nominal path over one arc: its poses, the load on the contacts, the supports that touch it."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.features import TOUCH
from regrasp.kernels.native import kernel
from regrasp.kernels.records import Record
from regrasp.kernels.surfaces import MESH
from regrasp.planner.arms import poses_of
from regrasp.planner.hand import Hand
from regrasp.planner.supports import COINCIDE, SEPARATE, SLIDE, STICK, Support, on_surface, patches_along
from regrasp.planner.turns import angle, from_rotvec, rotvec

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Path(Record):
    """n intervals of m steps each; sample s = 0 … m of interval j; P support slots.

    R_WO (n, m + 1, 3, 3), p_WO (n, m + 1, 3): object poses. up_O (n, m + 1, 3): what the contact forces must add up to, in
    units of the weight. support_mode (n, P): separate, stick or slide; support_p_O, support_n_O, support_t_O
    (n, m + 1, P, 3): contact point, normal into the object, direction of sliding friction on the object; support_mu (P,);
    support_of, support_slot (P,): which support a slot belongs to, and which of its slots (`supports.Touches`) it is.

    Agents stand on bases b = 0 … B − 1 (`Hand.base`): the world, and the palms P of arms that carry hands. R_WP, p_WP, R_PO,
    p_PO (B, n, m + 1, …): the bases, and the object in them; arm_q (n, m + 1, nq_a): joints of the arms; R_WG, p_WG (n, m + 1,
    G, …): their bodies.
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
    support_slot: Ints
    R_WP: Array
    p_WP: Array
    R_PO: Array
    p_PO: Array
    arm_q: Array
    R_WG: Array
    p_WG: Array


OF_INTERVALS = (
    "R_WO", "p_WO", "up_O", "support_mode", "support_p_O", "support_n_O", "support_t_O", "arm_q", "R_WG", "p_WG",
)  # fmt: skip
OF_BASES = ("R_WP", "p_WP", "R_PO", "p_PO")
"""Arrays of a Path whose first axis is that of the intervals, and whose second is."""


@kernel
def pose_at(path: Path, b: int, j: int) -> tuple[Array, Array]:
    """Object pose in base b in configuration j = 0 … n."""
    n, samples = path.R_WO.shape[0], path.R_WO.shape[1]
    if j < n:
        return path.R_PO[b, j, 0], path.p_PO[b, j, 0]
    return path.R_PO[b, n - 1, samples - 1], path.p_PO[b, n - 1, samples - 1]


@kernel
def base_at(path: Path, b: int, j: int) -> tuple[Array, Array]:
    """Pose of base b in configuration j = 0 … n."""
    n, samples = path.R_WO.shape[0], path.R_WO.shape[1]
    if j < n:
        return path.R_WP[b, j, 0], path.p_WP[b, j, 0]
    return path.R_WP[b, n - 1, samples - 1], path.p_WP[b, n - 1, samples - 1]


Pose = tuple[Array, Array]


def interpolate(start: Pose, goal: Pose, u: Array) -> tuple[Array, Array]:
    """Poses (R, p) at u in [0, 1] on the straight, constant-twist path: p linear, R geodesic."""
    R = from_rotvec(u[:, None] * rotvec(goal[0] @ start[0].T)) @ start[0]
    return R, start[1] + u[:, None] * (goal[1] - start[1])


def distance(start: Pose, goal: Pose, radius: float) -> float:
    """Length of the straight path, m: |Δp| + radius · angle; a metric on poses, so an admissible estimate."""
    return float(np.linalg.norm(goal[1] - start[1]) + radius * angle(goal[0] @ start[0].T))


WANDER = 10.0
"""How much faster than the object a contact point may move; a faster one jumps, as where a face rises onto its edge."""


def nominal_path(
    R_WO: Array, p_WO: Array, n: int, m: int, gravity: Array, hand: Hand, supports: tuple[Support, ...],
    arm_q: Array | None = None,
) -> Path:  # fmt: skip
    """The Path along n·m + 1 given poses, with the arms' joints arm_q (n·m + 1, nq_a), or at rest.

    A support slot that bears force (`bearing`) has its mode from the velocity of the object's material point relative to the
    surface (paper §2): below 1 % of the fastest point of the object it sticks, else it slides, and friction opposes the
    motion.
    """
    index = np.arange(n)[:, None] * m + np.arange(m + 1)[None, :]
    R, p = R_WO[index], p_WO[index]
    g = float(np.linalg.norm(gravity))
    up_W = -gravity / g if g > 0.0 else np.zeros(3)
    up_O = np.einsum("jsba,b->jsa", R, up_W)
    radius = hand.radius if hand.kind_O == MESH else float(np.max(hand.size_O[:3]))
    touches = patches_along(hand, supports, R_WO, p_WO)
    of, slot = np.nonzero(np.any(touches.present, axis=0))
    present, p_W = touches.present[:, of, slot][index], touches.p_W[:, of, slot][index]
    begin_early(present, p_W, R, p, hand, [supports[a] for a in of])
    turns = angle(np.swapaxes(R[:, :-1], -1, -2) @ R[:, 1:])
    bears = bearing(present, p_W, np.linalg.norm(np.diff(p, axis=1), axis=-1) + radius * turns, of)
    used = np.flatnonzero(np.any(bears, axis=0))
    of, slot, p_W, bears = of[used], slot[used], p_W[:, :, used], bears[:, used]
    n_W = touches.n_W[:, of, slot][index]
    p_O = (p_W - p[:, :, None]) @ R
    v = point_velocity(R, p, p_O)
    v -= np.sum(v * n_W, axis=-1, keepdims=True) * n_W
    speed = np.linalg.norm(v, axis=-1)
    fastest = np.linalg.norm(p[:, -1] - p[:, 0], axis=-1) + radius * angle(R[:, -1] @ np.swapaxes(R[:, 0], -1, -2))
    sticks = np.all(speed <= 0.01 * fastest[:, None, None], axis=1)
    mode = np.where(bears, np.where(sticks, STICK, np.where(np.all(speed > 0.0, axis=1), SLIDE, SEPARATE)), SEPARATE)
    here, slides = bears[:, None, :, None], (mode == SLIDE)[:, None, :, None]
    n_O = np.where(here, n_W @ R, [0.0, 0.0, 1.0])
    t_O = np.where(slides, -v / np.where(slides[..., 0], speed, 1.0)[..., None], 0.0) @ R
    mu = np.array([supports[a].mu for a in of], float)
    q = np.broadcast_to(hand.arm_home, (len(R_WO), len(hand.arm_home))) if arm_q is None else arm_q
    arrays = (R, p, up_O, mode, np.where(here, p_O, 0.0), n_O, t_O, mu, of, slot, *carried(hand, R_WO, p_WO, q, index))
    return Path(*(np.ascontiguousarray(array) for array in arrays))


def head(path: Path, n: int) -> Path:
    """The first n intervals."""
    over = {name: getattr(path, name)[:n] for name in OF_INTERVALS}
    beside = {name: np.ascontiguousarray(getattr(path, name)[:, :n]) for name in OF_BASES}
    return replace(path, **over, **beside)


def carried(hand: Hand, R_WO: Array, p_WO: Array, arm_q: Array, index: Ints) -> tuple[Array, ...]:
    """The last seven arrays of a Path, of poses (count, …), joints (count, nq_a) and the samples' places (n, m + 1) there."""
    R_WP, p_WP, R_WG, p_WG = poses_of(hand, arm_q)
    R_PO = np.swapaxes(R_WP, -1, -2) @ R_WO
    p_PO = (np.swapaxes(R_WP, -1, -2) @ (p_WO - p_WP)[..., None])[..., 0]
    return (
        R_WP[:, index], p_WP[:, index], R_PO[:, index], p_PO[:, index], arm_q[index], R_WG[index], p_WG[index],
    )  # fmt: skip


def begin_early(
    present: NDArray[np.bool_], p_W: Array, R: Array, p: Array, hand: Hand, supports: list[Support]
) -> None:  # fmt: skip
    """Let slots that are present at all samples of an interval but one at its ends be so there too, where the point touches.

    A disc that tips has no point of its rim yet while it lies flat: it is the object's material point of the sample beside.
    """
    m = present.shape[1] - 1
    for end, beside in ((0, 1), (m, m - 1)):
        inner = np.delete(present, end, axis=1)
        for j, column in zip(*np.nonzero(np.all(inner, axis=1) & ~present[:, end]), strict=True):
            point = R[j, end] @ R[j, beside].T @ (p_W[j, beside, column] - p[j, beside]) + p[j, end]
            if on_surface(hand, supports[column], point):
                present[j, end, column], p_W[j, end, column] = True, point


def bearing(present: NDArray[np.bool_], p_W: Array, ways: Array, of: Ints) -> NDArray[np.bool_]:
    """Which slots bear force in which intervals, (n, P).

    Those that are present (n, m + 1, P) at every sample, whose points p_W (n, m + 1, P, 3) do not jump while the object moves
    by ways (n, m), and of which no other slot of the same support, of (P,), is in the same place: of two, the one that bears
    for longer stays, so that a contact keeps its slot.
    """
    steps = np.linalg.norm(np.diff(p_W, axis=1), axis=-1)
    bears = np.all(present, axis=1) & np.all(steps <= TOUCH + WANDER * ways[:, :, None], axis=1)
    ends = p_W[:, [0, -1]]
    apart = np.max(np.linalg.norm(ends[:, :, :, None] - ends[:, :, None], axis=-1), axis=1)
    rank = np.argsort(np.argsort(-np.sum(bears, axis=0), kind="stable"))
    before = (of[:, None] == of) & (rank[:, None] < rank)
    return np.asarray(bears & ~np.any(before & (apart <= COINCIDE) & bears[:, :, None], axis=1))


def point_velocity(R: Array, p: Array, p_O: Array) -> Array:
    """Velocity per interval of the object's material points p_O (n, m + 1, P, 3) at each sample, from the steps' twists (W)."""
    m = R.shape[1] - 1
    turn = rotvec(R[:, 1:] @ np.swapaxes(R[:, :-1], -1, -2)) * m
    shift = np.diff(p, axis=1) * m
    # Samples take the mean of the steps on either side; the ends the only one they have.
    omega, v = (
        np.concatenate([d[:, :1], 0.5 * (d[:, 1:] + d[:, :-1]), d[:, -1:]], axis=1)[:, :, None] for d in (turn, shift)
    )
    return np.asarray(v + np.cross(omega, p_O @ np.swapaxes(R, -1, -2)))
