"""`python -m benchmarks`: measure, or compare two saved runs."""

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from benchmarks import jobs, kernels, plans, scaling, table, tempering, threads
from benchmarks.axes import AXES, paper_job
from benchmarks.figure import draw
from benchmarks.measure import Row
from regrasp.bench.kernels import compile_kernels, say
from regrasp.bench.searches import PAPER_ITERATIONS, PAPER_SCENE, Job, job
from regrasp.planner.warm import warmed

TEMPERED = ("puma4-obstacles",)
"""Scenes on whose first arcs tempering is tried, beside the paper's job."""


def parts(quick: bool) -> dict[str, Callable[[], list[Row]]]:
    """Name → what measures it; quick: fewer seeds, repeats, iterations and values."""
    few, some, all_ = (1, 3, 2) if quick else (3, 7, 10)
    iterations = 400 if quick else PAPER_ITERATIONS
    tried: dict[str, Callable[[], Job]] = {
        PAPER_SCENE: paper_job,
        **{name: partial(job, name) for name in TEMPERED},
    }
    scalings = {axis: partial(scaling.rows, axis, quick, few) for axis in AXES}
    return {
        "kernels": lambda: kernels.rows(paper_job(), some),
        "paper": lambda: jobs.paper(paper_job(), all_, iterations),
        "scenes": lambda: jobs.scenes(100 if quick else 600, few),
        "moves": lambda: jobs.moves_apart(paper_job(), some),
        **scalings,
        "threads": lambda: threads.rows(paper_job(), iterations, 3 * some),
        "plans": lambda: plans.rows(1 if quick else 3, plans.LIMITS[3:4] if quick else plans.LIMITS),
        "tempering": lambda: tempering.rows(
            {name: made() for name, made in tried.items()}, few if quick else 8, iterations
        ),
    }


def measure(output: Path, only: tuple[str, ...], quick: bool) -> int:
    """Run the parts, show the table, write it with the run and the picture."""
    known = parts(quick)
    if unknown := [name for name in only if name not in known]:
        say(f"--only: no part {unknown[0]!r} (legal: {', '.join(known)})")
        return 2
    if not output.parent.is_dir():
        say(f"--output: no directory {output.parent} (make it first)")
        return 2
    compile_kernels()
    started, rows = time.perf_counter(), []
    with warmed(lambda _: None):
        for name, part in known.items():
            if only and name not in only:
                continue
            begun = time.perf_counter()
            rows += part()
            say(f"{name}: {time.perf_counter() - begun:.0f} s")
    table.save(output, rows, quick, time.perf_counter() - started)
    text = table.markdown(rows)
    output.with_suffix(".md").write_text(text, encoding="utf-8")
    draw(rows, output.with_suffix(".png"))
    print(text)
    return 0


def main(
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out/benchmarks.json"),
    only: tuple[str, ...] = (),
    quick: bool = False,
    compare: tuple[Path, Path] | None = None,
) -> int:
    """Measure what planning costs, as ratios within one run to a plain reference of the same work.

    Args:
        output: Where the run is saved; the table and the picture go beside it, as .md and .png.
        only: Parts to run: kernels, paper, scenes, moves, intervals, agents, candidates, obstacles, threads, plans, tempering.
        quick: A minute instead of fifteen, with little to be learnt from the figures.
        compare: Two saved runs, A and B: every row of both, marked where B differs by more than noise. Measures nothing.
    """
    if compare is None:
        return measure(output, only, quick)
    try:
        print(table.comparison(*(table.read(path) for path in compare)))
    except ValueError as error:
        say(str(error))
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(tyro.cli(main, prog="python -m benchmarks", use_underscores=False))
