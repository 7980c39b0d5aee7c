"""Perturbed worlds: uniform within their ranges, possible for the scene, the same for the same seed; Wilson's interval."""

import dataclasses

import numpy as np
import pytest
from armed import armed
from scipy.stats import kstest

from regrasp.errors import InputError
from regrasp.plan import NONE, STICK, Plan
from regrasp.scene.world import World, from_plan
from regrasp.settings import read
from regrasp.verify.replay import replay
from regrasp.verify.trials import Perturbation, draw, possible, wilson

RANGES = Perturbation(friction=0.3, mass=0.1, position=2e-3, rotation=0.05, timing=0.01)
COUNT = 400


def draws(plan: Plan, world: World, ranges: Perturbation = RANGES, count: int = COUNT):
    return [draw(plan, world, ranges, np.random.default_rng([9, n])) for n in range(count)]


def free(plan: Plan, freedoms: list[str]) -> World:
    return from_plan({**plan.scene, "freedoms": freedoms}, plan.xml, plan.assets)


def test_everything_drawn_is_uniform_in_its_range(handmade):
    plan, world = handmade["carry"]
    found = draws(plan, world)
    columns = {
        "friction": (np.array([each.friction for each in found]), 0.7, 1.3),
        "mass": (np.array([[each.mass] for each in found]), 0.9, 1.1),
        "shift": (np.array([each.shift for each in found]), -2e-3, 2e-3),
        "turn": (np.array([each.turn for each in found]), -0.05, 0.05),
    }
    samples = []
    for name, (values, low, high) in columns.items():
        for column in values.T:
            assert kstest(column, "uniform", (low, high - low)).pvalue > 1e-4, name
            samples.append((column - low) / (high - low))
    correlation = np.corrcoef(samples)[~np.eye(len(samples), dtype=bool)]
    assert np.abs(correlation).max() < 4.5 / np.sqrt(COUNT)  # each drawn on its own
    assert {each.delay for each in found} == {RANGES.timing}
    assert {each.noise for each in found} == {(RANGES.noise_position, RANGES.noise_rotation)}


def test_every_tip_and_support_has_its_own_friction(handmade):
    for name in ("roll", "push", "finger"):
        plan, world = handmade[name]
        reality = draws(plan, world, count=1)[0]
        assert len(set(reality.friction)) == len(world.agents) + len(world.support_geoms)


def test_without_ranges_the_world_is_as_planned(handmade):
    plan, world = handmade["push"]
    nothing = Perturbation(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for each in draws(plan, world, nothing, 5):
        assert np.all(each.friction == 1.0)
        assert each.mass == 1.0
        assert not each.shift.any()
        assert not each.turn.any()
        assert (each.delay, each.noise) == (0.0, (0.0, 0.0))


@pytest.mark.parametrize("freedoms", [["x"], ["x", "z", "ry"], ["rx", "ry", "rz"], ["y", "rz"]])
def test_only_the_scenes_freedoms_are_disturbed(handmade, freedoms):
    """The handmade hold stays where it is, so that its scene allows any freedoms."""
    plan, _ = handmade["hold"]
    for each in draws(plan, free(plan, freedoms), count=20):
        moved = np.concatenate([each.shift, each.turn]) != 0.0
        assert np.array_equal(moved, [name in freedoms for name in ("x", "y", "z", "rx", "ry", "rz")])


def standing(plan: Plan, normals: list[list[float]], modes: list[int] | None = None) -> Plan:
    """The plan with its object on supports of these normals."""
    N, M = plan.time.shape
    P = len(normals)
    n_W = np.broadcast_to(np.array(normals, dtype=float).reshape(1, 1, P, 3), (N, M, P, 3))
    return dataclasses.replace(
        plan, support_names=("table",) * P,
        support_mode=np.broadcast_to(np.array(modes or [STICK] * P, np.int8), (N, P)),
        support_n_W=n_W, support_p_O=np.zeros((N, M, P, 3)), support_force_W=np.zeros((N, M, P, 3)),
    )  # fmt: skip


SOLID = {"shape": "box", "size": [0.03, 0.02, 0.025], "rounding": 0.002, "mass": 0.2}


def shaped(plan: Plan, solid: dict[str, object] | None = None) -> World:
    """The handmade world with another solid; only its scene is looked at here."""
    world = from_plan(plan.scene, plan.xml, plan.assets)
    if solid is None:
        return world
    scene = world.scene.model_copy(update={"object": type(world.scene.object)(**solid)})
    return dataclasses.replace(world, scene=scene)


def part(vectors: np.ndarray, allowed: list[list[float]]) -> np.ndarray:
    """The nearest to each vector in the span of the allowed directions, by normal equations."""
    if not allowed:
        return np.zeros_like(vectors)
    span = np.linalg.qr(np.array(allowed, dtype=float).T)[0]
    return vectors @ span @ span.T


def check_possible(plan: Plan, world: World, shifts: list[list[float]], turns: list[list[float]]) -> None:
    drawn = np.random.default_rng(0).standard_normal((20, 2, 3))
    found = np.array([possible(plan, world, *each) for each in drawn])
    np.testing.assert_allclose(found[:, 0], part(drawn[:, 0], shifts), atol=1e-8)
    np.testing.assert_allclose(found[:, 1], part(drawn[:, 1], turns), atol=1e-8)


X, Y, Z = np.eye(3).tolist()
OBLIQUE, ALONG = [0.0, np.sqrt(0.5), np.sqrt(0.5)], [0.0, np.sqrt(0.5), -np.sqrt(0.5)]
NEARLY = [1e-9, 0.0, 1.0]
ALL = [X, Y, Z]
STANDS = [
    ([], ALL, ALL), ([Z], [X, Y], [Z]), ([Z] * 3, [X, Y], [Z]), ([Z, NEARLY], [X, Y], [Z]), ([OBLIQUE], [X, ALONG], [OBLIQUE]),
    ([Z, X], [Y], []), ([Z, OBLIQUE], [X], []), ([OBLIQUE, Z, X], [], []),
]  # fmt: skip


@pytest.mark.parametrize(("normals", "shifts", "turns"), STANDS)
def test_a_standing_object_keeps_its_supports(handmade, normals, shifts, turns):
    """It is pressed into none, lifted off none, tipped over none; a sphere may turn in its place as it likes."""
    plan = standing(handmade["hold"][0], normals)
    check_possible(plan, shaped(plan, SOLID), shifts, turns)
    check_possible(plan, shaped(plan), shifts, ALL)


@pytest.mark.parametrize(
    ("normals", "freedoms", "shifts", "turns"),
    [
        ([OBLIQUE], ("x", "y", "rz"), [X], []),  # along ALONG it would leave the plane of x and y
        ([OBLIQUE], ("y", "z", "ry", "rz"), [ALONG], [OBLIQUE]),
        ([Z], ("x", "y", "rx"), [X, Y], []),
        ([Z], ("x", "z", "rz"), [X], [Z]),
        ([Z, X], ("x", "y", "z"), [Y], []),
        ([], ("x", "rz"), [X], [Z]),
    ],
)
def test_no_support_brings_back_a_frozen_axis(handmade, normals, freedoms, shifts, turns):
    plan = standing(handmade["hold"][0], normals)
    scene = shaped(plan, SOLID).scene.model_copy(update={"freedoms": freedoms})
    check_possible(plan, dataclasses.replace(shaped(plan), scene=scene), shifts, turns)


def test_a_support_that_is_not_touched_at_the_start_does_not_count(handmade):
    plan = standing(handmade["hold"][0], [Z, X], [NONE, STICK])
    check_possible(plan, shaped(plan, SOLID), [Y, Z], [X])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *((field, value) for field in ("friction", "mass") for value in (-0.1, 1.0, np.nan)),
        *(
            (field, value)
            for field in ("position", "rotation", "timing", "noise_position")
            for value in (-1e-3, np.inf)
        ),
    ],
)
def test_impossible_ranges_are_refused(field, value):
    with pytest.raises(InputError, match=field):
        read(Perturbation, {field: value}, "perturbation")


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilsons_interval_is_the_published_one(successes, trials, low, high):
    """R. G. Newcombe, Two-sided confidence intervals for the single proportion, 1998, Table I, method 3."""
    assert wilson(successes, trials) == pytest.approx((low, high), abs=6e-5)
    mirrored = wilson(trials - successes, trials)
    assert mirrored == pytest.approx((1 - high, 1 - low), abs=6e-5)


def test_trials_depend_on_the_seed_and_not_on_the_cores(handmade):
    plan = armed(handmade["finger"][0])
    alone, shared, other = (
        replay(plan, trials=3, seed=seed, cores=cores).trials for seed, cores in ((5, 1), (5, 2), (6, 2))
    )
    assert alone == shared
    assert [each.mode for each in alone] == ["open", "feedback"]
    for before, after in zip(alone, other, strict=True):
        assert all(a.final != b.final for a, b in zip(before.trials, after.trials, strict=True))
    assert len({trial.final for each in alone for trial in each.trials}) == 6  # and no two are alike
    fewer = replay(plan, trials=2, seed=5, cores=1).trials
    assert [each.trials for each in fewer] == [each.trials[:2] for each in alone]
