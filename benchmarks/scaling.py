"""How the cost of an evaluation and of a move grows along an axis.

All values are measured in turn, round by round, so that a machine which slows down and speeds up bends no line: the exponents
are those of the rounds, and their median counts.
"""

import statistics

from benchmarks.axes import AXES
from benchmarks.jobs import from_scratch, pair, problem_of, start_of
from benchmarks.measure import Row, compared, exponent, row, seconds_of, spread_of
from benchmarks.table import number
from regrasp.bench.searches import Job
from regrasp.planner.chain import ContactMotions
from regrasp.planner.configurations import bodies_along
from regrasp.planner.scan import candidate_free, new_scan
from regrasp.planner.terms import Shortcuts
from regrasp.search.annealing import Settings as Annealing

SCAN, WHOLE, MOVE = "scan of all for one agent", "one evaluation from scratch", "one move"
RANDOM_V = 5  # V's whose evaluation from scratch makes one time
ROUNDS = 9

Times = dict[int, list[float]]
"""Value on the axis → s, round by round."""


def rows(axis: str, quick: bool, seeds: int) -> list[Row]:
    """Both costs at every value on one axis (quick: at three), then how they grow with it."""
    annealing = Annealing(iterations=60, trials=20) if quick else Annealing(iterations=300, trials=100)
    job_at, values = AXES[axis]
    if quick:
        values = values[0], values[len(values) // 2], values[-1]
    jobs = {value: job_at(value) for value in values}
    return [*(scans(jobs) if axis == "candidates" else evaluations(axis, jobs)), *moves(axis, jobs, annealing, seeds)]


def scans(jobs: dict[int, Job]) -> list[Row]:
    """What it takes to find out of all candidates whether an agent can stand there."""
    times: Times = {value: [] for value in jobs}
    for _ in range(ROUNDS):
        for value, work in jobs.items():
            times[value].append(scan_all(work))
    group = f"candidates: {SCAN}"
    found = [row(group, f"{value} candidates", each, "s", x=value) for value, each in times.items()]
    return [*found, growth(group, times)]


def evaluations(axis: str, jobs: dict[int, Job]) -> list[Row]:
    """The evaluation of a whole random V of which nothing is known, mean of RANDOM_V of them."""
    V = {value: [start_of(work, seed) for seed in range(RANDOM_V)] for value, work in jobs.items()}
    problems = {value: problem_of(work, V[value][0], Shortcuts()) for value, work in jobs.items()}
    times: Times = {value: [] for value in jobs}
    for _ in range(ROUNDS):
        for value, problem in problems.items():
            times[value].append(statistics.mean(from_scratch(problem, each) for each in V[value]))
    group = f"{axis}: {WHOLE}"
    found = [
        row(group, f"{value} {axis}", each, "s", x=value, note=counted_work(problems[value], ROUNDS * RANDOM_V + 1))
        for value, each in times.items()
    ]
    return [*found, growth(group, times)]


def moves(axis: str, jobs: dict[int, Job], annealing: Annealing, seeds: int) -> list[Row]:
    """A move of an annealing, beside the same chain's without shortcuts; a round is a seed."""
    ours: Times = {value: [] for value in jobs}
    plain: Times = {value: [] for value in jobs}
    for seed in range(seeds):
        for value, work in jobs.items():
            fast, slow = pair(work, seed, annealing)
            ours[value].append(fast.seconds_per_move)
            plain[value].append(slow.seconds_per_move)
    group = f"{axis}: {MOVE}"
    found = [compared(group, f"{value} {axis}", ours[value], plain[value], x=value) for value in jobs]
    return [*found, growth(group, ours, plain)]


def growth(group: str, times: Times, plain: Times | None = None) -> Row:
    """The exponent over the axis, the reference's beside it, and the line through the medians."""
    slopes = exponents(times)
    against = statistics.median(exponents(plain)) if plain else None
    medians = {value: statistics.median(each) for value, each in times.items()}
    line = statistics.linear_regression(list(medians), list(medians.values()))
    note = f"{number(line.slope, 's')} each and {number(line.intercept, 's')}"
    return Row(group, "exponent", statistics.median(slopes), "", spread_of(slopes), len(slopes), against, note=note)


def exponents(times: Times) -> list[float]:
    """The exponent in every round, over the values above 0."""
    x = [value for value in times if value > 0]
    return [exponent(x, each) for each in zip(*(times[value] for value in x), strict=True)]


def counted_work(problem: ContactMotions, evaluations: int) -> str:
    """What one of so many evaluations did."""
    counts = problem.work.counts
    words = {"configurations": "contacts", "programs": "programs", "pivots": "pivots", "ways": "free motions"}
    return ", ".join(f"{getattr(counts, key)[0] / evaluations:.0f} {word}" for key, word in words.items())


def scan_all(work: Job) -> float:
    """s to find out of every candidate whether agent 0 can stand there at the start."""
    hand, local = work.task.hand, work.task.settings.local
    scan = new_scan(hand, work.path, local.relocation)
    R_B, p_B = bodies_along(hand, work.path)

    def every() -> None:
        for c in range(len(scan.p_O)):
            candidate_free(hand, work.path, scan, R_B[0], p_B[0], 0, 0, c, local.energy.clearance)

    return seconds_of(every)
