"""Contact kinematics of a tip on an object: how the contact moves over both surfaces as the bodies move (Montana 1988).

The chart-free form of his contact equations: with the object's outward normal n, the shape operators S_O and S_T (the
tip's turned into O) and the motion of the tip relative to the object, angular velocity ω and velocity v of the tip's
material point at the contact, all in the object's frame O,

    (S_O + S_T) ṗ_O = ω × n + S_T v,        ċ_T = ṗ_O − v   (both tangent to the object at the contact).

It is the time derivative of "the points coincide, the normals oppose": n_O(p) + R n_T(c) = 0 with ṅ_O = S_O ṗ_O and
(R n_T)˙ = −ω × n + S_T ċ_T. A contact's state is p_OC (3,), the contact point on the object in O; p_TC (3,), the one on
the tip in T; R_OT (3, 3), the tip's orientation; x_O (3,), the unit tangent that is the contact frame's x axis (its
others are n × x and n). The tip's frame then stands at p_OT = p_OC − R_OT p_TC.

Surfaces are given by (kind, size) of `surfaces`, with the grids of both. Inside, vectors are triples, an orientation is the
triple of its columns and `pair` is (kind_O, size_O, kind_T, size_T, grids). Functions that can fail return OK, FLAT or LOST.
An object may be hollow: only what happens next to the contact is looked at here.
"""

import math

from regrasp.kernels.grids import Grids
from regrasp.kernels.native import inlined, kernel
from regrasp.kernels.rotations import Array, Triple, along, cross, dot, norm, plus, rodrigues, triple, unit
from regrasp.kernels.surfaces import bends, field, frame

Columns = tuple[Triple, Triple, Triple]
Size = tuple[float, float, float, float]
Pair = tuple[int, Size, int, Size, Grids]
Motion = tuple[float, float, float, float]

OK = 0
# S_O + S_T is not positive definite. Singular: the surfaces touch along a line or a face, the motion of the contact is not
# defined. Indefinite or negative: the tip is flatter than the hollow it stands in and would cut into its sides.
FLAT = 1
LOST = 2  # no pair of points with opposed normals was found nearby

# Relative to the larger principal curvature of S_O + S_T: below it the contact counts as a line or a face.
_SINGULAR = 1e-9
# A step that leaves the normals apart by more [rad] has crossed a seam (edge, rim) and is taken in smaller parts.
_SEAM = 0.03
_SMALLEST_PART = 1.0 / 1024.0
# Normals closer than this [rad] count as opposed.
_OPPOSED = 1e-10
_ITERATIONS = 20


@inlined
def _pair(kind_O: int, size_O: Array, kind_T: int, size_T: Array, grids: Grids) -> Pair:
    # An array is seven machine words to pass on, and its entries are read from memory anew wherever they are used.
    return (
        kind_O, (size_O[0], size_O[1], size_O[2], size_O[3]), kind_T, (size_T[0], size_T[1], size_T[2], size_T[3]),
        grids,
    )  # fmt: skip


@inlined
def _columns(R: Array) -> Columns:
    return (R[0, 0], R[1, 0], R[2, 0]), (R[0, 1], R[1, 1], R[2, 1]), (R[0, 2], R[1, 2], R[2, 2])


@inlined
def _to_object(R: Columns, a: Triple) -> Triple:
    return plus(along(R[0], R[1], a[0], a[1]), a[2], R[2])


@inlined
def _to_tip(R: Columns, a: Triple) -> Triple:
    return dot(R[0], a), dot(R[1], a), dot(R[2], a)


@inlined
def _turn(w: Triple, R: Columns) -> Columns:
    """exp([w]) R."""
    s, c = rodrigues(dot(w, w))
    u0, u1, u2 = cross(w, R[0]), cross(w, R[1]), cross(w, R[2])
    return (
        plus(plus(R[0], s, u0), c, cross(w, u0)),
        plus(plus(R[1], s, u1), c, cross(w, u1)),
        plus(plus(R[2], s, u2), c, cross(w, u2)),
    )


@inlined
def _transport(n: Triple, m: Triple, x: Triple) -> Triple:
    """The unit tangent x at normal n, carried to the normal m by the smallest rotation that takes n to m.

    Along a path of contact points this is parallel transport, to third order in the step between n and m.
    """
    k = dot(m, x) / (1.0 + dot(n, m))
    x = plus(plus(x, -k, n), -k, m)
    return unit(plus(x, -dot(m, x), m))  # round-off would grow over many steps


@inlined
def _retract(kind: int, size: Size, grids: Grids, p: Triple) -> tuple[Triple, Triple]:
    """(point on the surface near p, outward unit normal there), by Newton's method along ∇F."""
    F, g = field(kind, size, grids, p)
    for _ in range(_ITERATIONS):
        slope = dot(g, g)
        # |F|/|∇F| is the distance to the surface to first order, and p itself is known to round-off only.
        if abs(F) <= 1e-15 * math.sqrt(slope * dot(p, p)):
            break
        p = plus(p, -F / slope, g)
        F, g = field(kind, size, grids, p)
    return p, unit(g)


@inlined
def _curvature(kind: int, size: Size, grids: Grids, p: Triple, x: Triple, y: Triple) -> Triple:
    """The shape operator at p as a form on the tangents x, y: (xᵀSx, xᵀSy, yᵀSy) [1/m]."""
    F, g = field(kind, size, grids, p)
    length = norm(g)
    bend_x, bend_y = bends(kind, size, grids, p, F, g, x, y)
    return dot(x, bend_x) / length, dot(y, bend_x) / length, dot(y, bend_y) / length


@inlined
def _solve(
    pair: Pair, p: Triple, c: Triple, R: Columns, x: Triple, y: Triple,
    turn_x: float, turn_y: float, v_x: float, v_y: float,
) -> tuple[int, float, float, Triple, Triple]:  # fmt: skip
    """(status, ṗ_x, ṗ_y, S_O, S_T) of (S_O + S_T) ṗ = turn + S_T v, all on the object's tangents x, y."""
    kind_O, size_O, kind_T, size_T, grids = pair
    S_O = _curvature(kind_O, size_O, grids, p, x, y)
    S_T = _curvature(kind_T, size_T, grids, c, _to_tip(R, x), _to_tip(R, y))
    xx, xy, yy = S_O[0] + S_T[0], S_O[1] + S_T[1], S_O[2] + S_T[2]
    determinant, trace = xx * yy - xy * xy, xx + yy
    # The smaller eigenvalue is about determinant/trace.
    if not (determinant > _SINGULAR * trace * trace and trace > 0.0):
        return FLAT, 0.0, 0.0, S_O, S_T
    b_x, b_y = turn_x + S_T[0] * v_x + S_T[1] * v_y, turn_y + S_T[1] * v_x + S_T[2] * v_y
    return OK, (yy * b_x - xy * b_y) / determinant, (xx * b_y - xy * b_x) / determinant, S_O, S_T


@inlined
def _chord(S: Triple, x: Triple, y: Triple, d_x: float, d_y: float) -> Triple:
    """The chord under a geodesic arc of length and direction d at its middle, to third order: d − (dᵀSd) Sd/24."""
    t_x, t_y = S[0] * d_x + S[1] * d_y, S[1] * d_x + S[2] * d_y
    k = (d_x * t_x + d_y * t_y) / 24.0
    return along(x, y, d_x - k * t_x, d_y - k * t_y)


@inlined
def _rates(
    pair: Pair, p: Triple, c: Triple, R: Columns, n: Triple, x: Triple, command: Motion
) -> tuple[int, Triple, Triple, Triple]:
    """(status, ṗ_O, ċ_T, ω_O) for a motion `command` given on the tangents x and n × x."""
    w_x, w_y, v_x, v_y = command
    y = cross(n, x)
    status, p_x, p_y, _, _ = _solve(pair, p, c, R, x, y, w_y, -w_x, v_x, v_y)
    return status, along(x, y, p_x, p_y), _to_tip(R, along(x, y, p_x - v_x, p_y - v_y)), along(x, y, w_x, w_y)


@kernel
def contact_rates(
    kind_O: int, size_O: Array, kind_T: int, size_T: Array, grids: Grids, p_OC: Array, p_TC: Array, R_OT: Array,
    w_O: Array, v_O: Array,
    pdot_O: Array, cdot_T: Array,
) -> int:  # fmt: skip
    """Montana's contact equations for any relative motion: velocities of the contact over both surfaces.

    `w_O`, `v_O` (3,): angular velocity of the tip relative to the object, spin included, and velocity of the tip's
    material point at the contact, in O (of v only the tangential part counts). Writes `pdot_O` (3,), the velocity of
    the contact on the object in O, and `cdot_T` (3,), that on the tip in T. Returns OK, or FLAT with both meaningless.
    """
    n = unit(field(kind_O, size_O, grids, p_OC)[1])
    x, y = frame(n)
    status, pdot, cdot, _ = _rates(
        _pair(kind_O, size_O, kind_T, size_T, grids), triple(p_OC), triple(p_TC), _columns(R_OT), n, x,
        (dot(x, w_O), dot(y, w_O), dot(x, v_O), dot(y, v_O)),
    )  # fmt: skip
    pdot_O[0], pdot_O[1], pdot_O[2] = pdot
    cdot_T[0], cdot_T[1], cdot_T[2] = cdot
    return status


@kernel
def _settle(pair: Pair, p: Triple, c: Triple, R: Columns) -> tuple[int, float, Triple, Triple, Triple]:
    """(status, first angle between the normals, p, c, n): see `settle`."""
    kind_O, size_O, kind_T, size_T, grids = pair
    first, best = 0.0, math.inf
    p_from, c_from, step = p, c, p
    for iteration in range(_ITERATIONS):
        p, n = _retract(kind_O, size_O, grids, p)
        c, n_T = _retract(kind_T, size_T, grids, c)
        m = plus(n, 1.0, _to_object(R, n_T))
        gap = norm(m)
        if iteration == 0:
            first = gap
        if gap <= _OPPOSED:
            return OK, first, p, c, n
        if gap < best:
            best, p_from, c_from = gap, p, c
            x, y = frame(n)
            status, d_x, d_y, _, _ = _solve(pair, p, c, R, x, y, -dot(x, m), -dot(y, m), 0.0, 0.0)
            if status != OK:
                return status, first, p, c, n
            step = along(x, y, d_x, d_y)
        else:  # a seam lies in between, where Newton's step may overshoot for ever
            step = along(step, step, 0.5, 0.0)
        p, c = plus(p_from, 1.0, step), plus(c_from, 1.0, _to_tip(R, step))
    return LOST, first, p, c, n


@kernel
def settle(
    kind_O: int, size_O: Array, kind_T: int, size_T: Array, grids: Grids, p_OC: Array, p_TC: Array, R_OT: Array,
) -> tuple[int, float]:  # fmt: skip
    """Bring an approximate contact back onto both surfaces with opposed normals, at the given orientation of the tip.

    Newton's method on n_O(p) + R n_T(c) = 0 moves the two contact points by the same δ, (S_O + S_T) δ = −(n_O + R n_T):
    a correction that rolls and never slips, so the lengths of the two contact paths stay equal. p_OC and p_TC are in
    and out (untouched unless OK). Returns (status, angle between the normals at the start [rad]).
    """
    pair = _pair(kind_O, size_O, kind_T, size_T, grids)
    status, gap, p, c, _ = _settle(pair, triple(p_OC), triple(p_TC), _columns(R_OT))
    if status == OK:
        p_OC[0], p_OC[1], p_OC[2] = p
        p_TC[0], p_TC[1], p_TC[2] = c
    return status, gap


@kernel
def _midpoint(
    pair: Pair, command: Motion, p: Triple, c: Triple, R: Columns, x: Triple, n: Triple
) -> tuple[int, float, Triple, Triple, Columns, Triple, Triple]:
    """One step of the midpoint rule, settled: (status, gap, p, c, R, x, n)."""
    status, pdot, cdot, w = _rates(pair, p, c, R, n, x, command)
    if status != OK:
        return status, 0.0, p, c, R, x, n
    p_mid, c_mid, R_mid = plus(p, 0.5, pdot), plus(c, 0.5, cdot), _turn(along(w, w, 0.5, 0.0), R)
    n_mid = unit(field(pair[0], pair[1], pair[4], p_mid)[1])
    x_mid = _transport(n, n_mid, x)
    y_mid = cross(n_mid, x_mid)
    w_x, w_y, v_x, v_y = command
    status, p_x, p_y, S_O, S_T = _solve(pair, p_mid, c_mid, R_mid, x_mid, y_mid, w_y, -w_x, v_x, v_y)
    if status != OK:
        return status, 0.0, p, c, R, x, n
    # Chords instead of arcs: a step of the arc's length would fall short on the more curved of the two surfaces.
    p = plus(p, 1.0, _chord(S_O, x_mid, y_mid, p_x, p_y))
    c = plus(c, 1.0, _to_tip(R_mid, _chord(S_T, x_mid, y_mid, p_x - v_x, p_y - v_y)))
    R = _turn(along(x_mid, y_mid, w_x, w_y), R)
    status, gap, p, c, n_end = _settle(pair, p, c, R)
    return status, gap, p, c, R, _transport(n, n_end, x), n_end


@kernel
def _substep(pair: Pair, command: Motion, p_OC: Array, p_TC: Array, R_OT: Array, x_O: Array) -> int:
    """Move the state by `command` in place; in parts where it crosses a seam, at which the midpoint rule overshoots."""
    if command[0] == 0.0 and command[1] == 0.0 and command[2] == 0.0 and command[3] == 0.0:
        return OK
    p, c, R, x = triple(p_OC), triple(p_TC), _columns(R_OT), triple(x_O)
    n = unit(field(pair[0], pair[1], pair[4], p)[1])
    done, part = 0.0, 1.0
    status = OK
    while done < 1.0:
        piece = (part * command[0], part * command[1], part * command[2], part * command[3])
        status, gap, p_end, c_end, R_end, x_end, n_end = _midpoint(pair, piece, p, c, R, x, n)
        if (status != OK or gap > _SEAM) and part > _SMALLEST_PART:
            part *= 0.5
            continue
        if status != OK:
            break
        p, c, R, x, n = p_end, c_end, R_end, x_end, n_end
        done += part
    p_OC[0], p_OC[1], p_OC[2] = p
    p_TC[0], p_TC[1], p_TC[2] = c
    x_O[0], x_O[1], x_O[2] = x
    for j in range(3):
        R_OT[0, j], R_OT[1, j], R_OT[2, j] = R[j]
    return status


@kernel
def advance(
    kind_O: int, size_O: Array, kind_T: int, size_T: Array, grids: Grids,
    command: Array, substeps: int,
    p_OC: Array, p_TC: Array, R_OT: Array, x_O: Array,
) -> int:  # fmt: skip
    """Integrate the contact equations over a motion, in place; second order in 1/substeps, free of drift.

    `command` (4,) is the whole motion of the tip relative to the object, (ω_x, ω_y) [rad] and (v_x, v_y) [m] along the
    axes x, y of the contact frame, which is parallel-transported along the contact path from x_O; there is no spin.
    After every substep the points lie on the surfaces and the normals oppose. No motion leaves the state untouched.
    Returns OK, or FLAT or LOST with the state at the last point reached.
    """
    pair, h = _pair(kind_O, size_O, kind_T, size_T, grids), 1.0 / substeps
    piece = (h * command[0], h * command[1], h * command[2], h * command[3])
    for _ in range(substeps):
        status = _substep(pair, piece, p_OC, p_TC, R_OT, x_O)
        if status != OK:
            return status
    return OK
