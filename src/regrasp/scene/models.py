"""A robot that somebody else described, read from its file and put right where MuJoCo or the planner would refuse it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
from pydantic.fields import FieldInfo

from regrasp.errors import InputError
from regrasp.scene import assets, inertia, menagerie, urdf
from regrasp.scene.forms import MODELS, MenagerieModel, ModelFile, OwnModel
from regrasp.scene.pose import Pose


@dataclass(frozen=True)
class Robot:
    """A model that compiles, with its files in memory.

    repairs: what was put right, each in a sentence. speeds: joint → its speed limit, rad/s or m/s, where the file gives
    one (URDF).
    """

    spec: mujoco.MjSpec
    repairs: tuple[str, ...]
    speeds: Mapping[str, float]


def read(model: OwnModel) -> Robot:
    """The robot of a scene's `model`. Raises InputError where it cannot be found, read or repaired."""
    match model:
        case ModelFile():
            return read_file(Path(model.file), model.packages)
        case MenagerieModel():
            return read_file(menagerie.path(model.menagerie), {})
    raise TypeError(model)


def read_file(path: Path, packages: Mapping[str, str]) -> Robot:
    """The robot in an MJCF or URDF file; `packages`: folders of the packages that package:// paths name."""
    if not path.is_file():
        raise InputError("model.file", f"no file {path}", "a path counts from the scene file's directory")
    speeds: Mapping[str, float] = {}
    if is_urdf(path):
        found = urdf.read(path, packages)
        spec, speeds = found.spec, found.speeds
        said = assets.embed(spec, lambda name, _: found.files.get(name), found.uris.__getitem__) + list(found.said)
    else:
        try:
            spec = mujoco.MjSpec.from_file(str(path))
        except ValueError as error:
            raise InputError("model.file", f"MuJoCo cannot read it: {_line(error)}") from None
        said = assets.embed(spec, assets.beside(spec))
    said += inertia.repair(spec)
    try:
        spec.compile()
    except ValueError as error:
        raise InputError("model.file", f"MuJoCo cannot read it: {_line(error)}") from None
    return Robot(spec, tuple(said), speeds)


def is_urdf(path: Path) -> bool:
    """Whether a file is URDF: by its suffix, else by its first element."""
    if path.suffix.lower() in (".urdf", ".xacro"):
        return True
    return "<robot" in path.read_text(encoding="utf-8", errors="replace").split("<mujoco", 1)[0]


def hands() -> dict[str, dict[str, str]]:
    """Built-in hand → its fields and what they are where a scene does not say, in words."""
    found = {}
    for tag, kind in MODELS.items():
        if "hand" in kind.model_fields:
            fields = {name: field for name, field in kind.model_fields.items() if name != "hand"}
            found[tag.removeprefix("model: ")] = {name: _default(field) for name, field in fields.items()}
    return found


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if value is None or value == {}:
        return "the hand's own"
    return "the world's origin" if isinstance(value, Pose) else str(value).lower()


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
