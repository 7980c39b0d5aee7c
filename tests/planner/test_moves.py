"""Moves from poses in contact: what slides stays on, what pivots keeps its edge, what rolls does not slip."""

import itertools

import numpy as np
import pytest
from tables import ALL, TILT, Distances, graph, task, velocity

from regrasp.planner.arcs import Arc, straight
from regrasp.planner.moves import LEAST, along_surfaces, freedoms_of, pivots, rolls, shifts, turns
from regrasp.planner.poses import START, PoseGraph
from regrasp.planner.task import Task

UP = np.array([0.0, 0.0, 1.0])
LYING = (0.0, 0.0, 0.02, np.pi / 2, 0.0, 0.4)
ON_TABLE = {
    "box": (0.0, 0.0, 0.025, 0.0, 0.0, 0.4), "cylinder": (0.0, 0.0, 0.03), "capsule": LYING, "sphere": (0.0, 0.0, 0.025),
}  # fmt: skip
GOAL = (0.01, 0.005, 0.1)
U = np.linspace(0.0, 1.0, 9)


def begun(shape: str, supports: tuple[str, ...], start: tuple[float, ...], **fields: object) -> tuple[Task, PoseGraph]:
    t = task(shape, supports, start=start, goal=fields.pop("goal", GOAL), **fields)
    g = graph(t)
    assert g.held[START] == tuple(range(len(supports)))
    return t, g


def shifted(g: PoseGraph) -> list[Arc]:
    return list(shifts(g.start, g.patches(START), g.resolution.step, g.goal))


def turned(g: PoseGraph) -> list[Arc]:
    return list(turns(g.start, g.patches(START), list(g.rotations), g.resolution.angle, g.goal))


def pivoted(t: Task, g: PoseGraph) -> list[Arc]:
    """Pivots that get anywhere, as far as they do, that keep a contact."""
    found = [
        g.went(arc, g.held[START])[0] for arc in pivots(g.start, g.patches(START), float(t.router.around.radius_O[0]))
    ]
    return [arc for arc in found if arc.angle >= LEAST and arc.on]


def rolled(t: Task, g: PoseGraph) -> list[Arc]:
    return list(rolls(g.start, g.patches(START), t.hand.kind_O, t.hand.size_O, g.resolution.angle))


def directions(arcs: list[Arc]) -> set[tuple[float, ...]]:
    return {tuple((np.round(arc.d / np.linalg.norm(arc.d), 9) + 0.0).tolist()) for arc in arcs}


def touches(t: Task, arc: Arc, body: int) -> None:
    """The object touches the body all along the arc, and no other one is in its way (MuJoCo)."""
    distances = Distances(t)
    slack = 3e-5 if t.world.scene.object.shape == "cylinder" else 1e-6
    for u in U:
        gaps = distances(*arc.pose(u))
        assert gaps[body] == pytest.approx(0.0, abs=slack)
        assert gaps.min() > -slack


def lowest(t: Task, arc: Arc, u: float) -> np.ndarray:
    """Points (c, 3) of the box's surface that are lowest at part u: below its core's lowest corners."""
    R, p = arc.pose(u)
    r = float(t.router.around.radius_O[0])
    corners = np.array(list(itertools.product(*([-s, s] for s in t.hand.size_O[:3] - r)))) @ R.T + p
    return corners[corners[:, 2] < corners[:, 2].min() + 1e-9] - r * UP


@pytest.mark.parametrize("shape", ON_TABLE)
def test_slides_along_a_table_keep_on_it(shape: str) -> None:
    """Both ways along both axes, by a step and up to the goal's coordinate; the only other ways lead straight up."""
    t, g = begun(shape, ("table",), ON_TABLE[shape])
    slides = [arc for arc in shifted(g) if arc.kind == "slide"]
    up = [arc for arc in shifted(g) if arc.kind != "slide"]
    assert directions(slides) == {(1.0, 0, 0), (-1.0, 0, 0), (0, 1.0, 0), (0, -1.0, 0)}
    assert directions(up) == {(0, 0, 1.0)}
    step, height = g.resolution.step, 0.1 - g.start[1][2]
    ways = [[tuple(np.round(arc.d, 9)) for arc in arcs] for arcs in (slides, up)]
    assert {(round(step, 9), 0, 0), (0.01, 0, 0), (0, 0.005, 0)} <= set(ways[0])
    assert {(0, 0, round(step, 9)), (0, 0, round(height, 9))} == set(ways[1])
    for arc in slides:
        got, body = g.went(arc, (0,))
        assert (got.on, body, got.angle) == ((0,), -1, 0.0)
        touches(t, got, 0)
    for arc in up:
        assert g.went(arc, (0,))[0].on == ()


def test_a_wall_is_not_slid_into_but_along_and_up() -> None:
    """From the corner of table and wall: both are kept in ±y, the wall alone upwards, the table alone away from it."""
    t, g = begun("box", ("table", "wall"), (0.03, 0.0, 0.025))
    on = {direction: set() for direction in directions(shifted(g))}
    for arc in shifted(g):
        got, body = g.went(arc, (0, 1))
        assert body == -1
        assert arc.kind == "slide"
        on[next(iter(directions([arc])))].add(got.on)
        for b in got.on:
            touches(t, got, b)
    assert on == {(0, 1.0, 0): {(0, 1)}, (0, -1.0, 0): {(0, 1)}, (0, 0, 1.0): {(1,)}, (-1.0, 0, 0): {(0,)}}


def test_on_a_slope_slides_go_along_it() -> None:
    """Up, down and across; all else leads away from it."""
    c, n = np.cos(TILT), np.array([np.sin(TILT), 0.0, np.cos(TILT)])
    t, g = begun("sphere", ("slope",), (0.0, 0.0, -0.02 + 0.025 / c))
    slides = [arc for arc in shifted(g) if arc.kind == "slide"]
    assert len(directions(slides)) == 4
    for arc in slides:
        assert arc.d @ n == pytest.approx(0.0, abs=1e-9)
        touches(t, g.went(arc, (0,))[0], 0)
    assert all(arc.d @ n > 0.0 for arc in shifted(g) if arc.kind != "slide")


def test_what_leads_into_surfaces_is_taken_off_a_direction() -> None:
    """The result leads into none, is a unit vector, and the direction itself where that leads into none."""
    rng, barred = np.random.default_rng(0), 0
    for _ in range(300):
        d, *normals = rng.normal(size=(1 + rng.integers(1, 4), 3))
        d, normals = d / np.linalg.norm(d), [n / np.linalg.norm(n) for n in normals]
        found = along_surfaces(d, normals)
        if min(d @ n for n in normals) >= 0.0:
            np.testing.assert_allclose(found, d, atol=1e-12)
        if found is None:
            barred += 1
            continue
        assert np.linalg.norm(found) == pytest.approx(1.0, abs=1e-12)
        assert all(found @ n >= -1e-6 for n in normals)
    assert 0 < barred < 150
    assert along_surfaces(-UP, [UP]) is None
    np.testing.assert_allclose(along_surfaces(np.array([0.6, 0.0, -0.8]), [UP]), [1.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("shape", ON_TABLE)
def test_turns_on_a_table_are_about_its_normal_and_keep_on_it(shape: str) -> None:
    start = ON_TABLE[shape]
    yaw = start[5] if len(start) > 5 else 0.0
    goal = (*start[:3], *(start[3:5] or (0.0, 0.0)), yaw + 1.1)
    t, g = begun(shape, ("table",), start, goal=goal)
    arcs = turned(g)
    np.testing.assert_allclose(
        sorted(arc.w @ UP for arc in arcs), [-g.resolution.angle, g.resolution.angle, 1.1], atol=1e-9
    )
    for arc in arcs:
        np.testing.assert_allclose(np.cross(arc.w, UP), 0.0, atol=1e-12)
        got, body = g.went(arc, (0,))
        assert (body, got.on) == (-1, (0,))
        np.testing.assert_allclose(got.goal[1], g.start[1], atol=1e-12)
        touches(t, got, 0)


def test_no_turn_on_a_table_leads_to_an_orientation_off_it() -> None:
    _, g = begun("box", ("table",), ON_TABLE["box"], goal=(0, 0, 0.1, 0.3, 0.2, 1.1))
    assert len(turned(g)) == 2


def test_in_the_air_turns_lead_to_the_orientations_asked_for() -> None:
    _, g = begun("box", (), (0.0, 0.0, 0.1, 0.3, 0.1, -0.2))
    assert {arc.kind for arc in turned(g)} == {"turn"}
    for arc, R in zip(turned(g), g.rotations, strict=True):
        np.testing.assert_allclose(arc.goal[0], R, atol=1e-9)
        np.testing.assert_allclose(arc.goal[1], g.start[1], atol=1e-12)
    assert directions(shifted(g)) == {tuple((s * e + 0.0).tolist()) for s in (1.0, -1.0) for e in np.eye(3)}


def test_a_box_pivots_over_each_edge_of_its_face_onto_the_next_one() -> None:
    """Both ways, rolling and in place: the edge stays on the table, the face leaves it, the next one ends the pivot."""
    t, g = begun("box", ("table",), ON_TABLE["box"])
    arcs = pivoted(t, g)
    assert len(arcs) == 8
    assert len({tuple(np.round(arc.w / arc.angle, 6).tolist()) for arc in arcs}) == 4
    for arc in arcs:
        assert arc.angle == pytest.approx(np.pi / 2, abs=1e-4)
        touches(t, arc, 0)
        assert [len(lowest(t, arc, u)) for u in (0.0, 0.1, 0.9)] == [4, 2, 2]
        end = g.touched(arc.goal)
        assert end == (0,)
        assert arc.goal[1][2] == pytest.approx(np.abs(arc.goal[0][2]) @ t.hand.size_O[:3], abs=1e-6)


def test_a_rolling_edge_does_not_slip_and_one_that_turns_in_its_place_slides() -> None:
    """The velocity of what touches the table: nothing, or radius times rate across the edge (finite differences)."""
    t, g = begun("box", ("table",), ON_TABLE["box"])
    r, kinds = float(t.router.around.radius_O[0]), {0: 0, 1: 0}
    for arc in pivoted(t, g):
        slides = int(not np.any(arc.d))
        kinds[slides] += 1
        for u in (0.1, 0.5, 0.9):
            for x in lowest(t, arc, u):
                v = velocity(arc.pose, u, x)
                np.testing.assert_allclose(v, slides * r * np.cross(arc.w, -UP), atol=1e-8)
    assert kinds == {0: 4, 1: 4}


def test_over_a_tables_edge_the_face_turns_about_it() -> None:
    """The line of the edge x = 0 stays where it is on the face; the object tips down over it."""
    t, g = begun("box", ("edge",), (0.01, 0.0, 0.025))
    (arc,) = [arc for arc in pivoted(t, g) if arc.w[1] > 0.0 and abs(arc.c[0]) < 1e-9]
    for y in (-0.01, 0.0, 0.01):
        for u in U:
            np.testing.assert_allclose(velocity(arc.pose, u, np.array([0.0, y, 0.0])), 0.0, atol=1e-9)
    touches(t, arc, 0)
    assert arc.goal[1][2] < 0.0 < g.start[1][2]
    assert arc.angle == pytest.approx(np.pi / 2, abs=1e-4)  # its face against the table's side


def test_a_wall_ends_a_pivot_where_they_touch() -> None:
    """The box tips towards the wall, 3 mm away, until the top edge meets it, and no further."""
    t = task("box", ("table", "wall"), start=(0.027, 0.0, 0.025), goal=GOAL)
    g = graph(t)
    arcs = [arc for arc in pivoted(t, g) if arc.w[1] > 0.0]
    assert len(arcs) == 2
    for arc in arcs:
        touches(t, arc, 0)
        assert g.touched(arc.goal) == (0, 1)
        assert Distances(t)(*arc.goal)[1] == pytest.approx(0.0, abs=1e-6)
        assert LEAST < arc.angle < 0.5


def test_points_and_round_edges_have_no_pivot_of_a_face() -> None:
    """A sphere has none at all; what lies on a line turns about it only, which keeps the line."""
    t, g = begun("sphere", ("table",), ON_TABLE["sphere"])
    assert not list(pivots(g.start, g.patches(START), float(t.router.around.radius_O[0])))
    t, g = begun("capsule", ("table",), LYING)
    axis = g.start[0][:, 2]
    for arc in pivoted(t, g):
        # About the line, or over one of its ends.
        w = arc.w / arc.angle
        assert abs(w @ axis) == pytest.approx(1.0, abs=1e-9) or np.hypot(w @ axis, w[2]) < 1e-9
        touches(t, arc, 0)


@pytest.mark.parametrize(
    ("shape", "start", "count"), [("sphere", ON_TABLE["sphere"], 4), ("capsule", LYING, 2), ("cylinder", LYING, 2)]
)
def test_what_is_round_rolls_without_slipping(shape: str, start: tuple[float, ...], count: int) -> None:
    """The material point on the table is at rest at every moment, and the way is radius times angle."""
    t, g = begun(shape, ("table",), start)
    arcs = rolled(t, g)
    assert len(arcs) == count
    for arc in arcs:
        got, body = g.went(arc, (0,))
        assert (body, got.on) == (-1, (0,))
        touches(t, got, 0)
        assert got.length(0.0) == pytest.approx(t.hand.size_O[0] * got.angle, rel=1e-9)
        for u in U:
            p = got.pose(u)[1]
            np.testing.assert_allclose(velocity(got.pose, u, p - t.hand.size_O[0] * UP), 0.0, atol=1e-9)


@pytest.mark.parametrize("shape", ["box", "cylinder"])
def test_what_stands_on_a_face_does_not_roll(shape: str) -> None:
    assert rolled(*begun(shape, ("table",), ON_TABLE[shape])) == []


@pytest.mark.parametrize("free", [s for size in (1, 2, 3, 6) for s in itertools.combinations(ALL, size)])
def test_freedoms_allow_what_keeps_to_them(free: tuple[str, ...]) -> None:
    """A move along or about one axis is allowed if that is free; one about two if both are; a roll if both of its are."""
    flags, start = freedoms_of(free), (np.eye(3), np.array([0.1, 0.2, 0.3]))
    zero = np.zeros(3)
    for a, name in enumerate(ALL):
        e = np.eye(3)[a % 3]
        arc = Arc(start, zero, start[1], 0.1 * e, "") if a < 3 else Arc(start, 0.5 * e, start[1], zero, "")
        assert flags.allow(arc) is (name in free)
        for b, other in enumerate(ALL[:3]):
            d = np.eye(3)[b]
            assert flags.allow(Arc(start, arc.w, start[1], arc.d + 0.2 * d, "")) is ({name, other} <= set(free))
    assert flags.allow(Arc(start, zero, start[1], zero, ""))
    off = Arc(
        start, np.array([0.0, 0.5, 0.0]), np.zeros(3), zero, ""
    )  # about a point: the origin goes round in x and z
    assert flags.allow(off) is ({"x", "z", "ry"} <= set(free))
    assert flags.allow(straight(start, start))
