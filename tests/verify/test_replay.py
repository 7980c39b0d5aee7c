"""The verdict of a replay, and its command: exit code, reason and JSON."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from armed import armed, limp

from regrasp.cli import main
from regrasp.control.controller import Control
from regrasp.control.impedance import Impedance
from regrasp.control.reference import Phases
from regrasp.errors import InputError
from regrasp.plan import Plan
from regrasp.verify.diagnosis import Failure
from regrasp.verify.execution import EVERY, Execution
from regrasp.verify.physics import PERIOD, nominal
from regrasp.verify.replay import (
    LARGE,
    MODES,
    TOLERANCE,
    TRIAL_TOLERANCE,
    TUBE,
    Bench,
    Replay,
    Trial,
    Trials,
    agreement,
    control_of,
    replay,
)
from regrasp.verify.trials import Perturbation


def saved(plan: Plan, directory: Path) -> str:
    path = directory / "plan.npz"
    plan.save(path)
    return str(path)


def controlled(plan: Plan, **control: object) -> Plan:
    return dataclasses.replace(plan, scene={**plan.scene, "control": control})


def trial(failure: Failure | None = None, final: tuple[float, float] = (1e-3, 0.01)) -> Trial:
    return Trial(final, 0.0, 1.0, failure is not None, failure)


FAILED = Failure(1, 0.5, "tip0", "lost contact")


def test_both_modes_are_run_and_the_plan_passes(handmade):
    found = replay(armed(handmade["carry"][0]))
    assert tuple(each.mode for each in found.nominal) == MODES
    assert found.passed
    assert found.trials == ()
    for each in found.nominal:
        assert each.failure is None
        assert all(x <= y for x, y in zip(each.final, each.largest, strict=True))
        assert each.force == pytest.approx(np.linalg.norm(each.run.force_W, axis=2).max())
        assert each.speed == pytest.approx(each.run.seconds / each.run.wall)


def test_a_plan_without_its_forces_fails_in_both_modes_with_the_reason(handmade):
    found = replay(limp(armed(handmade["hold"][0])))
    assert not found.passed
    for each in found.nominal:
        assert not each.passed
        assert each.failure is not None
        assert (each.failure.interval, each.failure.who) == (0, "object")
        assert each.correlation is None or np.isfinite(each.correlation)


def test_leaving_the_tube_on_the_way_is_no_success(handmade, monkeypatch):
    bench = Bench(armed(handmade["hold"][0]), Control())
    run = bench.run("open", nominal(bench.world), np.random.default_rng(0))
    error = run.error.copy()
    cases = [(axis, share) for axis in (0, 3) for share in (0.9, 1.1)]
    for axis, share in cases:
        way, passed = share * TUBE[axis // 3], share < 1.0
        error[len(error) // 2] = 0.0
        error[len(error) // 2, axis] = way
        shown = dataclasses.replace(run, error=error)
        monkeypatch.setattr(Bench, "run", lambda *_, shown=shown: shown)
        verdict = bench.nominal("open")
        assert verdict.passed is passed
        assert verdict.failure is None
        assert verdict.largest[axis // 3] == pytest.approx(way, abs=1e-6)


def test_the_tolerance_grows_with_objects_of_more_than_a_decimetre(handmade):
    bench = Bench(armed(handmade["hold"][0]), Control())
    assert bench.size == pytest.approx(0.06)
    assert bench.tolerance(TRIAL_TOLERANCE) == TRIAL_TOLERANCE
    assert bench.tolerance(TOLERANCE["open"]) == TOLERANCE["open"]
    bench.size = 1.5
    assert bench.tolerance(TOLERANCE["open"]) == (LARGE * 1.5, TOLERANCE["open"][1])


@pytest.mark.parametrize(("failures", "passed"), [(0, True), (1, True), (2, False)])
def test_nineteen_of_twenty_trials_are_enough(failures, passed):
    done = Trials("feedback", TRIAL_TOLERANCE, (trial(),) * (20 - failures) + (trial(FAILED),) * failures)
    assert done.passed is passed
    assert done.rate == pytest.approx(1 - failures / 20)
    assert Replay("x", (), (done,)).passed is passed
    # The open loop has no eyes: its trials are shown, not judged.
    assert Replay("x", (), (dataclasses.replace(done, mode="open"),)).passed


def test_drops_before_the_first_record_are_finite_in_json():
    done = Trials("open", TRIAL_TOLERANCE, (trial(), trial(FAILED, (np.inf, np.inf)), trial(FAILED, (np.inf, np.inf))))
    told = done.to_dict()
    json.dumps(told, allow_nan=False)
    assert told["worst_error"] == [None, None]
    assert told["drops"] == 2
    assert [each["trial"] for each in told["failures"]] == [1, 2]
    assert told["wilson"][0] < told["rate"] < told["wilson"][1]


def records(planned: np.ndarray, measured: np.ndarray, bears: np.ndarray | None = None) -> Execution:
    """An execution of which nothing is known but the forces."""
    S, k, _ = planned.shape
    return Execution(
        time=np.zeros(S), interval=np.zeros(S, int), qpos=np.zeros((S, 7)), error=np.zeros((S, 6)), force_W=measured,
        planned_W=planned, bears=np.ones((S, k), bool) if bears is None else bears, slip=np.zeros((S, k)),
        strained=np.zeros((S, k), bool), touches=(), trouble=None, seconds=1.0, wall=1.0,
    )  # fmt: skip


def test_correlation_is_pearsons_and_gain_the_slope_over_the_contacts_alone():
    rng = np.random.default_rng(0)
    planned = rng.standard_normal((50, 2, 3))
    bears = rng.random((50, 2)) < 0.5
    run = records(planned, 2.0 * planned + 0.3, bears)
    run.force_W[~bears] = 100.0 * rng.standard_normal((np.sum(~bears), 3))
    assert agreement(run) == (pytest.approx(1.0), pytest.approx(2.0))
    run.force_W[:] = rng.standard_normal((50, 2, 3))
    x, y = run.force_W[bears].ravel(), planned[bears].ravel()
    wanted = np.mean((x - x.mean()) * (y - y.mean())) / (x.std() * y.std())
    slope = np.polyfit(y, x, 1)[0]
    assert agreement(run) == (pytest.approx(wanted), pytest.approx(slope))
    assert agreement(dataclasses.replace(run, bears=np.zeros((50, 2), bool))) == (None, None)
    assert agreement(dataclasses.replace(run, planned_W=0 * planned)) == (None, None)
    assert agreement(dataclasses.replace(run, force_W=0 * planned)) == (None, 0.0)


def test_a_lost_share_of_the_force_shows_in_the_gain_alone():
    planned = np.random.default_rng(1).standard_normal((50, 2, 3))
    for share in (0.2, 0.8, 1.0):
        assert agreement(records(planned, share * planned)) == (pytest.approx(1.0), pytest.approx(share))


def test_the_scenes_control_is_what_the_plan_is_run_with(handmade):
    plan = controlled(handmade["hold"][0], impedance={"stiffness": 300}, phases={"hold": 0.1})
    control = control_of(plan)
    assert control == Control(impedance=Impedance(stiffness=300.0), phases=Phases(hold=0.1))
    soft, stiff = (replay(armed(each)).nominal[0].run for each in (plan, handmade["hold"][0]))
    assert len(soft.time) == len(stiff.time) - round(0.4 / (EVERY * PERIOD))
    given = replay(armed(plan), control=Control()).nominal[0].run
    np.testing.assert_array_equal(given.error, stiff.error)


@pytest.mark.parametrize(
    ("control", "words"),
    [
        ({"impedence": {}}, r"control.impedence: unknown key \(impedance\?\)"),
        ({"impedance": {"stiffness": -1}}, "control.impedance.*stiffness is -1"),
        ({"feedback": {"period": "often"}}, "control.feedback.period"),
        ({"feedback": {"period": 0}}, "control.feedback.*period"),
        ({"feedback": {"smoothing": 0.0}}, "control.feedback.*smoothing"),
        ({"feedback": {"rate": -3}}, "control.feedback.*rate"),
        ({"feedback": {"reach": float("inf")}}, "control.feedback.*reach"),
        ({"phases": {"approach": -1}}, "control.phases.*approach"),
        ({"phases": {"hold": float("inf")}}, "control.phases.*hold"),
    ],
)
def test_control_that_cannot_be_is_refused_with_its_field(control, words, handmade):
    with pytest.raises(InputError, match=words):
        control_of(controlled(handmade["hold"][0], **control))


def finite(value: object) -> bool:
    """Whether a JSON value holds numbers, words and nothing else."""
    if isinstance(value, dict):
        return all(map(finite, value.values()))
    if isinstance(value, list):
        return all(map(finite, value))
    return value is None or isinstance(value, str | int) or (isinstance(value, float) and np.isfinite(value))


def test_the_command_says_passed_with_exit_0(handmade, tmp_path, capsys):
    path = saved(armed(handmade["finger"][0]), tmp_path)
    assert main(["replay", path, "--trials", "2", "--cores", "1", "--seed", "3", "--json"]) == 0
    out, err = capsys.readouterr()
    answer = json.loads(out)
    assert finite(answer)
    assert answer["exit"] == 0
    assert answer["passed"] is True
    assert [each["mode"] for each in answer["nominal"]] == list(MODES)
    assert [each["trials"] for each in answer["trials"]] == [2, 2]
    again = replay(armed(handmade["finger"][0]), trials=2, seed=3, cores=1).to_dict()
    assert json.loads(json.dumps(again["trials"])) == answer["trials"]
    assert err == ""
    assert main(["replay", path, "--trials", "2", "--cores", "1"]) == 0
    shown = capsys.readouterr().out
    assert shown.count(" open ") == shown.count(" feedback ") == 2
    assert all(len(line) <= 80 for line in shown.splitlines() if path not in line)
    assert "…" not in shown
    assert f"{answer['nominal'][0]['gain']:.3f}" in shown


def test_the_command_says_why_a_plan_failed_with_exit_1(handmade, tmp_path, capsys):
    path = saved(limp(armed(handmade["hold"][0])), tmp_path)
    assert main(["replay", path, "--json"]) == 1
    out, err = capsys.readouterr()
    answer = json.loads(out)
    assert finite(answer)
    assert answer["passed"] is False
    lines = err.splitlines()
    assert [line.split(": ")[1] for line in lines] == list(MODES)
    assert all(line.startswith(path) and "interval 0" in line and "object" in line for line in lines)
    assert answer["nominal"][0]["failure"]["why"] in lines[0]
    assert main(["replay", path]) == 1
    assert capsys.readouterr().out


def test_flags_override_the_scenes_control(handmade, tmp_path, capsys):
    path = saved(controlled(armed(handmade["hold"][0]), impedance={"stiffness": 300}), tmp_path)
    figures = []
    for flags in ([], ["--control.impedance.stiffness", "300"], ["--control.impedance.stiffness", "600"]):
        assert main(["replay", path, *flags, "--json"]) == 0
        figures.append(json.loads(capsys.readouterr().out)["nominal"][0]["force"])
    assert figures[0] == figures[1]
    assert figures[0] != figures[2]


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--trials", "-1"], "--trials: is -1"),
        (["--cores", "0"], "--cores: is 0"),
        (["--cores", "-2"], "--cores: is -2"),
        (["-o", "film.avi"], ".png"),
        (["-o", "no/such/film.gif"], "no/such"),
        (["--trials", "many"], "--trials"),
        (["--control.impedance.stiffness", "0"], "stiffness"),
        (["--control.feedback.smoothing", "0"], "smoothing"),
        (["--perturbation.mass", "1.5"], "mass"),
        (["--control.impedance.stifness", "5"], "stiffness"),
    ],
)
def test_bad_flags_are_one_line_and_exit_2(flags, words, handmade, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("regrasp.verify.replay.replay", lambda *_: pytest.fail("it ran"))
    path = saved(handmade["hold"][0], tmp_path)
    assert main(["replay", path, *flags, "--json"]) == 2
    out, err = capsys.readouterr()
    assert words in err
    assert err.count("\n") == 1
    assert json.loads(out)["error"] == err.strip()
    assert [each.name for each in tmp_path.iterdir()] == ["plan.npz"]


def test_bad_plans_are_one_line_and_exit_2(handmade, tmp_path, capsys):
    assert main(["replay", str(tmp_path / "missing.npz")]) == 2
    assert "missing.npz" in capsys.readouterr().err
    path = saved(controlled(handmade["hold"][0], impedence={}), tmp_path)
    assert main(["replay", path]) == 2
    out, err = capsys.readouterr()
    assert "control.impedence: unknown key (impedance?)" in err
    assert (out, err.count("\n")) == ("", 1)


def test_a_model_that_cannot_be_driven_is_exit_2(handmade, tmp_path, capsys):
    plan = armed(handmade["hold"][0])
    twice = "".join(f'<motor name="m{i}" joint="robot/slidex0"/>' for i in range(2))
    path = saved(
        dataclasses.replace(plan, xml=plan.xml.replace("</mujoco>", f"<actuator>{twice}</actuator></mujoco>")), tmp_path
    )
    assert main(["replay", path]) == 2
    err = capsys.readouterr().err
    assert "2 actuators move joint 'robot/slidex0'" in err
    assert err.count("\n") == 1


def test_the_ranges_of_the_trials_are_the_flags(handmade, tmp_path, capsys):
    """Trials without any perturbation all do what the plan does as planned."""
    path = saved(armed(handmade["finger"][0]), tmp_path)
    nothing = [
        flag
        for each in dataclasses.fields(Perturbation)
        for flag in (f"--perturbation.{each.name.replace('_', '-')}", "0")
    ]
    assert main(["replay", path, "--trials", "1", "--cores", "1", *nothing, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    for planned, trials in zip(answer["nominal"], answer["trials"], strict=True):
        assert trials["worst_error"] == pytest.approx(planned["final"])
