"""What is dear to make and follows from its input alone, kept on disk between runs under a hash of that input."""

import contextlib
import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any


def folder() -> Path:
    """The user's cache of regrasp, below XDG_CACHE_HOME or ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "regrasp"


def kept(kind: str, content: bytes, make: Callable[[], Any]) -> Any:
    """`make()`, plain data for JSON, or what it gave before for the same content and kind.

    `kind` names what is made and by which version of the method. A cache that cannot be read or written is none.
    """
    path = folder() / kind / f"{hashlib.sha256(content).hexdigest()}.json"
    with contextlib.suppress(OSError, ValueError):
        return json.loads(path.read_text(encoding="utf-8"))
    made = make()
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        whole = path.with_suffix(f".{os.getpid()}")  # another process may write or read the same one
        whole.write_text(json.dumps(made), encoding="utf-8")
        whole.replace(path)
    return made
