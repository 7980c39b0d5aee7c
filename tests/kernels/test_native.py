"""Kernels without the memory manager: what they read and assign is what numpy does, and nothing can be allocated."""

import ast
import importlib
import inspect
import pkgutil
import textwrap
from collections.abc import Callable

import numpy as np
import pytest
from numba import config, njit
from numba.core.errors import NumbaError
from numba.core.event import Event, Listener, install_listener

import regrasp
from regrasp.kernels.native import kernel
from regrasp.kernels.stack import stack
from regrasp.planner.warm import kernels


def assign(rows: np.ndarray, block: np.ndarray, numbers: np.ndarray, cube: np.ndarray, square: np.ndarray) -> None:
    """Assignments of every form that kernels use."""
    cube[0] = square
    cube[1, :, :] = block[2, :3, :3]
    cube[2, 1:, 0] = rows[:2]
    cube[2, 0] = square[:, 1]
    rows[2:] = square[2, : len(rows) - 2]
    numbers[1:3], numbers[3:] = rows[:2], 7
    square[:] = 0.5


def arguments() -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(0)
    return rng.random(5), rng.random((3, 4, 5)), np.arange(6), rng.random((3, 3, 3)), rng.random((3, 3))


def test_slices_are_assigned_as_numpy_does() -> None:
    wanted, got = arguments(), arguments()
    assign(*wanted)
    kernel(assign)(*got)
    for a, b in zip(wanted, got, strict=True):
        np.testing.assert_array_equal(a, b)


def read(cube: np.ndarray, rows: np.ndarray, first: int, last: int, out: np.ndarray) -> None:
    """Numbers, rows, blocks and slices, of which some are empty and some reach to the end or would beyond it."""
    out[0] = len(rows[first:last]) + 10 * len(rows[first:]) + 100 * len(rows[:last]) + 1000 * len(rows[:])
    out[1] = len(rows[first : last + 9]) + 10 * len(rows[last:last]) + 100 * len(rows[len(rows) :])
    block = cube[first, 1:, :last]
    out[2], out[3] = block.shape[0], block.shape[1]
    for a in range(block.shape[0]):
        for b in range(block.shape[1]):
            out[4] += block[a, b] * cube[:, a, b][first] * cube[first:][0][a][b]
    out[5] = cube[first, 1, last] + rows[first:][1]


def test_what_is_read_is_what_numpy_reads() -> None:
    rng = np.random.default_rng(1)
    compiled = kernel(read)
    for first, last in ((0, 0), (0, 3), (1, 2), (2, 2)):
        cube, rows = rng.random((3, 4, 5)), rng.random(5)
        wanted, got = np.zeros(6), np.zeros(6)
        read(cube, rows, first, last, wanted)
        compiled(cube, rows, first, last, got)
        np.testing.assert_allclose(got, wanted, rtol=1e-15)


def from_the_end(function: Callable[..., object]) -> list[str]:
    """The indices and ends of slices in a function's source that are negative numbers."""
    found = []
    for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(function)))):
        if isinstance(node, ast.Subscript):
            signs = [number.op for number in numbers(node.slice) if isinstance(number, ast.UnaryOp)]
            found += [ast.unparse(node)] * any(isinstance(sign, ast.USub) for sign in signs)
    return found


def numbers(index: ast.expr) -> list[ast.expr | None]:
    """The numbers of an index: of its axes, and the ends of its slices."""
    axes = index.elts if isinstance(index, ast.Tuple) else [index]
    return [end for axis in axes for end in ([axis.lower, axis.upper] if isinstance(axis, ast.Slice) else [axis])]


def test_no_kernel_counts_from_the_end() -> None:
    for module in pkgutil.walk_packages(regrasp.__path__, "regrasp."):
        importlib.import_module(module.name)
    compiled = [one for one in kernels() if one.targetoptions.get("_nrt") is False]
    assert len(compiled) > 200
    assert [(one.py_func.__name__, index) for one in compiled for index in from_the_end(one.py_func)] == []
    assert sorted(from_the_end(negative)) == ["rows[-1]", "rows[0, -1]", "rows[1:-n]"]


def negative(rows: np.ndarray, n: int) -> float:
    """What a kernel must not do."""
    return rows[-1] + rows[1:-n] + rows[n - 1] + rows[0, -1]


def test_numbas_switch_stands_as_it_stood_before_a_compilation() -> None:
    seen = []

    def looks(a: np.ndarray) -> float:
        return a[0]

    before = config.SLP_VECTORIZE
    compiled = kernel(looks)
    compiled._cache.flush()  # an earlier run of the tests has compiled it
    with install_listener("numba:compile", During(seen)):
        assert compiled(np.ones(3)) == 1.0
    assert seen == [1, 1]
    assert before == config.SLP_VECTORIZE


class During(Listener):
    """Notes the switch when a compilation begins and ends."""

    def __init__(self, seen: list[int]) -> None:
        self._seen = seen

    def on_start(self, _: Event) -> None:
        self._seen.append(config.SLP_VECTORIZE)

    on_end = on_start


def test_a_kernel_allocates_nothing() -> None:
    def makes(n: int) -> float:
        return np.zeros(n)[0]

    with pytest.raises(NumbaError, match="zeros"):
        kernel(makes)(3)


@kernel
def triangle(n: int, out: np.ndarray) -> None:
    """Scratch arrays of lengths that are known at run time only, mixed with such that are not."""
    flat, block = stack(n), stack((2, n, 3))
    for a in range(n):
        flat[a] = a
        for b in range(3):
            block[0, a, b], block[1, a, b] = 10 * a + b, -1.0
    for a in range(n):
        out[a] = flat[a] + block[0, a, 2] + block[1, a, 1] + block.shape[0] * block.shape[2] * len(flat)


@njit
def triangles(n: int, times: int, out: np.ndarray) -> None:
    """Many calls of it, whose arrays together would be larger than a stack."""
    for _ in range(times):
        triangle(n, out)


def test_scratch_arrays_of_any_length_are_given_back() -> None:
    out = np.zeros(50)
    triangles(50, 100_000, out)
    np.testing.assert_array_equal(out, 11.0 * np.arange(50) + 1.0 + 300.0)
