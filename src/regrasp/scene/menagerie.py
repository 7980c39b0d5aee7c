"""MuJoCo Menagerie on this machine: a collection of robot models, found under the folder MENAGERIE_ROOT."""

import difflib
import os
from pathlib import Path

from regrasp.errors import InputError

VARIABLE = "MENAGERIE_ROOT"
SOURCE = "https://github.com/google-deepmind/mujoco_menagerie"


def root() -> str | None:
    """The folder that MENAGERIE_ROOT names."""
    return os.environ.get(VARIABLE) or None


def names() -> tuple[str, ...]:
    """All models found, `folder/file` without suffix; none where MENAGERIE_ROOT is not set.

    A file that only includes others to make a scene of them (scene*.xml) is not one.
    """
    folder = root()
    if folder is None:
        return ()
    files = (path for path in Path(folder).glob("*/*.xml") if not path.name.startswith("scene"))
    return tuple(sorted(f"{path.parent.name}/{path.stem}" for path in files))


def path(name: str) -> Path:
    """The file of a model, `folder/file` or, where the folder holds just one, `folder`.

    Raises InputError where MENAGERIE_ROOT is not set or has no such model: nothing is fetched from the network.
    """
    folder = root()
    if folder is None:
        remedy = f"git clone {SOURCE}, and set {VARIABLE} to its folder"
        raise InputError("model.menagerie", f"{VARIABLE} is not set", remedy)
    found = names()
    if not found:
        raise InputError("model.menagerie", f"no model under {VARIABLE}={folder}", f"a copy of {SOURCE}")
    if name in found:
        return Path(folder, f"{name}.xml")
    inside = [each for each in found if each.split("/")[0] == name]
    if len(inside) == 1:
        return Path(folder, f"{inside[0]}.xml")
    if inside:
        raise InputError("model.menagerie", f"{name!r} holds {len(inside)} models", f"legal: {', '.join(inside)}")
    near = difflib.get_close_matches(name, found, n=1, cutoff=0.4)
    hint = f"{near[0]}? " if near else ""
    raise InputError("model.menagerie", f"no model {name!r} under {folder}", f"{hint}see regrasp models")
