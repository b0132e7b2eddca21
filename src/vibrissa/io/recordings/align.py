"""One row per wrench: poses mapped to the clock and stamps of the wrenches."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vibrissa.files import InputError
from vibrissa.io.recordings.clock import ClockOffset, estimated_offset
from vibrissa.io.recordings.streams import Poses, Streams, in_gap, interpolated, usable, within
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.io.setup import Setup
from vibrissa.sensor import RawRecording
from vibrissa.sensor.raw import Rows


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording as rows, not yet checked.

    Attributes
    ----------
    raw
        Its rows, at the stamps of the wrenches.
    missing
        Rows (n,) in a gap between poses that is longer than the setup allows. Poses are still
        interpolated there, to keep the motion complete.
    offset
        Clock offset of the poses, with its standard error if it was estimated.
    notes
        What was left out, recovered or estimated, one sentence each.
    poses
        As recorded, on the clock of the wrenches; None if they share rows with the wrenches.
    """

    raw: RawRecording
    missing: Rows
    offset: ClockOffset
    notes: tuple[str, ...] = ()
    poses: Poses | None = None

    @property
    def marked(self) -> RawRecording:
        """The rows, with NaN for missing poses."""
        lost = self.missing[:, None]
        return replace(
            self.raw,
            position=np.where(lost, np.nan, self.raw.position),
            orientation=np.where(lost, np.nan, self.raw.orientation),
        )


def aligned(file: Path, streams: Streams, setup: Setup) -> Recording:
    """Interpolate poses at the stamps of the wrenches; wrenches before the first and after the last
    pose are dropped.

    Parameters
    ----------
    file
        For messages.
    streams
        As read; bad pose rows are skipped, bad wrench rows kept.
    setup
        Clock offset and longest gap; also the rod's length, which sets the scale of motion over
        which reactions change, for estimating the offset.

    Raises
    ------
    InputError
        If no row holds readings, no wrench has a pose, or the offset is to be estimated and the
        data do not determine it.
    """
    wrench, pose, notes = streams.wrench, streams.pose, list(streams.notes)
    if not np.isfinite(wrench.channels).any():
        raise InputError(
            f"{file}: no row holds readings; allowed are rows with a force and a torque"
        )
    table, length = setup.recording or RecordingTable(), setup.rod.length
    if table.time_offset != "estimate":
        offset = ClockOffset(table.time_offset, None)
    else:
        try:
            offset = estimated_offset(wrench, usable(pose), table.largest_offset, length)
        except ValueError as error:
            raise InputError(f"{file}: time_offset = 'estimate': {error}") from error
        notes.append(
            f"time offset of the poses estimated: {offset.seconds:.4f} ± "
            f"{offset.standard_error:.4f} s"
        )
    recorded, missing = None, np.zeros(len(wrench.time), bool)
    if not streams.together or offset.seconds != 0:
        shifted = replace(pose, time=pose.time + offset.seconds)
        recorded, pose = None if streams.together else shifted, usable(shifted)
        if not len(pose.time):
            raise InputError(f"{file}: no usable pose; allowed are finite numbers with a rotation")
        inside = np.isnan(wrench.time) | within(pose, wrench.time)
        if not inside.any():
            first, last = wrench.time.min(initial=np.inf), wrench.time.max(initial=-np.inf)
            raise InputError(
                f"{file}: wrenches from {first:.9g} to {last:.9g} s, poses from "
                f"{pose.time[0]:.9g} to {pose.time[-1]:.9g} s; "
                "allowed are stamps that overlap, by time_offset in [recording]"
            )
        wrench = wrench.rows(inside)
        missing = in_gap(pose, wrench.time, table.longest_gap) | np.isnan(wrench.time)
        pose = interpolated(pose, wrench.time)
        if not inside.all():
            notes.append(
                f"{np.count_nonzero(~inside)} of {len(inside)} wrenches lie before the first or "
                "after the last pose and are left out"
            )
        if missing.any():
            notes.append(
                f"{np.count_nonzero(missing)} of {len(missing)} rows, first at "
                f"{wrench.time[missing][0]:.9g} s, lie in gaps of the poses longer than "
                f"longest_gap = {table.longest_gap:g} s and have no reactions"
            )
    raw = RawRecording(wrench.time, pose.position, pose.orientation, wrench.force, wrench.torque)
    return Recording(raw, missing, offset, tuple(notes), recorded)
