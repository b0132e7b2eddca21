"""For all tests: shape checks that take plain numbers, Hypothesis without a clock, kernels compiled
once for all processes, and the data beside the checkout.
"""

import os
import shutil
import tempfile
from pathlib import Path
from typing import get_args

import beartype
import jaxtyping
import pytest
from hypothesis import settings
from numpy.typing import ArrayLike

# NumPy's `ArrayLike` says complex for "any number" and a protocol for "any sequence" that tuples do
# not fulfil; read to the letter, (0.0, 0.0, 1.0) would be none. The shape checks look up
# `beartype.beartype` when the package is imported.
_SEQUENCES = {hint: tuple | hint for hint in get_args(ArrayLike) if "NestedSequence" in repr(hint)}
beartype.beartype = beartype.beartype(
    conf=beartype.BeartypeConf(is_pep484_tower=True, hint_overrides=beartype.FrozenDict(_SEQUENCES))
)

# Fresh examples in every run; one that fails is printed with what repeats it.
settings.register_profile(
    "vibrissa", deadline=None, database=None, max_examples=25, print_blob=True
)
settings.load_profile("vibrissa")

_COMPILED = "JAX_COMPILATION_CACHE_DIR"
_HERE = "VIBRISSA_TESTS_COMPILED"

if _COMPILED not in os.environ:
    # Of this run alone: the processes that share the tests, and those that tests start, compile
    # each kernel once.
    os.environ[_COMPILED] = os.environ[_HERE] = tempfile.mkdtemp(prefix="vibrissa-tests-")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")


def pytest_unconfigure() -> None:
    """Leave nothing behind."""
    if "PYTEST_XDIST_WORKER" not in os.environ and _HERE in os.environ:
        shutil.rmtree(os.environ.pop(_HERE), ignore_errors=True)


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
