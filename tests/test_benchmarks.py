"""The benchmarks compare like with like, tell changes from noise, and the work counted grows as it must."""

import dataclasses
import json
import math

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks import axes, jobs, reference, table
from benchmarks.measure import Row, compared, exponent, spread_of
from regrasp.kernels.basis import program
from regrasp.kernels.chains import forward
from regrasp.kernels.contact import OK, advance
from regrasp.kernels.forces import EDGES, friction_edges
from regrasp.kernels.rotations import exp
from regrasp.kernels.simplex import OPTIMAL, solve
from regrasp.kernels.wrist import solve_near
from regrasp.planner.terms import Shortcuts
from regrasp.search.annealing import Settings as Annealing

FASTER = Row("kernels, per call", "forward", 1e-7, "s", 0.02, 7, 2e-6, 20.0)
PLAIN = Row("the first certified plan", "fig2", 0.3, "s", 0.02, 5)


@pytest.fixture(scope="module")
def paper_job():
    return axes.paper_job()


def test_ratios_are_taken_pair_by_pair():
    """A machine that is slow for one pair is slow for both its sides: the ratio doesn't see it."""
    row = compared("g", "n", [1.0, 10.0, 1.0], [3.0, 30.0, 3.0], "s")
    assert (row.value, row.reference, row.ratio, row.spread) == (1.0, 3.0, 3.0, 0.0)
    assert compared("g", "n", [4.0], [2.0], "1/s").ratio == 2.0
    assert spread_of([1.0, 2.0, 3.0, 4.0, 5.0]) == pytest.approx(1.0 / 3.0)
    assert exponent([1.0, 2.0, 4.0], [3.0, 12.0, 48.0]) == pytest.approx(2.0)


@pytest.mark.parametrize(("a", "b", "better", "beyond"), [
    (FASTER, dataclasses.replace(FASTER, value=1e-6, reference=2e-5), 1.0, False),  # a slower machine, the same ratio
    (FASTER, dataclasses.replace(FASTER, ratio=20.8), 1.04, False),  # within 5 %, whatever the spread
    (FASTER, dataclasses.replace(FASTER, ratio=10.0), 0.5, True),
    (FASTER, dataclasses.replace(FASTER, ratio=10.0, spread=0.6), 0.5, False),
    (PLAIN, dataclasses.replace(PLAIN, value=0.1), 3.0, True),  # less time is better
    (dataclasses.replace(PLAIN, unit="certified"), dataclasses.replace(PLAIN, unit="certified", value=0.6), 2.0, True),
    (dataclasses.replace(PLAIN, value=math.nan), dataclasses.replace(PLAIN, value=math.nan), 1.0, False),
    (dataclasses.replace(PLAIN, value=math.inf), PLAIN, math.nan, True),
])  # fmt: skip
def test_a_change_is_told_from_noise(a, b, better, beyond):
    found, marked = table.change(a, b)
    assert found == pytest.approx(better, nan_ok=True)
    assert marked is beyond


def test_a_run_is_saved_shown_drawn_and_compared(tmp_path, monkeypatch, capsys):
    x = [Row("agents: one move", f"{k} agents", 1e-4 * k, "s", 0.0, 3, 1e-3 * k, 10.0, x=k) for k in (2, 4)]
    rows = {"kernels": [FASTER], "plans": [PLAIN], "agents": x}
    monkeypatch.setattr(command, "parts", lambda _: {name: lambda each=each: each for name, each in rows.items()})
    monkeypatch.setattr(command, "compile_kernels", lambda: 0.0)
    first, second = tmp_path / "a.json", tmp_path / "b.json"
    assert command.main(first, quick=True) == 0
    text = capsys.readouterr().out
    assert "| forward | 100 ns | 2 µs | 20.00 | 2 % |" in text
    assert first.with_suffix(".md").read_text() == text.removesuffix("\n")
    assert first.with_suffix(".png").stat().st_size > 10_000
    assert table.read(first) == [FASTER, PLAIN, *x]
    rows["kernels"] = [dataclasses.replace(FASTER, ratio=40.0)]
    assert command.main(second, only=("kernels",)) == 0
    capsys.readouterr()
    assert command.main(compare=(first, second)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[2].endswith("| 20 | 40 | × 2.00 | **better** |")
    assert lines[3].endswith("only in A |")


def test_bad_requests_are_refused_in_words(tmp_path, capsys):
    assert command.main(tmp_path / "a.json", only=("kernel",)) == 2
    assert command.main(tmp_path / "no" / "a.json") == 2
    foreign = tmp_path / "foreign.json"
    for text in ("[]", "{", json.dumps({"version": 0, "rows": []})):
        foreign.write_text(text)
        assert command.main(compare=(foreign, foreign)) == 2
    assert "legal: kernels, paper" in capsys.readouterr().err


def test_reference_kinematics_are_the_kernels(paper_job):
    hand, rng = paper_job.task.hand, np.random.default_rng(0)
    R, p = np.empty((7, 3, 3)), np.empty((7, 3))
    for i in range(4):
        q = hand.home[6 * i : 6 * i + 6] + rng.uniform(-0.3, 0.3, 6)
        forward(hand.chains, i, q, R, p)
        turns, places = reference.forward(hand.chains, i, q)
        np.testing.assert_allclose(turns, R, atol=1e-12)
        np.testing.assert_allclose(places, p, atol=1e-12)
        seed = q + rng.uniform(-0.05, 0.05, 6)
        error, found = reference.inverse(hand.chains, i, R[6], p[6], seed)
        assert error < 1e-10
        assert solve_near(hand.chains, hand.wrists, i, R[6], p[6], seed)
        np.testing.assert_allclose(found, seed, atol=1e-8)


def test_reference_contact_is_the_kernel_in_the_limit(paper_job):
    """RK4 in many steps and the midpoint rule in many end at the same point; in few they differ by more."""
    hand, r = paper_job.task.hand, 0.0135
    p0, x0 = np.array([0.0, 0.0, hand.size_O[2]]), np.array([0.0, 1.0, 0.0])
    command_ = np.array([0.2, -0.1, 0.001, 0.002])
    far = reference.contact(hand.size_O[:3], r, p0, x0, command_, 64)
    errors = []
    for steps in (2, 64):
        p, c, R, x = p0.copy(), np.array([0.0, 0.0, -r]), np.eye(3), x0.copy()
        size = np.array([r, 0.0, 0.0, 0.0])
        assert (
            advance(hand.kind_O, hand.size_O, hand.kind_T[0], size, hand.grids, command_, np.int64(steps), p, c, R, x)
            == OK
        )
        errors.append(np.linalg.norm(p - far))
    assert errors[1] < 1e-8
    assert errors[1] < 0.01 * errors[0]


@pytest.mark.parametrize("cap", [np.inf, 0.6, 0.2])
def test_reference_force_program_is_the_kernel(cap):
    """Two tips below and two beside a ball, each with a cap: held, or not with caps that add up to too little."""
    P = program(4 * EDGES, 4)
    P.b[:] = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    P.cap[:] = cap
    for g, (a, b) in enumerate([(0.0, -0.7), (2.1, -0.7), (4.2, -0.7), (1.0, 0.0)]):
        n = np.array([math.cos(a) * math.cos(b), math.sin(a) * math.cos(b), math.sin(b)])
        x = np.array([-math.sin(a), math.cos(a), 0.0])
        friction_edges(tuple(n), tuple(-n), tuple(x), tuple(np.cross(n, x)), 0.5, 1.0, P.A, EDGES * g)
        P.group[EDGES * g : EDGES * (g + 1)] = g
    status, value, _ = solve(P, 4 * EDGES, False)
    plain = reference.least_force(P.A, P.b, P.group, P.cap)
    assert (status == OPTIMAL) is (cap > 0.5) is math.isfinite(plain)
    if status == OPTIMAL:
        assert value == pytest.approx(plain, rel=1e-7)


def test_exp_is_the_kernels():
    R = np.empty((3, 3))
    for w in (np.zeros(3), np.array([1e-3, 0.0, 0.0]), np.array([1.0, -2.0, 0.5])):
        exp(w, R)
        np.testing.assert_allclose(reference.exp(w), R, atol=1e-14)


def test_shortcuts_leave_the_chain_and_take_work_off(paper_job):
    """Operations counted, not timed: each shortcut saves some of them, all together most."""
    annealing = Annealing(iterations=150, trials=50)
    fast = jobs.chain(paper_job, 1, annealing, Shortcuts())
    for words, change in jobs.SWITCHED.items():
        slow = jobs.chain(paper_job, 1, annealing, Shortcuts(**change))
        np.testing.assert_allclose(slow.energies, fast.energies, rtol=1e-9, err_msg=words)
        saved = [slow.counts[key] - fast.counts[key] for key in fast.counts]
        assert min(saved) >= -0.02 * max(fast.counts.values()), words
        assert max(saved) > 0, words
    plain = jobs.chain(paper_job, 1, annealing, jobs.PLAIN)
    np.testing.assert_allclose(plain.energies, fast.energies, rtol=1e-9)
    assert plain.counts["configurations"] > 5 * fast.counts["configurations"]


def test_the_work_of_an_evaluation_grows_linearly_with_the_intervals():
    """From nothing: every agent is followed through every interval once, a force program stands at each end at most twice."""
    for n in (10, 20, 40):
        work = axes.longer(n)
        assert len(work.path.R_WO) == n
        problem = jobs.problem_of(work, jobs.start_of(work, 0), Shortcuts())
        counts = problem.work.counts
        assert 3 * n <= counts.configurations[0] <= 4 * n
        assert counts.programs[0] <= 2 * n
        assert counts.ways[0] <= 4 * n


def test_obstacles_are_clear_of_the_motion_without_them():
    """Among obstacles the same V has the same energy: they cost time, and that alone is measured."""
    free, among = axes.among(0), axes.among(25)
    V = jobs.start_of(free, 0)
    assert among.task.hand.object_geom - free.task.hand.object_geom == 25
    first, second = (jobs.problem_of(work, V, Shortcuts()) for work in (free, among))
    assert second.energy() == pytest.approx(first.energy(), rel=1e-12)
