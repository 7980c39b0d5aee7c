"""How the planner's kernels come into memory: from numba's cache with nothing beside them, or compiled, and then told."""

# numba's caches and its registry of kernels are untyped.
# mypy: disable-error-code="import-untyped, no-untyped-call, misc, attr-defined"

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import llvmlite.binding as llvm
import numba
from numba.core import event
from numba.core.caching import FunctionCache, _Cache
from numba.core.codegen import JITCodeLibrary
from numba.core.dispatcher import Dispatcher
from numba.core.runtime import rtsys

from regrasp.planner.outcome import Progress, Report

TRIED = "0.68."
"""The numba whose caches `Lean` and `Stored` know; with any other, kernels load as numba does it, a second slower."""

COMPILING = "compiling the kernels, once, which takes minutes"
"""The stage that is told."""


class Stored(JITCodeLibrary):
    """Machine code from the cache. Its bitcode is kept as it is until a kernel that is compiled links it.

    numba parses the bitcode of everything below a kernel at once, which takes four times as long as loading the code.
    """

    _bitcode: bytes | None = None

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, str, Any]) -> JITCodeLibrary:
        name, kind, data = state
        if kind != "object":
            return super()._unserialize(codegen, state)
        library = codegen.create_library(name)
        library.enable_object_caching()
        code, library._bitcode = data
        library._set_compiled_object(code)
        library._finalize_final_module()
        return library

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None and self._bitcode is not None:
            self._shared_module = llvm.parse_bitcode(self._bitcode)
            self._codegen._engine._load_defined_symbols(self._shared_module)
        return super()._get_module_for_linking()

    def get_pointer_to_function(self, name: str) -> int:
        """Address of one of its functions."""
        if self._shared_module is None and self._bitcode is not None:
            return self._codegen._engine.get_function_address(name)
        return super().get_pointer_to_function(name)


class Lean(_Cache):
    """A kernel's cache that loads it without numba's tables of types and operations, which only a compilation reads.

    To fill them takes longer than to load all kernels; a compilation does it by itself.
    """

    def __init__(self, cache: FunctionCache) -> None:
        self._cache = cache

    @property
    def cache_path(self) -> str:
        """Directory of its files."""
        return self._cache.cache_path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The kernel compiled for a signature, None where there is none."""
        rtsys.initialize(target_context)
        target_context.codegen()._library_class = Stored
        with self._cache._guard_against_spurious_io_errors():
            return self._cache._load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled."""
        self._cache.save_overload(sig, data)

    def enable(self) -> None:
        """Use the cache."""
        self._cache.enable()

    def disable(self) -> None:
        """Don't use the cache."""
        self._cache.disable()

    def flush(self) -> None:
        """Throw away what is kept."""
        self._cache.flush()


def kernels() -> list[Dispatcher]:
    """All kernels of the modules imported so far."""
    modules = [module for name, module in sys.modules.items() if name.startswith("regrasp.")]
    return [
        value
        for module in modules
        for value in vars(module).values()
        if isinstance(value, Dispatcher) and value.py_func.__module__ == module.__name__
    ]


class Told(event.Listener):
    """Reports how many of the kernels are in memory, whenever the compilation of one begins or ends."""

    def __init__(self, kernels: list[Dispatcher], report: Report) -> None:
        self._kernels, self._report = kernels, report

    def on_start(self, _: event.Event) -> None:
        """One more is compiled: numba says so only where the cache does not have it."""
        done = sum(bool(kernel.overloads) for kernel in self._kernels)
        self._report(Progress(COMPILING, done, len(self._kernels), math.nan, math.nan))

    on_end = on_start


@contextmanager
def warmed(report: Report) -> Iterator[None]:
    """A context in which kernels come from the cache leanly, and `report` is told of those that have to be compiled."""
    found = kernels()
    for kernel in found if numba.__version__.startswith(TRIED) else ():
        if isinstance(kernel._cache, FunctionCache):
            kernel._cache = Lean(kernel._cache)
    with event.install_listener("numba:compile", Told(found, report)):
        yield
