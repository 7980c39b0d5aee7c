"""Figures for print: V, energy, forces, joints and clearances of a plan over time, in colours told apart by all eyes."""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import MaxNLocator

from regrasp.plan import FIRST_SLIDE, OFF, RELOCATE, SLIDE, STAY, STICK, SUPPORT_MODES, Plan
from regrasp.scene.world import World, from_plan
from regrasp.view import strip
from regrasp.view.clearances import clearances
from regrasp.view.ink import DARK, SUPPORT_FORCE, rgb
from regrasp.view.show import colours
from regrasp.view.viewpoint import object_radius

PANELS = ("V", "energy", "forces", "joints", "clearances")
SUFFIXES = (".pdf", ".svg", ".png")
WIDTH = 7.0
"""in: two columns of a paper."""
STYLE: Any = {
    "font.family": "DejaVu Sans", "font.size": 7.5, "axes.titlesize": 8, "axes.titleweight": "bold",
    "axes.titlelocation": "left", "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.6,
    "lines.linewidth": 1.2, "legend.frameon": False, "legend.fontsize": 7, "xtick.major.width": 0.6,
    "ytick.major.width": 0.6, "axes.grid": True, "grid.color": "#E4E4E0", "grid.linewidth": 0.5, "axes.axisbelow": True,
    # Type 42 embeds the font; an SVG has the letters as shapes. So both look the same everywhere.
    "pdf.fonttype": 42, "svg.fonttype": "path", "svg.hashsalt": "regrasp",
}  # fmt: skip
DASHES = ("-", "--", ":", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 2.5)))
"""One for each joint of an agent, in turn, and one for each agent's force."""
FAR = 3.0
"""Clearances of more are not told apart, in radii of the object."""


def figure(plan: Plan, what: Sequence[str] = PANELS) -> Figure:
    """The panels named, one below the other, of a plan; all but the energy share the time, s.

    V: the contact motion of each agent. energy: of the V's that the annealing came by, Eq. (1). forces: of each agent
    and of all supports together. joints: one row for each agent. clearances: see `regrasp.view.clearances`.
    """
    world = from_plan(plan.scene, plan.xml, plan.assets)
    k = len(plan.agent_names)
    heights = {"V": [0.5 + 0.16 * (k + len(strip.supports(plan)))], "joints": [0.75] * k}
    rows = [heights.get(name, [1.35]) for name in what]
    each = [height for of_panel in rows for height in of_panel]
    with rc_context(STYLE):
        whole = Figure(figsize=(WIDTH, sum(each) + 0.4 * len(rows)), layout="constrained")
        # One grid for all, so that the same time is at the same place in all panels.
        axes = list(whole.subplots(len(each), 1, squeeze=False, height_ratios=each)[:, 0])
        for name, of_panel in zip(what, rows, strict=True):
            DRAWN[name](axes[: len(of_panel)], plan, world)
            del axes[: len(of_panel)]
    return whole


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure by the path's suffix, one of SUFFIXES; the same figure gives the same bytes."""
    suffix = Path(path).suffix.lower()
    date = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}, ".png": {}}[suffix]
    with rc_context(STYLE):
        figure.savefig(path, metadata=date, dpi=200)


def _motions(rows: Sequence[Axes], plan: Plan, world: World) -> None:
    """The matrix V, intervals as long as they last."""
    (axes,) = rows
    axes.set_title("V, the contact motions")
    begin, last = plan.time[:, 0] - plan.time[0, 0], plan.time[:, -1] - plan.time[:, 0]
    names = [*plan.agent_names, *strip.supports(plan)]
    for i in range(len(plan.agent_names)):
        fills = [strip.fill(int(code)) for code in plan.V[:, i]]
        axes.broken_barh(list(zip(begin, last, strict=True)), (i - 0.42, 0.84), facecolors=fills, edgecolor="white",
                         linewidth=0.3)  # fmt: skip
    for i, name in enumerate(strip.supports(plan), len(plan.agent_names)):
        modes = plan.support_mode[:, [slot == name for slot in plan.support_names]].max(axis=1)
        for mode, look in SUPPORT_LOOKS.items():
            bars = [(begin[j], last[j]) for j in np.flatnonzero(modes == mode)]
            axes.broken_barh(bars, (i - 0.3, 0.6), edgecolor=SUPPORT_FORCE, linewidth=0.4, **look)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(visible=False)
    _time(axes, plan)
    used = {strip.fill(int(code)): words for code, words in MOTION_WORDS.items() if np.any(_kind(plan) == code)}
    patches = [Patch(facecolor=fill, edgecolor="#8a8a8a", linewidth=0.4, label=words) for fill, words in used.items()]
    if len(names) > len(plan.agent_names):
        patches += [Patch(edgecolor=SUPPORT_FORCE, label=f"support: {SUPPORT_MODES[mode]}", **look)
                    for mode, look in SUPPORT_LOOKS.items()]  # fmt: skip
    _legend(axes, patches)


SUPPORT_LOOKS: Mapping[int, dict[str, Any]] = {
    STICK: {"facecolor": SUPPORT_FORCE},
    SLIDE: {"facecolor": "white", "hatch": "//////"},
}

MOTION_WORDS = {STAY: "stay", 1: "roll", FIRST_SLIDE: "slide", RELOCATE: "relocate", OFF: "off"}


def _kind(plan: Plan) -> Any:
    """V with all rolls as the first one, all slides as the first one."""
    rolls, slides = (plan.V > STAY) & (plan.V < FIRST_SLIDE), (plan.V >= FIRST_SLIDE) & (plan.V < RELOCATE)
    return np.where(rolls, 1, np.where(slides, FIRST_SLIDE, plan.V))


def _energy(rows: Sequence[Axes], plan: Plan, world: World) -> None:
    """The history of the annealing, arc after arc, and the least so far of each."""
    (axes,) = rows
    axes.set_title("energy E(V) of Eq. (1), arc after arc")
    axes.set_xlabel("evaluation")
    start = 0
    for arc in np.unique(plan.energy_segment):
        history = plan.energy[plan.energy_segment == arc]
        x = start + np.arange(len(history))
        axes.plot(x, history, color="#999999", linewidth=0.7, label="current" if not start else None)
        best = np.minimum.accumulate(history)
        axes.plot(x, best, color=DARK, drawstyle="steps-post", marker="." if len(x) == 1 else None,
                  label="least so far" if not start else None)  # fmt: skip
        start += len(history)
    if plan.energy.size and plan.energy.min() > 0 and plan.energy.max() > 20 * plan.energy.min():
        axes.set_yscale("log")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    _legend(axes)


def _forces(rows: Sequence[Axes], plan: Plan, world: World) -> None:
    """Magnitudes at the samples."""
    (axes,) = rows
    axes.set_title("contact forces, N")
    time, size = _times(plan), np.linalg.norm(plan.force_W, axis=-1)
    for i, (name, colour) in enumerate(zip(plan.agent_names, colours(plan), strict=True)):
        _line(axes, time, size[:, :, i].ravel(), colour, DASHES[i % len(DASHES)], name)
    if plan.support_mode.any():
        of_supports = np.linalg.norm(plan.support_force_W, axis=-1).sum(axis=-1)
        _line(axes, time, of_supports.ravel(), SUPPORT_FORCE, "-", "all supports")
    axes.set_ylim(bottom=0.0)
    _time(axes, plan)
    _legend(axes)


def _joints(rows: Sequence[Axes], plan: Plan, world: World) -> None:
    """Values of the joints, one row for each agent."""
    rows[0].set_title("joint values, rad (slides: m)")
    time, first = _times(plan), 0
    for axes, agent, colour in zip(rows, world.agents, colours(plan), strict=True):
        for n in range(len(agent.joints)):
            name = plan.joint_names[first + n].removeprefix(f"{agent.name}/").removeprefix("robot/")
            _line(axes, time, plan.joints[:, :, first + n].ravel(), colour, DASHES[n % len(DASHES)], name)
        first += len(agent.joints)
        axes.set_ylabel(agent.name)
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.05), fontsize=6, handlelength=2.6, labelspacing=0.2)
        axes.set_xlim(0, time[-1])
        axes.tick_params(labelbottom=axes is rows[-1])
    rows[-1].set_xlabel("time, s")


def _clearances(rows: Sequence[Axes], plan: Plan, world: World) -> None:
    """Least distances of bodies that must not touch."""
    (axes,) = rows
    axes.set_title("clearances, mm")
    far = FAR * object_radius(world)
    found = clearances(plan, world, far)
    for (kind, least), colour, dash in zip(found.items(), KIND_COLOURS, DASHES, strict=False):
        shown = np.where(least < far, least, np.nan)
        _line(axes, _times(plan), 1e3 * shown.ravel(), colour, dash, kind)
    axes.axhline(0.0, color=DARK, linewidth=0.6)
    _time(axes, plan)
    _legend(axes)


KIND_COLOURS = ("#009E73", "#D55E00", "#CC79A7", "#0072B2")
"""Of Okabe and Ito, for the kinds of clearance."""
DRAWN: Mapping[str, Callable[[Sequence[Axes], Plan, World], None]] = {
    "V": _motions, "energy": _energy, "forces": _forces, "joints": _joints, "clearances": _clearances,
}  # fmt: skip


def _times(plan: Plan) -> Any:
    return (plan.time - plan.time[0, 0]).ravel()


def _line(axes: Axes, x: Any, y: Any, colour: str, dash: Any, label: str) -> None:
    """A line; a light one has a dark edge, without which it could not be seen on white."""
    light = float(rgb(colour) @ [0.2126, 0.7152, 0.0722]) > 0.7
    effects = [Stroke(linewidth=2.0, foreground="#6b6b6b"), Normal()] if light else []
    axes.plot(x, y, color=colour, linestyle=dash, label=label, path_effects=effects)


def _time(axes: Axes, plan: Plan) -> None:
    axes.set_xlim(0, float(plan.time[-1, -1] - plan.time[0, 0]))
    axes.set_xlabel("time, s")


def _legend(axes: Axes, handles: Sequence[Patch] | None = None) -> None:
    """Right of the panel, so that it covers nothing."""
    own = {} if handles is None else {"handles": handles}
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.05), **own)
