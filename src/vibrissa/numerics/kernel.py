"""Compiled functions: soon at hand at first, fast once they have much to do."""

import gc
import hashlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import cache
from typing import Any, Generic, TypeVar

import jax
import numpy as np

from vibrissa.numerics.compiled import compiled, is_marked, mark

Result = TypeVar("Result")

_PATIENCE = 1.0
"""Compile time [s] after which a message is shown on a terminal."""
_told = threading.Lock()
_LARGE = 1 << 18
"""So many numbers among its arguments keep a single call busy for longer than that."""

_within = threading.local()
_at_once = threading.Event()


class Kernel(Generic[Result]):
    """A compiled function of trees of arrays; while one thread compiles it, others wait.

    Scalar code (`alone`) is first compiled without optimisation: in half the time, but it then
    takes three times as long to run. What has run for as long as it took to compile is compiled
    well, and in later processes at once: not knowing how much there is to do, that costs at most
    about twice what it would have cost to know.
    """

    def __init__(self, function: Callable[..., Result], *, alone: bool) -> None:
        self._name = function.__name__
        self._well = compiled(function)
        self._quick = compiled(function, quick=True) if alone else None
        self._ran: dict[object, float] = {}
        """How much longer [s] quick code has run than it took to compile, for each structure of
        arguments.
        """
        self._known: set[object] = set()
        self._compiling = threading.Lock()

    def __call__(self, *arguments: Any) -> Result:
        """Call the function."""
        leaves, structure = jax.tree.flatten(arguments)
        if self._quick is None or self._is_worth(structure, leaves):
            return self._called(self._well, structure, arguments)
        # Each shape is compiled separately.
        shaped = structure, *map(np.shape, leaves)
        runs, begin = (self._quick, shaped) in self._known, time.perf_counter()
        found = self._called(self._quick, shaped, arguments)
        took = time.perf_counter() - begin
        self._ran[structure] += took if runs else -took
        return found

    def _is_worth(self, structure: Any, leaves: list[Any]) -> bool:
        """Whether arguments of this structure are worth code that is compiled well."""
        ran = self._ran.get(structure, -np.inf)
        if ran == np.inf:
            return True
        worth = ran > 0 or _at_once.is_set() or sum(map(np.size, leaves)) > _LARGE
        if worth or ran == -np.inf:
            name = hashlib.sha256(f"{self._name} {structure}".encode()).hexdigest()
            if worth:
                mark(name)
            self._ran[structure] = np.inf if worth or is_marked(name) else 0.0
        return self._ran[structure] == np.inf

    def _called(self, function: Callable[..., Result], known: object, arguments: Any) -> Result:
        known = (function, known)
        if known in self._known:
            return function(*arguments)
        told = nullcontext() if getattr(_within, "quiet", False) else _telling()
        with told, self._compiling, _uncollected():
            found = function(*arguments)
            self._known.add(known)
        return found


@contextmanager
def quietly() -> Iterator[None]:
    """Say nothing of compilation in this thread."""
    _within.quiet = True
    try:
        yield
    finally:
        _within.quiet = False


@contextmanager
def compiled_well() -> Iterator[None]:
    """Compile well at once: for what may not be late afterwards."""
    # Threads that are started meanwhile do so too.
    _at_once.set()
    try:
        yield
    finally:
        _at_once.clear()


@cache
def _tell() -> None:
    sys.stderr.write("vibrissa: compiling, once on a machine for each kind of object …\n")


@contextmanager
def _telling() -> Iterator[None]:
    """Say on a terminal that kernels are being compiled, if the block takes long; once in a
    process.
    """
    if not sys.stderr.isatty() or not _told.acquire(blocking=False):
        yield
        return
    timer = threading.Timer(_PATIENCE, _tell)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        _told.release()


@contextmanager
def _uncollected() -> Iterator[None]:
    """Switch off garbage collection: tracing makes little garbage but triggers it very often, which
    takes a tenth of a compilation's time.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()
