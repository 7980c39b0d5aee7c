"""Hand-overs and the plan's forces, on courses made by hand: balance, continuity, friction, optimality, failure in words."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
import springs
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.spatial.transform import Rotation

from regrasp.plan import NONE, OFF, RELOCATE, SLIDE, STAY, STICK
from regrasp.planner import cones
from regrasp.planner.assemble import remarks
from regrasp.planner.cones import JOIN, nodes_of, solve, sparse
from regrasp.planner.contacts import Contacts, bases, contacts_of, excess, residual
from regrasp.planner.course import Course, changes, with_hand_overs
from regrasp.planner.loads import WITHIN, Loads, between, forces, most_lacking
from regrasp.planner.outcome import Failure
from regrasp.planner.reserve import SOFT, Margins
from regrasp.planner.timing import Timing, durations

Array = NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, -9.81])
ROLL, SLIDE_X = 1, 5
MARGIN = 0.1
"""Part of μ unused."""
RESERVE = Margins(MARGIN, 0.05, 0.05, 0.5)
M = 6
HAND = SimpleNamespace(
    mu=np.full(4, 0.8),
    cap=np.full(4, 3.0),
    radius=0.05,
    p_OM_O=np.array([1e-3, 0.0, -2e-3]),
    shifts=np.ones(3),
    turns=np.ones(3),
)


def unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def course_of(V: list[list[int]], support: list[int], segment: list[int], twist: float = 0.01) -> Course:
    """A ball that rises and turns while four contacts creep along it; agent 3, if ever away, stands elsewhere after interval 2.

    twist: rad by which the contact frames jump from one interval to the next, as those of real courses do.
    """
    codes = np.array(V, np.int8)
    N, k = codes.shape
    t = (np.arange(N)[:, None] + np.linspace(0.0, 1.0, M))[..., None]
    R = Rotation.from_rotvec((t * [0.05, -0.03, 0.08]).reshape(-1, 3)).as_matrix().reshape(N, M, 3, 3)
    angle = 2.0 * np.pi * np.arange(k) / k + 0.06 * t
    if np.any(codes[:, 3] >= RELOCATE):
        angle[3:, :, 3] += 0.4
    n = np.stack([np.cos(angle), np.sin(angle), 0.15 * np.sin(2.0 * angle) - 0.1 + 0.0 * angle], axis=-1)
    n = unit(n)
    x = unit(np.cross([0.0, 0.0, 1.0], n))
    y = np.cross(n, x)
    turn = (twist * np.arange(N))[:, None, None, None]
    x = np.cos(turn) * x + np.sin(turn) * y
    away = (codes >= RELOCATE)[:, None, :, None]
    down = np.broadcast_to([0.0, 0.0, -1.0], (N, M, 1, 3))
    slides = (np.array(support) == SLIDE)[:, None, None, None]
    return Course(
        segment=np.array(segment),
        object_position=t * [0.0, 0.0, 0.01],
        object_rotation=R,
        joints=np.sin(t + np.arange(2 * k)),
        V=codes,
        twist=0.01 * np.ones((N, k, 4)) * (codes < RELOCATE)[..., None],
        p_OC_O=np.where(away, np.nan, 0.05 * n),
        n_O=np.where(away, np.nan, n),
        x_O=np.where(away, np.nan, x),
        support_mode=np.array(support, np.int8)[:, None],
        support_p_O=0.05 * np.einsum("nmba,nmcb->nmca", R, down),
        support_n_W=-down,
        support_t_W=np.where(slides, np.broadcast_to([0.6, 0.8, 0.0], down.shape), 0.0),
        moves=np.ones(N, bool),
    )


@pytest.fixture(scope="module")
def course() -> Course:
    """Everything at once: rolls, a relocation, slides over several intervals, a support that is left, two segments."""
    V = [
        [STAY, ROLL, STAY, STAY],
        [STAY, STAY, ROLL, STAY],
        [STAY, STAY, STAY, RELOCATE],
        [SLIDE_X, STAY, STAY, STAY],
        [SLIDE_X, STAY, STAY, STAY],
        [STAY, RELOCATE, STAY, STAY],
        [STAY, OFF, STAY, STAY],
    ]
    return course_of(V, [STICK, SLIDE, SLIDE, NONE, NONE, NONE, NONE], [0, 0, 0, 0, 1, 1, 1])


@pytest.fixture(scope="module")
def whole(course: Course) -> Course:
    return with_hand_overs(course)


@pytest.fixture(scope="module")
def contacts(whole: Course) -> Contacts:
    return contacts_of(whole, HAND, np.array([0.5]), GRAVITY)


@pytest.fixture(scope="module")
def f(contacts: Contacts) -> Array:
    found = forces(contacts, RESERVE, Loads())
    assert not isinstance(found, Failure), found
    return found


def test_hand_overs_stand_exactly_where_the_modes_change(course: Course, whole: Course) -> None:
    """After intervals 0 (support slides), 1, 2 (agent 3 leaves and comes, the support is left), 4 and none else."""
    np.testing.assert_array_equal(np.flatnonzero(changes(course)), [0, 1, 2, 4])
    np.testing.assert_array_equal(np.flatnonzero(~whole.moves), [1, 3, 5, 8])
    np.testing.assert_array_equal(whole.segment, [0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1])
    for each in fields(course):
        np.testing.assert_array_equal(getattr(whole, each.name)[whole.moves], getattr(course, each.name))


def test_in_a_hand_over_nothing_moves_and_both_sets_are_in_contact(whole: Course) -> None:
    for j in np.flatnonzero(~whole.moves):
        for name in ("object_position", "object_rotation", "joints", "p_OC_O", "n_O", "x_O", "support_p_O"):
            array = getattr(whole, name)
            np.testing.assert_array_equal(array[j], np.broadcast_to(array[j, 0], array[j].shape), err_msg=name)
        for name in ("object_position", "object_rotation", "joints"):
            np.testing.assert_array_equal(getattr(whole, name)[j, 0], getattr(whole, name)[j - 1, -1], err_msg=name)
        assert not whole.twist[j].any()
        for i in range(whole.V.shape[1]):
            beside = [h for h in (j - 1, j + 1) if whole.V[h, i] < RELOCATE]
            assert whole.V[j, i] == (STAY if beside else OFF)
            for h in beside:
                np.testing.assert_allclose(whole.p_OC_O[j, 0, i], whole.p_OC_O[h, -1 if h < j else 0, i], atol=1e-15)
        beside = whole.support_mode[[j - 1, j + 1]].any(axis=0)
        np.testing.assert_array_equal(whole.support_mode[j], np.where(beside, STICK, NONE))


def test_an_agent_that_lands_and_leaves_at_once_is_off_in_the_hand_over() -> None:
    V = [[STAY] * 4, [STAY, STAY, STAY, RELOCATE], [STAY, STAY, SLIDE_X, RELOCATE], [STAY] * 4]
    whole = with_hand_overs(course_of(V, [NONE] * 4, [0] * 4))
    np.testing.assert_array_equal(whole.V[:, 3], [STAY, STAY, RELOCATE, OFF, RELOCATE, STAY, STAY])
    assert np.isnan(whole.p_OC_O[3, :, 3]).all()


def test_a_slide_that_turns_is_handed_over_and_one_that_goes_on_is_not() -> None:
    V = [[STAY, STAY, STAY, code] for code in (5, 5, 6, 7)]
    np.testing.assert_array_equal(changes(course_of(V, [NONE] * 4, [0] * 4)), [False, True, True])
    assert changes(course_of(V[:2] * 2, [NONE] * 4, [0] * 4, twist=0.2)).all()


def test_the_object_is_in_equilibrium_at_every_sample(contacts: Contacts, f: Array) -> None:
    assert np.abs(residual(contacts, f)).max() < 1e-9


def test_the_wrench_is_that_of_the_textbook(whole: Course, f: Array) -> None:
    """Σ f = m g upwards and Σ (p − p_M) × f = 0, all told in W from the course's own arrays."""
    for j, s in np.ndindex(f.shape[:2]):
        R = whole.object_rotation[j, s]
        arms = np.vstack([whole.p_OC_O[j, s], whole.support_p_O[j, s]]) - HAND.p_OM_O
        torque = np.cross(np.nan_to_num(arms) @ R.T, f[j, s]).sum(axis=0) / HAND.radius
        np.testing.assert_allclose(f[j, s].sum(axis=0), [0.0, 0.0, 1.0], atol=1e-9)
        np.testing.assert_allclose(torque, 0.0, atol=1e-9)


def test_forces_are_continuous_but_where_a_slide_jumps(contacts: Contacts, f: Array) -> None:
    jump = np.abs(f[1:, 0] - f[:-1, -1]).max(axis=(1, 2))
    slides = np.any((contacts.mode[1:] == SLIDE) & (contacts.mode[:-1] == SLIDE), axis=1)
    assert slides.sum() == 1  # agent 0 slides on; the support's slide is interrupted by a hand-over
    assert jump[slides].min() > 1e-5  # so that the test sees jumps
    assert jump[~slides].max() < 1e-6
    assert jump[slides].max() < 0.03


def test_a_contact_bears_nothing_as_it_lifts_off_and_touches_down(whole: Course, f: Array) -> None:
    bears = whole.mode != NONE
    starts = ~bears[:-1] & bears[1:]
    ends = bears[:-1] & ~bears[1:]
    assert starts.any()
    assert ends.any()
    assert not f[1:, 0][starts].any()
    assert not f[:-1, -1][ends].any()
    assert not np.moveaxis(f, 1, 2)[~bears].any()
    for j in np.flatnonzero(~whole.moves):
        leaves, lands = bears[j - 1] & ~bears[j + 1], bears[j + 1] & ~bears[j - 1]
        size = np.linalg.norm(f[j], axis=-1)
        assert size[0, leaves & (np.arange(5) < 4)].min(initial=1.0) >= RESERVE.grip - 1e-6
        assert size[-1, lands].min(initial=1.0) >= RESERVE.grip - 1e-6


def asked(contacts: Contacts, margins: Margins, j: int, s: int) -> Array:
    """(C,): what contacts have to spare at a sample of interval j, by their definition."""
    sticks, least = np.flatnonzero(contacts.mode[j] == STICK), np.zeros(len(contacts.mu))
    sigma = np.zeros(len(least))
    sigma[sticks] = springs.shares(contacts.p_W[j, s, sticks], contacts.shifts, contacts.turns)
    bears = (contacts.mode[j] != NONE) & contacts.grips
    least[bears] = springs.to_spare(margins, contacts.mu, sigma, contacts.cap)[bears]
    return least


def test_friction_limits_and_what_is_to_spare_are_kept(contacts: Contacts, f: Array) -> None:
    """At the ends of intervals in which something moves; true cones and limits everywhere."""
    assert excess(contacts, f).max() <= WITHIN
    normal = np.sum(f * contacts.inward_W, axis=-1)
    across = np.linalg.norm(f - normal[..., None] * contacts.inward_W, axis=-1)
    lag = f - normal[..., None] * (contacts.inward_W + contacts.mu[:, None] * contacts.slip_W)
    found = []
    for j in np.flatnonzero(contacts.moves):
        sticks, slides = contacts.mode[j] == STICK, contacts.mode[j] == SLIDE
        assert np.abs(lag[j][:, slides]).max(initial=0.0) < 1e-9
        for s in (0, M - 1):
            least = asked(contacts, RESERVE, j, s)
            assert np.all((across[j, s] - (1 - MARGIN) * contacts.mu * (normal[j, s] - least))[sticks] < 1e-6)
            assert np.all((normal[j, s] - least)[slides] > -1e-6)
            assert np.all(normal[j, s, slides & contacts.grips] < RESERVE.slide + 1e-6)
            found.append(least[sticks & contacts.grips])
    assert np.ptp(np.concatenate(found)) > 0.02  # three contacts, and the support that sticks, make a difference
    assert normal[..., contacts.grips].max() < 3.0
    has, wanted, _ = most_lacking(contacts, f, RESERVE)
    assert abs(has - wanted) < 1e-6  # somewhere it is all used


def still(p: Array, mu: float = 0.5, cap: float = np.inf, load: tuple[float, float, float] = (0, 0, 1)) -> Contacts:
    """Contacts at points p (C, 3) of the unit sphere that rest for two intervals."""
    C = len(p)
    points = np.broadcast_to(p, (2, M, C, 3)).astype(float)
    return Contacts(
        np.full((2, C), STICK, np.int8), points, -points, np.zeros_like(points), np.full(C, mu), np.full(C, cap),
        np.ones(C, bool), np.ones(3), np.ones(3), np.array(load, float), np.ones(2, bool), np.zeros(2, np.int64),
    )  # fmt: skip


def circle(count: int) -> Array:
    """Points (count, 3) on the unit circle about z."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


@pytest.mark.parametrize("mu", [0.5, 5.0])
@pytest.mark.parametrize(("grip", "disturbance"), [(0.0, 0.0), (0.1, 0.0), (0.05, 0.1)])
@pytest.mark.parametrize("count", [3, 4])
def test_symmetric_fingers_share_the_weight_evenly(count: int, mu: float, grip: float, disturbance: float) -> None:
    """Each carries its part across its normal and presses as hard as friction asks for that, and has its s to spare above:
    of a disturbance σ² = 3/C² + 1 / (C + SOFT)² + 1 / (C/2 + SOFT)²."""
    p = circle(count)
    sigma = np.sqrt(3 / count**2 + 1 / (count + SOFT) ** 2 + 1 / (count / 2 + SOFT) ** 2)
    squeeze = 1 / count / (mu * (1 - MARGIN)) + grip + disturbance * sigma * np.sqrt(1 + 1 / mu**2)
    contacts, margins = still(p, mu), Margins(MARGIN, grip, disturbance, np.inf)
    f = forces(contacts, margins, Loads())
    np.testing.assert_allclose(f, np.broadcast_to([0, 0, 1 / count] - squeeze * p, f.shape), atol=1e-6)
    has, wanted, _ = most_lacking(contacts, f, margins)
    assert (has, wanted) == pytest.approx((grip + disturbance * sigma * np.sqrt(1 + 1 / mu**2),) * 2, abs=1e-6)


def test_two_fingers_press_an_unloaded_ball_with_what_they_have_to_spare() -> None:
    p = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    for grip, disturbance in ((0.2, 0.0), (0.2, 0.1)):
        f = forces(still(p, load=(0, 0, 0)), Margins(MARGIN, grip, disturbance, np.inf), Loads())
        spared = grip + disturbance * np.sqrt(3 / 4 + 2 / (2 + SOFT) ** 2) * np.sqrt(5.0)
        np.testing.assert_allclose(f, np.broadcast_to(-spared * p, f.shape), atol=1e-6)


def test_a_narrow_grasp_presses_harder_than_a_wide_one() -> None:
    """Unloaded pairs at a height over each other: the turn across them is borne at a lever that is their distance."""
    pressed = []
    for half in (0.9, 0.5, 0.2):
        p = np.array([[half, 0, 0.0], [-half, 0, 0.0]])
        contacts = replace(still(p, load=(0, 0, 0)), inward_W=np.broadcast_to(-p / half, (2, M, 2, 3)))
        f = forces(contacts, RESERVE, Loads())
        pressed.append(np.linalg.norm(f[0, 0, 0]))
    assert pressed[0] < pressed[1] < pressed[2]


def test_without_friction_a_force_is_normal() -> None:
    f = forces(still(np.array([[0.0, 0, -1]]), mu=0.0), Margins(MARGIN, 0.1, 0.1, np.inf), Loads())
    np.testing.assert_allclose(f, np.broadcast_to([0.0, 0, 1], f.shape), atol=1e-7)


def objective(f: Array, smoothness: float) -> float:
    """∫ |f|² + ω |f'|² over the intervals, by the trapezoidal rule with the ends (B, C, 3) of B − 1 intervals."""
    size = np.sum(f**2, axis=(1, 2))
    return float(np.sum(0.5 * (size[1:] + size[:-1])) + smoothness * np.sum(np.diff(f, axis=0) ** 2))


@pytest.mark.parametrize("smoothness", [0.0, 1.0, 30.0])
def test_no_other_forces_are_better(smoothness: float) -> None:
    """Random ones that balance and keep friction and what is to spare, and all on the way there: from the best it goes up
    all ways."""
    rng = np.random.default_rng(0)
    contacts = contacts_of(course_of([[STAY] * 4] * 5, [NONE] * 5, [0] * 5), HAND, np.array([0.5]), GRAVITY)
    at = [(0, 0), *((j, M - 1) for j in range(5))]

    def ends(margins: Margins, settings: Loads) -> Array:
        f = forces(contacts, margins, settings)
        return np.array([f[a] for a in at])[:, :4]

    best, inside = ends(RESERVE, Loads(smoothness=smoothness)), ends(Margins(0.3, 0.6, 0.0, np.inf), Loads())
    least = np.array([asked(contacts, RESERVE, *a) for a in at])[:, :4]
    p, n_in = (np.array([array[a] for a in at])[:, :4] for array in (contacts.p_W, contacts.inward_W))
    crosses = [[np.cross(p[b, c], np.eye(3)).T for c in range(4)] for b in range(len(at))]
    null = [np.linalg.svd(np.vstack([np.tile(np.eye(3), 4), np.hstack(row)]))[2][6:] for row in crosses]
    kept = 0
    for _ in range(3000):
        factors = rng.normal(size=(len(at), 6)) * rng.random((len(at), 1)) ** 3
        step = np.array([row @ basis for row, basis in zip(factors, null, strict=True)]).reshape(best.shape)
        other = inside + 10.0 ** rng.uniform(-2, 0) * step
        normal = np.sum(other * n_in, axis=-1)
        across = np.linalg.norm(other - normal[..., None] * n_in, axis=-1)
        if np.all(across <= (1 - MARGIN) * 0.8 * (normal - least)):
            kept += 1
            for part in (1e-3, 1e-2, 0.1, 1.0):
                assert objective(best + part * (other - best), smoothness) > objective(best, smoothness) - 1e-7
    assert kept > 300


@pytest.mark.parametrize("smoothness", [0.0, 3.0])
def test_the_quadratic_program_has_the_sum_of_squares_and_of_changes(contacts: Contacts, smoothness: float) -> None:
    """½ xᵀ P x is Σ span |f|² + ω Σ |Δf|² / gap of the forces that x stands for, summed node by node."""
    nodes = nodes_of(contacts, MARGIN, np.zeros(len(contacts.mode), bool))
    column = np.where(nodes.free, np.cumsum(nodes.free).reshape(nodes.free.shape) - 1, -1)
    width = int(np.sum(nodes.free)) + 2
    found = cones.objective(nodes, column, width, smoothness)
    upper = csc_matrix((found.data, found.indices, found.indptr), found.shape).toarray()
    np.testing.assert_array_equal(np.tril(upper, -1), 0.0)
    P = upper + np.triu(upper, 1).T
    x = np.random.default_rng(0).normal(size=width)
    f = np.einsum("bcae,bce->bca", nodes.basis, np.where(nodes.free, x[column], 0.0))
    step = np.sum(np.diff(f, axis=0) ** 2, axis=(1, 2))
    change = sum(s * (1.0 / gap if gap > 0.0 else JOIN) for s, gap in zip(step, nodes.gap, strict=True))
    total = np.sum(nodes.span[:, None, None] * f**2) + smoothness * change
    assert 0.5 * x @ P @ x == pytest.approx(total, rel=1e-12)


def test_compressed_columns_are_scipys() -> None:
    """With empty rows and columns, first and last ones too."""
    dense = np.zeros((5, 7))
    dense[[1, 3, 0, 3], [4, 1, 4, 5]] = [1.0, -2.0, 3.0, 4.0]
    row, column = np.nonzero(dense)
    order = np.random.default_rng(0).permutation(len(row))
    ours, theirs = sparse(dense[row, column][order], row[order], column[order], dense.shape), csc_matrix(dense)
    for name in ("data", "indices", "indptr"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


def test_smoothness_buys_even_forces_with_larger_ones(contacts: Contacts) -> None:
    change, size = [], []
    for smoothness in (0.0, 1.0, 100.0):
        f = forces(contacts, RESERVE, Loads(smoothness=smoothness))
        ends = np.concatenate([f[:1, 0], f[:, -1]])
        change.append(np.sum(np.diff(ends, axis=0) ** 2))
        size.append(objective(ends, 0.0))
    assert change[0] > change[1] > change[2]
    assert size[0] < size[1] < size[2]


def swinging() -> Contacts:
    """One interval in which two of three contacts roll a long way towards each other."""
    contacts = still(np.eye(3), mu=0.45)
    u = np.linspace(0.0, 1.0, M)[None, :, None]
    angle = 2 * np.pi * np.arange(3) / 3 + 0.9 * u * np.array([1.0, -1.0, 0.0])
    p = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    return replace(contacts, p_W=np.repeat(p, 2, axis=0), inward_W=-np.repeat(p, 2, axis=0))


def test_where_interpolated_forces_pass_the_cone_the_program_has_every_sample() -> None:
    contacts = swinging()
    contacts = replace(
        contacts,
        **{name: getattr(contacts, name)[:1] for name in ("mode", "p_W", "inward_W", "slip_W", "moves", "segment")},
    )
    margins = Margins(0.0, 0.0, 0.0, np.inf)
    nodes = nodes_of(contacts, 0.0, np.zeros(1, bool))
    ends = solve(contacts, nodes, margins, 1.0)
    assert ends is not None
    assert excess(contacts, between(contacts, nodes, ends, 0.0)).max() > 1e-3
    f = forces(contacts, margins, Loads())
    assert excess(contacts, f).max() <= WITHIN
    assert np.abs(residual(contacts, f)).max() < 1e-9


def test_a_course_that_jumps_is_refused() -> None:
    """One contact of an interval is elsewhere than it was: forces at the instant between balance on one side only, and where
    nothing is to spare, what would make them balance on the other leaves the cones."""
    course = course_of([[STAY] * 4] * 4, [NONE] * 4, [0] * 4)
    contacts = contacts_of(course, HAND, np.array([0.5]), GRAVITY)
    moved = contacts.p_W.copy(), contacts.inward_W.copy()
    for array in moved:
        array[2, :, 3] = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]) @ array[2, 0, 3]
    found = forces(replace(contacts, p_W=moved[0], inward_W=moved[1]), Margins(MARGIN, 0.0, 0.0, np.inf), Loads())
    assert isinstance(found, Failure)
    assert found.where == "the whole way"


def test_what_no_forces_hold_is_said_with_its_place() -> None:
    V = [[STAY] * 4, [STAY] * 4, [STAY, OFF, OFF, OFF], [STAY] * 4]
    course = with_hand_overs(course_of(V, [NONE] * 4, [0, 1, 1, 1]))
    found = forces(contacts_of(course, HAND, np.array([0.5]), GRAVITY), RESERVE, Loads())
    assert isinstance(found, Failure)
    assert found.constraint == "equilibrium"
    assert found.where == "segment 2, interval 2 of 3"
    assert "friction" in found.remedy


@pytest.mark.parametrize("margins", [Margins(MARGIN, 0.0, 0.0, np.inf), RESERVE])
def test_a_load_above_the_limits_is_not_held_and_one_below_is_whatever_there_is_to_spare(margins: Margins) -> None:
    needed = 1 / 3 / (0.5 * (1 - MARGIN))
    assert isinstance(forces(still(circle(3), cap=0.99 * needed), margins, Loads()), Failure)
    assert not isinstance(forces(still(circle(3), cap=1.01 * needed), margins, Loads()), Failure)


def test_what_cannot_be_spared_is_missed_by_as_little_as_possible_and_said() -> None:
    """Three fingers whose limit leaves less than asked beside the weight: they press with the limit, and each has all that
    friction leaves of it. A limit that leaves enough is not reached, and nothing is said."""
    needed, p = 1 / 3 / (0.5 * (1 - MARGIN)), circle(3)
    contacts, margins = still(p, cap=1.2), Margins(MARGIN, 0.5, 0.0, np.inf)
    f = forces(contacts, margins, Loads())
    assert not isinstance(f, Failure)
    np.testing.assert_allclose(f, np.broadcast_to([0, 0, 1 / 3] - 1.2 * p, f.shape), atol=1e-6)
    has, wanted, (j, i) = most_lacking(contacts, f, margins)
    assert (has, wanted) == pytest.approx((1.2 - needed, 0.5), abs=1e-6)
    said = remarks(contacts, f, margins, ("a", "b", "c"))
    assert said == (
        f"{'abc'[i]} has 0.46 of 0.5 weights to spare in segment 1, interval {j + 1} of 2 "
        "(planner.local.energy.grip and .disturbance ask for them)",
    )
    contacts = still(p, cap=needed + 0.51)
    assert not remarks(contacts, forces(contacts, margins, Loads()), margins, ("a", "b", "c"))


def test_only_who_must_gives_up_what_it_has_to_spare() -> None:
    """Four fingers push the ball along +x: finger 2 with its limit of 0.35, 1 and 3 by friction with 0.45 of what their
    limits, 0.4, leave above the 0.2 to spare. For a push of 0.4 finger 0, against it, has to give way to 0.13: nobody else
    gains as much by giving up the same."""
    contacts = replace(still(circle(4), load=(0.4, 0, 0)), cap=np.array([np.inf, 0.4, 0.35, 0.4]))
    f = forces(contacts, Margins(MARGIN, 0.2, 0.0, np.inf), Loads())
    expected = np.array([[-0.13, 0, 0], [0.09, -0.4, 0], [0.35, 0, 0], [0.09, 0.4, 0]])
    np.testing.assert_allclose(f, np.broadcast_to(expected, f.shape), atol=1e-6)


def test_what_a_sliding_finger_may_press_is_limited() -> None:
    """One that slides below the ball bears its part of the weight, and with a limit no more than that; the rest is the
    others'."""
    contacts = still(np.vstack([circle(4), [0.0, 0.0, -1.0]]))
    slip = np.zeros_like(contacts.p_W)
    slip[:, :, 4, 0] = 1.0
    mode = contacts.mode.copy()
    mode[:, 4] = SLIDE
    contacts, margins = replace(contacts, mode=mode, slip_W=slip), Margins(MARGIN, 0.1, 0.0, np.inf)
    free, limited = (forces(contacts, replace(margins, slide=slide), Loads()) for slide in (np.inf, 0.3))
    assert free[..., 4, 2].min() > 0.34
    np.testing.assert_allclose(limited[..., 4, :], np.broadcast_to([0.15, 0.0, 0.3], (2, M, 3)), atol=1e-6)
    np.testing.assert_allclose(
        limited[..., :4, :].sum(axis=2), np.broadcast_to([-0.15, 0.0, 0.7], (2, M, 3)), atol=1e-6
    )


def test_a_hand_over_lasts_as_long_as_its_forces_take_to_pass(whole: Course, f: Array) -> None:
    timing = Timing(force_rate=0.5, settle=0.01)
    owner, speeds = np.repeat(np.arange(4), 2), np.full(8, np.pi)
    lasts = durations(whole, f[:, :, :4], owner, speeds, HAND.radius, timing)
    for j in np.flatnonzero(~whole.moves):
        change = np.linalg.norm(f[j, -1, :4] - f[j, 0, :4], axis=-1).max()
        assert lasts[j] == pytest.approx(max(change / 0.5, 0.01))
    patient = durations(whole, f[:, :, :4], owner, speeds, HAND.radius, Timing(settle=7.0))
    np.testing.assert_array_equal(patient == 7.0, ~whole.moves)


def test_bases_are_orthonormal(contacts: Contacts) -> None:
    ray, basis, free = bases(contacts, MARGIN)
    product = np.einsum("nmcae,nmcaf->nmcef", basis, basis)
    used = free[..., :, None] & free[..., None, :]
    np.testing.assert_allclose(product[used], np.broadcast_to(np.eye(3), product.shape)[used], atol=1e-12)
    np.testing.assert_array_equal(free.sum(axis=-1)[ray], 1)
