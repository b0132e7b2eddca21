"""MATLAB's `.mat`, up to version 7; version 7.3 is HDF5."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vibrissa.io.recordings.arrays import Columns, matched, numbers, reading


def columns(file: Path, wanted: Sequence[str]) -> Columns:
    """Matrices of a `.mat` file by their names, fields of structs as `struct.field`.

    Parameters
    ----------
    file
        Of version 4, 6 or 7.
    wanted
        The matrices to read; those that are not there are left out.

    Raises
    ------
    InputError
        If the file is damaged, or what is asked for holds no real numbers.
    """
    from scipy.io import loadmat  # noqa: PLC0415

    with reading(file, ".mat"):
        held = dict(_leaves(loadmat(file, appendmat=False, simplify_cells=True)))
        chosen = matched(wanted, held)
        arrays = {name: numbers(file, name, np.asarray(held[own])) for name, own in chosen.items()}
    return Columns(file, list(held), arrays)


def _leaves(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        elif not key.startswith("__"):
            yield f"{prefix}{key}", value
