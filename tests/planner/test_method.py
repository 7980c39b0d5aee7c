"""The whole method on a small scene: a plan that proves itself, the same for the same seed; bad inputs in one line."""

import dataclasses
import itertools
import json
from pathlib import Path

import numpy as np
import pytest
import springs
from arcs import arc, changed
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from regrasp.cli import main
from regrasp.plan import FIRST_SLIDE, RELOCATE, Plan
from regrasp.planner.assemble import quaternions
from regrasp.planner.chain import ContactMotions
from regrasp.planner.clock import start_clock
from regrasp.planner.local import LocalPlanner, plan_arc, terms_of
from regrasp.planner.method import plan_scene
from regrasp.planner.outcome import Failure
from regrasp.planner.path import head
from regrasp.planner.scan import new_scan
from regrasp.planner.task import Settings
from regrasp.scene.load import builtin, dump, load
from regrasp.scene.schema import Scene
from regrasp.search.annealing import Settings as Annealing
from regrasp.settings import read
from regrasp.verify.check import check

QUICK = Settings(local=LocalPlanner(annealing=Annealing(iterations=400, trials=50)))


def small() -> Scene:
    return changed(load("fig3-puma3"), goal={"pose": {"position": [0.005, 0, 0.14], "euler": [0.1, 0, 0.15]}})


def planned(seed: int) -> Plan:
    outcome = plan_scene(small(), seed, QUICK)
    assert outcome.plan is not None, str(outcome.failure)
    return outcome.plan


@pytest.fixture(scope="module")
def plan() -> Plan:
    return planned(0)


def test_the_plan_proves_itself(plan: Plan) -> None:
    certificate = check(plan)
    assert certificate.passed, [str(finding) for finding in certificate.refusals]
    assert plan.feasible


@pytest.mark.parametrize("name", ["fig2-planar", "puma4-obstacles"])
def test_a_built_in_scene_proves_itself(name: str) -> None:
    settings = dataclasses.replace(
        QUICK, local=dataclasses.replace(QUICK.local, annealing=Annealing(iterations=1500, trials=100))
    )
    outcome = plan_scene(load(name), 0, settings)
    assert outcome.plan is not None, str(outcome.failure)
    certificate = check(outcome.plan)
    assert certificate.passed, [str(finding) for finding in certificate.refusals]


def test_forces_keep_off_the_edges_of_their_cones(plan: Plan) -> None:
    """Where intervals meet, a rolling agent has its share of μ unused."""
    hand, margin = arc("fig3-puma3").hand, QUICK.local.energy.friction_margin
    R = Rotation.from_quat(plan.object_quaternion.reshape(-1, 4), scalar_first=True).as_matrix()
    n_W = np.einsum("sab,skb->ska", R, plan.n_O.reshape(len(R), -1, 3)).reshape(plan.n_O.shape)
    normal = -np.sum(plan.force_W * n_W, axis=-1)[:, [0, -1]]
    tangential = np.linalg.norm(plan.force_W[:, [0, -1]] + normal[..., None] * n_W[:, [0, -1]], axis=-1)
    rolling = np.repeat((plan.V < FIRST_SLIDE)[:, None], 2, axis=1)
    assert rolling.any()
    assert np.all((tangential - (1.0 - margin) * hand.mu * normal)[rolling] <= 1e-6 * hand.weight)
    assert np.all(normal[np.repeat((plan.V < RELOCATE)[:, None], 2, axis=1)] > -1e-6 * hand.weight)


def test_where_intervals_meet_every_agent_has_to_spare_what_it_is_asked(plan: Plan) -> None:
    """The cone of a contact that rests or rolls is moved up its normal by the grip and what keeps δ σ in it, σ from equal
    springs at all that rest or roll; a sliding agent presses with the grip and with no more than the limit for it."""
    hand, energy = arc("fig3-puma3").hand, QUICK.local.energy
    rolls, slides = plan.V < FIRST_SLIDE, (plan.V >= FIRST_SLIDE) & (plan.V < RELOCATE)
    moves = np.ptp(plan.joints, axis=1).max(axis=1) > 0.0
    asked = []
    for j, s in itertools.product(np.flatnonzero(moves), (0, -1)):
        R = Rotation.from_quat(plan.object_quaternion[j, s], scalar_first=True).as_matrix()
        f = plan.force_W[j, s] @ R / hand.weight
        normal = -np.sum(f * plan.n_O[j, s], axis=-1)
        across = np.linalg.norm(f + normal[:, None] * plan.n_O[j, s], axis=-1)
        on = np.flatnonzero(rolls[j])
        sigma = springs.shares((plan.p_OC_O[j, s, on] - hand.p_OM_O) / hand.radius)
        least = springs.to_spare(energy.margins, hand.mu[on], sigma, hand.cap[on])
        use = (1.0 - energy.friction_margin) * hand.mu[on]
        assert np.all(across[on] <= use * (normal[on] - least) + 1e-5)
        assert np.all((normal[slides[j]] > energy.grip - 1e-5) & (normal[slides[j]] < energy.slide_force + 1e-5))
        asked += list(least)
    assert np.ptp(asked) > 0.01
    assert not plan.remarks


def test_forces_that_are_not_found_are_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    said = Failure("equilibrium", "segment 1, interval 2 of 3", "object", "no contact forces hold the object", "")
    monkeypatch.setattr("regrasp.planner.assemble.forces", lambda *_: said)
    outcome = plan_scene(small(), 0, QUICK)
    assert outcome.plan is None
    assert outcome.failure == said


def test_every_interval_lasts_as_long_as_it_must_and_no_longer(plan: Plan) -> None:
    """A part of each joint's limit along the spline, the object's speed, the rate of the forces, the least durations."""
    timing, task = QUICK.timing, arc("fig3-puma3").task
    speeds = np.concatenate([agent.speed for agent in task.world.agents])
    owner = np.repeat(np.arange(len(plan.agent_names)), [len(agent.qpos) for agent in task.world.agents])
    lasts = plan.time[:, -1] - plan.time[:, 0]
    np.testing.assert_array_equal(plan.time[1:, 0], plan.time[:-1, -1])
    for j, t in enumerate(plan.time):
        rate = CubicSpline(t, plan.joints[j])(np.linspace(t[0], t[-1], 400), 1)
        free = np.any(np.ptp(plan.joints[j], axis=0)[plan.V[j, owner] >= RELOCATE] > 0.0)
        joints = np.max(np.abs(rate) / speeds) / (timing.free_speed if free else timing.speed)
        way = np.linalg.norm(np.diff(plan.object_position[j], axis=0), axis=1).sum()
        turn = Rotation.from_quat(plan.object_quaternion[j], scalar_first=True)
        angle = (turn[:-1].inv() * turn[1:]).magnitude().sum()
        surface = (way + task.hand.radius * angle) / lasts[j] / timing.object_speed
        change = np.linalg.norm(np.diff(plan.force_W[j], axis=0), axis=-1).max() / (t[1] - t[0]) / task.hand.weight
        still = np.ptp(plan.joints[j], axis=0).max() == 0.0
        least = (timing.settle if still else timing.shortest) / lasts[j]
        limits = [joints, surface, change / timing.force_rate, least]
        # The duration looks at five points between samples; the peak between two of these is hardly higher.
        assert 0.99 < max(limits) < 1.01, (j, limits)


def test_quaternions_are_unit_and_never_jump(plan: Plan) -> None:
    q = plan.object_quaternion.reshape(-1, 4)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-12)
    assert np.all(np.linalg.norm(np.diff(q, axis=0), axis=1) < 0.1)


def test_quaternions_follow_two_full_turns_without_a_jump() -> None:
    R = Rotation.from_rotvec(np.linspace(0, 4 * np.pi, 200)[:, None] * [0.6, 0.0, 0.8]).as_matrix()
    q = quaternions(R.reshape(20, 10, 3, 3)).reshape(-1, 4)
    assert np.all(np.linalg.norm(np.diff(q, axis=0), axis=1) < 0.05)
    np.testing.assert_allclose(Rotation.from_quat(q, scalar_first=True).as_matrix(), R, atol=1e-12)


def test_intervals_join(plan: Plan) -> None:
    """Each interval begins where the one before ends, to the last bit in the joints; start and goal are exact."""
    np.testing.assert_allclose(plan.joints[1:, 0], plan.joints[:-1, -1], atol=1e-12)
    np.testing.assert_array_equal(plan.object_position[1:, 0], plan.object_position[:-1, -1])
    scene = small()
    np.testing.assert_allclose(plan.object_position[0, 0], scene.start.pose.p, atol=1e-12)
    np.testing.assert_allclose(plan.object_position[-1, -1], scene.goal.pose.p, atol=1e-12)
    R = Rotation.from_quat(plan.object_quaternion[-1, -1], scalar_first=True).as_matrix()
    np.testing.assert_allclose(R, scene.goal.pose.R, atol=1e-12)


def arrays(plan: Plan) -> dict[str, np.ndarray]:
    return {
        f.name: getattr(plan, f.name) for f in dataclasses.fields(plan) if isinstance(getattr(plan, f.name), np.ndarray)
    }


def test_the_same_seed_gives_the_same_plan_and_another_seed_another(plan: Plan) -> None:
    again, other = planned(0), planned(1)
    assert len(arrays(plan)) > 15
    for name, value in arrays(plan).items():
        np.testing.assert_array_equal(value, getattr(again, name), err_msg=name)
    assert not np.array_equal(plan.V, other.V) or not np.array_equal(plan.joints, other.joints)


@pytest.mark.parametrize("name", ["fig3-puma3", "fig2-planar", "fig4-relocation"])
def test_the_number_of_threads_does_not_change_the_motion(name: str) -> None:
    """Also where the first annealing runs break a constraint and a later one counts."""
    a = arc(name)
    few = dataclasses.replace(QUICK.local, attempts=4, annealing=Annealing(iterations=60, trials=10))
    results = [
        [
            plan_arc(
                a.hand, a.path, a.grasp, a.task.names, dataclasses.replace(few, threads=threads), np.random.default_rng(seed),
                lambda _: None, "segment 1", start_clock(0.0), 1,
            )
            for seed in range(4)
        ]
        for threads in (1, 2)
    ]  # fmt: skip
    assert any(result.moves > 60 for result in results[0])
    for one, other in zip(*results, strict=True):
        np.testing.assert_array_equal(one.V, other.V)
        np.testing.assert_array_equal(one.energy, other.energy)
        np.testing.assert_array_equal(one.motion.joints, other.motion.joints)


@pytest.mark.parametrize("ahead", [0, 5])
def test_what_lies_ahead_of_a_piece_is_searched_but_does_not_count(ahead: int) -> None:
    """Motion, V and grasp end with the piece, and are those of its V along it alone, whatever comes afterwards."""
    a = arc("fig4-relocation")
    n = len(a.path.R_WO) - ahead
    result = plan_arc(
        a.hand, a.path, a.grasp, a.task.names, QUICK.local, np.random.default_rng(0), lambda _: None, "segment 1",
        start_clock(0.0), 1, ahead=ahead,
    )  # fmt: skip
    assert len(result.V) == len(result.motion.joints) == n
    whole = ContactMotions(a.hand, a.path, a.scan(), a.terms, a.grasp, np.concatenate([result.V, result.onward]))
    assert whole.energy() == pytest.approx(result.energy.min(), rel=1e-9)
    part = head(a.path, n)
    scan, terms = new_scan(a.hand, part, QUICK.local.relocation), terms_of(a.hand, QUICK.local)
    alone = ContactMotions(a.hand, part, scan, terms, a.grasp, result.V)
    np.testing.assert_allclose(result.grasp.q, alone.grasp(n).q, atol=1e-12)
    holds = alone.grasp(n).holds == 1
    np.testing.assert_allclose(result.grasp.p_OC[holds], alone.grasp(n).p_OC[holds], atol=1e-12)
    assert (result.failure is None) == (not result.motion.violations)
    np.testing.assert_allclose(result.motion.joints[-1, -1], result.grasp.q, atol=1e-9)


@pytest.mark.parametrize("limit", [1e-3, 0.1])
@pytest.mark.parametrize("name", builtin())
def test_a_run_that_is_short_of_time_says_what_it_has(name: str, limit: float) -> None:
    """Either a plan that proves itself, or the reason and a plan that says that it is not feasible and whose answer can be
    printed; `check` looks at it without failing, and refuses it where it does not end at the goal."""
    for seed in range(2):
        scene = load(name)
        outcome = plan_scene(scene, seed, dataclasses.replace(read(Settings, scene.planner), time_limit=limit))
        plan = outcome.plan
        assert plan is not None
        assert plan.feasible is (outcome.failure is None)
        certificate = check(plan)
        if outcome.failure is None:
            assert certificate.passed, [str(finding) for finding in certificate.refusals]
            continue
        assert outcome.failure.constraint == "time"
        assert f"{limit:g} s" in outcome.failure.reason
        away = np.linalg.norm(plan.object_position[-1, -1] - load(name).goal.pose.p)
        turn = (
            Rotation.from_quat(plan.object_quaternion[-1, -1], scalar_first=True).as_matrix().T @ load(name).goal.pose.R
        )
        if away > 2e-3 or np.trace(turn) < 3.0 - 1e-3:
            assert not certificate.passed
        summary = json.loads(json.dumps(plan.summary()))
        assert summary["feasible"] is False
        assert len(summary["found_after"]) == len(summary["evaluations"]) == summary["segments"]
        assert all(0 <= a < b for a, b in zip(summary["found_after"], summary["evaluations"], strict=True))


def test_the_best_plan_so_far_is_written_and_refused_on_the_command_line(tmp_path, capsys) -> None:
    file = tmp_path / "plan.npz"
    assert main(["plan", "fig4-relocation", "-o", str(file), "--time-limit", "0.001", "--json"]) == 1
    said = capsys.readouterr()
    answer = json.loads(said.out)
    assert answer["failure"]["constraint"] == "time"
    assert (answer["exit"], answer["feasible"], answer["plan"]) == (1, False, str(file))
    assert len(answer["found_after"]) == len(answer["evaluations"]) == answer["segments"]
    assert "not feasible" in said.err
    assert main(["plan", "fig4-relocation", "-o", str(file), "--time-limit", "0.001"]) == 1
    said = capsys.readouterr()
    lines = [line for line in said.err.splitlines() if "not feasible" in line]
    assert len(lines) == 1
    assert str(file) in lines[0]
    assert "evaluations" in said.out
    assert main(["check", str(file)]) == 1
    said = capsys.readouterr()
    assert "refused" in said.err
    assert "Traceback" not in said.err


def refused(scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str], *flags: str) -> tuple[int, dict, str]:
    """Exit code, JSON answer and what is said of planning a scene file on the command line."""
    file, out = tmp_path / "bad.yaml", tmp_path / "plan.npz"
    file.write_text(dump(scene))
    code = main(["plan", str(file), "-o", str(out), "--iterations", "100", "--json", *flags])
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    assert not out.exists()
    return code, json.loads(said.out), said.err


HEAVY = {"shape": "ellipsoid", "size": [0.045, 0.04, 0.04], "mass": 20.0}
POINTS = [[0.045, 0, 0], [-0.02, 0.03, 0], [-0.02, -0.03, 0]]
FAR = [{"agent": f"finger{i + 1}", "point": point} for i, point in enumerate(POINTS)]
BLOCK = [{"name": "block", "shape": "box", "size": [0.02, 0.02, 0.02], "pose": {"position": [0, 0, 0.3]}}]


@pytest.mark.parametrize(
    ("fields", "constraint", "words"),
    [
        ({"object": HEAVY}, "equilibrium", "max_force"),
        ({"start": {"pose": {"position": [0.3, 0, 0.4]}, "grasp": FAR}}, "reach", "finger2"),
        (
            {"environment": BLOCK, "start": {"pose": {"position": [0, 0, 0.3]}}},
            "collision",
            "start.pose",
        ),
        ({"environment": BLOCK, "goal": {"pose": {"position": [0, 0, 0.3]}}}, "collision", "goal.pose"),
    ],
    ids=["too heavy", "unreachable contact", "start in collision", "goal in an obstacle"],
)
def test_what_cannot_be_planned_is_said_in_one_line_with_exit_code_1(
    fields, constraint, words, tmp_path, capsys
) -> None:
    code, answer, said = refused(changed(small(), **fields), tmp_path, capsys)
    assert code == 1
    assert answer["failure"]["constraint"] == constraint
    assert answer["failure"]["remedy"]
    lines = [line for line in said.splitlines() if "no plan" in line]
    assert len(lines) == 1
    assert words in lines[0]


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("planner: {local: {atempts: 3}}", "planner.local.atempts"),
        ("planner: {samples: many}", "planner.samples"),
        ("planner: {local: {energy: {grip: -0.1}}}", "grip"),
        ("planner: {local: {energy: {friction_margin: 1.0}}}", "friction_margin"),
        ("planner: {local: {energy: {disturbance: -0.1}}}", "disturbance"),
        ("planner: {local: {energy: {slide_force: 0.01}}}", "slide_force"),
        ("planner: {loads: {smoothness: -1.0}}", "smoothness"),
    ],
)
def test_bad_settings_are_named_with_exit_code_2(text: str, field: str, tmp_path, capsys) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(f"{dump(small())}{text}\n")
    assert main(["plan", str(file), "-o", str(tmp_path / "plan.npz")]) == 2
    said = capsys.readouterr().err
    assert field in said
    assert len(said.strip().splitlines()) == 1
