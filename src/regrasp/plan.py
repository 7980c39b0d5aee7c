"""The plan: what the planner found, as one immutable value that outlives its sources.

N intervals, M samples per interval (both ends included, so interval j ends where interval j+1 begins), k agents with nq
joints together, P support slots, A arcs of the route, L entries of energy history. Between samples the motion is
defined, not left open: inside an interval the joints and the object's position are the not-a-knot cubic spline in time
through the interval's M samples, the object's orientation is the slerp between neighbouring samples.

The file is an npz archive without pickle: the arrays, the assets of the model as bytes, and a JSON manifest. The same
plan gives the same bytes.
"""

import io
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regrasp.errors import InputError

FORMAT = "regrasp plan"
VERSION = 1

MOTIONS = (
    "stay", "roll+x", "roll-x", "roll+y", "roll-y", "slide+x", "slide-x", "slide+y", "slide-y", "relocate", "off",
)  # fmt: skip
"""Names of the codes in V. ±x, ±y: axis, in the contact frame, of the relative angular velocity (roll) or velocity."""
STAY, FIRST_ROLL, FIRST_SLIDE, RELOCATE, OFF = 0, 1, 5, 9, 10

SUPPORT_MODES = ("none", "stick", "slide")
"""Names of the codes in support_mode: what the object does on the support at that slot's contact."""
NONE, STICK, SLIDE = 0, 1, 2

Array = NDArray[np.float64]


ARRAYS: Mapping[str, tuple[type[np.generic], tuple[str | int, ...]]] = {
    "time": (np.float64, ("N", "M")),
    "object_position": (np.float64, ("N", "M", 3)),
    "object_quaternion": (np.float64, ("N", "M", 4)),
    "joints": (np.float64, ("N", "M", "nq")),
    "V": (np.int8, ("N", "k")),
    "twist": (np.float64, ("N", "k", 4)),
    "p_OC_O": (np.float64, ("N", "M", "k", 3)),
    "n_O": (np.float64, ("N", "M", "k", 3)),
    "x_O": (np.float64, ("N", "M", "k", 3)),
    "force_W": (np.float64, ("N", "M", "k", 3)),
    "support_mode": (np.int8, ("N", "P")),
    "support_p_O": (np.float64, ("N", "M", "P", 3)),
    "support_n_W": (np.float64, ("N", "M", "P", 3)),
    "support_force_W": (np.float64, ("N", "M", "P", 3)),
    "segment": (np.int64, ("N",)),
    "route": (np.float64, ("B", 7)),
    "energy": (np.float64, ("L",)),
    "energy_segment": (np.int64, ("L",)),
}
"""dtype and shape of every array of a plan; a letter means the same length everywhere."""


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """Object path, joints, contact motions, contacts and forces, and the scene they belong to.

    SI units, quaternions w x y z. An agent that is off or relocating in an interval has NaN in p_OC_O, n_O and x_O and
    zero in twist and force_W there. Construction copies the arrays, makes them read-only and raises InputError if a
    shape or dtype is wrong; whether the numbers are a valid motion is for `regrasp.verify.check` to say.
    """

    time: Array
    """Time of each sample, s."""
    object_position: Array
    """p_WO, m."""
    object_quaternion: Array
    """Rotation of O in W."""
    joints: Array
    """Joint values, in the order of `joint_names` (agent after agent), rad or m."""
    V: NDArray[np.int8]
    """The matrix V of the paper (§4): contact motion of each agent in each interval, codes in MOTIONS."""
    twist: Array
    """Relative motion of tip to object over the interval, in the contact frame: ω_x, ω_y in rad, v_x, v_y in m."""
    p_OC_O: Array
    """Contact point on the object, in O, m."""
    n_O: Array
    """Outward normal of the object there, in O."""
    x_O: Array
    """x axis of the contact frame (x, y, n), in O: parallel-transported along the contact's path in the interval."""
    force_W: Array
    """Force of the agent on the object, in W, N."""
    support_mode: NDArray[np.int8]
    """What each support slot does in each interval, codes in SUPPORT_MODES."""
    support_p_O: Array
    """Contact point with the support, in O, m; finite also where the mode is none."""
    support_n_W: Array
    """Normal from the support into the object, in W; finite also where the mode is none."""
    support_force_W: Array
    """Force of the support on the object, in W, N."""
    segment: NDArray[np.int64]
    """Arc of the route each interval belongs to."""
    route: Array
    """The global planner's subgoals (§3), B = A + 1 poses of the object: position, quaternion."""
    energy: Array
    """History of E(V), Eq. (1), of the local planner's current state."""
    energy_segment: NDArray[np.int64]
    """Arc each entry of the history belongs to."""
    support_names: tuple[str, ...]
    """Support (a name in the scene's `supports`) of each slot; one with several contact points has several slots."""
    agent_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    scene: Mapping[str, Any]
    """The scene file's content, complete."""
    xml: str
    """The MuJoCo model the plan was made for."""
    assets: Mapping[str, bytes]
    """Files the model refers to."""
    seed: int
    settings: Mapping[str, Any]
    """The planner's settings, complete."""
    versions: Mapping[str, str]
    """Versions of regrasp and of the libraries that made the plan."""
    feasible: bool
    """Whether the planner holds the plan for feasible; `check` does not rely on it."""
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        lengths: dict[str | int, tuple[int, str]] = {}
        lengths["P"] = (len(self.support_names), "support_names")
        lengths["k"] = (len(self.agent_names), "agent_names")
        lengths["nq"] = (len(self.joint_names), "joint_names")
        for name, (dtype, wanted) in ARRAYS.items():
            array = np.asarray(getattr(self, name))
            if array.dtype != dtype:
                raise InputError(f"plan.{name}", f"dtype {array.dtype}", f"wanted {np.dtype(dtype)}")
            for letter, length in zip(wanted, array.shape, strict=False):
                lengths.setdefault(letter, (length, name))
            if array.shape != tuple(n if isinstance(n, int) else lengths.get(n, (-1, ""))[0] for n in wanted):
                known = [f"{n} = {lengths[n][0]} as in {lengths[n][1]}" for n in wanted if n in lengths]
                hint = f"wanted ({', '.join(map(str, wanted))}){' with ' if known else ''}{', '.join(known)}"
                raise InputError(f"plan.{name}", f"shape {array.shape}", hint)
            array = array.copy(order="C")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        for letter, least in (("N", 1), ("M", 2), ("B", 2)):
            length, where = lengths[letter]
            if length < least:
                raise InputError(f"plan.{where}", f"{letter} = {length}", f"at least {least}")

    def summary(self) -> dict[str, Any]:
        """Counts, times and the use of each contact motion: what `--json` prints about a plan.

        energy: Σ over the segments of the least E(V); found_after: how many V's of each had been tried by then.
        """
        motions = {name: int(np.count_nonzero(code == self.V)) for code, name in enumerate(MOTIONS)}
        normal = np.linalg.norm(self.force_W, axis=-1).sum(axis=-1)
        histories = [self.energy[self.energy_segment == a] for a in np.unique(self.energy_segment)]
        return {
            "scene": self.scene.get("name", ""),
            "feasible": self.feasible,
            "intervals": int(self.time.shape[0]),
            "samples": int(self.time.shape[1]),
            "segments": int(self.route.shape[0] - 1),
            "duration": float(self.time[-1, -1] - self.time[0, 0]),
            "agents": list(self.agent_names),
            "motions": {name: count for name, count in motions.items() if count},
            "supports": sorted({name for p, name in enumerate(self.support_names) if np.any(self.support_mode[:, p])}),
            "largest_force": float(np.linalg.norm(self.force_W, axis=-1).max(initial=0.0)),
            "largest_force_sum": float(normal.max(initial=0.0)),
            "energy": float(sum(row.min() for row in histories)),
            "found_after": [int(row.argmin()) for row in histories],
            "evaluations": [len(row) for row in histories],
            "seed": self.seed,
            "remarks": list(self.remarks),
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the plan to `path`, whole or not at all (a temporary file beside it, renamed at the end)."""
        target = Path(path)
        handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(self._bytes())
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(temporary, 0o666 & ~umask)  # mkstemp's 0600 would make the plan unreadable to others
            os.replace(temporary, target)
        except BaseException:
            os.unlink(temporary)
            raise

    def _bytes(self) -> bytes:
        manifest: dict[str, Any] = {"format": FORMAT, "version": VERSION, "assets": list(self.assets)}
        arrays: dict[str, NDArray[Any]] = {}
        for each in fields(self):
            if each.name in ARRAYS:
                arrays[each.name] = getattr(self, each.name)
            elif each.name != "assets":
                manifest[each.name] = getattr(self, each.name)
        for i, content in enumerate(self.assets.values()):
            arrays[f"asset{i}"] = np.frombuffer(content, dtype=np.uint8)
        try:
            text = json.dumps(manifest, sort_keys=True, allow_nan=False, ensure_ascii=False)
        except (TypeError, ValueError) as error:
            raise InputError("plan", f"its manifest is not JSON: {error}", "finite numbers, strings, lists") from None
        arrays["manifest"] = np.frombuffer(text.encode(), dtype=np.uint8)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, allow_pickle=False, **arrays)
        return buffer.getvalue()


def load(path: str | os.PathLike[str]) -> Plan:
    """Read a plan file.

    Raises InputError naming the file if it can't be read, is no plan, is damaged, has another version, lacks an array
    or holds a manifest that is not finite JSON.
    """
    name = str(path)
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise InputError("plan", error.strerror or str(error), "path of a plan file", name) from None
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        manifest = _manifest(arrays.pop("manifest").tobytes(), name)
    except InputError:
        raise
    except Exception:  # a damaged archive makes zipfile, zlib and numpy raise nearly anything
        reason = "is not a plan" if not content.startswith(b"PK") else "is damaged or not a plan"
        raise InputError("plan", reason, "a file written by `regrasp plan`", name) from None
    values: dict[str, Any] = {}
    for each in fields(Plan):
        source = arrays if each.name in ARRAYS else manifest
        if each.name not in source:
            raise InputError(f"plan.{each.name}", "is missing", "plan it again", name)
        else:
            value = source[each.name]
            values[each.name] = tuple(value) if isinstance(value, list) else value
    try:
        values["assets"] = {asset: arrays[f"asset{i}"].tobytes() for i, asset in enumerate(manifest["assets"])}
        return Plan(**values)
    except InputError as error:
        raise InputError(error.field, error.reason, error.hint, name) from None
    except KeyError:
        raise InputError("plan.assets", "is missing a file", "plan it again", name) from None
    except TypeError:
        raise InputError("plan.manifest", "holds a value of the wrong type", "plan it again", name) from None


def _manifest(text: bytes, name: str) -> dict[str, Any]:
    def refuse(constant: str) -> float:
        raise InputError("plan.manifest", f"holds {constant}", "finite numbers only", name)

    try:
        manifest = json.loads(text, parse_constant=refuse)
    except ValueError:
        raise InputError("plan.manifest", "is not JSON", "a file written by `regrasp plan`", name) from None
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise InputError("plan.manifest.format", "is not a plan's", f"{FORMAT!r}", name)
    if manifest.get("version") != VERSION:
        found = manifest.get("version")
        raise InputError("plan.manifest.version", f"is {found}", f"this regrasp reads {VERSION}", name)
    return manifest
