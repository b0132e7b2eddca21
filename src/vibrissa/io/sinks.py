"""Files that a stream writes: JSON lines and PLY."""

import json
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrissa.contacts import ContactKind, Status
from vibrissa.inverse import Reconstruction
from vibrissa.io.contacts import VERTEX, cloud, columns, deviations, structured
from vibrissa.io.rosbag.disk import naming_file, whole_file
from vibrissa.io.rosbag.growing import Stamps
from vibrissa.sensor import RawRecording

_COUNT_DIGITS = 20  # of the largest number of 64 bits
_RAW = ("position", "orientation", "force", "torque")
_FOUND = ("point", "normal", "arc_length")


class _ContactsAlone:
    """What takes raw samples and leaves them."""

    def wrench(self, *samples: object) -> None:
        """Raw samples are not written."""


class JsonLinesSink(_ContactsAlone):
    """One JSON object a row and line, written as soon as it is known.

    Keys: `stamp` [ns], `kind`, `status`, `position` and `orientation` of the sensor, `force` and
    `torque` without tare, and, with a contact, `point`, `normal`, `arc_length` and
    `standard_deviations` (along x, y, z, where the noise is known); else these are null.

    Where the disk is full, the file ends with a whole line.

    Parameters
    ----------
    path
        Of the file, or None for standard output.

    Raises
    ------
    OSError
        If the file cannot be written; it names the file.
    """

    def __init__(self, path: Path | None) -> None:
        self._path, self._size = path or Path("standard output"), 0
        with naming_file(self._path):
            place = os.dup(sys.stdout.fileno()) if path is None else path
            self._file = open(place, "wb", buffering=0)  # noqa: PTH123, SIM115

    def contacts(self, stamp: Stamps, raw: RawRecording, found: Reconstruction) -> None:
        """Write whole lines."""
        descriptor = self._file.fileno()
        with naming_file(self._path):
            for row in _rows(stamp, raw, found):
                left = line = f"{json.dumps(row, allow_nan=False)}\n".encode()
                try:
                    while left:
                        left = left[os.write(descriptor, left) :]
                except OSError:
                    # A pipe cannot be cut.
                    with suppress(OSError):
                        self._file.truncate(self._size)
                    raise
                self._size += len(line)

    def flush(self) -> None:
        """Nothing is held back."""

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
    """Numbers of each row, or None where one of them is not finite: JSON has no word for it."""
    finite = np.isfinite(values).reshape(len(values), -1).all(axis=1)
    return [row if known else None for row, known in zip(values.tolist(), finite, strict=True)]


class PlySink(_ContactsAlone):
    """Contacts as points with normals in a PLY file that is whole whenever the process is killed.

    Points are written behind the ones the header counts; then the header, which lies within a
    page, is overwritten in one piece with the new count.

    Parameters
    ----------
    path
        Of the file, which is there, whole and empty, once this is built.
    unit
        Of length, for a comment in the file.

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
        """Of the same length whatever the count."""
        points = np.broadcast_to(np.zeros(1, dtype=VERTEX), self._count)
        filler = "." * (_COUNT_DIGITS - len(str(self._count)))
        return f"{cloud(points, self._unit, filler).header}\n".encode()

    def contacts(
        self,
        stamp: Stamps,  # noqa: ARG002
        raw: RawRecording,  # noqa: ARG002
        found: Reconstruction,
    ) -> None:
        """Keep the rows with a contact."""
        self._held += structured(VERTEX, columns(found), found.in_contact).tobytes()

    def flush(self) -> None:
        """Write what is held, then the count."""
        if not self._held:
            return
        self._disk.write(self._held, len(self._header()) + self._count * VERTEX.itemsize)
        self._count += len(self._held) // VERTEX.itemsize
        self._held = b""
        self._disk.write(self._header(), 0)

    def close(self) -> None:
        """Write the rest."""
        try:
            self.flush()
        finally:
            self._disk.close()
