"""From recordings of any format to support reactions: read, align, check, remove tare and mount."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vibrissa.contacts import RecordingNote, RecordingWarning
from vibrissa.files import InputError
from vibrissa.io.recordings import bags, formats, layout, text
from vibrissa.io.recordings.align import Recording, aligned
from vibrissa.io.recordings.formats import BAG, TEXT, Columns, kind_of
from vibrissa.io.recordings.misread import misread_faults
from vibrissa.io.recordings.streams import Poses, Streams
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.io.recordings.write import COLUMNS
from vibrissa.io.setup import Setup
from vibrissa.reactions import Reactions
from vibrissa.sensor import Fault, FaultKind, Inspection, RawRecording, inspect_raw
from vibrissa.sensor.stamps import stamp_faults
from vibrissa.sensor.units import norm_faults, wrong_norms


def read_recording(path: str | Path, setup: Setup) -> Reactions:
    """Read a recording and return support reactions on the rod about the clamp, in world axes, tare
    removed, with covariance if the noise is known.

    Anything that contradicts the setup or spoils contacts (`Inspection.warnings`) is reported as a
    `RecordingWarning`; what was left out, recovered or estimated as a `RecordingNote`, a subclass.
    Noise at rest above the stated level enters the covariance, and a drift between rests is
    removed. Unusable rows (missing numbers, a stuck or saturated channel, a repeated stamp, a gap
    in the poses) hold NaN; `inspect_recording` says which and why.

    Parameters
    ----------
    path
        CSV, Parquet, HDF5, NetCDF, MATLAB .mat, or a rosbag2 folder or one of its MCAP or SQLite
        files, recognized by content, then by suffix. Without a table [recording] in the setup a CSV
        must have exactly the header `time,px,py,pz,qx,qy,qz,qw,fx,fy,fz,tx,ty,tz`, in SI units, and
        other formats hold those names, or arrays `position`, `orientation`, `force` and `torque`.
        Names are not case-sensitive.
    setup
        Mount, sign, frame and noise; layout of the recording.

    Raises
    ------
    InputError
        If the file cannot be read or is damaged, names or topics are missing, a row is short or cut
        off, time runs backwards, a quaternion is not of unit norm, the tare window does not fit or
        no rest is found, clocks do not overlap, or the numbers cannot be in metres, newtons and
        newton metres.
    """
    found = _judged(Path(path), setup)
    reactions = found.sensor.reactions(
        found.cleaned, found.tare, tolerances=setup.parameter_covariance
    )
    return replace(reactions, misread=found.misread)


def read_cleaned(path: str | Path, setup: Setup) -> RawRecording:
    """Read a recording as logged, tare included, with increasing stamps, a pose in each row, and
    NaN for unusable wrenches.

    Raises
    ------
    InputError
        As `read_recording` does.
    """
    return _judged(Path(path), setup).cleaned


def _judged(file: Path, setup: Setup) -> Inspection:
    """Inspect a recording: warn of what is found, or raise if it makes the recording unusable."""
    streams = _streams(file, setup.recording)
    _check(file, streams)
    recording = aligned(file, streams, setup)
    for note in recording.notes:
        warnings.warn(f"{file}: {note}", RecordingNote, stacklevel=3)
    found = _inspected(file, recording, setup)
    if found.unusable:
        # The cause may be a wrong unit that by itself is no reason to refuse: with stamps in
        # milliseconds, no rest is found.
        units = [fault for fault in found.faults if fault.kind is FaultKind.UNITS]
        besides = [fault for fault in units if not fault.unusable]
        texts = [fault.text for fault in (found.unusable[0], *besides)]
        raise InputError(f"{file}: " + "; also: ".join(texts))
    for line in found.warnings:
        warnings.warn(f"{file}: {line}", RecordingWarning, stacklevel=3)
    return found


def _check(file: Path, streams: Streams) -> None:
    """Refuse stamps that run backwards and orientations that are not rotations: which rows are
    right cannot be known.
    """
    pose = streams.pose
    for fault in norm_faults(pose.time, pose.orientation):
        row = int(np.argmax(wrong_norms(pose.orientation)))
        raise InputError(f"{file}, {pose.place(row)}: {fault.text}")
    for stream in (streams.wrench, pose):
        falling = np.flatnonzero(np.diff(stream.time) < 0).tolist()
        if falling:
            row = falling[0] + 1
            raise InputError(
                f"{file}, {stream.place(row)}: time = {stream.time[row]} after "
                f"{stream.time[row - 1]} ({len(falling)} such); allowed are increasing times"
            )


def inspect_recording(path: str | Path, setup: Setup) -> Inspection:
    """Read a recording of any format; return its faults, and what its rest says about the sensor.

    Raises
    ------
    InputError
        If the file cannot be read in its format, names or topics are missing, or no row has a stamp
        or a pose.
    """
    return _inspected(Path(path), read_raw(path, setup), setup)


def _inspected(file: Path, recording: Recording, setup: Setup) -> Inspection:
    poses = recording.poses
    own = (poses.time, poses.position, poses.orientation) if poses else None
    try:
        found = inspect_raw(recording.marked, setup.sensor, setup.rod, poses=own)
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error

    def in_degrees() -> RawRecording:
        table = setup.recording or RecordingTable()
        degrees = table.model_copy(update={"angle_unit": "deg"})
        return read_raw(file, replace(setup, recording=degrees)).raw

    faults = [
        *found.faults,
        *misread_faults(found, setup, in_degrees),
        *(pose_faults(poses) if poses else ()),
    ]
    faults.sort(key=lambda fault: (fault.start, fault.stop))
    return replace(found, faults=tuple(faults), notes=recording.notes)


def pose_faults(pose: Poses) -> Iterator[Fault]:
    """Faults of poses that have their own stamps, on the clock of the wrenches, which interpolation
    would hide.
    """
    channels, known = ("position", "orientation"), pose.rows(np.isfinite(pose.time))
    for fault in stamp_faults(known.time):
        yield replace(fault, channels=channels, text=f"stamps of the poses: {fault.text}")
    yield from norm_faults(known.time, known.orientation)
    lost = pose.time[~pose.finite]
    if len(lost) and len(known.time):
        stamps = lost[np.isfinite(lost)] if np.isfinite(lost).any() else known.time
        text = f"{len(lost)} poses without a number, which are skipped"
        yield Fault.over(channels, FaultKind.DROP_OUT, stamps, text, len(lost))


def read_raw(path: str | Path, setup: Setup) -> Recording:
    """Read a recording without checking it: rows may hold NaN, and stamps may repeat or decrease.

    Raises
    ------
    InputError
        If the file cannot be read in its format, names or topics are missing, or no wrench has a
        pose.
    """
    file = Path(path)
    return aligned(file, _streams(file, setup.recording), setup)


def _streams(file: Path, stated: RecordingTable | None) -> Streams:
    """Both streams, whatever the format."""
    table = stated or RecordingTable()
    try:
        kind, poses = kind_of(file), None
        if table.pose_file:
            beside = file.parent / table.pose_file.replace("{name}", file.stem)
            poses = _columns(beside, kind_of(beside), table.of_poses)
        if kind == BAG:
            return bags.streams(file, table, poses)
        exactly = COLUMNS if stated is None else ()
        return layout.streams(_columns(file, kind, table, exactly), table, poses)
    except ImportError as error:
        raise InputError(f"{file}: {error}") from error


def _columns(file: Path, kind: str, table: RecordingTable, exactly: Sequence[str] = ()) -> Columns:
    """Read the columns that the layout may refer to; `name[k]` also without its index."""
    if kind == BAG:
        raise InputError(f"{file}: is a bag; allowed for pose_file is a file of columns")
    quantities = ("time", "force", "torque", "position", "orientation")
    layouts = table, table.of_poses
    names = [name for one in layouts for key in quantities for name in getattr(one, key)]
    wanted = [*names, *(name.rsplit("[", 1)[0] for name in names), *quantities]
    if kind == TEXT:
        return text.columns(file, table, exactly or wanted, exactly)
    return formats.columns(file, kind, wanted)
