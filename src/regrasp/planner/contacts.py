"""What presses on the object along a course, and what forces there do: wrench, friction, limits. Units: weights, radii."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regrasp.plan import NONE, SLIDE
from regrasp.planner.course import Course, rotate
from regrasp.planner.hand import Hand

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Contacts:
    """What presses on the object: N intervals, M samples, C contacts, agents first, then supports. Units: weights, radii.

    mode (N, C): no force, sticks or slides. p_W (N, M, C, 3): from the centre of mass; inward_W: unit normal into the object;
    slip_W: unit direction of friction where it slides. mu (C,); cap (C,): largest normal force, inf for none.
    grips (C,): which are agents. shifts, turns (3,): 1 for the axes of disturbances, as in `Hand`.
    load_W (3,): what the forces add up to. moves (N,): false where nothing does; segment (N,).
    """

    mode: NDArray[np.int8]
    p_W: Array
    inward_W: Array
    slip_W: Array
    mu: Array
    cap: Array
    grips: NDArray[np.bool_]
    shifts: Array
    turns: Array
    load_W: Array
    moves: NDArray[np.bool_]
    segment: NDArray[np.int64]


def contacts_of(course: Course, hand: Hand, support_mu: Array, gravity: Array) -> Contacts:
    """The contacts of a course. support_mu (P,): friction of each slot."""
    k, P = course.V.shape[1], course.support_mode.shape[1]
    g = float(np.linalg.norm(gravity))
    points = np.concatenate([course.p_OC_O, course.support_p_O], axis=2) - hand.p_OM_O
    inward = np.concatenate([rotate(course.object_rotation, -course.n_O), course.support_n_W], axis=2)
    bears = (course.mode != NONE)[:, None, :, None]
    return Contacts(
        mode=course.mode,
        p_W=np.where(bears, rotate(course.object_rotation, points) / hand.radius, 0.0),
        inward_W=np.where(bears, inward, 0.0),
        slip_W=np.where(bears, course.slip_W, 0.0),
        mu=np.concatenate([hand.mu, support_mu]),
        cap=np.concatenate([hand.cap, np.full(P, np.inf)]),
        grips=np.arange(k + P) < k,
        shifts=hand.shifts,
        turns=hand.turns,
        load_W=-gravity / g if g > 0.0 else np.zeros(3),
        moves=course.moves,
        segment=course.segment,
    )


def bases(contacts: Contacts, margin: float) -> tuple[NDArray[np.bool_], Array, NDArray[np.bool_]]:
    """At every sample (N, M): whether a contact's force has one direction only, an orthonormal basis, its columns in use."""
    slides = contacts.mode == SLIDE
    ray = slides | ((1.0 - margin) * contacts.mu <= 0.0)
    along = contacts.inward_W + np.where(slides[:, None, :, None], contacts.mu[:, None] * contacts.slip_W, 0.0)
    along = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-300)
    N, M, C = along.shape[:3]
    basis = np.where(ray[:, None, :, None, None], 0.0, np.broadcast_to(np.eye(3), (N, M, C, 3, 3)))
    basis[..., 0] = np.where(ray[:, None, :, None], along, basis[..., 0])
    free = np.repeat((contacts.mode != NONE)[:, None], M, axis=1)[..., None] & (~ray[:, None, :, None] | [1, 0, 0])
    return np.broadcast_to(ray[:, None], (N, M, C)), basis, free.astype(bool)


def wrenches(p: Array, forces: Array) -> Array:
    """(…, 6, 3) from arms p (…, 3) and directions as columns (…, 3, 3): what each adds to the force and the torque."""
    return np.concatenate([forces, np.cross(p[..., None, :], forces, axisa=-1, axisb=-2, axisc=-2)], axis=-2)


def excess(contacts: Contacts, f: Array) -> Array:
    """(N,): weights by which forces f (N, M, C, 3) pass the true cones and the limits, worst in each interval."""
    bears = (contacts.mode != NONE)[:, None]
    normal = np.sum(f * contacts.inward_W, axis=-1)
    across = np.linalg.norm(f - normal[..., None] * contacts.inward_W, axis=-1)
    cone = np.where((contacts.mode == SLIDE)[:, None], 0.0, across - contacts.mu * normal)
    return np.asarray(np.where(bears, np.maximum.reduce([cone, -normal, normal - contacts.cap]), 0.0).max(axis=(1, 2)))


def residual(contacts: Contacts, f: Array) -> Array:
    """(N, M, 6): wrench of forces f less the load."""
    force = f.sum(axis=2) - contacts.load_W
    return np.concatenate([force, np.cross(contacts.p_W, f).sum(axis=2)], axis=-1)
