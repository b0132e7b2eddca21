"""The cache of compiled kernels, and what is compiled how."""

import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vibrissa.numerics import compiled, kernel


def test_a_cache_that_has_become_too_large_loses_its_older_half(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is left is younger than all that went; a smaller one is left alone."""
    for age in range(10):
        entry = tmp_path / f"kernel-{age}"
        entry.touch()
        os.utime(entry, (1e9 - age, 1e9 - age))
    for most, left in ((10, 10), (9, 5)):
        monkeypatch.setattr(compiled, "_MOST_KERNELS", most)
        compiled._shrink(tmp_path)
        names = [f"kernel-{age}" for age in range(left)]
        assert sorted(entry.name for entry in tmp_path.iterdir()) == names
    compiled._shrink(tmp_path / "missing")


def test_what_runs_for_long_is_compiled_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And at once by the next process, or if its arguments are many, or if that is wanted."""
    monkeypatch.setattr(kernel, "is_marked", lambda name: (tmp_path / name).exists())
    monkeypatch.setattr(kernel, "mark", lambda name: (tmp_path / name).touch())
    monkeypatch.setattr(kernel, "_WORTH", 0.05)
    calls = []

    def compiled(function: Any, *, alone: bool, quick: bool = False) -> Any:
        def call(*arguments: Any) -> Any:
            calls.append("quick" if quick else "well")
            return function(*arguments)

        return call

    monkeypatch.setattr(kernel, "compiled", compiled)

    def slow(row: tuple[Any, ...]) -> float:
        time.sleep(0.03)
        return float(len(row))

    first = kernel.Kernel(slow, alone=True)
    # The first call of each shape, which compiles it, does not count.
    for row in [(1.0,)] * 5 + [(np.zeros(2),)]:
        first(row)
    assert calls == ["quick"] * 3 + ["well"] * 3
    calls.clear()

    again = kernel.Kernel(slow, alone=True)
    again((1.0,))
    again((1.0, 2.0))
    again((np.zeros(kernel._LARGE), 2.0))
    with kernel.compiled_well():
        again((1.0, 2.0, 3.0))
    again((1.0, 2.0, 3.0))
    assert calls == ["well", "quick", "well", "well", "well"]
    calls.clear()
    kernel.Kernel(slow, alone=False)((1.0, 2.0, 3.0, 4.0))
    assert calls == ["well"]
