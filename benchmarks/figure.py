"""One picture of a run: how the costs grow, and what is faster than its reference by how much."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from benchmarks.kernels import GROUP as KERNELS
from benchmarks.measure import Row
from benchmarks.scaling import AXES, MOVE, WHOLE

BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#767676"
"""Of Okabe and Ito's colours, which the colour-blind tell apart too; the marks differ as well."""


def draw(rows: list[Row], path: Path) -> None:
    """Write the picture of a run: a panel for each axis, below them the ratios."""
    figure, panels = plt.subplots(2, 4, figsize=(15, 8.5), layout="constrained", height_ratios=[1.0, 1.15])
    for axis, panel in zip(AXES, panels[0], strict=True):
        growth(panel, axis, rows)
    panels[0, 0].set_ylabel("ms")
    grid = panels[1, 0].get_gridspec()
    for panel in panels[1]:
        panel.remove()
    bars(
        figure.add_subplot(grid[1, :2]),
        "kernels: times faster than the reference",
        [r for r in rows if r.group == KERNELS],
    )
    rest = [row for row in rows if row.group.startswith(("the paper's", "built-in", "one move,", "threads"))]
    bars(
        figure.add_subplot(grid[1, 2:]),
        "jobs: times faster than the reference",
        [r for r in rest if r.ratio is not None],
    )
    figure.savefig(path, dpi=110)
    plt.close(figure)


def growth(panel: Axes, axis: str, rows: list[Row]) -> None:
    """Costs over one axis, both logarithmic, beside the slope of linear growth."""
    panel.set_title(axis)
    for group, label, colour, mark in (
        (f"{axis}: {WHOLE}", WHOLE, BLUE, "o"),
        (f"{axis}: scan of all, one agent", "scan of all", BLUE, "o"),
        (f"{axis}: {MOVE}", MOVE, ORANGE, "s"),
    ):
        points = [row for row in rows if row.group == group and row.x]
        if not points:
            continue
        slope = next((row for row in rows if row.group == group and row.name == "exponent"), None)
        x, y = [row.x or 0.0 for row in points], [1e3 * row.value for row in points]
        words = f"{label}: exponent {slope.value:.2f}" if slope else label
        panel.loglog(x, y, color=colour, marker=mark, label=words)
        if group.endswith(MOVE):
            plain = [1e3 * row.reference for row in points if row.reference is not None]
            panel.loglog(x, plain, color=GREY, marker="^", linestyle="--", label="one move, reference")
        else:
            ends = [x[0], x[-1]]
            panel.loglog(ends, [y[0], y[0] * x[-1] / x[0]], color=GREY, linewidth=0.8, linestyle=":", label="linear")
    if panel.lines:
        panel.legend(fontsize=8)
    panel.grid(alpha=0.3)


def bars(panel: Axes, title: str, rows: list[Row]) -> None:
    """Ratios, the quartiles as whiskers."""
    panel.set_title(title)
    names = [row.name.replace(", reference without", " without") for row in rows]
    ratios = [row.ratio or 1.0 for row in rows]
    panel.barh(range(len(rows)), [r - 1.0 for r in ratios], left=1.0, color=[BLUE if r >= 1.0 else ORANGE for r in ratios],
               xerr=[r * row.spread for r, row in zip(ratios, rows, strict=True)], ecolor=GREY)  # fmt: skip
    panel.set_yticks(range(len(rows)), names, fontsize=8)
    panel.invert_yaxis()
    panel.set_xscale("log")
    panel.axvline(1.0, color="black", linewidth=0.8)
    for place, ratio in enumerate(ratios):
        panel.annotate(
            f"{ratio:.3g}", (max(ratio, 1.0), place), (6, 0), textcoords="offset points", va="center", fontsize=8
        )
    panel.margins(x=0.15)
    panel.grid(axis="x", alpha=0.3)
