"""One picture of a run: how the costs grow, and what is faster than its reference by how much."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from benchmarks.axes import AXES
from benchmarks.jobs import ALL, ARC
from benchmarks.kernels import GROUP as KERNELS
from benchmarks.measure import Row
from benchmarks.scaling import MOVE, SCAN, WHOLE

BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#767676"
"""Of Okabe and Ito's colours, which the colour-blind tell apart too; the marks differ as well."""


def draw(rows: list[Row], path: Path) -> None:
    """Write the picture of a run: a panel for each axis, below them the ratios."""
    figure = plt.figure(figsize=(15, 9.5), layout="constrained")
    grid = figure.add_gridspec(2, 1, height_ratios=[1.0, 1.1])
    above, below = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    panels = above.subplots(1, len(AXES))
    for axis, panel in zip(AXES, panels, strict=True):
        growth(panel, axis, rows)
    panels[0].set_ylabel("ms")
    named = {line.get_label(): line for panel in panels for line in panel.lines}
    if named:
        above.legend(named.values(), named.keys(), loc="outside upper center", ncols=len(named), frameon=False)
    left, right = below.add_subplot(1, 2, 1), below.add_subplot(1, 2, 2)
    bars(left, "kernels: times faster than the reference", {row.name: row for row in rows if row.group == KERNELS})
    shown = {}
    for row in rows:
        if row.group.startswith("the paper's job, one move"):
            shown[row.name.replace("reference", "paper's job")] = row
        elif row.group.startswith(ARC) and row.name.endswith(ALL):
            shown[row.group.removeprefix(ARC).replace(", one move", f" without {ALL}")] = row
        elif row.group.startswith("threads"):
            shown[row.name] = row
    bars(right, "moves: times faster than the reference", shown)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def growth(panel: Axes, axis: str, rows: list[Row]) -> None:
    """Costs over one axis, both logarithmic, beside the slope of linear growth."""
    exponents = []
    for label, colour, mark in ((SCAN, BLUE, "v"), (WHOLE, BLUE, "o"), (MOVE, ORANGE, "s")):
        group = f"{axis}: {label}"
        points = [row for row in rows if row.group == group and row.x]
        if not points:
            continue
        exponents += [f"{row.value:.2f}" for row in rows if row.group == group and row.name == "exponent"]
        x, y = [row.x or 0.0 for row in points], [1e3 * row.value for row in points]
        panel.loglog(x, y, color=colour, marker=mark, label=label)
        if label == MOVE:
            plain = [1e3 * row.reference for row in points if row.reference is not None]
            panel.loglog(x, plain, color=GREY, marker="^", linestyle="--", label=f"{MOVE}, reference")
        else:
            panel.loglog([x[0], x[-1]], [y[0], y[0] * x[-1] / x[0]], color=GREY, lw=0.9, ls=":", label="linear")
        panel.set_xticks(x, [f"{each:g}" for each in x])
        panel.xaxis.set_minor_locator(NullLocator())
    panel.set_title(f"{axis}: exponents {', '.join(exponents)}" if exponents else axis, fontsize=10)
    panel.grid(alpha=0.3)


def bars(panel: Axes, title: str, named: dict[str, Row]) -> None:
    """Ratios under names, half their interquartile range as whiskers."""
    panel.set_title(title, fontsize=10)
    rows = list(named.values())
    ratios = [row.ratio or 1.0 for row in rows]
    whiskers = [ratio * row.spread for ratio, row in zip(ratios, rows, strict=True)]
    colours = [BLUE if ratio >= 1.0 else ORANGE for ratio in ratios]
    panel.barh(range(len(rows)), [r - 1.0 for r in ratios], left=1.0, color=colours, xerr=whiskers, ecolor=GREY)
    panel.set_yticks(range(len(rows)), list(named), fontsize=8)
    panel.invert_yaxis()
    panel.set_xscale("log")
    panel.axvline(1.0, color="black", linewidth=0.8)
    for place, (ratio, whisker) in enumerate(zip(ratios, whiskers, strict=True)):
        text = f"{ratio:.0f}" if ratio >= 100.0 else f"{ratio:.3g}"
        panel.annotate(
            text, (max(ratio + whisker, 1.0), place), (6, 0), textcoords="offset points", va="center", fontsize=8
        )
    panel.margins(x=0.15)
    panel.grid(axis="x", alpha=0.3)
