"""Hand-overs and the plan's forces, on courses made by hand: balance, continuity, friction, optimality, failure in words."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from regrasp.plan import NONE, OFF, RELOCATE, SLIDE, STAY, STICK
from regrasp.planner.cones import nodes_of, solve
from regrasp.planner.contacts import Contacts, bases, contacts_of, excess, residual
from regrasp.planner.course import Course, changes, with_hand_overs
from regrasp.planner.loads import WITHIN, Loads, between, forces, least_grip
from regrasp.planner.outcome import Failure
from regrasp.planner.timing import Timing, durations

Array = NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, -9.81])
ROLL, SLIDE_X = 1, 5
MARGIN = 0.1
M = 6
HAND = SimpleNamespace(mu=np.full(4, 0.8), cap=np.full(4, 3.0), radius=0.05, p_OM_O=np.array([1e-3, 0.0, -2e-3]))


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
    found = forces(contacts, MARGIN, Loads())
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
        assert size[0, leaves & (np.arange(5) < 4)].min(initial=1.0) >= 0.1 - 1e-6
        assert size[-1, lands].min(initial=1.0) >= 0.1 - 1e-6


def test_friction_limits_and_grip_are_kept(contacts: Contacts, f: Array) -> None:
    assert excess(contacts, f).max() <= WITHIN
    normal = np.sum(f * contacts.inward_W, axis=-1)
    across = np.linalg.norm(f - normal[..., None] * contacts.inward_W, axis=-1)
    sticks, slides = ((contacts.mode == mode)[:, None] & contacts.moves[:, None, None] for mode in (STICK, SLIDE))
    ends = np.zeros((1, M, 1), bool)
    ends[:, [0, -1]] = True
    assert np.where(sticks & ends, across - (1 - MARGIN) * contacts.mu * normal, 0.0).max() < 1e-6
    lag = f - normal[..., None] * (contacts.inward_W + contacts.mu[:, None] * contacts.slip_W)
    assert np.where(slides[..., None], np.abs(lag), 0.0).max() < 1e-9
    presses = (sticks | slides) & ends & contacts.grips
    assert np.where(presses, normal, 1.0).min() > 0.1 - 1e-6
    assert normal[..., contacts.grips].max() < 3.0


def still(p: Array, mu: float = 0.5, cap: float = np.inf, load: tuple[float, float, float] = (0, 0, 1)) -> Contacts:
    """Contacts at points p (C, 3) of the unit sphere that rest for two intervals."""
    C = len(p)
    points = np.broadcast_to(p, (2, M, C, 3)).astype(float)
    return Contacts(
        np.full((2, C), STICK, np.int8), points, -points, np.zeros_like(points), np.full(C, mu), np.full(C, cap),
        np.ones(C, bool), np.array(load, float), np.ones(2, bool), np.zeros(2, np.int64),
    )  # fmt: skip


@pytest.mark.parametrize(("mu", "squeeze"), [(0.5, 1 / 3 / 0.45), (5.0, 0.1)])
def test_three_symmetric_fingers_share_the_weight_evenly(mu: float, squeeze: float) -> None:
    """Each carries a third across its normal and presses as hard as friction, or else the grip, asks for."""
    angle = 2 * np.pi * np.arange(3) / 3
    p = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    f = forces(still(p, mu), MARGIN, Loads())
    np.testing.assert_allclose(f, np.broadcast_to([0, 0, 1 / 3] - squeeze * p, f.shape), atol=1e-6)


def test_two_fingers_press_an_unloaded_ball_with_the_grip() -> None:
    p = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    f = forces(still(p, load=(0, 0, 0)), MARGIN, Loads(grip=0.2))
    np.testing.assert_allclose(f, np.broadcast_to(-0.2 * p, f.shape), atol=1e-6)


def test_without_friction_a_force_is_normal() -> None:
    f = forces(still(np.array([[0.0, 0, -1]]), mu=0.0), MARGIN, Loads())
    np.testing.assert_allclose(f, np.broadcast_to([0.0, 0, 1], f.shape), atol=1e-7)


def objective(f: Array, smoothness: float) -> float:
    """∫ |f|² + ω |f'|² over the intervals, by the trapezoidal rule with the ends (B, C, 3) of B − 1 intervals."""
    size = np.sum(f**2, axis=(1, 2))
    return float(np.sum(0.5 * (size[1:] + size[:-1])) + smoothness * np.sum(np.diff(f, axis=0) ** 2))


@pytest.mark.parametrize("smoothness", [0.0, 1.0, 30.0])
def test_no_other_forces_are_better(smoothness: float) -> None:
    """Random ones that balance and keep friction and grip, and all on the way there: from the best it goes up all ways."""
    rng = np.random.default_rng(0)
    contacts = contacts_of(course_of([[STAY] * 4] * 5, [NONE] * 5, [0] * 5), HAND, np.array([0.5]), GRAVITY)
    at = [(0, 0), *((j, M - 1) for j in range(5))]

    def ends(margin: float, settings: Loads) -> Array:
        f = forces(contacts, margin, settings)
        return np.array([f[a] for a in at])[:, :4]

    best, inside = ends(MARGIN, Loads(smoothness=smoothness)), ends(0.3, Loads(grip=0.6))
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
        if np.all(across <= (1 - MARGIN) * 0.8 * normal) and np.all(normal >= 0.1):
            kept += 1
            for part in (1e-3, 1e-2, 0.1, 1.0):
                assert objective(best + part * (other - best), smoothness) > objective(best, smoothness) - 1e-7
    assert kept > 300


def test_smoothness_buys_even_forces_with_larger_ones(contacts: Contacts) -> None:
    change, size = [], []
    for smoothness in (0.0, 1.0, 100.0):
        f = forces(contacts, MARGIN, Loads(smoothness=smoothness))
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
    nodes = nodes_of(contacts, 0.0, np.zeros(1, bool))
    ends = solve(contacts, nodes, 0.0, 0.1, 1.0)
    assert ends is not None
    assert excess(contacts, between(contacts, nodes, ends, 0.0)).max() > 1e-3
    f = forces(contacts, 0.0, Loads())
    assert excess(contacts, f).max() <= WITHIN
    assert np.abs(residual(contacts, f)).max() < 1e-9


def test_a_course_that_jumps_is_refused() -> None:
    """One contact of an interval is elsewhere than it was: no force at the instant between balances on both sides."""
    course = course_of([[STAY] * 4] * 4, [NONE] * 4, [0] * 4)
    contacts = contacts_of(course, HAND, np.array([0.5]), GRAVITY)
    moved = contacts.p_W.copy(), contacts.inward_W.copy()
    for array in moved:
        array[2, :, 3] = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]) @ array[2, 0, 3]
    found = forces(replace(contacts, p_W=moved[0], inward_W=moved[1]), MARGIN, Loads())
    assert isinstance(found, Failure)
    assert found.where == "the whole way"


def test_what_no_forces_hold_is_said_with_its_place() -> None:
    V = [[STAY] * 4, [STAY] * 4, [STAY, OFF, OFF, OFF], [STAY] * 4]
    course = with_hand_overs(course_of(V, [NONE] * 4, [0, 1, 1, 1]))
    found = forces(contacts_of(course, HAND, np.array([0.5]), GRAVITY), MARGIN, Loads())
    assert isinstance(found, Failure)
    assert found.constraint == "equilibrium"
    assert found.where == "segment 2, interval 2 of 3"
    assert "friction" in found.remedy


def test_a_load_above_the_limits_is_not_held() -> None:
    angle = 2 * np.pi * np.arange(3) / 3
    p = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    needed = 1 / 3 / (0.5 * (1 - MARGIN))
    assert isinstance(forces(still(p, cap=0.99 * needed), MARGIN, Loads()), Failure)
    assert not isinstance(forces(still(p, cap=1.01 * needed), MARGIN, Loads()), Failure)


def test_a_grip_that_cannot_be_kept_is_missed_by_as_little_as_possible() -> None:
    p = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    contacts = still(p, cap=0.3, load=(0, 0, 0))
    f = forces(contacts, MARGIN, Loads(grip=0.5))
    assert not isinstance(f, Failure)
    np.testing.assert_allclose(f, np.broadcast_to(-0.3 * p, f.shape), atol=1e-6)
    assert least_grip(contacts, f)[0] == pytest.approx(0.3, abs=1e-6)


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
