"""Grasps: which agents touch the object where; the start grasp that a scene gives."""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.chains import couple, forward
from regrasp.kernels.surfaces import project
from regrasp.planner.configurations import Grasp
from regrasp.planner.hand import Hand
from regrasp.planner.motions import STAY
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Path
from regrasp.planner.scan import lower, touch_down
from regrasp.planner.tips import tip_gap, under
from regrasp.scene.schema import Contact
from regrasp.scene.world import COUPLED

Array = NDArray[np.float64]
NEAR = 0.03  # m from the object, to which joints given for a grasp bring a tip at least


def nothing(grasp: Grasp) -> NDArray[np.int16]:
    """V (0, k): no interval planned yet."""
    return np.empty((0, len(grasp.holds)), np.int16)


def continued(onward: NDArray[np.int16], n: int) -> NDArray[np.int16]:
    """V (n, k) that begins with the rows `onward` (…, k), after which all agents keep what they do.

    Off the object to stay means to stay off; unlike `OFF` it leaves an agent that a search puts onto the object there.
    """
    return np.concatenate([onward, np.full((n, onward.shape[1]), STAY, np.int16)])[:n]


def contact_from(hand: Hand, i: int, R_PO: Array, q: Array, p_O: Array, n_O: Array) -> tuple[Array, Array, Array]:
    """(p_OC, p_TC, R_OT) of a tip that touches the object, turned by R_PO in its base, at p_O with joints q."""
    count = len(q)
    R_WL, p_WL = np.empty((count + 1, 3, 3)), np.empty((count + 1, 3))
    forward(hand.chains, i, q, R_WL, p_WL)
    R_OT, p_TC = R_PO.T @ R_WL[count], np.empty(3)
    under(hand, i, R_OT, n_O, p_TC)
    return p_O, p_TC, R_OT


def build_grasp(hand: Hand, path: Path, contacts: dict[int, tuple[Array, Array, Array]]) -> Grasp:
    """The grasp at a path's start with agent i at contacts[i] = (q, p_O, n_O); all others at rest."""
    k = len(hand.tip_geom)
    q, holds = hand.home.copy(), np.zeros(k, np.uint8)
    p_OC, p_TC, R_OT = np.zeros((k, 3)), np.zeros((k, 3)), np.tile(np.eye(3), (k, 1, 1))
    for i, (joints, p_O, n_O) in contacts.items():
        q[hand.chains.start[i] : hand.chains.start[i + 1]] = joints
        p_OC[i], p_TC[i], R_OT[i] = contact_from(hand, i, path.R_PO[hand.base[i], 0, 0], joints, p_O, n_O)
        holds[i] = 1
    return Grasp(q, holds, p_OC, p_TC, R_OT, path.arm_q[0, 0].copy())


def given_grasp(hand: Hand, path: Path, contacts: tuple[Contact, ...], names: tuple[str, ...]) -> Grasp | Failure:
    """The scene's own start contacts, points on the object or joints.

    Points are reached by inverse kinematics from the rest posture. Joints bring the tip near: it goes on, pointing as it does,
    to the nearest point of the object.
    """
    found: dict[int, tuple[Array, Array, Array]] = {}
    for contact in contacts:
        i = names.index(contact.agent)
        R_WO, p_WO = path.R_PO[hand.base[i], 0, 0], path.p_PO[hand.base[i], 0, 0]
        first, last = hand.chains.start[i], hand.chains.start[i + 1]
        R_WL, p_WL = np.empty((last - first + 1, 3, 3)), np.empty((last - first + 1, 3))
        foot, n = np.empty(3), np.empty(3)
        if contact.joints is not None:
            q = np.array(contact.joints, float)
            if len(q) != last - first:
                return Failure("grasp", "start.grasp", contact.agent, f"{len(q)} joint values", f"give {last - first}")
            coupled = q.copy()
            couple(hand.chains, i, coupled)
            if np.max(np.abs(coupled - q)) > COUPLED:
                joint = int(np.argmax(np.abs(coupled - q)))
                return Failure(
                    "grasp", "start.grasp", contact.agent, f"joint value {joint + 1} is {q[joint]:g}, but follows another",
                    f"give {coupled[joint]:.7g}",
                )  # fmt: skip
            forward(hand.chains, i, q, R_WL, p_WL)
            centre = R_WO.T @ (p_WL[last - first] - p_WO)
            gap = tip_gap(hand, i, R_WO.T @ R_WL[last - first], centre, foot, n)
            if abs(gap) > NEAR:
                return Failure(
                    "grasp", "start.grasp", contact.agent, f"its tip is {1e3 * gap:.0f} mm from the object's surface",
                    f"joints that bring it within {1e3 * NEAR:.0f} mm, or the point where it shall touch",
                )  # fmt: skip
            direction = R_WO.T @ R_WL[last - first] @ hand.axis_T[i]
        else:
            q = hand.home[first:last].copy()
            project(hand.kind_O, hand.size_O, hand.grids, np.array(contact.point, float), foot, n)
            direction = -n
        stand, seed = (hand, i, R_WO, p_WO, foot, n, 0.0, direction), q.copy()
        reached = touch_down(*stand, q, R_WL, p_WL)
        if not reached:  # an arm with a closed form points its tool exactly there or not at all
            q = seed
            reached = lower(*stand, q, R_WL, p_WL)
        if not reached:
            return Failure(
                "reach", "start.grasp", contact.agent, f"cannot reach the contact at {np.round(foot, 4).tolist()}",
                "a point nearer to the agent's base, or a larger hand",
            )  # fmt: skip
        found[i] = (q, foot, n)
    return build_grasp(hand, path, found)
