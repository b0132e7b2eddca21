"""The cache of compiled kernels, and what is compiled how."""

import os
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
    calls: list[str] = []
    seconds = [0]
    monkeypatch.setattr(kernel.time, "perf_counter", lambda: seconds[0])

    def compiled(function: Any, *, quick: bool = False) -> Any:
        shapes: set[object] = set()

        def call(row: tuple[Any, ...]) -> Any:
            shape = tuple(map(np.shape, row))
            seconds[0] += 2 * (shape not in shapes)
            shapes.add(shape)
            calls.append("quick" if quick else "well")
            return function(row)

        return call

    monkeypatch.setattr(kernel, "compiled", compiled)

    def slow(row: tuple[Any, ...]) -> float:
        seconds[0] += 1
        return float(len(row))

    # The first call of each shape compiles it, which takes three seconds with the call itself.
    for rows, most in (([(1.0,)] * 9, 5), ([(1.0,), (np.zeros(2),)] + [(1.0,)] * 9, 9)):
        calls.clear()
        for marked in tmp_path.iterdir():
            marked.unlink()
        first = kernel.Kernel(slow, alone=True)
        for row in rows:
            first(row)
        assert calls == ["quick"] * most + ["well"] * (len(rows) - most)
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
