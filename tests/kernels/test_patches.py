"""Contact patches: linear programs, closed forms of the surfaces and the inequality of projections as oracles."""

import itertools

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from regrasp.kernels.cores import BOX, CYLINDER, ELLIPSOID, PLANE, POINT, SEGMENT
from regrasp.kernels.patches import ROOM, SCRATCH, SLOTS, contact, patch

Body = tuple[int, np.ndarray, float, np.ndarray, np.ndarray]

HALF = {
    "sphere": (POINT, [0, 0, 0], 0.02), "capsule": (SEGMENT, [0, 0, 0.03], 0.015), "box": (BOX, [0.05, 0.03, 0.01], 0.004),
    "cylinder": (CYLINDER, [0.03, 0.03, 0.02], 0.004), "ellipsoid": (ELLIPSOID, [0.05, 0.03, 0.02], 0.0),
    "card": (BOX, [0.05, 0.03, 1e-3], 5e-4), "cube": (BOX, [0.02, 0.02, 0.02], 0.002),
}  # fmt: skip
STATIC = {
    "plane": (PLANE, [0, 0, 0], 0.0), "table": (BOX, [0.1, 0.08, 0.02], 0.0), "post": (BOX, [0.01, 0.015, 0.04], 0.0),
    "ball": (POINT, [0, 0, 0], 0.03), "rail": (SEGMENT, [0, 0, 0.06], 0.01), "drum": (CYLINDER, [0.05, 0.05, 0.03], 0.0),
}  # fmt: skip
GROUP = Rotation.create_group("O").as_matrix()


def body(spec: tuple[int, list[float], float], R: np.ndarray, p: np.ndarray) -> Body:
    return spec[0], np.array(spec[1], float), spec[2], np.ascontiguousarray(R), np.array(p, float)


def turn(axis: str, angle: float) -> np.ndarray:
    return Rotation.from_euler(axis, angle).as_matrix()


def attitudes(rng: np.random.Generator, count: int) -> list[np.ndarray]:
    """Faces, edges and vertices up, aligned and yawed, and anything."""
    found = []
    for _ in range(count):
        up = GROUP[rng.integers(len(GROUP))]
        lean = [
            np.eye(3),
            turn("x", np.pi / 4),
            turn("x", 0.3),
            Rotation.align_vectors([0, 0, 1], [1, 1, 1])[0].as_matrix(),
        ]
        yaw = turn("z", rng.choice([0.0, np.pi / 4, rng.uniform(0, 6)]))
        found.append(Rotation.random(rng=rng).as_matrix() if rng.random() < 0.2 else yaw @ lean[rng.integers(4)] @ up)
    return found


def touch(S: Body, B: Body) -> tuple[Body, np.ndarray]:
    """The object moved along the normal until it touches, and that normal."""
    for _ in range(20):
        gap, n = contact(*S, *B)
        B = (*B[:4], B[4] - gap * np.array(n))
        if abs(gap) < 1e-11:
            break
    return B, np.array(contact(*S, *B)[1])


def contacts(S: Body, B: Body) -> tuple[np.ndarray, np.ndarray, dict[int, np.ndarray]]:
    """Normal, polygon and slots."""
    n = contact(*S, *B)[1]
    polygon, present, points = np.empty((ROOM, 3)), np.zeros(SLOTS, np.uint8), np.zeros((SLOTS, 3))
    count = patch(S[0], S[1], S[3], S[4], *B, n, np.empty((SCRATCH, ROOM, 4)), polygon, present, points)
    return np.array(n), polygon[:count], {int(s): points[s].copy() for s in np.flatnonzero(present)}


def placed(rng: np.random.Generator, static: str, thing: str, R: np.ndarray, R_S: np.ndarray) -> tuple[Body, Body]:
    """S and O in touch: O beside, above, over an edge or a corner of S, or just inside it."""
    S = body(STATIC[static], R_S, [0.01, -0.02, 0.05])
    half = np.array(STATIC[static][1]) if STATIC[static][0] != PLANE else np.full(3, 0.05)
    where = rng.choice([-1.0, -0.5, 0.0, 1.0, rng.uniform(-1, 1)], 3)
    if STATIC[static][0] == PLANE:
        where[2] = 1.0
    else:
        where[rng.integers(3)] = rng.choice([-1.0, 1.0])
    out = where * (np.abs(where) == np.max(np.abs(where)))
    reach = rng.choice([0.2, 0.06, 0.01])
    B = body(HALF[thing], R_S @ R, R_S @ (where * half + reach * out / np.linalg.norm(out)) + S[4])
    return S, touch(S, B)[0]


def corners(B: Body) -> np.ndarray:
    """The corners (c, 3) of a polytope core."""
    signs = np.array(list(itertools.product([-1, 1], repeat=3))) if B[0] == BOX else np.array([[0, 0, -1], [0, 0, 1]])
    return signs * B[1] @ B[3].T + B[4]


def surface(B: Body, p_W: np.ndarray) -> float:
    """Distance from the surface, for the ellipsoid to first order."""
    kind, core, radius, R, p = B
    x = R.T @ (p_W - p)
    if kind == PLANE:
        return float(x[2])
    if kind == ELLIPSOID:
        return float((np.sum((x / core) ** 2) - 1.0) / (2.0 * np.linalg.norm(x / core**2)))
    q = np.array([np.hypot(x[0], x[1]) - core[0], abs(x[2]) - core[2]]) if kind == CYLINDER else np.abs(x) - core
    return float(np.linalg.norm(np.maximum(q, 0.0)) + min(np.max(q), 0.0) - radius)


@pytest.mark.parametrize("thing", HALF)
@pytest.mark.parametrize("static", STATIC)
def test_patches_lie_on_both_surfaces(static: str, thing: str) -> None:
    """Whatever touches whatever, on a face, over an edge or on a corner: all corners and slots are points of both."""
    rng = np.random.default_rng(0)
    # Of smooth cores the normal is good to the root of round-off, and beside a sharp edge its error counts in full.
    exact = 5e-7 if {STATIC[static][0], HALF[thing][0]} & {CYLINDER, ELLIPSOID} else 1e-9
    for R in attitudes(rng, 60):
        S, B = placed(rng, static, thing, R, Rotation.random(rng=rng).as_matrix())
        n, polygon, slots = contacts(S, B)
        assert abs(contact(*S, *B)[0]) < 1e-10
        assert np.linalg.norm(n) == pytest.approx(1.0, abs=1e-12)
        assert len(polygon) >= 1
        assert slots
        for p_W in (*polygon, *slots.values()):
            assert surface(B, p_W) == pytest.approx(0.0, abs=exact)
            assert surface(S, p_W) == pytest.approx(0.0, abs=exact)


@pytest.mark.parametrize("thing", ["box", "card", "cube", "capsule"])
@pytest.mark.parametrize("static", ["table", "post", "rail"])
def test_the_patch_is_where_the_cores_are_nearest(static: str, thing: str) -> None:
    """Pairs of nearest points of two convex sets all differ by h n. Over the convex combinations a of O's and b of S's
    corners with a − b = h n, a linear program finds how far the patch reaches in a direction; n separates the cores by h,
    so h is their distance."""
    rng = np.random.default_rng(1)
    for R in attitudes(rng, 25):
        S, B = placed(rng, static, thing, R, Rotation.random(rng=rng).as_matrix())
        n, polygon, _ = contacts(S, B)
        a, b, h = corners(B), corners(S), S[2] + B[2]
        assert np.min(a @ n) - np.max(b @ n) == pytest.approx(h, abs=1e-10)
        # Lengths in cm: HiGHS holds equations to 1e-7.
        left = 100.0 * np.hstack([a.T, -b.T])
        A = np.vstack([left, np.repeat([[1.0, 0.0], [0.0, 1.0]], [len(a), len(b)], axis=1)])
        for u in rng.normal(size=(3, 3)):
            u -= (u @ n) * n
            u /= np.linalg.norm(u)
            best = linprog(-np.concatenate([a @ u, np.zeros(len(b))]), A_eq=A, b_eq=[*(100.0 * h * n), 1.0, 1.0])
            assert best.status == 0
            assert np.max(polygon @ u) == pytest.approx(-best.fun, abs=2e-6)


@pytest.mark.parametrize("thing", ["box", "cylinder", "capsule", "card"])
@pytest.mark.parametrize("static", ["plane", "table", "post", "drum"])
def test_slots_are_the_points_nearest_to_corners(static: str, thing: str) -> None:
    """A point s of a convex polygon is nearest to c if, and only if, (c − s)·(q − s) ≤ 0 for all its corners q."""
    rng = np.random.default_rng(2)
    seen = 0
    for R in attitudes(rng, 60):
        S, B = placed(rng, static, thing, R, Rotation.random(rng=rng).as_matrix())
        n, polygon, slots = contacts(S, B)
        across = np.eye(3) - np.outer(n, n)
        flat = (polygon - B[4]) @ across
        for C, first in ((B, 0), (S, 8)):
            if C[0] != BOX:
                continue
            for s, p_W in slots.items():
                if first <= s < first + 8:
                    sign = np.where((s - first) >> np.arange(3) & 1, 1.0, -1.0)
                    c = across @ (C[3] @ (sign * C[1]) + C[4] - B[4])
                    x = across @ (p_W - B[4])
                    assert np.max((flat - x) @ (c - x)) <= 1e-9
                    seen += 1
    assert seen > 60 or (static not in ("table", "post") and thing not in ("box", "card"))


def flush(thing: str, static: str, yaw: float, x: float, y: float) -> tuple[Body, Body]:
    """O flat on S's upper face, turned by yaw, at x, y."""
    S = body(STATIC[static], np.eye(3), np.zeros(3))
    height = STATIC[static][1][2] + HALF[thing][1][2] + HALF[thing][2]
    return S, body(HALF[thing], turn("z", yaw), [x, y, height])


def test_a_card_over_the_edge_of_a_table() -> None:
    """Aligned, its patch is the rectangle over the table; corners beyond the edge have their slots on the edge."""
    S, B = flush("card", "table", 0.0, 0.1, 0.0)
    n, polygon, slots = contacts(S, B)
    np.testing.assert_array_equal(n, [0, 0, 1])
    assert sorted(slots) == [0, 1, 2, 3, 12, 13, 14, 15]
    np.testing.assert_allclose(slots[1], [0.1, -0.03, 0.02], atol=1e-15)
    np.testing.assert_allclose(slots[0], [0.05, -0.03, 0.02], atol=1e-15)
    np.testing.assert_allclose(sorted(map(tuple, polygon)), [[0.05, -0.03, 0.02], [0.05, 0.03, 0.02], [0.1, -0.03, 0.02],
                                                              [0.1, 0.03, 0.02]], atol=1e-15)  # fmt: skip


def test_what_is_larger_than_its_support_rests_on_all_of_it() -> None:
    S, B = flush("card", "post", 0.4, 0.0, 0.0)
    _, polygon, slots = contacts(S, B)
    rectangle = [[x, y, 0.04] for x in (-0.01, 0.01) for y in (-0.015, 0.015)]
    np.testing.assert_allclose(sorted(map(tuple, polygon)), rectangle, atol=1e-12)
    np.testing.assert_allclose([slots[s] for s in (12, 14, 13, 15)], rectangle, atol=1e-12)


@pytest.mark.parametrize(
    ("thing", "static", "R", "p", "corners"),
    [
        ("cube", "table", turn("y", np.pi / 4), [0, 0, 0.1], 2),
        ("cube", "table", turn("y", np.pi / 4), [0.1, 0, 0.1], 2),
        ("cube", "table", turn("y", np.pi / 4), [0.13, 0, 0.05], 2),
        ("box", "table", turn("y", 0.4), [0.12, 0, 0.05], 2),
        ("box", "table", turn("yz", [0.4, 0.3]), [0.11, 0, 0.05], 1),
        ("capsule", "table", turn("x", np.pi / 2), [0, 0, 0.1], 2),
        ("capsule", "table", turn("xz", [np.pi / 2, 0.4]), [0.13, 0, 0.05], 1),
        ("capsule", "rail", np.eye(3), [0.1, 0, 0.02], 2),
        ("cube", "rail", np.eye(3), [0.1, 0, 0], 2),
        ("cylinder", "drum", np.eye(3), [0.2, 0.1, 0.01], 2),
        ("cylinder", "table", turn("x", np.pi / 2), [0, 0, 0.1], 2),
        ("cylinder", "plane", turn("x", 0.4), [0, 0, 0.1], 1),
        ("cylinder", "plane", np.eye(3), [0, 0, 0.1], 12),
        ("ellipsoid", "table", turn("x", 0.4), [0.13, 0, 0.05], 1),
    ],
)
def test_points_lines_and_faces(thing: str, static: str, R: np.ndarray, p: list[float], corners: int) -> None:
    S = body(STATIC[static], np.eye(3), np.zeros(3))
    B, _ = touch(S, body(HALF[thing], R, p))
    assert len(contacts(S, B)[1]) == corners


@pytest.mark.parametrize(
    ("thing", "static"), [("card", "table"), ("cube", "post"), ("cylinder", "table"), ("card", "drum")]
)
def test_slots_wander_continuously(thing: str, static: str) -> None:
    """Along a slide over the support, partly beyond its edge: at half the step the longest step of a slot is half."""
    rng = np.random.default_rng(3)
    for _ in range(10):
        yaw, ways = rng.uniform(0, 6), rng.uniform(-1, 1, (2, 2)) * np.array(STATIC[static][1])[:2] * 0.95

        def longest(count: int, yaw: float = yaw, ways: np.ndarray = ways) -> float:
            at = [
                contacts(*flush(thing, static, yaw, *(ways[0] + u * (ways[1] - ways[0]))))[2]
                for u in np.linspace(0, 1, count + 1)
            ]
            assert len({tuple(sorted(slots)) for slots in at}) == 1
            return max(np.linalg.norm(a[s] - b[s]) for a, b in itertools.pairwise(at) for s in a)

        coarse, fine = longest(200), longest(400)
        assert fine <= 0.51 * coarse + 1e-12


def test_a_corner_keeps_its_slot_from_face_to_edge_to_vertex() -> None:
    """A box that tips over an edge and on over its end touches with the same corners, in the same slots, as long as they do."""
    S = body(STATIC["table"], np.eye(3), np.zeros(3))
    numbers, points = [], []
    for R in [turn("y", a) for a in np.linspace(0, 0.4, 5)] + [
        turn("x", a) @ turn("y", 0.4) for a in np.linspace(0.1, 0.4, 4)
    ]:
        B, _ = touch(S, body(HALF["box"], R, [0, 0, 0.1]))
        slots = {s: B[3].T @ (p - B[4]) for s, p in contacts(S, B)[2].items() if s < 8}
        numbers.append(set(slots))
        points.append(slots)
    assert numbers[0] == {0, 1, 2, 3}
    assert all(slots == {1, 3} for slots in numbers[1:5])
    assert all(slots == {1} for slots in numbers[5:])
    for slots in points:
        for s, p_O in slots.items():
            corner = np.where(s >> np.arange(3) & 1, 1.0, -1.0) * HALF["box"][1]
            assert np.linalg.norm(p_O - corner) == pytest.approx(HALF["box"][2], abs=1e-12)


@pytest.mark.parametrize("thing", ["ellipsoid", "cylinder", "capsule", "sphere"])
@pytest.mark.parametrize("depth", [0.01, 0.0, -1e-4])
def test_on_a_face_the_normal_is_that_of_the_face(thing: str, depth: float) -> None:
    rng = np.random.default_rng(4)
    for R in attitudes(rng, 20):
        R_S = Rotation.random(rng=rng).as_matrix()
        for static in ("plane", "table"):
            S = body(STATIC[static], R_S, np.zeros(3))
            B, _ = touch(S, body(HALF[thing], R, 0.2 * R_S[:, 2]))
            gap, n = contact(*S, *(*B[:4], B[4] + depth * R_S[:, 2]))
            np.testing.assert_allclose(n, R_S[:, 2], atol=1e-12)
            assert gap == pytest.approx(depth, abs=1e-11)
