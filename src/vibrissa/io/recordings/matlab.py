"""MATLAB's `.mat`, up to version 7; version 7.3 is HDF5."""

import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np

from vibrissa.files import InputError
from vibrissa.io.recordings.arrays import Array, Columns
from vibrissa.io.recordings.limits import Budget

_HEADER = 128
_COMPRESSED = 15
_PIECE = 2**20
_DEEPEST = 8


def columns(file: Path) -> Columns:
    """Matrices of a `.mat` file by their names, fields of structs as `struct.field`.

    Parameters
    ----------
    file
        Of version 4, 6 or 7.

    Raises
    ------
    InputError
        If the file is damaged, unpacks to more than allowed, or what is asked for is no numeric matrix.
    """
    from scipy.io import loadmat  # noqa: PLC0415

    content = file.read_bytes()
    if content[:6] == b"MATLAB":
        _check_size(file, content)
    try:
        variables = loadmat(BytesIO(content), struct_as_record=True, squeeze_me=False, chars_as_strings=True)
    # SciPy's reader meets damage in many ways; none of them may reach the user as anything else than a damaged file.
    except Exception as error:
        raise InputError(f"{file}: damaged .mat ({str(error)[:200]}); allowed is a whole file of MATLAB 4 to 7.3") from error
    found = dict(_fields({name: value for name, value in variables.items() if not name.startswith("__")}))
    return Columns(file, list(found), lambda name: _numbers(file, name, found[name]))


def _check_size(file: Path, content: bytes) -> None:
    """Unpack what is compressed once, piece by piece and without keeping it: only then is its size known."""
    budget = Budget(file)
    order: Literal["little", "big"] = "little" if content[126:128] == b"IM" else "big"
    at = _HEADER
    while at + 8 <= len(content):
        kind, size = (int.from_bytes(content[at + shift : at + shift + 4], order) for shift in (0, 4))
        if kind == _COMPRESSED:
            unpacking = zlib.decompressobj()
            packed = memoryview(content)[at + 8 : at + 8 + size]
            try:
                while packed and not unpacking.eof:
                    budget.take(len(unpacking.decompress(packed, _PIECE)), "what is compressed")
                    packed = memoryview(unpacking.unconsumed_tail)
            except zlib.error as error:
                raise InputError(f"{file}: damaged .mat ({error}); allowed is a whole file of MATLAB 4 to 7.3") from error
            at += 8 + size
        else:
            # Elements that are not compressed are padded to 8 bytes.
            at += 8 + size + (-size) % 8


def _fields(value: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, np.ndarray]]:
    """Matrices of plain structs (1, 1), however deep they lie."""
    if depth > _DEEPEST:
        return
    parts = value.items() if isinstance(value, dict) else [(name, value[name].ravel()[0]) for name in value.dtype.names]
    for name, part in parts:
        if not isinstance(part, np.ndarray):
            continue
        if part.dtype.names and part.size == 1:
            yield from _fields(part, f"{prefix}{name}.", depth + 1)
        else:
            yield f"{prefix}{name}", part


def _numbers(file: Path, name: str, matrix: np.ndarray) -> Array:
    if matrix.dtype.kind not in "iuf" or matrix.ndim > 2:
        raise InputError(
            f"{file}: {name!r} has type {matrix.dtype.kind!r} and shape {matrix.shape}; allowed are real numbers (n, 1) or (n, k)"
        )
    numbers = matrix.astype(np.float64)
    return np.atleast_1d(numbers.ravel() if 1 in numbers.shape else numbers)
