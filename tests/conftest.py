"""For all tests: shape checks that take plain numbers, Hypothesis without a clock, and the data
beside the checkout.

Kernels are kept in the user's cache folder, as the package keeps them: the processes that share the
tests compile each once, and the next run compiles what has changed.
"""

import gc
import os
import re
import sys
from collections import Counter
from functools import partial, wraps
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, get_args

import beartype
import jaxtyping
import pytest
from hypothesis import settings
from numpy.typing import ArrayLike

# Bytecode is kept, whatever the machine's habit: without it each process that the tests start takes
# three times as long to import what it needs.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Two processes share the cores: a BLAS with threads of its own in each waits four times as long.
# Taken up by the processes that pytest starts.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Most of what tests make lives on, as compiled code does: looking through it less often takes a
# fiftieth less time.
gc.set_threshold(200_000, 50, 100)

# NumPy's `ArrayLike` says complex for "any number" and a protocol for "any sequence" that tuples do
# not fulfil; read to the letter, (0.0, 0.0, 1.0) would be none. The shape checks look up
# `beartype.beartype` when the package is imported.
_SEQUENCES = {hint: tuple | hint for hint in get_args(ArrayLike) if "NestedSequence" in repr(hint)}
_checking = beartype.beartype(
    conf=beartype.BeartypeConf(is_pep484_tower=True, hint_overrides=beartype.FrozenDict(_SEQUENCES))
)
_MADE: dict[object, Any] = {}


def _made_once(signature: Any) -> Any:
    """The check of a signature, which jaxtyping gives as a function that does nothing else. It is
    made once also for a function within a function, which every call defines anew: making it takes
    about 1 ms, whether checks are on or off.
    """
    hints = tuple(map(repr, signature.__annotations__.items()))
    known = signature.__module__, signature.__qualname__, signature.__code__, hints
    if known not in _MADE:
        _MADE[known] = _checking(signature)
    return _MADE[known]


beartype.beartype = _made_once

_CALLS = Counter[CodeType]()
_MOST_CALLS = 100
"""Calls of a function in a test whose shapes are checked: later ones say the same, and checks take
longer than most functions.
"""
_jaxtyped = jaxtyping.jaxtyped


def _checked_at_first(function: Any = None, **typechecker: Any) -> Any:
    """What jaxtyping makes of a function, and the function itself after so many calls and where
    checks are off. A function within a function is defined by every call, and making its checks
    takes half a millisecond.
    """
    if function is None:
        return partial(_checked_at_first, **typechecker)
    if not isinstance(function, FunctionType):
        return _jaxtyped(function, **typechecker)
    code = function.__code__

    def off() -> bool:
        return bool(jaxtyping.config.jaxtyping_disable) or _CALLS[code] >= _MOST_CALLS

    if "<locals>" in function.__qualname__ and off():
        return function
    checked = _jaxtyped(function, **typechecker)

    @wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        if off():
            return function(*args, **kwargs)
        _CALLS[code] += 1
        return checked(*args, **kwargs)

    return called


jaxtyping.jaxtyped = _checked_at_first

# Fresh examples in every run; one that fails is printed with what repeats it.
settings.register_profile(
    "vibrissa", deadline=None, database=None, max_examples=25, print_blob=True
)
settings.load_profile("vibrissa")

_TOGETHER = (
    r"calibrat|setup_check",
    r"smooth|kalman|manifold|thin_tips|branches|engine_rods|loaded_recordings|expected_error|loads_and_back",
    r"oracle|equilibria|stability|second_variation|test_friction\.py|friction_and_back|surface_sensing",
    r"test_noise\.py|channels|test_contact\.py|test_scene",
    r"degenerate|convex_objects|scan_of_primitives",
    r"turning|test_scan\.py|scan_properties|test_mesh\.py|reconstruct_properties",
)
"""Names of files whose tests need the same kernels: one process traces them once."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keep the tests of a file, and of files that need the same kernels, in one process."""
    from xdist.scheduler import LoadScopeScheduling

    class Together(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return next((names for names in _TOGETHER if re.search(names, file)), file)

    return Together(config, log)


_CHECKED: set[str] = set()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Any:
    """Check shapes in the first case of each test of parts; what else runs, runs as a user's
    program does, in half the time.
    """
    test = item.nodeid.partition("[")[0]
    jaxtyping.config.update("jaxtyping_disable", test in _CHECKED or "unit" not in item.path.parts)
    _CHECKED.add(test)
    _CALLS.clear()
    return (yield)


_SHARED = Path(__file__).parents[1].parent / "shared"


def _shared(*parts: str) -> Path:
    path = _SHARED.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"{'/'.join(parts)} does not lie beside this checkout, in the folder shared")
    return path


@pytest.fixture
def no_shape_checks(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the user meets, who runs without them: for arguments of another type than the signature
    says.
    """
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


@pytest.fixture(scope="session")
def oracle() -> Path:
    """The 40-digit solutions of the paper's case."""
    return _shared("oracle", "paraboloid_trails.csv")


@pytest.fixture(scope="session")
def sphere_60mm() -> Path:
    """The folder of recordings of a steel wire under a sphere."""
    return _shared("recordings", "sphere_60mm")
