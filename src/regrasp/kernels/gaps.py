"""How far a tip stands from an object: the pair of points nearest to each other, and the distance between them."""

import math

from regrasp.kernels.contact import FLAT, LOST, OK
from regrasp.kernels.gauss import support_point
from regrasp.kernels.grids import Grids
from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import Array, Triple, dot, norm, rotate_back, triple
from regrasp.kernels.stack import stack
from regrasp.kernels.surfaces import SPHERE, frame, project, shape_operator

NEAREST = (
    1e-10  # m by which the two points may be off the common normal; rad by which their normals may be off each other
)
ITERATIONS = 50
HALVED = 4  # times, after which a step of Newton's method is given up


@kernel
def _form(S: Array, x: Triple, y: Triple) -> Triple:
    """(xᵀSx, xᵀSy, yᵀSy)."""
    xx, xy, yy = 0.0, 0.0, 0.0
    for i in range(3):
        S_x, S_y = dot(S[i], x), dot(S[i], y)
        xx, xy, yy = xx + x[i] * S_x, xy + x[i] * S_y, yy + y[i] * S_y
    return xx, xy, yy


@kernel
def gap(
    kind_O: int, size_O: Array, kind_T: int, size_T: Array, grids: Grids, R_OT: Array, p_OT: Array,
    p_OC: Array, p_TC: Array, n_O: Array,
) -> tuple[int, float]:  # fmt: skip
    """(status, signed distance [m], negative where they overlap) of a tip at the pose (R_OT, p_OT) to the object.

    Writes the nearest points, p_OC (3,) on the object in O and p_TC (3,) on the tip in T, and the object's outward normal
    n_O (3,). Exact for spherical tips; else Newton's method, from the object's point nearest to the tip's centre, on "the
    normals oppose, and the points lie on a common normal": with m = n_O + R n_T and the way r = g n + t, t tangent, from the
    object's point to the tip's,

        (S_O + S_T + g S_T S_O) δ_O = S_T t − m,        δ_T = δ_O + g S_O δ_O − t.

    FLAT: a line or a face of both is equally near, or the tip does not fit; LOST: no such pair was found. The distance is then
    that of the last pair along the normal.
    """
    a, c = stack(3), stack(3)
    distance = project(kind_O, size_O, grids, p_OT, p_OC, n_O)
    rotate_back(R_OT, n_O, a)
    p_TC[0], p_TC[1], p_TC[2] = support_point(kind_T, size_T, grids, (-a[0], -a[1], -a[2]))
    if kind_T == SPHERE:
        return OK, distance - size_T[0]
    n_T, S_O, S_T = stack(3), stack((3, 3)), stack((3, 3))
    g, best, halved = 0.0, math.inf, 0
    step_O, step_T, at_O, at_T = triple(p_OC), triple(p_TC), triple(p_OC), triple(p_TC)
    for _ in range(ITERATIONS):
        shape_operator(kind_O, size_O, grids, p_OC, n_O, S_O)
        shape_operator(kind_T, size_T, grids, p_TC, n_T, S_T)
        n = triple(n_O)
        for i in range(3):
            a[i] = n[i] + dot(R_OT[i], n_T)
            c[i] = dot(R_OT[i], p_TC) + p_OT[i] - p_OC[i]
        g = dot(c, n)
        x, y = frame(n)
        t_x, t_y, m_x, m_y = dot(x, c), dot(y, c), dot(x, a), dot(y, a)
        off, aside = norm(a), math.sqrt(t_x * t_x + t_y * t_y)
        in_O, in_T = _form(S_O, x, y), _form(S_T, _turned_back(R_OT, x), _turned_back(R_OT, y))
        xx, xy, yy = in_O[0] + in_T[0], in_O[1] + in_T[1], in_O[2] + in_T[2]
        flat = not (xx * yy - xy * xy > 1e-9 * (xx + yy) * (xx + yy) and xx + yy > 0.0)
        if off <= NEAREST and aside <= NEAREST:
            return FLAT if flat else OK, g
        merit = off + aside * (in_O[0] + in_O[2] + in_T[0] + in_T[2])
        if merit < best:
            best, halved, at_O, at_T = merit, 0, triple(p_OC), triple(p_TC)
            if flat:
                return FLAT, g
            b_x, b_y = in_T[0] * t_x + in_T[1] * t_y - m_x, in_T[1] * t_x + in_T[2] * t_y - m_y
            a_xx, a_xy = (
                xx + g * (in_T[0] * in_O[0] + in_T[1] * in_O[1]),
                xy + g * (in_T[0] * in_O[1] + in_T[1] * in_O[2]),
            )
            a_yx, a_yy = (
                xy + g * (in_T[1] * in_O[0] + in_T[2] * in_O[1]),
                yy + g * (in_T[1] * in_O[1] + in_T[2] * in_O[2]),
            )
            determinant = a_xx * a_yy - a_xy * a_yx
            if abs(determinant) < 1e-12 * (xx + yy) * (xx + yy):
                return LOST, g
            d_x, d_y = (a_yy * b_x - a_xy * b_y) / determinant, (a_xx * b_y - a_yx * b_x) / determinant
            e_x = d_x + g * (in_O[0] * d_x + in_O[1] * d_y) - t_x
            e_y = d_y + g * (in_O[1] * d_x + in_O[2] * d_y) - t_y
            step_O = (d_x * x[0] + d_y * y[0], d_x * x[1] + d_y * y[1], d_x * x[2] + d_y * y[2])
            step_T = (e_x * x[0] + e_y * y[0], e_x * x[1] + e_y * y[1], e_x * x[2] + e_y * y[2])
        elif (
            halved == HALVED
        ):  # a seam lies in between: on to the point nearest to the tip's, and to the tip's below it
            best, halved = math.inf, 0
            for i in range(3):
                c[i] += p_OC[i]
            project(kind_O, size_O, grids, c, p_OC, n_O)
            rotate_back(R_OT, n_O, a)
            p_TC[0], p_TC[1], p_TC[2] = support_point(kind_T, size_T, grids, (-a[0], -a[1], -a[2]))
            continue
        else:
            halved += 1
            step_O = (0.5 * step_O[0], 0.5 * step_O[1], 0.5 * step_O[2])
            step_T = (0.5 * step_T[0], 0.5 * step_T[1], 0.5 * step_T[2])
        back = _turned_back(R_OT, step_T)
        for i in range(3):
            p_OC[i], p_TC[i] = at_O[i] + step_O[i], at_T[i] + back[i]
        project(kind_O, size_O, grids, p_OC, p_OC, n_O)
        project(kind_T, size_T, grids, p_TC, p_TC, n_T)
    return LOST, g


@kernel
def _turned_back(R: Array, a: Triple) -> Triple:
    """Rᵀ a."""
    return (
        R[0, 0] * a[0] + R[1, 0] * a[1] + R[2, 0] * a[2],
        R[0, 1] * a[0] + R[1, 1] * a[1] + R[2, 1] * a[2],
        R[0, 2] * a[0] + R[1, 2] * a[1] + R[2, 2] * a[2],
    )
