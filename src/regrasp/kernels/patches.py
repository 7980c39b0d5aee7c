"""Where two convex bodies touch: the normal and the patch that their faces, edges and vertices have in common.

A body is a core with a radius (`cores`), S the static one, O the object. The contact patch is the intersection of what each
core has furthest towards the other (a face, an edge, a vertex), seen along the normal. Forces act at its slots: the points
of the patch nearest to the corners of either body. As projection onto a convex set is continuous, a slot wanders
continuously while the bodies slide over each other, and the same corner has the same slot whether it carries alone, in
an edge or in a face.
"""

import math

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.cores import BOX, CYLINDER, HULL, PLANE, SEGMENT, support
from regrasp.kernels.features import RIM, TOUCH, feature
from regrasp.kernels.gjk import separation
from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import Array, Triple, cross, dot, minus, plus, triple
from regrasp.kernels.surfaces import frame

SLOTS = 16  # of the object's corners 0 … 7, then of the static body's
ROOM = 2 * RIM + 4  # corners of the largest patch, that of two discs, and of what clipping makes on the way
SCRATCH = 6  # arrays of ROOM × 4 numbers that `patch` works in
SAME = 1e-9  # m between corners of a patch that are one

Flags = NDArray[np.uint8]


@kernel
def contact(
    kind_S: int, core_S: Array, r_S: float, R_S: Array, p_S: Array,
    kind_O: int, core_O: Array, r_O: float, R_O: Array, p_O: Array,
) -> tuple[float, Triple]:  # fmt: skip
    """Signed distance in m of bodies S and O (not PLANE) at poses (R, p) in W, and the unit normal n from S into O.

    Exact while the cores are apart, so in contact wherever edges are rounded, and of an ellipsoid too; if even the cores
    overlap, a way out as `gjk.separation` finds it.
    """
    if kind_S != PLANE:
        h, n = separation(kind_S, core_S, R_S, p_S, kind_O, core_O, R_O, p_O)
        return h - r_S - r_O, n
    n = (R_S[0, 2], R_S[1, 2], R_S[2, 2])
    lowest = support(kind_O, core_O, R_O, (-n[0], -n[1], -n[2]))
    return dot(n, minus(p_O, p_S)) + dot(n, lowest) - r_S - r_O, n


@kernel
def patch(
    kind_S: int, core_S: Array, R_S: Array, p_S: Array,
    kind_O: int, core_O: Array, r_O: float, R_O: Array, p_O: Array,
    n: Triple, scratch: Array, polygon: Array, present: Flags, points: Array,
) -> int:  # fmt: skip
    """The contact patch of S and O whose normal, from S into O, is n: points of the object's surface in W.

    polygon (ROOM, 3): its corners in order: 1, the 2 ends of a segment, or more; returns how many. present (SLOTS,),
    points (SLOTS, 3): which slots there are, and where. scratch: (SCRATCH, ROOM, 4). A disc counts as the inscribed polygon
    of RIM corners. Bodies that do not touch have the patch that they would have if moved together along n.
    """
    F_O, F_S, A, B, Q, spare = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5]
    count_O = feature(kind_O, core_O, R_O, p_O, (-n[0], -n[1], -n[2]), F_O)
    count_S = feature(kind_S, core_S, R_S, p_S, n, F_S)
    x, y = frame(n)
    _flatten(F_O, count_O, p_O, x, y, A)
    _flatten(F_S, count_S, p_O, x, y, B)
    count = _intersect(A, count_O, B, count_S, Q, spare)
    for i in range(count):
        _lift(F_O, count_O, A, p_O, r_O, x, y, n, Q[i, 0], Q[i, 1], polygon[i])
    present[:] = 0
    for i in range(count_O):
        if F_O[i, 3] >= 0.0:
            slot = int(F_O[i, 3])
            present[slot] = 1
            u, v = _nearest(Q, count, A[i, 0], A[i, 1])
            _lift(F_O, count_O, A, p_O, r_O, x, y, n, u, v, points[slot])
    if kind_S in (BOX, CYLINDER, SEGMENT, HULL):
        for i in range(count_S):
            if F_S[i, 3] >= 0.0:
                slot = SLOTS // 2 + int(F_S[i, 3])
                present[slot] = 1
                u, v = _nearest(Q, count, B[i, 0], B[i, 1])
                _lift(F_O, count_O, A, p_O, r_O, x, y, n, u, v, points[slot])
    return count


@kernel
def _flatten(F: Array, count: int, o: Array, x: Triple, y: Triple, flat: Array) -> None:
    """flat (count, 2): the points F in the plane of x and y about o."""
    for i in range(count):
        d = minus(F[i], o)
        flat[i, 0], flat[i, 1] = dot(x, d), dot(y, d)


@kernel
def _lift(
    F: Array, count: int, flat: Array, o: Array, r: float, x: Triple, y: Triple, n: Triple, u: float, v: float, out: Array
) -> None:  # fmt: skip
    """out: the point of the object's surface over (u, v), r off that of its feature F along −n."""
    foot = triple(F[0])
    if count == 2:
        a, b = flat[1, 0] - flat[0, 0], flat[1, 1] - flat[0, 1]
        t = (a * (u - flat[0, 0]) + b * (v - flat[0, 1])) / (a * a + b * b)
        foot = plus(F[0], min(max(t, 0.0), 1.0), minus(F[1], F[0]))
    elif count > 2:
        m = cross(minus(F[max(count // 4, 1)], F[0]), minus(F[max(count // 2, 2)], F[0]))
        foot = plus(plus(o, u, x), v, y)
        foot = plus(foot, dot(m, minus(F[0], foot)) / dot(m, n), n)
    for a in range(3):
        out[a] = foot[a] - r * n[a]


@kernel
def _intersect(A: Array, count_A: int, B: Array, count_B: int, Q: Array, spare: Array) -> int:
    """Write the intersection of the convex sets with corners A and B (none: the plane) to Q; returns its corners' number.

    What bodies in touch have of each other meets; where TOUCH or round-off keeps it apart, the point nearest to both counts.
    """
    if count_B == 0 or count_A == 1:
        return _copy(A, count_A, Q)
    if count_B == 1:
        Q[0, 0], Q[0, 1] = _nearest(A, count_A, B[0, 0], B[0, 1])
        return 1
    count = 0
    if count_A > 2 or count_B > 2:
        # The one with more corners cuts the other: a segment cannot.
        if count_B > 2:
            count = _clip(Q, _copy(A, count_A, Q), B, count_B, spare)
        else:
            count = _clip(Q, _copy(B, count_B, Q), A, count_A, spare)
    elif _parallel(A, B):
        count = _overlap(A, B, Q)
    if count == 0:
        u, v = _crossing(A, B) if count_A == 2 and count_B == 2 else (B[0, 0], B[0, 1])
        for _ in range(64):  # projections in turn end where the two sets are nearest
            a, b = _nearest(A, count_A, u, v)
            c, d = _nearest(B, count_B, a, b)
            moved = abs(c - u) + abs(d - v)
            u, v = c, d
            if moved <= SAME:
                break
        Q[0, 0], Q[0, 1] = u, v
        count = 1
    return count


@kernel
def _copy(A: Array, count: int, Q: Array) -> int:
    for i in range(count):
        Q[i, 0], Q[i, 1] = A[i, 0], A[i, 1]
    return count


@kernel
def _parallel(A: Array, B: Array) -> bool:
    """Whether the shorter of two segments turns away from the other's direction by less than TOUCH at its ends."""
    a, b = A[1, 0] - A[0, 0], A[1, 1] - A[0, 1]
    c, d = B[1, 0] - B[0, 0], B[1, 1] - B[0, 1]
    # |e × f| over the longer's length is the shorter's extent across it.
    return abs(a * d - b * c) <= TOUCH * math.sqrt(max(a * a + b * b, c * c + d * d))


@kernel
def _crossing(A: Array, B: Array) -> tuple[float, float]:
    """Where the line of segment A crosses that of B; a corner of A if it nowhere does."""
    a, b = A[1, 0] - A[0, 0], A[1, 1] - A[0, 1]
    c, d = B[1, 0] - B[0, 0], B[1, 1] - B[0, 1]
    det = a * d - b * c
    t = ((B[0, 0] - A[0, 0]) * d - (B[0, 1] - A[0, 1]) * c) / det if det != 0.0 else 0.0
    return A[0, 0] + t * a, A[0, 1] + t * b


@kernel
def _overlap(A: Array, B: Array, Q: Array) -> int:
    """The part of segment A beside the parallel segment B, as `_intersect` writes it; 0 if there is none."""
    a, b = A[1, 0] - A[0, 0], A[1, 1] - A[0, 1]
    s = 1.0 / (a * a + b * b)
    t0 = s * (a * (B[0, 0] - A[0, 0]) + b * (B[0, 1] - A[0, 1]))
    t1 = s * (a * (B[1, 0] - A[0, 0]) + b * (B[1, 1] - A[0, 1]))
    low, high = max(min(t0, t1), 0.0), min(max(t0, t1), 1.0)
    if low > high:
        return 0
    Q[0, 0], Q[0, 1] = A[0, 0] + low * a, A[0, 1] + low * b
    Q[1, 0], Q[1, 1] = A[0, 0] + high * a, A[0, 1] + high * b
    return 2


@kernel
def _clip(Q: Array, count: int, B: Array, count_B: int, spare: Array) -> int:
    """Cut the polygon (or segment) Q by the convex polygon B, in place (Sutherland & Hodgman 1974)."""
    area = 0.0
    for k in range(2, count_B):
        area += (B[k - 1, 0] - B[0, 0]) * (B[k, 1] - B[0, 1]) - (B[k - 1, 1] - B[0, 1]) * (B[k, 0] - B[0, 0])
    for k in range(count_B):
        f = k + 1 if k + 1 < count_B else 0
        a, b = B[f, 0] - B[k, 0], B[f, 1] - B[k, 1]
        s = (1.0 if area >= 0.0 else -1.0) / math.sqrt(a * a + b * b)
        kept = 0
        for i in range(count):
            j = i + 1 if i + 1 < count else 0
            h = s * (a * (Q[i, 1] - B[k, 1]) - b * (Q[i, 0] - B[k, 0]))
            g = s * (a * (Q[j, 1] - B[k, 1]) - b * (Q[j, 0] - B[k, 0]))
            if h >= -SAME:
                kept = _append(spare, kept, Q[i, 0], Q[i, 1])
            if (h >= -SAME) != (g >= -SAME):
                t = min(max(h / (h - g), 0.0), 1.0)
                kept = _append(spare, kept, Q[i, 0] + t * (Q[j, 0] - Q[i, 0]), Q[i, 1] + t * (Q[j, 1] - Q[i, 1]))
        if kept > 1 and abs(spare[0, 0] - spare[kept - 1, 0]) + abs(spare[0, 1] - spare[kept - 1, 1]) <= SAME:
            kept -= 1
        count = _copy(spare, kept, Q)
    return count


@kernel
def _append(Q: Array, count: int, u: float, v: float) -> int:
    """Put a corner after the `count` of Q unless it is the last one again; returns the new count."""
    if count > 0 and abs(Q[count - 1, 0] - u) + abs(Q[count - 1, 1] - v) <= SAME:
        return count
    Q[count, 0], Q[count, 1] = u, v
    return count + 1


@kernel
def _nearest(Q: Array, count: int, u: float, v: float) -> tuple[float, float]:
    """The point of the convex set with corners Q nearest to (u, v)."""
    best, found = math.inf, (u, v)
    left, right = False, False
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        a, b = Q[j, 0] - Q[i, 0], Q[j, 1] - Q[i, 1]
        c, d = u - Q[i, 0], v - Q[i, 1]
        if a * d - b * c >= 0.0:
            left = True
        else:
            right = True
        length = a * a + b * b
        t = min(max((a * c + b * d) / length, 0.0), 1.0) if length > 0.0 else 0.0
        e, f = c - t * a, d - t * b
        if e * e + f * f < best:
            best, found = e * e + f * f, (Q[i, 0] + t * a, Q[i, 1] + t * b)
    return (u, v) if count > 2 and left != right else found
