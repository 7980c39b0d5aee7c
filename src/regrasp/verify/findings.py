"""Findings: one measured worst value each, with its tolerance and the place where it was found."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Finding:
    """A point of the certificate: the worst value measured, what is allowed, and where it stands.

    `value` must not exceed `tolerance`; the worst one is that with the largest ratio to its tolerance. `interval`,
    `time` (s) and `who` (agent, joint, geom or support) are None or empty where the point has no such place.
    """

    name: str
    text: str
    value: float
    tolerance: float
    unit: str
    interval: int | None = None
    time: float | None = None
    who: str = ""

    @property
    def passed(self) -> bool:
        """Whether the value is a number within its tolerance."""
        return bool(self.value <= self.tolerance)

    @property
    def place(self) -> str:
        """Interval, time and body in words."""
        parts = [self.who] if self.who else []
        if self.interval is not None:
            parts.append(f"interval {self.interval}")
        if self.time is not None:
            parts.append(f"t = {self.time:.4g} s")
        return ", ".join(parts)

    def __str__(self) -> str:
        sign = "≤" if self.passed else "exceeds"
        where = f" [{self.place}]" if self.place else ""
        return f"{self.name}: {self.text}: {self.value:.3g} {sign} {self.tolerance:.3g} {self.unit}".rstrip() + where


@dataclass(frozen=True)
class Certificate:
    """What `check` found: every point of docs/certificate.md that could be measured. It passes if all of them pass."""

    findings: tuple[Finding, ...]

    @property
    def passed(self) -> bool:
        """Whether the plan proves what a plan must prove."""
        return bool(self.findings) and all(finding.passed for finding in self.findings)

    @property
    def refusals(self) -> tuple[Finding, ...]:
        """The findings that do not pass, the worst first."""
        failed = [finding for finding in self.findings if not finding.passed]
        return tuple(sorted(failed, key=lambda f: -f.value / f.tolerance if f.tolerance > 0 else -math.inf))

    def to_dict(self) -> dict[str, Any]:
        """The certificate as JSON: a value that is no finite number becomes null."""
        rows = []
        for finding in self.findings:
            row = asdict(finding) | {"passed": finding.passed}
            row["value"] = finding.value if math.isfinite(finding.value) else None
            rows.append(row)
        return {"passed": self.passed, "findings": rows}


def worst(
    name: str,
    text: str,
    values: ArrayLike,
    tolerance: ArrayLike,
    unit: str,
    axes: str = "",
    time: Array | None = None,
    who: Sequence[str] = (),
    where: ArrayLike = True,
) -> Finding:
    """The finding at the entry of `values` with the largest ratio to `tolerance` (> 0).

    `axes` names the axes of `values`: j interval, s instant (looked up in `time` (N, S)), x entry of `who`. Entries
    where `where` is false are not judged; an entry that is judged and is no number counts as infinite.
    """
    values = np.asarray(values, dtype=float)
    allowed = np.broadcast_to(np.asarray(tolerance, dtype=float), values.shape)
    judged = np.broadcast_to(np.asarray(where, dtype=bool), values.shape)
    if not judged.any():
        return Finding(name, text, 0.0, float(np.nanmax(allowed, initial=0.0)), unit)
    values = np.where(np.isnan(values), np.inf, values)
    at = np.unravel_index(int(np.argmax(np.where(judged, values / allowed, -1.0))), values.shape)
    index = {axis: int(i) for axis, i in zip(axes, at, strict=True)}
    return Finding(
        name,
        text,
        float(values[at]),
        float(allowed[at]),
        unit,
        index.get("j"),
        float(time[index["j"], index["s"]]) if time is not None and "s" in index else None,
        who[index["x"]] if "x" in index else "",
    )
