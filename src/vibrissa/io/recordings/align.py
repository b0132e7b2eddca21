"""One row a wrench: poses brought onto its clock and to its stamps."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from vibrissa.files import InputError
from vibrissa.io.recordings.clock import ClockOffset, estimated_offset
from vibrissa.io.recordings.resample import interpolated, usable, within
from vibrissa.io.recordings.streams import Poses, Streams, Wrenches
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.sensor import RawRecording


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording in rows, not judged.

    Attributes
    ----------
    raw
        Its rows, at the stamps of the wrenches.
    missing
        (n,): rows that lie in a gap of the poses longer than the setup allows. Poses there are
        interpolated all the same, so that the motion stays whole.
    offset
        Clock offset of the poses, with its standard error where it was estimated.
    notes
        What was left out, recovered or estimated, a sentence each.
    poses
        As recorded, on the clock of the wrenches; None where they stand in the rows of the
        wrenches.
    """

    raw: RawRecording
    missing: Bool[np.ndarray, "n"]
    offset: ClockOffset
    notes: tuple[str, ...] = ()
    poses: Poses | None = None

    @property
    def marked(self) -> RawRecording:
        """The rows, with poses of NaN where they are missing."""
        position, orientation = (
            np.where(self.missing[:, None], np.nan, part)
            for part in (self.raw.position, self.raw.orientation)
        )
        return replace(self.raw, position=position, orientation=orientation)


def aligned(file: Path, streams: Streams, table: RecordingTable, length: float) -> Recording:
    """Poses at the stamps of the wrenches; wrenches before the first and after the last pose are
    left out.

    Parameters
    ----------
    file
        For messages.
    streams
        As read; bad rows of the poses are passed over, those of the wrenches stay.
    table
        Offset of the clocks, and the longest gap.
    length
        Of the rod [m]: reactions change over a small part of it, which an estimate of the offset
        uses.

    Raises
    ------
    InputError
        If no wrench has a pose, or the offset is to be estimated and the data do not determine it.
    """
    offset = _offset(file, streams, table, length)
    wrench, pose = streams.wrench, streams.pose
    if streams.together and offset.seconds == 0:
        missing = np.zeros(len(wrench.time), bool)
        return Recording(_raw(wrench, pose), missing, offset, streams.notes)
    recorded = replace(pose, time=pose.time + offset.seconds)
    pose = usable(recorded)
    inside = np.isnan(wrench.time) | (len(pose.time) > 0 and within(pose, wrench.time))
    if not len(pose.time) or not inside.any():
        raise InputError(
            f"{file}: {_ranges(wrench, pose)}; "
            "allowed are stamps that overlap, by time_offset in [recording]"
        )
    wrench = wrench.rows(inside)
    missing = np.isnan(interpolated(pose, wrench.time, table.longest_gap).position[:, 0])
    notes = list(streams.notes)
    if offset.standard_error is not None:
        notes.append(
            f"time offset of the poses estimated: {offset.seconds:.4f} ± "
            f"{offset.standard_error:.4f} s"
        )
    if not inside.all():
        notes.append(
            f"{np.count_nonzero(~inside)} of {len(inside)} wrenches lie before the first or after "
            "the last pose and are left out"
        )
    if missing.any():
        notes.append(
            f"{np.count_nonzero(missing)} of {len(missing)} rows, first at "
            f"{wrench.time[np.argmax(missing)]:.9g} s, lie in gaps of the poses longer than "
            f"longest_gap = {table.longest_gap:g} s and have no reactions"
        )
    return Recording(
        _raw(wrench, interpolated(pose, wrench.time)),
        missing,
        offset,
        tuple(notes),
        None if streams.together else recorded,
    )


def _offset(file: Path, streams: Streams, table: RecordingTable, length: float) -> ClockOffset:
    if table.time_offset != "estimate":
        return ClockOffset(table.time_offset, None)
    try:
        return estimated_offset(streams.wrench, usable(streams.pose), table.largest_offset, length)
    except ValueError as error:
        raise InputError(f"{file}: time_offset = 'estimate': {error}") from error


def _raw(wrench: Wrenches, pose: Poses) -> RawRecording:
    return RawRecording(wrench.time, pose.position, pose.orientation, wrench.force, wrench.torque)


def _ranges(wrench: Wrenches, pose: Poses) -> str:
    if not len(pose.time):
        return "no usable pose"
    time = wrench.time[np.isfinite(wrench.time)]
    return (
        f"wrenches from {time.min(initial=np.inf):.9g} to {time.max(initial=-np.inf):.9g} s, "
        f"poses from {pose.time[0]:.9g} to {pose.time[-1]:.9g} s"
    )
