"""What a convex core has furthest in a direction: a face, an edge or a vertex, with numbers for its corners."""

import math

from regrasp.kernels.cores import BOX, COUNT, CYLINDER, FIRST, HULL, PLANE, ROW, SEGMENT, support
from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import Array, Triple
from regrasp.kernels.stack import stack
from regrasp.kernels.surfaces import frame

TOUCH = 2e-5  # m: bodies this close touch; what lies within it of a core's extreme points belongs to them
RIM = 12  # points for a cylinder's disc, and the corners of a face that are told apart
CORNERS = 256  # vertices of a hull at most
LOOKS = 48  # directions in a face's plane in which its corners are looked for
THIN = 1e-6  # m: half extents below it make no edge


@kernel
def feature(kind: int, core: Array, R: Array, p: Array, d: Triple, points: Array) -> int:
    """The core's points in W furthest along the unit vector d, in order round a face; returns their number, at most RIM.

    An edge or a face belongs to them whose points differ along d by no more than TOUCH. Rows of points (RIM, 4) are x, y, z
    and the number, 0 … 7, of the corner that the point is, −1 for none. Corners of a BOX are numbered by the signs of x, y, z
    (bits 0, 1, 2; set: positive). A SEGMENT ends in 0 and 1. A CYLINDER has 0 … 3 on its discs, at x, y, −x, −y, and the ends
    of the line on its side, or the point of its rim, as 4 (−z) and 5 (z). The point of the other cores is 0.
    The vertices of a HULL have the numbers in its core. A PLANE has no points.
    """
    if kind == PLANE:
        return 0
    x = R[0, 0] * d[0] + R[1, 0] * d[1] + R[2, 0] * d[2]
    y = R[0, 1] * d[0] + R[1, 1] * d[1] + R[2, 1] * d[2]
    z = R[0, 2] * d[0] + R[1, 2] * d[1] + R[2, 2] * d[2]
    if kind == BOX:
        return _box(core, R, p, (x, y, z), points)
    if kind == HULL:
        return _hull(core, R, p, (x, y, z), points)
    upper = core[2] > THIN and z >= 0.0
    line = core[2] > THIN and 2.0 * core[2] * abs(z) <= TOUCH
    if kind == SEGMENT:
        for i in range(2 if line else 1):
            end = i if line else int(upper)
            _put(R, p, 0.0, 0.0, core[2] if end else -core[2], points, i)
            points[i, 3] = end
        return 2 if line else 1
    if kind == CYLINDER:
        across = math.sqrt(x * x + y * y)
        if core[0] > THIN and 2.0 * core[0] * across <= TOUCH and abs(z) > 0.5:
            for i in range(RIM):
                angle = 2.0 * math.pi * i / RIM
                _put(
                    R, p, core[0] * math.cos(angle), core[0] * math.sin(angle), core[2] if upper else -core[2],
                    points, i,
                )  # fmt: skip
                points[i, 3] = 4 * i // RIM if 4 * i % RIM == 0 else -1
            return RIM
        k = core[0] / across if across > 0.0 else 0.0
        for i in range(2 if line else 1):
            end = i if line else int(upper)
            _put(R, p, k * x, k * y, core[2] if end else -core[2], points, i)
            points[i, 3] = 4 + end
        return 2 if line else 1
    s = support(kind, core, R, d)
    for a in range(3):
        points[0, a] = p[a] + s[a]
    points[0, 3] = 0
    return 1


@kernel
def _box(core: Array, R: Array, p: Array, d: Triple, points: Array) -> int:
    """`feature` of a BOX, with d in its own frame."""
    steepest = 0
    for i in range(1, 3):
        if abs(d[i]) > abs(d[steepest]):
            steepest = i
    corner, u, v = 0, -1, -1
    for i in range(3):
        if core[i] <= THIN:
            continue
        if i != steepest and 2.0 * core[i] * abs(d[i]) <= TOUCH:
            u, v = (i, u) if u < 0 else (u, i)
        elif d[i] >= 0.0:
            corner |= 1 << i
    count = 1 if u < 0 else (2 if v < 0 else 4)
    for i in range(count):
        number = corner
        if i in (1, 2):
            number |= 1 << u
        if i >= 2:
            number |= 1 << v
        _put(
            R, p, core[0] if number & 1 else -core[0], core[1] if number & 2 else -core[1],
            core[2] if number & 4 else -core[2], points, i,
        )  # fmt: skip
        points[i, 3] = number
    return count


@kernel
def _hull(core: Array, R: Array, p: Array, d: Triple, points: Array) -> int:
    """`feature` of a HULL, with d in its own frame: of faces of more corners those that reach farthest RIM ways."""
    last = FIRST + ROW * int(core[COUNT])
    best = -math.inf
    for i in range(FIRST, last, ROW):
        best = max(best, d[0] * core[i] + d[1] * core[i + 1] + d[2] * core[i + 2])
    x, y = frame(d)
    corners, found, a, b = stack(CORNERS), 0, 0.0, 0.0
    for i in range(FIRST, last, ROW):
        if found < CORNERS and d[0] * core[i] + d[1] * core[i + 1] + d[2] * core[i + 2] >= best - TOUCH:
            corners[found] = i
            a, b, found = a + _along(core, i, x), b + _along(core, i, y), found + 1
    a, b = a / found, b / found
    # Whichever way one goes from the middle, a corner is farthest; round once, the corners come in order.
    count = 0
    for k in range(LOOKS):
        angle = 2.0 * math.pi * k / LOOKS
        cos, sin = math.cos(angle), math.sin(angle)
        far, at = -math.inf, corners[0]
        for n in range(found):
            i = int(corners[n])
            s = cos * (_along(core, i, x) - a) + sin * (_along(core, i, y) - b)
            if s > far:
                far, at = s, corners[n]
        new = count < RIM
        for n in range(count):
            if points[n, 3] == at:
                new = False
        if new:
            points[count, 3] = at
            count += 1
    count = _flat(core, x, y, points, count)
    for n in range(count):
        i = int(points[n, 3])
        _put(R, p, core[i], core[i + 1], core[i + 2], points, n)
        points[n, 3] = core[i + 3]
    return count


@kernel
def _along(core: Array, i: int, x: Triple) -> float:
    """The vertex at core[i] along x."""
    return x[0] * core[i] + x[1] * core[i + 1] + x[2] * core[i + 2]


@kernel
def _flat(core: Array, x: Triple, y: Triple, points: Array, count: int) -> int:
    """Of corners (rows in points[:, 3]) that lie on one line, or on one point, within TOUCH, only its ends; the number left."""
    length, p, q = 0.0, 0, 0
    for m in range(count):
        for n in range(m + 1, count):
            i, j = int(points[m, 3]), int(points[n, 3])
            s = math.hypot(_along(core, i, x) - _along(core, j, x), _along(core, i, y) - _along(core, j, y))
            if s > length:
                length, p, q = s, i, j
    if count < 2 or length <= TOUCH:
        return min(count, 1)
    u = (_along(core, q, x) - _along(core, p, x)) / length
    v = (_along(core, q, y) - _along(core, p, y)) / length
    wide = 0.0
    for n in range(count):
        i = int(points[n, 3])
        s = u * (_along(core, i, y) - _along(core, p, y)) - v * (_along(core, i, x) - _along(core, p, x))
        wide = max(wide, abs(s))
    if wide > TOUCH:
        return count
    points[0, 3], points[1, 3] = p, q
    return 2


@kernel
def _put(R: Array, p: Array, x: float, y: float, z: float, points: Array, i: int) -> None:
    """points[i] = R (x, y, z) + p."""
    for a in range(3):
        points[i, a] = p[a] + R[a, 0] * x + R[a, 1] * y + R[a, 2] * z
