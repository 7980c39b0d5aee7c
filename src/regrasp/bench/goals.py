"""Random goals of an object held in three fingertips: how many are planned and certified, how fast, why the others are not."""

import dataclasses
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from regrasp.bench.kernels import compile_kernels, print_reasons, say
from regrasp.planner.method import plan_scene
from regrasp.planner.task import Settings
from regrasp.scene.load import validate
from regrasp.scene.schema import Scene
from regrasp.settings import read
from regrasp.verify.check import check

Array = NDArray[np.float64]

OBJECTS: dict[str, dict[str, Any]] = {
    "cube": {"shape": "box", "size": [0.025, 0.025, 0.025], "rounding": 0.004, "mass": 0.05},
    "ellipsoid": {"shape": "ellipsoid", "size": [0.035, 0.025, 0.025], "mass": 0.05},
    "cylinder": {"shape": "cylinder", "size": [0.025, 0.03], "rounding": 0.004, "mass": 0.05},
    "bracket": {"shape": "mesh", "file": "bracket.stl", "rounding": 0.004, "mass": 0.05},
}
BRACKET = np.array([[-22, -22], [28, -22], [28, 3], [3, 3], [3, 28], [-22, 28]]) * 1e-3
"""Corners of the bracket's section in x and y, m: an L, 50 mm either way and 25 mm thick; it is 50 mm high."""
HALF_HEIGHT = 0.025
HOLD = ("index", "middle", "thumb")
START = (0.055, -0.01, 0.075)
"""Where the object starts over the palm, m: in the middle of what the tips of all fingers reach."""
FAR, TURNED = 0.02, np.radians(60.0)
"""m, along each axis, and rad: the farthest goal."""
TOLERANCE = {"position": 0.001, "rotation": float(np.radians(1.0))}
LIMIT = 2.0
"""s that a goal is planned in."""
MARK = 0.9
"""Part of the goals of each object to be certified."""


def draw(count: int, rng: np.random.Generator) -> list[tuple[Array, Array]]:
    """Shifts (3,), uniform in the cube ±FAR, and rotation vectors (3,): any axis, an angle up to TURNED."""
    axes = rng.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return list(zip(rng.uniform(-FAR, FAR, (count, 3)), rng.uniform(0.0, TURNED, (count, 1)) * axes, strict=True))


def write_bracket(folder: Path) -> None:
    """The concave mesh, as a file of the name that OBJECTS has for it."""
    import trimesh

    n = len(BRACKET)
    low, high = (np.insert(BRACKET, 2, z, axis=1) for z in (-HALF_HEIGHT, HALF_HEIGHT))
    lid = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    k, following = np.arange(n), np.roll(np.arange(n), -1)
    sides = [np.stack([k, following, following + n], axis=1), np.stack([k, following + n, k + n], axis=1)]
    faces = np.concatenate([lid[:, ::-1], lid + n, *sides])
    trimesh.Trimesh(np.concatenate([low, high]), faces).export(folder / OBJECTS["bracket"]["file"])


def scene_of(name: str, shift: Array, turn: Array, folder: Path) -> Scene:
    """An object of OBJECTS over the Allegro hand's palm, to be moved by a shift and a rotation vector; folder: of the mesh."""
    shape = dict(OBJECTS[name])
    if "file" in shape:
        shape["file"] = str(folder / shape["file"])
    return in_hand(name, shape, np.zeros(3), shift, turn)


def in_hand(name: str, shape: dict[str, Any], middle: Array, shift: Array, turn: Array) -> Scene:
    """An object whose `middle` (3,) in O starts over the Allegro hand's palm, to be moved by a shift and a rotation vector."""
    R = Rotation.from_rotvec(turn)
    start, end = np.array(START) - middle, np.array(START) + shift - R.apply(middle)
    return validate({
        "name": f"goals-{name}",
        "model": {"hand": "allegro"},
        "object": shape,
        "agents": [{"name": finger} for finger in HOLD],
        "max_force": 5.0,
        "start": {"pose": {"position": start.tolist()}},
        "goal": {
            "pose": {"position": end.tolist(), "quaternion": R.as_quat(scalar_first=True).tolist()},
            "tolerance": TOLERANCE,
        },
    })  # fmt: skip


def goals(seeds: int) -> dict[str, Any]:
    """`seeds` random goals for every object, planned with default settings in LIMIT s, and checked.

    Passed if MARK of the goals of every object are certified.
    """
    compile_kernels()
    drawn = draw(seeds, np.random.default_rng(0))
    with tempfile.TemporaryDirectory() as folder:
        write_bracket(Path(folder))
        rows = [row_of(name, [scene_of(name, *goal, Path(folder)) for goal in drawn]) for name in OBJECTS]
    return shown("object", seeds, rows)


def shown(what: str, seeds: int, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The answer, after the rows are printed as a table, and why goals were missed; what: a row is of."""
    title = f"{seeds} random goals per {what}, three fingertips, {LIMIT:g} s each"
    table = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))
    for heading in ("object", "planned", "certified", "median s", "90 % s"):
        table.add_column(heading, justify="left" if heading == "object" else "right", no_wrap=True)
    for row in rows:
        table.add_row(
            row["scene"], str(row["planned"]), str(row["certified"]), f"{row['seconds']:.2f}", f"{row['most_seconds']:.2f}"
        )  # fmt: skip
    console = Console()
    console.print(table)
    print_reasons(console, rows)
    return {"passed": all(row["certified"] >= MARK * seeds for row in rows), "goals": seeds, "objects": rows}


def row_of(name: str, scenes: list[Scene]) -> dict[str, Any]:
    """How many scenes of one object are planned in LIMIT s and certified.

    seconds: median and ninth tenth of all, planned or not.
    """
    seconds, planned, certified, reasons = [], 0, 0, []
    for number, scene in enumerate(scenes):
        settings = dataclasses.replace(read(Settings, scene.planner), time_limit=LIMIT)
        started = time.perf_counter()
        outcome = plan_scene(scene, 0, settings)
        seconds.append(time.perf_counter() - started)
        reason = ""
        if outcome.plan is None or outcome.failure:
            reason = f"no plan: {outcome.failure}"
        elif seconds[-1] > LIMIT:  # what is under way when the time is up is finished
            reason = f"no plan in {LIMIT:g} s"
        else:
            planned += 1
            if refusals := check(outcome.plan).refusals:
                reason = "; ".join(f"refused: {finding}" for finding in refusals)
        certified += not reason
        say(f"{name}, goal {number}: {reason or 'certified'}, {seconds[-1]:.2f} s")
        if reason:
            reasons.append(f"goal {number}: {reason}")
    return {
        "scene": name,
        "planned": planned,
        "certified": certified,
        "seconds": float(np.median(seconds)),
        "most_seconds": float(np.quantile(seconds, 0.9)),
        "reasons": reasons,
    }
