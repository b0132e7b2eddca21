"""Output files of a stream: JSON lines and PLY."""

import json
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from vibrissa.contacts import ContactKind, Status
from vibrissa.inverse import Reconstruction
from vibrissa.io.contacts import VERTEX, cloud, columns, deviations, structured
from vibrissa.io.disk import naming_file, whole_file
from vibrissa.sensor import RawRecording

_COUNT_DIGITS = 20  # digits of the largest 64-bit number
_RAW = ("position", "orientation", "force", "torque")
_FOUND = ("point", "normal", "arc_length")

Stamps = Int[np.ndarray, "n"]
"""[ns]."""


class _ContactsAlone:
    """A sink that ignores raw samples."""

    def wrench(self, *samples: object) -> None:
        """Do nothing: raw samples are not written."""


class JsonLinesSink(_ContactsAlone):
    """One JSON object per row, each on its own line, written as soon as it is known.

    Keys: `stamp` [ns], `kind`, `status`, `position` and `orientation` of the sensor, `force` and
    `torque` with the tare removed, and, with a contact, `point`, `normal`, `arc_length` and
    `standard_deviations` (along x, y, z, if the noise is known), which are null otherwise.

    If the disk is full, the file still ends with a complete line.

    Parameters
    ----------
    path
        The file, or None for standard output.

    Raises
    ------
    OSError
        If the file cannot be written; the error names it.
    """

    def __init__(self, path: Path | None) -> None:
        self._path, self._size = path or Path("standard output"), 0
        with naming_file(self._path):
            place = os.dup(sys.stdout.fileno()) if path is None else path
            self._file = open(place, "wb", buffering=0)  # noqa: PTH123, SIM115

    def contacts(self, stamp: Stamps, raw: RawRecording, found: Reconstruction) -> None:
        """Write complete lines."""
        descriptor = self._file.fileno()
        with naming_file(self._path):
            for row in _rows(stamp, raw, found):
                left = line = f"{json.dumps(row, allow_nan=False)}\n".encode()
                try:
                    while left:
                        left = left[os.write(descriptor, left) :]
                except OSError:
                    # A pipe cannot be truncated.
                    with suppress(OSError):
                        self._file.truncate(self._size)
                    raise
                self._size += len(line)

    def flush(self) -> None:
        """Do nothing: nothing is buffered."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _rows(stamp: Stamps, raw: RawRecording, found: Reconstruction) -> list[dict[str, object]]:
    columns = {
        "stamp": stamp.tolist(),
        "kind": [ContactKind(kind).name for kind in found.kind.tolist()],
        "status": [Status(status).name for status in found.status.tolist()],
        **{name: _known(getattr(raw, name)) for name in _RAW},
        **{name: _known(getattr(found, name)) for name in _FOUND},
        "standard_deviations": _known(deviations(found)),
    }
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _known(values: Float[np.ndarray, "n ..."]) -> list[Any]:
    """Numbers of each row, or None if one of them is not finite, which JSON cannot express."""
    finite = np.isfinite(values).reshape(len(values), -1).all(axis=1)
    return [row if known else None for row, known in zip(values.tolist(), finite, strict=True)]


class PlySink(_ContactsAlone):
    """Contacts as points with normals in a PLY file that stays valid if the process is killed.

    New points are written after those that the header counts; then the header, which lies within a
    page, is overwritten in one write with the new count.

    Parameters
    ----------
    path
        The file, which exists, valid and empty, as soon as this is constructed.
    unit
        Length unit, for a comment in the file.

    Raises
    ------
    OSError
        If the file cannot be written.
    """

    def __init__(self, path: Path, unit: str = "metre") -> None:
        self._unit, self._count, self._held = unit, 0, b""
        with whole_file(path) as self._disk:
            self._disk.write(self._header(), 0)

    def _header(self) -> bytes:
        """The header, of the same length whatever the count."""
        points = np.broadcast_to(np.zeros(1, dtype=VERTEX), self._count)
        filler = "." * (_COUNT_DIGITS - len(str(self._count)))
        return f"{cloud(points, self._unit, filler).header}\n".encode()

    def contacts(
        self,
        stamp: Stamps,  # noqa: ARG002
        raw: RawRecording,  # noqa: ARG002
        found: Reconstruction,
    ) -> None:
        """Buffer the rows with a contact."""
        self._held += structured(VERTEX, columns(found), found.in_contact).tobytes()

    def flush(self) -> None:
        """Write the buffered points, then the count."""
        if not self._held:
            return
        self._disk.write(self._held, len(self._header()) + self._count * VERTEX.itemsize)
        self._count += len(self._held) // VERTEX.itemsize
        self._held = b""
        self._disk.write(self._header(), 0)

    def close(self) -> None:
        """Write what is buffered and close the file."""
        try:
            self.flush()
        finally:
            self._disk.close()
