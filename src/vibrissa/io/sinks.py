"""Files that a stream writes: JSON lines and PLY."""

import json
import math
import os
import sys
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from vibrissa.contacts import ContactKind, Status
from vibrissa.io.rosbag.growing import FileDisk
from vibrissa.reconstruct import Reconstruction
from vibrissa.sensor import RawRecording

_KINDS = [kind.name for kind in ContactKind]
_STATUS = [status.name for status in Status]
_COUNT_DIGITS = 20
_VERTEX = np.dtype(
    [*((name, "<f8") for name in ("x", "y", "z", "nx", "ny", "nz", "arc_length", "standard_deviation")), ("kind", "u1"), ("status", "u1")]
)


class JsonLinesSink:
    """One JSON object a row and line, written as soon as it is known.

    Keys: `stamp` [ns], `kind`, `status`, `position` and `orientation` of the sensor, `force` and `torque` without tare, and, with a contact, `point`,
    `normal`, `arc_length` and `standard_deviations` (along x, y, z, where the noise is known); else these are null.

    Parameters
    ----------
    path
        Of the file, or None for standard output.
    """

    def __init__(self, path: Path | None) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644) if path is not None else os.dup(sys.stdout.fileno())

    def wrench(
        self, stamp: Int[np.ndarray, "n"], sequence: Int[np.ndarray, "n"], force: Float[np.ndarray, "n 3"], torque: Float[np.ndarray, "n 3"]
    ) -> None:
        """Raw samples are not written."""

    def contacts(self, stamp: Int[np.ndarray, "n"], raw: RawRecording, found: Reconstruction) -> None:
        """Write whole lines."""
        lines = [json.dumps(row, allow_nan=False) for row in _rows(stamp, raw, found)]
        left = memoryview("".join(line + "\n" for line in lines).encode())
        while left:
            left = left[os.write(self._descriptor, left) :]

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)


def _rows(stamp: Int[np.ndarray, "n"], raw: RawRecording, found: Reconstruction) -> list[dict[str, object]]:
    deviations = None if found.covariance is None else np.sqrt(np.diagonal(found.covariance, axis1=-2, axis2=-1)).tolist()
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
        moment, kind, status, position, orientation, force, torque, point, normal, arc_length = values
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

    Points are written behind those that the header counts; then the header, which lies within a page, is overwritten in one piece with the new count.

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
        part = path.with_name(f".{path.name}.part")
        self._disk = FileDisk(part)
        self._disk.write(self._header(), 0)
        part.replace(path)

    def _header(self) -> bytes:
        """Of the same length whatever the count."""
        lines = [
            "ply",
            "format binary_little_endian 1.0",
            f"comment contacts of an elastic rod, unit {self._unit}",
            f"element vertex {self._count}",
        ]
        kinds = {"<f8": "double", "|u1": "uchar"}
        lines += [f"property {kinds[part[0].str]} {name}" for name, part in (_VERTEX.fields or {}).items()]
        filler = "." * (_COUNT_DIGITS - len(str(self._count)))
        return "\n".join([*lines, f"comment {filler}", "end_header", ""]).encode()

    def wrench(
        self, stamp: Int[np.ndarray, "n"], sequence: Int[np.ndarray, "n"], force: Float[np.ndarray, "n 3"], torque: Float[np.ndarray, "n 3"]
    ) -> None:
        """Raw samples are not written."""

    def contacts(self, stamp: Int[np.ndarray, "n"], raw: RawRecording, found: Reconstruction) -> None:  # noqa: ARG002
        """Keep the rows with a contact."""
        rows = found.in_contact
        vertices = np.zeros(int(np.count_nonzero(rows)), dtype=_VERTEX)
        deviation = np.full(len(vertices), np.nan)
        if found.covariance is not None:
            deviation = np.sqrt(np.trace(found.covariance[rows], axis1=-2, axis2=-1))
        values = np.column_stack([found.point[rows], found.normal[rows], found.arc_length[rows], deviation])
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
