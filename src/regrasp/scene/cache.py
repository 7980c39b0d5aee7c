"""What is dear to make and follows from its input alone, kept on disk between runs under a hash of that input."""

import contextlib
import hashlib
import io
import json
import os
import sys
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]


def folder() -> Path:
    """The user's cache of regrasp, below XDG_CACHE_HOME or where the platform has it."""
    home = Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")
    return Path(os.environ.get("XDG_CACHE_HOME") or home) / "regrasp"


def kept(kind: str, content: bytes, make: Callable[[], Any]) -> Any:
    """`make()`, plain data for JSON, or what it gave before for the same content and kind.

    `kind` names what is made and by which version of the method. A cache that cannot be read or written is none.
    """
    path = folder() / kind / f"{hashlib.sha256(content).hexdigest()}.json"
    with contextlib.suppress(OSError, ValueError):
        return json.loads(path.read_text(encoding="utf-8"))
    made = make()
    _write(path, json.dumps(made).encode())
    return made


def kept_arrays(kind: str, made_from: Arrays, make: Callable[[], Arrays]) -> Arrays:
    """As `kept`, of arrays by their names, made from such."""
    digest = hashlib.sha256()
    for name, array in sorted(made_from.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    path = folder() / kind / f"{digest.hexdigest()}.npz"
    with contextlib.suppress(OSError, ValueError, EOFError, zipfile.BadZipFile), np.load(path) as archive:
        return dict(archive)
    arrays = make()
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **arrays)
    _write(path, file.getvalue())
    return arrays


def _write(path: Path, content: bytes) -> None:
    """The file written whole or not at all: another process may write or read the same one."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}")
        part.write_bytes(content)
        part.replace(path)
