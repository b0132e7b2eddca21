"""What every format of named columns or arrays is read to."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from vibrissa.files import InputError

Array = Float[np.ndarray, "n"] | Float[np.ndarray, "n k"]


@dataclass(frozen=True)
class Columns:
    """Columns (n,) or arrays (n, k) of a file.

    Attributes
    ----------
    file
        For messages.
    names
        All that it holds.
    arrays
        Those that were asked for, by the names they were asked for with; stamps of a type of their
        own in seconds.
    units
        What the file says of their units.
    lines
        (n,) lines of the text that the rows stand in, from 1; None for other formats.
    """

    file: Path
    names: Sequence[str]
    arrays: Mapping[str, Array]
    units: Mapping[str, str | None] = field(default_factory=dict)
    lines: Int[np.ndarray, "n"] | None = None


def matched(wanted: Iterable[str], names: Iterable[str]) -> dict[str, str]:
    """Names of a file by those asked for: the same, or else the only one that differs in capitals
    alone.
    """
    folded: dict[str, list[str]] = {}
    for name in dict.fromkeys(names):
        folded.setdefault(name.casefold(), []).append(name)
    found = {}
    for name in wanted:
        alike = folded.get(name.strip("/").casefold(), [])
        if name in alike or len(alike) == 1:
            found[name] = name if name in alike else alike[0]
    return found


def numbers(file: Path, name: str, stored: np.ndarray) -> Array:
    """Floats of what a binary format stores, rows first; a matrix of one row or column is a vector.

    Raises
    ------
    InputError
        If it holds no real numbers, or has more than two axes.
    """
    if stored.dtype.kind not in "iuf" or stored.ndim > 2:
        raise InputError(
            f"{file}: {name!r} is of type {stored.dtype} and shape {stored.shape}; "
            "allowed are real numbers (n,) or (n, k)"
        )
    # A damaged number of single precision may be a signalling NaN.
    with np.errstate(invalid="ignore"):
        floats = stored.astype(np.float64)
    return np.atleast_1d(floats.ravel() if 1 in floats.shape else floats)


@contextmanager
def reading(file: Path, what: str) -> Iterator[None]:
    """One line that names the file for whatever a library raises on it, unless it is missing."""
    try:
        yield
    except (InputError, ImportError):
        raise
    except Exception as error:
        raise InputError(
            f"{file}: damaged {what} ({str(error)[:200]}); allowed is a whole file of {what}"
        ) from error
