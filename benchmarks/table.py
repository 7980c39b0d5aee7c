"""Runs written and read, shown as tables in Markdown, and one run compared with another."""

import json
import math
import os
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

from benchmarks.measure import Row

VERSION = 1
NOISE = 2.0
"""Spreads by which a row must have moved to count as changed, and no less than LEAST."""
LEAST = 0.05
HIGHER = ("1/s", "certified")
"""Units of which more is better."""


def machine() -> dict[str, Any]:
    """What the times were taken on."""
    versions = {name: metadata.version(name) for name in ("numba", "numpy", "scipy", "mujoco")}
    return {
        "processors": os.cpu_count(),
        "machine": platform.machine(),
        "python": platform.python_version(),
        **versions,
    }


def save(path: Path, rows: list[Row], quick: bool, seconds: float) -> None:
    """A run as JSON."""
    run = {
        "version": VERSION,
        "quick": quick,
        "seconds": seconds,
        "load": os.getloadavg(),
        "machine": machine(),
        "rows": [row.as_dict() for row in rows],
    }
    path.write_text(json.dumps(run, indent=1), encoding="utf-8")


def read(path: Path) -> list[Row]:
    """The rows of a saved run; ValueError where it is none."""
    try:
        run = json.loads(path.read_text(encoding="utf-8"))
        if run["version"] != VERSION:
            raise ValueError(f"{path}: version {run['version']}, not {VERSION}")
        return [Row(**row) for row in run["rows"]]
    except (OSError, TypeError, KeyError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: not a saved run ({error})") from None


def number(value: float | None, unit: str) -> str:
    """A value with its unit, times in what suits them."""
    if value is None or math.isnan(value):
        return ""
    if math.isinf(value):
        return "never"
    if unit == "s":
        for factor, word in ((1e9, "ns"), (1e6, "µs"), (1e3, "ms")):
            if abs(value) * factor < 999.5:
                return f"{value * factor:.3g} {word}"
        return f"{value:.3g} s"
    if unit == "certified":
        return f"{100.0 * value:.0f} %"
    return f"{value:.4g}" if value < 1e4 else f"{value:.0f}"


def markdown(rows: list[Row]) -> str:
    """All rows, a table for each group."""
    lines = []
    for group in dict.fromkeys(row.group for row in rows):
        lines += [f"| {group} | here | reference | ratio | ± | |", "|---|---|---|---|---|---|"]
        for row in rows:
            if row.group == group:
                ratio = "" if row.ratio is None else f"{row.ratio:.2f}" if row.ratio < 100.0 else f"{row.ratio:.0f}"
                cells = [row.name, number(row.value, row.unit), number(row.reference, row.unit), ratio]
                lines.append(f"| {' | '.join(cells)} | {100.0 * row.spread:.0f} % | {row.note} |")
        lines.append("")
    return "\n".join(lines)


def change(a: Row, b: Row) -> tuple[float, bool]:
    """(how many times better b is than a, whether that is beyond both rows' spreads); by the ratios where there are any.

    A ratio to the reference of its own run tells two machines' codes apart, not the machines.
    """
    first, second = (a.ratio, b.ratio) if a.ratio is not None and b.ratio is not None else (a.value, b.value)
    if not (0.0 < first < math.inf and 0.0 < second < math.inf):
        return (1.0, False) if str(first) == str(second) else (math.nan, True)
    better = second / first if a.ratio is not None or a.unit in HIGHER else first / second
    noise = max(NOISE * math.hypot(a.spread, b.spread), LEAST)
    return better, abs(math.log(better)) > math.log1p(noise)


def comparison(first: list[Row], second: list[Row]) -> str:
    """Every row of either run: how many times better the second is, marked where that is more than noise."""
    old, new = ({(row.group, row.name): row for row in rows} for rows in (first, second))
    lines = ["| | A | B | ratio A | ratio B | B better | |", "|---|---|---|---|---|---|---|"]
    for key in dict.fromkeys([*old, *new]):
        a, b = old.get(key), new.get(key)
        cells = [f"{key[0]}: {key[1]}"]
        cells += [number(row.value, row.unit) if row else "" for row in (a, b)]
        cells += [f"{row.ratio:.3g}" if row and row.ratio is not None else "" for row in (a, b)]
        if a is None or b is None:
            cells += ["", f"only in {'B' if a is None else 'A'}"]
        else:
            better, beyond = change(a, b)
            word = "changed" if math.isnan(better) else "better" if better > 1.0 else "worse"
            cells += ["" if math.isnan(better) else f"× {better:.2f}", f"**{word}**" if beyond else ""]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
