"""Files that a stream writes: JSON lines and PLY."""

import json
import math
import os
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from vibrissa.contacts import ContactKind, Status
from vibrissa.inverse import Reconstruction
from vibrissa.io.rosbag.disk import naming_file, whole_file
from vibrissa.sensor import RawRecording

_KINDS = [kind.name for kind in ContactKind]
_STATUS = [status.name for status in Status]
_COUNT_DIGITS = 20
# Bytes of one call of the system: a batch of 64 rows has some 40 kB.
_MOST_WRITTEN = 1 << 20
_VERTEX = np.dtype(
    [
        *(
            (name, "<f8")
            for name in ("x", "y", "z", "nx", "ny", "nz", "arc_length", "standard_deviation")
        ),
        ("kind", "u1"),
        ("status", "u1"),
    ]
)


class JsonLinesSink:
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
        self._path, self._size = path, 0
        with naming_file(path or Path("standard output")):
            flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND
            self._descriptor = (
                os.open(path, flags, 0o644) if path is not None else os.dup(sys.stdout.fileno())
            )

    def wrench(
        self,
        stamp: Int[np.ndarray, "n"],
        sequence: Int[np.ndarray, "n"],
        force: Float[np.ndarray, "n 3"],
        torque: Float[np.ndarray, "n 3"],
    ) -> None:
        """Raw samples are not written."""

    def contacts(
        self, stamp: Int[np.ndarray, "n"], raw: RawRecording, found: Reconstruction
    ) -> None:
        """Write whole lines."""
        lines = [json.dumps(row, allow_nan=False) for row in _rows(stamp, raw, found)]
        text = "".join(line + "\n" for line in lines).encode()
        done = 0
        with naming_file(self._path or Path("standard output")):
            try:
                while done < len(text):
                    done += os.write(self._descriptor, text[done : done + _MOST_WRITTEN])
            finally:
                whole = text.rfind(b"\n", 0, done) + 1
                self._size += whole
                if whole < done and self._path is not None:
                    with suppress(OSError):
                        os.ftruncate(self._descriptor, self._size)

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)


def _rows(
    stamp: Int[np.ndarray, "n"], raw: RawRecording, found: Reconstruction
) -> list[dict[str, object]]:
    deviations = (
        None
        if found.covariance is None
        else np.sqrt(np.diagonal(found.covariance, axis1=-2, axis2=-1)).tolist()
    )
    columns = (
        stamp,
        found.kind,
        found.status,
        raw.position,
        raw.orientation,
        raw.force,
        raw.torque,
        found.point,
        found.normal,
        found.arc_length,
    )
    rows: list[dict[str, object]] = []
    for place, values in enumerate(zip(*(column.tolist() for column in columns), strict=True)):
        moment, kind, status, position, orientation, force, torque, point, normal, arc_length = (
            values
        )
        rows.append(
            {
                "stamp": moment,
                "kind": _KINDS[kind],
                "status": _STATUS[status],
                "position": _known(position),
                "orientation": _known(orientation),
                "force": _known(force),
                "torque": _known(torque),
                "point": _known(point),
                "normal": _known(normal),
                "arc_length": arc_length if math.isfinite(arc_length) else None,
                "standard_deviations": None if deviations is None else _known(deviations[place]),
            }
        )
    return rows


def _known(values: list[float]) -> list[float] | None:
    """The numbers, or None where one is none: JSON has no word for it."""
    return values if all(map(math.isfinite, values)) else None


class PlySink:
    """Contacts as points with normals in a PLY file that is whole whenever the process is killed.

    Points are written behind those that the header counts; then the header, which lies within a
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
        lines = [
            "ply",
            "format binary_little_endian 1.0",
            f"comment contacts of an elastic rod, unit {self._unit}",
            f"element vertex {self._count}",
        ]
        kinds = {"<f8": "double", "|u1": "uchar"}
        lines += [
            f"property {kinds[part[0].str]} {name}" for name, part in (_VERTEX.fields or {}).items()
        ]
        filler = "." * (_COUNT_DIGITS - len(str(self._count)))
        return "\n".join([*lines, f"comment {filler}", "end_header", ""]).encode()

    def wrench(
        self,
        stamp: Int[np.ndarray, "n"],
        sequence: Int[np.ndarray, "n"],
        force: Float[np.ndarray, "n 3"],
        torque: Float[np.ndarray, "n 3"],
    ) -> None:
        """Raw samples are not written."""

    def contacts(
        self,
        stamp: Int[np.ndarray, "n"],  # noqa: ARG002
        raw: RawRecording,  # noqa: ARG002
        found: Reconstruction,
    ) -> None:
        """Keep the rows with a contact."""
        rows = found.in_contact
        vertices = np.zeros(int(np.count_nonzero(rows)), dtype=_VERTEX)
        deviation = np.full(len(vertices), np.nan)
        if found.covariance is not None:
            deviation = np.sqrt(np.trace(found.covariance[rows], axis1=-2, axis2=-1))
        values = np.column_stack(
            [found.point[rows], found.normal[rows], found.arc_length[rows], deviation]
        )
        for column, name in enumerate((_VERTEX.names or ())[:8]):
            vertices[name] = values[:, column]
        vertices["kind"], vertices["status"] = found.kind[rows], found.status[rows]
        self._held += vertices.tobytes()

    def flush(self) -> None:
        """Write what is held, then the count."""
        if not self._held:
            return
        self._disk.write(self._held, len(self._header()) + self._count * _VERTEX.itemsize)
        self._count += len(self._held) // _VERTEX.itemsize
        self._held = b""
        self._disk.write(self._header(), 0)

    def close(self) -> None:
        """Write the rest."""
        try:
            self.flush()
        finally:
            self._disk.close()
