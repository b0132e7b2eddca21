"""The cache of compiled kernels."""

import os
from pathlib import Path

import pytest

from vibrissa.numerics import compiled


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
