"""What is dear to compute from a mesh is kept on disk, under the hash of all that it was computed from."""

import contextlib
import hashlib
import os
import sys
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]

VERSION = 1  # of what is kept: another number forgets it all


def folder() -> Path:
    """The user's cache directory for regrasp, as the platform has it."""
    home = Path("~/Library/Caches" if sys.platform == "darwin" else "~/.cache").expanduser()
    return Path(os.environ.get("XDG_CACHE_HOME") or home) / "regrasp"


def kept(kind: str, made_from: Arrays, make: Callable[[], Arrays]) -> Arrays:
    """The arrays that `make` computes from the arrays `made_from`, from disk where they have been computed before.

    A cache that can be neither read nor written is no error.
    """
    digest = hashlib.sha256(f"{kind} {VERSION}".encode())
    for name, array in sorted(made_from.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    path = folder() / f"{kind}-{digest.hexdigest()[:32]}.npz"
    with contextlib.suppress(OSError, ValueError, EOFError, zipfile.BadZipFile), np.load(path) as archive:
        return dict(archive)
    arrays = make()
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]  # to pack and unpack takes longer than to read
        Path(file.name).replace(path)
    return arrays
