"""Drops the compiled kernels that an edit reaches.

numba keeps machine code beside each source and throws it away when that source has changed, but not when only a kernel
that it calls has. So what is kept of every module that imports an edited one, directly or not, goes too.

    python tools/stale.py STAMP    STAMP: a file as old as the last compilation; without it all goes
"""

import sys
from pathlib import Path

import grimp

SOURCES = Path(__file__).parents[1] / "src"


def module_of(path: Path) -> str:
    """The module's dotted name."""
    parts = path.relative_to(SOURCES).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def reached(edited: set[str]) -> set[str]:
    """The edited modules and all that import them, directly or not."""
    graph = grimp.build_graph("regrasp", cache_dir=None)
    known = edited & graph.modules
    return edited.union(*(graph.find_downstream_modules(module) for module in known))


def main(stamp: Path) -> None:
    """Drop what was compiled before the edits since `stamp`."""
    sources = {module_of(path): path for path in SOURCES.rglob("*.py")}
    if stamp.exists():
        last = stamp.stat().st_mtime
        stale = reached({name for name, path in sources.items() if path.stat().st_mtime > last})
    else:
        stale = set(sources)
    for module in stale & sources.keys():
        path = sources[module]
        for kept in (path.parent / "__pycache__").glob(f"{path.stem}.*.nb[ic]"):
            kept.unlink()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
