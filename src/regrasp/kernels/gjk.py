"""Gap between two convex cores by the algorithm of Gilbert, Johnson & Keerthi 1988, with a certified bracket.

The Minkowski difference D = {b − a} is explored through support functions. v, the point nearest to the origin of a
simplex in D, bounds the distance from above by |v|; the plane through the support point w in the direction −v bounds it
from below by v·w/|v|. The iteration ends when the two meet.
"""

import math

from regrasp.kernels.cores import BOX, CYLINDER, SEGMENT, support
from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import Array, Triple, cross, dot, minus, norm, plus, unit

ITERATIONS = 128  # tens for smooth bodies, fewer than ten for polytopes
BRACKET = 1e-9  # m between the two bounds
TOUCH = 1e-10  # m below which the cores overlap
PUSHES = 4  # steps that refine the depth of an overlap
APART = 1e-4  # m between cores from which on the direction of their distance is well defined
ROUNDING = 1e-15  # m: round-off of a distance


@kernel
def _nearest2(a: Triple, w: Triple) -> tuple[Triple, bool]:
    """Point of the segment a w nearest to the origin, and whether a is needed for it."""
    e = minus(a, w)
    s, t = dot(e, e), -dot(w, e)
    if t <= 0.0 or s <= 0.0:
        return w, False
    t = min(t / s, 1.0)
    return (w[0] + t * e[0], w[1] + t * e[1], w[2] + t * e[2]), True


@kernel
def _nearest3(a: Triple, b: Triple, w: Triple) -> tuple[Triple, bool, bool]:
    """Point of the triangle a b w nearest to the origin among those with a share of w, and whether a, b are needed."""
    e, f = minus(a, w), minus(b, w)
    n = cross(e, f)
    nn = dot(n, n)
    # Cross products, not the Gram matrix: triangles are slivers near smooth contacts, and a square loses them.
    if nn > 1e-26 * dot(e, e) * dot(f, f):
        x, y = dot(cross(f, w), n), dot(cross(w, e), n)
        if x > 0.0 and y > 0.0 and x + y < nn:
            h = dot(w, n) / nn
            return (h * n[0], h * n[1], h * n[2]), True, True
    p, with_a = _nearest2(a, w)
    q, with_b = _nearest2(b, w)
    if dot(p, p) <= dot(q, q):
        return p, with_a, False
    return q, False, with_b


@kernel
def _beyond(a: Triple, b: Triple, w: Triple, other: Triple) -> bool:
    """Whether the face a b w separates the origin from the fourth vertex, or the tetrahedron is flat over it."""
    e, f, g = minus(a, w), minus(b, w), minus(other, w)
    n = cross(e, f)
    height, origin = dot(g, n), -dot(w, n)
    return height * origin <= 0.0 or height * height <= 1e-24 * dot(n, n) * dot(g, g)


@kernel
def _minkowski(
    kind_A: int, core_A: Array, R_A: Array, kind_B: int, core_B: Array, R_B: Array, o: Triple, d: Triple
) -> Triple:
    """Point of D = {b − a} furthest along d, o = p_B − p_A."""
    b = support(kind_B, core_B, R_B, d)
    a = support(kind_A, core_A, R_A, (-d[0], -d[1], -d[2]))
    return o[0] + b[0] - a[0], o[1] + b[1] - a[1], o[2] + b[2] - a[2]


@kernel
def _nearest(
    kind_A: int,
    core_A: Array,
    R_A: Array,
    kind_B: int,
    core_B: Array,
    R_B: Array,
    o: Triple,
    limit: float,
    bracket: float,
) -> tuple[float, Triple]:
    """Distance of D from the origin, to the bracket (m), and its nearest point v; o = p_B − p_A.

    Returns early with a lower bound above limit. If D holds the origin: minus the least depth that the directions tried
    show, with the direction that shows it, pointing into D.
    """
    v, length = o, norm(o)
    if length <= TOUCH:
        return -math.inf, v
    lower, upper, direction = -math.inf, math.inf, v
    a, b, c, count = v, v, v, 0
    for _ in range(ITERATIONS):
        w = _minkowski(kind_A, core_A, R_A, kind_B, core_B, R_B, o, (-v[0], -v[1], -v[2]))
        bound = dot(v, w) / length
        if bound > lower:
            lower, direction = bound, v
            if lower > limit:
                return lower, v
            if upper - lower <= bracket:
                return upper, v
        # The simplex is the `count` first of a, b, c, and w; keep what carries its nearest point, w last.
        if count == 0:
            u, a, count = w, w, 1
        elif count == 1:
            u, with_a = _nearest2(a, w)
            if with_a:
                b, count = w, 2
            else:
                a = w
        elif count == 2:
            u, with_a, with_b = _nearest3(a, b, w)
            if with_a and with_b:
                c, count = w, 3
            elif with_a:
                b = w
            elif with_b:
                a = b
                b = w
            else:
                a, count = w, 1
        else:
            best, face = math.inf, 0
            u, with_1, with_2 = w, False, False
            if _beyond(a, b, w, c):
                u, with_1, with_2 = _nearest3(a, b, w)
                best, face = dot(u, u), 1
            if _beyond(b, c, w, a):
                p, with_p, with_q = _nearest3(b, c, w)
                if dot(p, p) < best:
                    u, with_1, with_2, best, face = p, with_p, with_q, dot(p, p), 2
            if _beyond(c, a, w, b):
                p, with_p, with_q = _nearest3(c, a, w)
                if dot(p, p) < best:
                    u, with_1, with_2, best, face = p, with_p, with_q, dot(p, p), 3
            if face == 0:
                break  # inside the tetrahedron
            if face == 2:
                a, b = b, c
            elif face == 3:
                a, b = c, a
            if with_1 and with_2:
                c = w
            elif with_1:
                b, count = w, 2
            elif with_2:
                a, b, count = b, w, 2
            else:
                a, count = w, 1
        length = norm(u)
        if length <= TOUCH:
            break
        if length >= upper:  # round-off has the last word
            return upper, v
        v, length, upper = u, length, length
    if lower > TOUCH:  # proven apart, whatever round-off made of the simplex
        return upper, v
    return lower, direction


@kernel
def gap(
    kind_A: int, core_A: Array, R_A: Array, p_A: Array, kind_B: int, core_B: Array, R_B: Array, p_B: Array, limit: float
) -> float:
    """Distance in m between two cores (not PLANE) in W; if they overlap, minus the length of a shift that parts them.

    The shift is a local minimum over the directions, never shorter than the true depth, which it meets in shallow
    overlaps. Returns early, with a lower bound of the distance, as soon as one exceeds limit.
    """
    o = minus(p_B, p_A)
    value, v = _nearest(kind_A, core_A, R_A, kind_B, core_B, R_B, o, limit, BRACKET)
    if value > 0.0:
        return value
    depth, length = -value, norm(v)
    s = -1.0 / length if length > 0.0 else 0.0
    n = (s * v[0], s * v[1], s * v[2])
    for i in range(12):
        R, s = (R_A if i < 6 else R_B), (1.0 if i % 2 else -1.0)
        k = (i % 6) // 2
        u = (s * R[0, k], s * R[1, k], s * R[2, k])
        h = dot(u, _minkowski(kind_A, core_A, R_A, kind_B, core_B, R_B, o, u))
        if h < depth:
            depth, n = h, u
    # Push D out along n, further than needed: the nearest point there shows a direction that is no worse.
    for _ in range(PUSHES):
        m = 2.0 * depth + 1e-6
        shifted = (o[0] - m * n[0], o[1] - m * n[1], o[2] - m * n[2])
        value, v = _nearest(kind_A, core_A, R_A, kind_B, core_B, R_B, shifted, math.inf, BRACKET)
        if value <= 0.0:
            break
        length = norm(v)
        u = (-v[0] / length, -v[1] / length, -v[2] / length)
        h = dot(u, _minkowski(kind_A, core_A, R_A, kind_B, core_B, R_B, o, u))
        if h >= depth - BRACKET:
            break
        depth, n = h, u
    return -max(depth, 0.0)


@kernel
def separation(
    kind_A: int, core_A: Array, R_A: Array, p_A: Array, kind_B: int, core_B: Array, R_B: Array, p_B: Array
) -> tuple[float, Triple]:
    """Signed distance in m of two cores (not PLANE) in W, and the unit normal n from A into B along which it is taken.

    n is the direction whose separating slab is widest: h(n) = min nᵀd over D is largest. Smooth cores leave GJK a normal
    that is good to the root of round-off; normals of faces, and of pairs of edges, that are no worse are therefore
    preferred, so that what lies flat does so exactly. If the cores overlap, n is a local maximum of h, as in `gap`.
    """
    o = minus(p_B, p_A)
    value, v = _nearest(kind_A, core_A, R_A, kind_B, core_B, R_B, o, math.inf, ROUNDING)
    n = unit(v) if norm(v) > 0.0 else (0.0, 0.0, 1.0)
    h = _width(kind_A, core_A, R_A, kind_B, core_B, R_B, o, n)
    h, n = _faced(kind_A, core_A, R_A, kind_B, core_B, R_B, o, h, n, value > APART)
    if value > APART:
        return h, n
    # Parted along the common normal, bodies keep their nearest points, but the direction becomes sharp.
    for _ in range(2 * PUSHES):
        shifted = plus(o, 2.0 * max(-h, 0.0) + APART, n)
        value, v = _nearest(kind_A, core_A, R_A, kind_B, core_B, R_B, shifted, math.inf, ROUNDING)
        if value <= 0.0:
            break
        u = unit(v)
        width = _width(kind_A, core_A, R_A, kind_B, core_B, R_B, o, u)
        if width <= h + ROUNDING:
            break
        h, n = width, u
    return _faced(kind_A, core_A, R_A, kind_B, core_B, R_B, o, h, n, True)


@kernel
def _width(
    kind_A: int, core_A: Array, R_A: Array, kind_B: int, core_B: Array, R_B: Array, o: Triple, n: Triple
) -> float:
    """Width h(n) of the slab across n that separates the cores; negative where they overlap along n."""
    return dot(n, _minkowski(kind_A, core_A, R_A, kind_B, core_B, R_B, o, (-n[0], -n[1], -n[2])))


@kernel
def _faced(
    kind_A: int, core_A: Array, R_A: Array, kind_B: int, core_B: Array, R_B: Array, o: Triple, h: float, n: Triple,
    near: bool,
) -> tuple[float, Triple]:  # fmt: skip
    """The best of n, with h = h(n), and the normals of faces and of pairs of edges (near: only those next to n)."""
    best, found = h - ROUNDING, False
    m = n
    first_A, first_B = _first_axis(kind_A), _first_axis(kind_B)
    for i in range(first_A, 4):
        for k in range(first_B, 4):
            if i == 3 and k == 3:
                continue
            # Column 3 stands for no edge: the other body's axis is the normal of its face.
            a = (R_A[0, i % 3], R_A[1, i % 3], R_A[2, i % 3])
            b = (R_B[0, k % 3], R_B[1, k % 3], R_B[2, k % 3])
            u = a if k == 3 else (b if i == 3 else cross(a, b))
            length = norm(u)
            side = dot(u, n)
            if length < 1e-6 or (near and abs(side) < 0.999 * length):
                continue
            s = 1.0 / length if side >= 0.0 else -1.0 / length
            for _ in range(1 if near else 2):
                w = (s * u[0], s * u[1], s * u[2])
                width = _width(kind_A, core_A, R_A, kind_B, core_B, R_B, o, w)
                if width > best:
                    best, m, found = width, w, True
                s = -s
    return (best, m) if found else (h, n)


@kernel
def _first_axis(kind: int) -> int:
    """First of the frame's axes 0 … 2 along which the core has straight edges: all, z alone, or none (3)."""
    if kind == BOX:
        return 0
    return 2 if kind == CYLINDER or kind == SEGMENT else 3  # noqa: SIM109
