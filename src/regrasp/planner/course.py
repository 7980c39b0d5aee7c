"""The course of a whole plan before forces and times: the arcs' motions joined, with hand-overs between them.

The paper's forces change at once where a contact motion changes. Real ones need time: between two intervals with different
contacts the object and the agents stand still for an interval, the hand-over, in which force passes from one set to the other.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regrasp.plan import FIRST_SLIDE, NONE, OFF, RELOCATE, SLIDE, STAY, STICK
from regrasp.planner.motion import Motion
from regrasp.planner.supports import Support

Array = NDArray[np.float64]
Codes = NDArray[np.int8]

TURNED = 0.1
"""rad: a contact that slides on in another direction than before by more than this changes its mode too."""


@dataclass(frozen=True)
class Course:
    """N intervals, M samples, k agents, P support slots; the fields are those of `regrasp.plan.Plan`, and three more.

    object_rotation (N, M, 3, 3): R_WO. support_t_W (N, M, P, 3): unit direction of a sliding support's friction on the object.
    moves (N,): false in hand-overs.
    """

    segment: NDArray[np.int64]
    object_position: Array
    object_rotation: Array
    joints: Array
    V: Codes
    twist: Array
    p_OC_O: Array
    n_O: Array
    x_O: Array
    support_mode: Codes
    support_p_O: Array
    support_n_W: Array
    support_t_W: Array
    moves: NDArray[np.bool_]

    @property
    def mode(self) -> Codes:
        """(N, k + P): whether each contact, agents first, bears no force, sticks (rests, rolls) or slides."""
        agents = np.where(self.V >= RELOCATE, NONE, np.where(self.V >= FIRST_SLIDE, SLIDE, STICK))
        return np.concatenate([agents, self.support_mode], axis=1).astype(np.int8)

    @property
    def slip_W(self) -> Array:
        """(N, M, k + P, 3): direction of each contact's friction on the object where it slides, unit, else zero."""
        V = self.V[:, None, :, None]
        along = np.where(V < FIRST_SLIDE + 2, self.x_O, np.cross(self.n_O, self.x_O))
        slides = (V >= FIRST_SLIDE) & (V < RELOCATE)
        slip_O = np.where(slides, np.where((V - FIRST_SLIDE) % 2 == 0, along, -along), 0.0)
        return np.concatenate([rotate(self.object_rotation, slip_O), self.support_t_W], axis=2)


def rotate(R: Array, vectors: Array) -> Array:
    """R (N, M, 3, 3) applied to vectors (N, M, ·, 3)."""
    return np.asarray(np.einsum("nmab,nmcb->nmca", R, vectors))


def joined(motions: list[Motion], supports: tuple[Support, ...]) -> tuple[Course, tuple[str, ...]]:
    """The course of consecutive motions, one per segment, and the support of each slot."""
    slots = sorted({slot for motion in motions for slot in slots_of(motion)})
    spread = [support_slots(motion, slots) for motion in motions]
    n = [len(motion.V) for motion in motions]
    course = Course(
        segment=np.repeat(np.arange(len(motions)), n),
        object_position=np.concatenate([motion.path.p_WO for motion in motions]),
        object_rotation=np.concatenate([motion.path.R_WO for motion in motions]),
        **{name: np.concatenate([getattr(motion, name) for motion in motions])
           for name in ("joints", "V", "twist", "p_OC_O", "n_O", "x_O")},
        **{name: np.concatenate([arrays[name] for arrays in spread]) for name in spread[0]},
        moves=np.ones(sum(n), np.bool_),
    )  # fmt: skip
    return course, tuple(supports[a].name for a, _ in slots)


def slots_of(motion: Motion) -> list[tuple[int, int]]:
    """The slots of a motion's path: (support, slot of its own)."""
    return list(zip(motion.path.support_of.tolist(), motion.path.support_slot.tolist(), strict=True))


def support_slots(motion: Motion, slots: list[tuple[int, int]]) -> dict[str, Any]:
    """A motion's support arrays spread over the plan's slots."""
    path = motion.path
    (n, samples), P = path.R_WO.shape[:2], len(slots)
    columns = [slots.index(slot) for slot in slots_of(motion)]
    out: dict[str, Any] = {
        "support_mode": np.zeros((n, P), np.int8),
        **{name: np.zeros((n, samples, P, 3)) for name in ("support_p_O", "support_n_W", "support_t_W")},
    }
    out["support_n_W"][..., 2] = 1.0
    out["support_mode"][:, columns] = path.support_mode
    out["support_p_O"][:, :, columns] = path.support_p_O
    out["support_n_W"][:, :, columns] = rotate(path.R_WO, path.support_n_O)
    out["support_t_W"][:, :, columns] = rotate(path.R_WO, path.support_t_O)
    return out


def changes(course: Course) -> NDArray[np.bool_]:
    """(N − 1,): whether any contact's mode differs between interval j and j + 1."""
    mode, slip = course.mode, course.slip_W
    turned = np.linalg.norm(slip[1:, 0] - slip[:-1, -1], axis=-1) > 2.0 * np.sin(0.5 * TURNED)
    both = (mode[1:] == SLIDE) & (mode[:-1] == SLIDE)
    return np.asarray(np.any((mode[1:] != mode[:-1]) | (both & turned), axis=1))


def with_hand_overs(course: Course) -> Course:
    """The course with a hand-over wherever the modes of contacts change; it belongs to the segment before.

    Whoever bears force before or after stays in its contact meanwhile; a support bears that does so before or after.
    """
    before = np.flatnonzero(changes(course))
    order = np.sort(np.concatenate([np.arange(len(course.V)), before]), kind="stable")
    at = before + 1 + np.arange(len(before))  # where the hand-overs stand in the new order
    rows = {each.name: getattr(course, each.name)[order] for each in fields(course)}
    for name, array in rows.items():
        if name not in ("segment", "V", "twist", "support_mode", "moves"):
            array[at] = array[at, -1:]
    agents = course.V < RELOCATE
    # Where a contact begins only after the hand-over, its place is taken from there; so it is where it begins to slide, as then
    # its force is on the cone about that very normal, which has gained a last digit from one interval to the next.
    k = course.V.shape[1]
    starts = (course.mode[before + 1, :k] == SLIDE) & (course.mode[before, :k] != SLIDE)
    lands = ((agents[before + 1] & ~agents[before]) | starts)[:, None, :, None]
    touches = ((course.support_mode[before + 1] != NONE) & (course.support_mode[before] == NONE))[:, None, :, None]
    for names, new in ((("p_OC_O", "n_O", "x_O"), lands), (("support_p_O", "support_n_W"), touches)):
        for name in names:
            rows[name][at] = np.where(new, getattr(course, name)[before + 1, :1], rows[name][at])
    rows["V"][at] = np.where(agents[before] | agents[before + 1], STAY, OFF)
    rows["support_mode"][at] = np.where(course.support_mode[before] | course.support_mode[before + 1], STICK, NONE)
    rows["twist"][at] = 0.0
    rows["support_t_W"][at] = 0.0
    rows["moves"][at] = False
    return replace(course, **rows)
