"""Surfaces as implicit functions F (F < 0 inside) with their gradient, Hessian, shape operator and closest point.

Every surface stands in its own frame; `size` has four entries [m] and states OUTER sizes:

========= ==== ==========================================================================
SPHERE    0    radius, -, -, -
ELLIPSOID 1    semi-axes along x, y, z, -
CAPSULE   2    radius, half length of the axis segment (along z), -, -
CYLINDER  3    radius, half height (along z), -, radius of the rounded rim
BOX       4    half lengths along x, y, z, radius of the rounded edges and corners
PLANE     5    -, -, -, -: the half space z ≤ 0
MESH      6    number of its grid in `grids`, -, -, radius of the rounded edges
========= ==== ==========================================================================

All others but the ellipsoid are a convex core dilated by a ball, so that F is the signed distance in closed form and |∇F| = 1.
The ellipsoid has F = (x²/a² + y²/b² + z²/c² − 1)/2. These surfaces are C¹ and piecewise smooth: where a flat face, an edge
and a corner meet, the curvature jumps, and the seam itself counts as the flatter side. A mesh is the zero level of a
signed-distance grid (`kernels.grids`): any closed surface, convex or not, C², with |∇F| = 1 up to the grid's error.
"""

import math

from regrasp.kernels.grids import Grids, grid_bends, grid_field, grid_project
from regrasp.kernels.native import kernel
from regrasp.kernels.rotations import Array, Triple, Vector, norm

Size = Array | tuple[float, float, float, float]

SPHERE, ELLIPSOID, CAPSULE, CYLINDER, BOX, PLANE, MESH = range(7)


@kernel
def field(kind: int, size: Size, grids: Grids, p: Vector) -> tuple[float, Triple]:
    """(F, ∇F) at the point p, a triple or an array; where F has a kink (axis, centre) ∇F is a one-sided gradient."""
    x, y, z = p[0], p[1], p[2]
    if kind == SPHERE or kind == CAPSULE:  # noqa: SIM109
        if kind == CAPSULE:
            z -= min(max(z, -size[1]), size[1])
        length = math.sqrt(x * x + y * y + z * z)
        if length > 0.0:
            return length - size[0], (x / length, y / length, z / length)
        return -size[0], (1.0, 0.0, 0.0)
    if kind == ELLIPSOID:
        g = (x / (size[0] * size[0]), y / (size[1] * size[1]), z / (size[2] * size[2]))
        return 0.5 * (x * g[0] + y * g[1] + z * g[2] - 1.0), g
    if kind == CYLINDER:
        e, rho = size[3], math.sqrt(x * x + y * y)
        F, g_r, g_z = _rectangle(rho - (size[0] - e), abs(z) - (size[1] - e), e)
        g_z = g_z if z >= 0.0 else -g_z
        return F, ((g_r * x / rho, g_r * y / rho, g_z) if rho > 0.0 else (g_r, 0.0, g_z))
    if kind == BOX:
        return _box(size, x, y, z)
    if kind == PLANE:
        return z, (0.0, 0.0, 1.0)
    return grid_field(grids, int(size[0]), p)


@kernel
def _rectangle(q_r: float, q_z: float, e: float) -> Triple:
    """Distance to a rectangle dilated by e, with its gradient, from the distances beyond the rectangle's two sides."""
    o_r, o_z = max(q_r, 0.0), max(q_z, 0.0)
    outside = math.sqrt(o_r * o_r + o_z * o_z)
    if outside > 0.0:
        return outside - e, o_r / outside, o_z / outside
    if q_r >= q_z:
        return q_r - e, 1.0, 0.0
    return q_z - e, 0.0, 1.0


@kernel
def _box(size: Size, x: float, y: float, z: float) -> tuple[float, Triple]:
    e = size[3]
    q_x, q_y, q_z = abs(x) - (size[0] - e), abs(y) - (size[1] - e), abs(z) - (size[2] - e)
    s_x, s_y, s_z = 1.0 if x >= 0.0 else -1.0, 1.0 if y >= 0.0 else -1.0, 1.0 if z >= 0.0 else -1.0
    o_x, o_y, o_z = max(q_x, 0.0), max(q_y, 0.0), max(q_z, 0.0)
    outside = math.sqrt(o_x * o_x + o_y * o_y + o_z * o_z)
    if outside > 0.0:
        return outside - e, (s_x * o_x / outside, s_y * o_y / outside, s_z * o_z / outside)
    if q_x >= q_y and q_x >= q_z:
        return q_x - e, (s_x, 0.0, 0.0)
    if q_y >= q_z:
        return q_y - e, (0.0, s_y, 0.0)
    return q_z - e, (0.0, 0.0, s_z)


@kernel
def bend(kind: int, size: Size, grids: Grids, p: Vector, F: float, g: Triple, u: Vector) -> Triple:
    """∇²F u at the point p, from F and g = ∇F there; p, g, u and the value are triples (p and u may be arrays)."""
    if kind == ELLIPSOID:
        return u[0] / (size[0] * size[0]), u[1] / (size[1] * size[1]), u[2] / (size[2] * size[2])
    if kind == CYLINDER:
        return _bend_cylinder(size, p, F, g, u)
    if kind == MESH:
        return grid_bends(grids, int(size[0]), p, u, u)[0]
    rounding = size[3] if kind == BOX else size[0]
    if kind == PLANE or F + rounding <= 0.0:
        return 0.0, 0.0, 0.0
    # F + rounding is the distance to the core; its Hessian is, over that distance, the projector off the gradient and
    # off the directions in which the core extends here.
    k = 1.0 / (F + rounding)
    u_x, u_y, u_z = u[0], u[1], u[2]
    if kind == CAPSULE and abs(p[2]) <= size[1]:
        u_z = 0.0
    elif kind == BOX:
        u_x = u_x if g[0] != 0.0 or size[0] <= rounding else 0.0
        u_y = u_y if g[1] != 0.0 or size[1] <= rounding else 0.0
        u_z = u_z if g[2] != 0.0 or size[2] <= rounding else 0.0
    along = g[0] * u_x + g[1] * u_y + g[2] * u_z
    return k * (u_x - along * g[0]), k * (u_y - along * g[1]), k * (u_z - along * g[2])


@kernel
def bends(
    kind: int, size: Size, grids: Grids, p: Vector, F: float, g: Triple, u: Vector, v: Vector
) -> tuple[Triple, Triple]:
    """(∇²F u, ∇²F v), as `bend` gives them: a mesh's second derivatives are found once for both."""
    if kind == MESH:
        return grid_bends(grids, int(size[0]), p, u, v)
    return bend(kind, size, grids, p, F, g, u), bend(kind, size, grids, p, F, g, v)


@kernel
def _bend_cylinder(size: Size, p: Vector, F: float, g: Triple, u: Vector) -> Triple:
    rho = math.sqrt(p[0] * p[0] + p[1] * p[1])
    thin, low = size[0] <= size[3], size[1] <= size[3]  # the core is a segment, a disc, or a point
    if rho == 0.0:
        k = 1.0 / (F + size[3]) if thin and F + size[3] > 0.0 else 0.0
        return k * u[0], k * u[1], 0.0
    x, y = p[0] / rho, p[1] / rho
    g_r, g_z = g[0] * x + g[1] * y, g[2]
    around = g_r / rho * (x * u[1] - y * u[0])
    h_x, h_y, h_z = -around * y, around * x, 0.0
    if F + size[3] > 0.0 and (g_r != 0.0 or thin) and (g_z != 0.0 or low):
        # On the rim the meridian bends too, along (g_z, −g_r) in the (ρ, z) half plane.
        meridian = (g_z * (x * u[0] + y * u[1]) - g_r * u[2]) / (F + size[3])
        h_x, h_y, h_z = h_x + meridian * g_z * x, h_y + meridian * g_z * y, -meridian * g_r
    return h_x, h_y, h_z


@kernel
def implicit(kind: int, size: Array, grids: Grids, p: Array, g: Array, H: Array) -> float:
    """F at p (3,), with g (3,) = ∇F [1; 1/m for the ellipsoid] and H (3, 3) = ∇²F [1/m; 1/m² for the ellipsoid]."""
    F, gradient = field(kind, size, grids, p)
    g[0], g[1], g[2] = gradient
    H[:, 0], H[:, 1] = bends(kind, size, grids, p, F, gradient, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    H[:, 2] = bend(kind, size, grids, p, F, gradient, (0.0, 0.0, 1.0))
    return F


@kernel
def shape_operator(kind: int, size: Array, grids: Grids, p: Array, n: Array, S: Array) -> float:
    """F at p (3,), with the outward unit normal n (3,) = ∇F/|∇F| and S (3, 3) = (I−nnᵀ) ∇²F (I−nnᵀ)/|∇F| [1/m].

    S maps a tangent velocity ṗ to ṅ; it is positive semi-definite on convex surfaces, and has a negative
    eigenvalue along every direction in which a surface is hollow.
    """
    F = implicit(kind, size, grids, p, n, S)
    length = norm(n)
    for i in range(3):
        n[i] /= length
    for i in range(3):
        off = S[i, 0] * n[0] + S[i, 1] * n[1] + S[i, 2] * n[2]
        for j in range(3):
            S[i, j] = (S[i, j] - off * n[j]) / length
    for j in range(3):
        off = n[0] * S[0, j] + n[1] * S[1, j] + n[2] * S[2, j]
        for i in range(3):
            S[i, j] -= off * n[i]
    return F


@kernel
def project(kind: int, size: Array, grids: Grids, p: Array, foot: Array, n: Array) -> float:
    """Signed distance [m] of p (3,) to the surface (negative inside), with the closest point foot (3,), normal n (3,).

    Where the closest point is not unique (centre, axis, medial planes) one of them is returned. foot may be p.
    """
    if kind == ELLIPSOID:
        return _project_ellipsoid(size, p, foot, n)
    if kind == MESH:
        F, x, g = grid_project(grids, int(size[0]), p)
        foot[0], foot[1], foot[2] = x
        n[0], n[1], n[2] = g
        return F
    F, g = field(kind, size, grids, p)
    for i in range(3):
        n[i] = g[i]
        foot[i] = p[i] - F * g[i]
    return F


@kernel
def _project_ellipsoid(size: Array, p: Array, foot: Array, n: Array) -> float:
    # foot_i = a_i² p_i / (t + a_i²) with t the root of |q(t)| = 1, q_i = a_i p_i / (t + a_i²) (Eberly, Distance from a
    # Point to an Ellipsoid). s = t + a_min² keeps its digits where t runs into the pole −a_min². 1/|q| is concave and
    # increasing in s, so Newton's method on it, once left of the root, climbs to it without overshoot (Moré, Hebden).
    k = 0 if size[0] <= size[1] else 1
    k = k if size[k] <= size[2] else 2
    shortest = size[k] * size[k]
    low = 0.0
    for i in range(3):
        foot[i] = p[i] if abs(p[i]) > 1e-200 else 0.0  # below, 1/s overflows
        low = max(low, shortest - size[i] * size[i] + size[i] * abs(foot[i]))  # q_i ≤ 1 for every i at the root
    s = max(shortest, low)
    for _ in range(64):
        q2, slope = 0.0, 0.0
        for i in range(3):
            if foot[i] != 0.0:
                w = 1.0 / (s + (size[i] * size[i] - shortest))
                q = size[i] * foot[i] * w
                q2 += q * q
                slope += q * q * w
        if slope == 0.0:  # the centre
            s = 0.0
            break
        following = max(low, s + q2 * (math.sqrt(q2) - 1.0) / slope)
        moved = abs(following - s)
        s = following
        if moved <= 1e-9 * s:  # the error left is of the order of its square
            break
    for i in range(3):
        d = s + (size[i] * size[i] - shortest)
        foot[i] = size[i] * size[i] * foot[i] / d if d > 0.0 else 0.0
    rest = 0.0
    for i in range(3):
        rest += (foot[i] / size[i]) ** 2
    if s == 0.0 and rest < 1.0:
        # p lies on the medial plane of the shortest axis: both ends of the chord are closest, the positive one counts.
        foot[k] = size[k] * math.sqrt(1.0 - rest)
    else:
        for i in range(3):
            foot[i] /= math.sqrt(rest)
    for i in range(3):
        n[i] = foot[i] / (size[i] * size[i])
    length = norm(n)
    for i in range(3):
        n[i] /= length
    return (s - shortest) * length  # p − foot = t foot/a²


@kernel
def frame(n: Vector) -> tuple[Triple, Triple]:
    """Unit tangents (x, y), two triples with (x, y, n) right-handed, as a fixed function of the unit normal n.

    Duff et al., Building an Orthonormal Basis, Revisited (JCGT 2017), with the branch cut moved off the equator: the
    frame jumps only across the circle n_z = −0.65, which no face normal of a box or cylinder comes near, and on the six
    faces of a box x and y run along its edges.
    """
    sign = 1.0 if n[2] >= -0.65 else -1.0
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return (1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]), (b, sign + n[1] * n[1] * a, -n[1])


@kernel
def tangents(n: Array, x: Array, y: Array) -> None:
    """Write the tangents of `frame` at the unit normal n (3,) to x (3,) and y (3,)."""
    (x[0], x[1], x[2]), (y[0], y[1], y[2]) = frame(n)
