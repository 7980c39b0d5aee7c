"""Kernels from the cache: without numba's tables, usable by kernels that are compiled, and told where there are none."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import json, sys
import numpy as np
from regrasp.kernels import rotations
from regrasp.planner.warm import COMPILING, warmed

steps = []
with warmed(steps.append):
    for name in sys.argv[1:]:
        print(json.dumps(getattr(rotations, name)(np.array([3.0, 0.0, 4.0]))))
assert all(step.stage == COMPILING for step in steps)
print(json.dumps([[step.done, step.total] for step in steps]))
print(json.dumps("numba.np.linalg" in sys.modules))
"""


def run(cache: Path, *names: str) -> list:
    """What a fresh process says: the kernels' values, the progress told, whether numba's tables were loaded."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *names],
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("numba")


def test_only_what_is_not_in_the_cache_is_compiled_and_told(cache: Path) -> None:
    """First `norm` is compiled; then it comes from the cache; then `unit`, which calls it, is compiled and links it."""
    value, steps, _ = run(cache, "norm")
    assert value == 5.0
    assert len(steps) == 2
    assert all(0 <= done < total for done, total in steps)
    assert [done for done, _ in steps] == sorted(done for done, _ in steps)

    assert run(cache, "norm") == [5.0, [], False]

    value, unit, steps, tables = run(cache, "norm", "unit")
    assert (value, unit, tables) == (5.0, [0.6, 0.0, 0.8], True)
    assert len(steps) == 2

    assert run(cache, "unit", "norm") == [[0.6, 0.0, 0.8], 5.0, [], False]
