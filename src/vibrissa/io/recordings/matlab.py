"""MATLAB's `.mat`, up to version 7; version 7.3 is HDF5.

Level 5 of the format (MathWorks, *MAT-File Format*) is read here, as far as recordings need it:
real matrices and structs of them. SciPy's reader ends the whole process on damaged files of it.
"""

import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from struct import unpack_from

import numpy as np

from vibrissa.files import InputError
from vibrissa.io.recordings.arrays import Array, Columns
from vibrissa.io.recordings.limits import Budget

_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_STORED = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
_STRUCT, _NUMERIC = 2, range(6, 16)
_CLASSES = {1: "cell", 2: "struct", 3: "object", 4: "char", 5: "sparse", 17: "object"}
_COMPLEX = 0x0800
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
        If the file is damaged, unpacks to more than allowed, or what is asked for is no numeric
        matrix.
    """
    content = file.read_bytes()
    try:
        found = dict(_level_5(file, content) if content[:6] == b"MATLAB" else _level_4(content))
    except InputError:
        raise
    # Level 4 has no sign of its own, so that anything may come here, and be anything to the reader.
    except Exception as reason:
        raise InputError(
            f"{file}: damaged .mat ({str(reason)[:200]}); allowed is a whole file of MATLAB 4 to 7.3"
        ) from reason
    return Columns(file, list(found), lambda name: _numbers(file, name, found[name]))


def _level_4(content: bytes) -> Iterator[tuple[str, np.ndarray | str]]:
    from scipy.io import loadmat  # noqa: PLC0415

    yield from loadmat(BytesIO(content)).items()


def _level_5(file: Path, content: bytes) -> Iterator[tuple[str, np.ndarray | str]]:
    order, budget = "<" if content[126:128] == b"IM" else ">", Budget(file)
    for kind, body in _elements(content, _HEADER, order):
        if kind == _COMPRESSED:
            unpacking = zlib.decompressobj()
            plain = unpacking.decompress(body, budget.left + 1)
            budget.take(len(plain), "what is compressed")
            for inner_kind, inner in _elements(plain, 0, order):
                if inner_kind == _MATRIX:
                    yield from _matrix(inner, order)
        elif kind == _MATRIX:
            yield from _matrix(body, order)


def _elements(content: bytes, start: int, order: str) -> Iterator[tuple[int, bytes]]:
    """Kinds and bodies of the elements that follow each other."""
    at = start
    while at + 8 <= len(content):
        kind, size = unpack_from(f"{order}II", content, at)
        small = kind >> 16
        if small:
            yield kind & 0xFFFF, content[at + 4 : at + 4 + min(small, 4)]
            at += 8
            continue
        end = at + 8 + size
        if end > len(content):
            raise ValueError(f"an element at byte {at} is cut off")
        yield kind, content[at + 8 : end]
        at = end if kind == _COMPRESSED else end + (-size) % 8


def _matrix(
    body: bytes, order: str, prefix: str = "", depth: int = 0, named: str | None = None
) -> Iterator[tuple[str, np.ndarray | str]]:
    """A matrix by its name, or in a struct by that of its field; of a plain struct (1, 1) what is
    in it; of others the name of their class.
    """
    parts = _elements(body, 0, order)
    (flags,) = unpack_from(f"{order}I", next(parts, (0, b""))[1])
    shape = np.frombuffer(next(parts, (0, b""))[1], dtype=f"{order}i4")
    own = next(parts, (0, b""))[1].decode("latin-1")
    name, kind = prefix + (own if named is None else named), flags & 0xFF
    if kind in _NUMERIC and not flags & _COMPLEX:
        yield name, _array(next(parts, (0, b"")), shape, order)
    elif kind == _STRUCT and np.prod(shape, dtype=np.float64) == 1 and depth < _DEEPEST:
        (length,) = unpack_from(f"{order}i", next(parts, (0, b""))[1])
        names = next(parts, (0, b""))[1]
        fields = (
            [
                names[at : at + length].split(b"\0")[0].decode("latin-1")
                for at in range(0, len(names), length)
            ]
            if length > 0
            else []
        )
        for field, (inner_kind, inner) in zip(fields, parts, strict=False):
            if inner_kind == _MATRIX and inner:
                yield from _matrix(inner, order, f"{name}.", depth + 1, field)
    else:
        yield name, "complex" if flags & _COMPLEX else _CLASSES.get(kind, "unknown")


def _array(element: tuple[int, bytes], shape: np.ndarray, order: str) -> np.ndarray:
    kind, body = element
    if kind not in _STORED or len(shape) < 2 or np.any(shape < 0):
        raise ValueError(f"a matrix of the shape {shape[:8].tolist()} is stored as type {kind}")
    return np.frombuffer(body, dtype=f"{order}{_STORED[kind]}").reshape(shape, order="F")


def _numbers(file: Path, name: str, matrix: np.ndarray | str) -> Array:
    if isinstance(matrix, str) or matrix.dtype.kind not in "iuf" or matrix.ndim > 2:
        what = (
            matrix
            if isinstance(matrix, str)
            else f"of type {matrix.dtype} and shape {matrix.shape}"
        )
        raise InputError(f"{file}: {name!r} is {what}; allowed are real numbers (n, 1) or (n, k)")
    with np.errstate(invalid="ignore"):
        numbers = matrix.astype(np.float64)
    return np.atleast_1d(numbers.ravel() if 1 in numbers.shape else numbers)
