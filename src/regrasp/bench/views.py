"""How big a page is, how soon it is there, and how fast its frames are made."""

import contextlib
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from regrasp.bench.kernels import compile_kernels, say
from regrasp.plan import Plan
from regrasp.planner.method import plan_scene
from regrasp.planner.task import Settings
from regrasp.scene.load import load
from regrasp.settings import read
from regrasp.view.page import page
from regrasp.view.story import pack, tell

SCENES = ("fig4-relocation", "allegro-cube", "tray-handover")
FRAMES, BYTES, SECONDS, RATE = 240, 10e6, 3.0, 20.0
"""A page of so many frames is to be smaller than so many bytes, there in so many seconds, its frames made at this rate."""

RUN = "import sys; from regrasp.cli import main; sys.exit(main())"


def view(seeds: int) -> dict[str, Any]:
    """Pages of plans of SCENES: their file, and `regrasp view` from its start to the page served, `seeds` times each."""
    compile_kernels()
    rows = []
    for name in SCENES:
        scene = load(name)
        plan = plan_scene(scene, 1, read(Settings, scene.planner)).plan
        if plan is None:
            say(f"{name}: no plan")
            continue
        rows.append({"scene": name, **row(plan, seeds)})
        say(f"{name}: {rows[-1]['bytes'] / 1e6:.2f} MB, {rows[-1]['seconds']:.2f} s")
    table = Table(title="pages of plans", title_justify="left", box=None, padding=(0, 2, 0, 0))
    for heading in ("scene", "frames", "MB", "MB of 240", "served, s", "worst, s", "frames/s"):
        table.add_column(heading, justify="left" if heading == "scene" else "right", no_wrap=True)
    for each in rows:
        table.add_row(
            each["scene"], f"{each['frames']}", f"{each['bytes'] / 1e6:.2f}",
            f"{each['bytes'] / 1e6 * min(1.0, FRAMES / each['frames']):.2f}", f"{each['seconds']:.2f}", f"{each['worst']:.2f}",
            f"{each['rate']:.0f}",
        )  # fmt: skip
    Console().print(table)
    passed = len(rows) == len(SCENES) and all(
        each["bytes"] < BYTES and each["seconds"] < SECONDS and each["rate"] >= RATE for each in rows
    )
    return {"passed": passed, "views": rows}


def row(plan: Plan, times: int) -> dict[str, Any]:
    """The figures of one plan. rate: frames over the time that the whole story takes, with all its numbers."""
    tell(plan)  # loads what there is to be loaded
    began = time.perf_counter()
    packed = pack(tell(plan))
    rate = plan.time.size / (time.perf_counter() - began)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plan.npz"
        plan.save(path)
        seconds = [served(path) for _ in range(times)]
    return {
        "frames": plan.time.size,
        "bytes": len(page(packed).encode()),
        "seconds": statistics.median(seconds),
        "worst": max(seconds),
        "rate": rate,
    }


def served(path: Path) -> float:
    """s from the start of `regrasp view` until the whole page has been served."""
    began = time.perf_counter()
    command = [sys.executable, "-c", RUN, "view", str(path), "--port", "0", "--no-browser"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        url = process.stderr.readline().split()[0]
        with urllib.request.urlopen(url, timeout=60) as answer:
            answer.read()
        return time.perf_counter() - began
    finally:
        process.kill()
        with contextlib.suppress(OSError):
            process.communicate()
