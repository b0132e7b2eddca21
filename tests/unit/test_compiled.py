"""The cache of compiled kernels."""

import os
from pathlib import Path

import pytest

from vibrissa.numerics import compiled


def test_a_cache_that_has_become_too_large_loses_its_oldest_entries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is left is within the limit, and younger than all that went."""
    for age in range(10):
        entry = tmp_path / f"kernel-{age}"
        entry.write_bytes(bytes(1000))
        os.utime(entry, (1e9 - age, 1e9 - age))
    monkeypatch.setattr(compiled, "_LARGEST_CACHE", 3500)
    compiled._shrink(tmp_path)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [f"kernel-{n}" for n in range(3)]
    compiled._shrink(tmp_path / "missing")
