"""Recordings of any format to support reactions: read, align, judge, and take off tare and mount."""

import warnings
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from vibrissa.contacts import RecordingNote, RecordingWarning
from vibrissa.files import read_table
from vibrissa.io.errors import InputError
from vibrissa.io.recordings import arrays, bags, hdf5, judge, matlab, parquet, text
from vibrissa.io.recordings.align import Recording, aligned
from vibrissa.io.recordings.arrays import Columns
from vibrissa.io.recordings.kinds import Kind, kind_of
from vibrissa.io.recordings.misread import misread_faults
from vibrissa.io.recordings.streams import Stream, Streams
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.io.recordings.write import COLUMNS
from vibrissa.io.setup import Setup
from vibrissa.reactions import Reactions
from vibrissa.sensor import FaultKind, Inspection, RawRecording, inspect_raw


def read_recording(path: str | Path, setup: Setup) -> Reactions:
    """Read a recording and return support reactions on the rod about the clamp, world axes, tare
    removed, with covariance where the noise is known.

    What in the recording contradicts the setup or spoils contacts (`Inspection.warnings`) is a
    `RecordingWarning`; what was left out, recovered or estimated is a `RecordingNote`, which is
    one, too. Noise at rest above the stated one is in the covariance, and a drift from rest to rest
    is taken off. Rows that are not usable (numbers missing, a stuck or saturated channel, a stamp
    that is there already, a gap of the poses) hold NaN; `inspect_recording` says what they are.

    Parameters
    ----------
    path
        CSV, Parquet, HDF5, NetCDF, MATLAB .mat, or a rosbag2 folder or one of its MCAP or SQLite
        files, told apart by content, then by suffix. Without the table [recording] in the setup a
        CSV has exactly the header `time,px,py,pz,qx,qy,qz,qw,fx,fy,fz,tx,ty,tz`, SI units, and
        other formats hold those names, or arrays `position`, `orientation`, `force` and `torque`.
    setup
        Mount, sign, frame and noise; layout of the recording.

    Raises
    ------
    InputError
        If the file cannot be read or is damaged, names or topics are missing, a row is short or cut
        off, time runs backwards, a quaternion has no unit norm, the tare window does not fit or no
        rest is found, clocks do not overlap, or the numbers cannot be in metres, newtons and newton
        metres.
    """
    inspection = _judged(Path(path), setup)
    reactions = inspection.sensor.reactions(
        inspection.cleaned, inspection.tare, tolerances=setup.parameter_covariance
    )
    misread = tuple(
        fault.text
        for fault in inspection.faults
        if fault.kind in {FaultKind.UNITS, FaultKind.MOUNT}
    )
    return replace(reactions, misread=misread) if misread else reactions


def read_cleaned(path: str | Path, setup: Setup) -> RawRecording:
    """Read a recording as it was logged, tare included, in rows that can be used: stamps increase,
    each row has a pose, and wrenches that are not usable are NaN.

    Raises
    ------
    InputError
        As `read_recording` does.
    """
    return _judged(Path(path), setup).cleaned


def _judged(file: Path, setup: Setup) -> Inspection:
    table = setup.recording or RecordingTable()
    streams = _streams(file, setup.recording)
    judge.check(file, streams)
    recording = aligned(file, streams, table, setup.rod.length)
    for note in recording.notes:
        warnings.warn(f"{file}: {note}", RecordingNote, stacklevel=3)
    inspection = _inspected(file, recording, setup)
    if inspection.unusable:
        # What cannot be used may follow from a unit that alone would not forbid it: stamps in
        # milliseconds leave no rest.
        first, units = (
            inspection.unusable[0],
            [
                fault.text
                for fault in inspection.faults
                if fault.kind is FaultKind.UNITS and not fault.unusable
            ],
        )
        raise InputError(f"{file}: " + "; besides: ".join([first.text, *units]))
    for line in inspection.warnings:
        warnings.warn(f"{file}: {line}", RecordingWarning, stacklevel=3)
    return inspection


def inspect_recording(path: str | Path, setup: Setup) -> Inspection:
    """Read a recording of any format and return its faults, with what its rest tells of the sensor.

    Raises
    ------
    InputError
        If the file cannot be read as what it is, names or topics are missing, or no row has a stamp
        or a pose.
    """
    return _inspected(Path(path), read_raw(path, setup), setup)


def _inspected(file: Path, recording: Recording, setup: Setup) -> Inspection:
    try:
        own = None if recording.poses is None else (recording.poses.time, recording.poses.values)
        found = inspect_raw(recording.marked, setup.sensor, setup.rod, poses=own)
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error

    def in_degrees() -> RawRecording:
        table = (setup.recording or RecordingTable()).model_copy(update={"angle_unit": "deg"})
        return read_raw(file, replace(setup, recording=table)).raw

    faults = [
        *found.faults,
        *misread_faults(found, setup.rod, setup.sensor, setup.recording, in_degrees),
    ]
    faults += [] if recording.poses is None else judge.pose_faults(recording.poses)
    return replace(
        found,
        faults=tuple(sorted(faults, key=lambda fault: (fault.start, fault.stop))),
        notes=recording.notes,
    )


def read_raw(path: str | Path, setup: Setup) -> Recording:
    """Read a recording without judging it: rows may hold NaN, and stamps stand or fall.

    Raises
    ------
    InputError
        If the file cannot be read as what it is, names or topics are missing, or no wrench has a
        pose.
    """
    file = Path(path)
    return aligned(
        file, _streams(file, setup.recording), setup.recording or RecordingTable(), setup.rod.length
    )


def _streams(file: Path, table: RecordingTable | None) -> Streams:
    """Both streams, whatever the format."""
    kind, layout = kind_of(file), table or RecordingTable()
    try:
        if kind is Kind.BAG:
            return bags.streams(file, layout, _pose_stream(file, layout))
        if kind is Kind.TEXT and table is None:
            return arrays.streams(_strict(file), layout)
        if layout.pose_file is None:
            return arrays.streams(_columns(file, kind, layout), layout)
        return arrays.streams(
            _columns(file, kind, layout), layout, _pose_columns(file, layout, layout.pose_file)
        )
    except ImportError as error:
        raise InputError(f"{file}: {error}") from error


def _pose_stream(file: Path, layout: RecordingTable) -> Stream | None:
    return (
        None
        if layout.pose_file is None
        else arrays.pose_stream(_pose_columns(file, layout, layout.pose_file), layout)
    )


def _pose_columns(file: Path, layout: RecordingTable, name: str) -> Columns:
    pose_file = file.parent / name.replace("{name}", file.stem)
    own = {"decimal": layout.pose_decimal, "skip_lines": layout.pose_skip_lines}
    return _columns(
        pose_file,
        kind_of(pose_file),
        layout.model_copy(update={key: value for key, value in own.items() if value is not None}),
    )


def _strict(file: Path) -> Columns:
    """The CSV that `write_recording` writes, and no other."""
    try:
        table = read_table(file, COLUMNS, finite=False)
    except InputError as error:
        if ", line 1: columns: " not in str(error):
            raise
        raise InputError(
            f"{error}; another layout is told by a table [recording] in the setup"
        ) from None
    return Columns(file, COLUMNS, table.__getitem__, lines=2 + np.arange(len(table["time"])))


def _columns(file: Path, kind: Kind, table: RecordingTable) -> Columns:
    wanted = _wanted(table)
    match kind:
        case Kind.TEXT:
            units = (
                (table.time, table.time_unit),
                (table.pose_time, table.pose_time_unit or table.time_unit),
            )
            stamps = [name for name, unit in units if isinstance(name, str) and unit == "stamp"]
            return text.columns(file, table, wanted, stamps)
        case Kind.PARQUET:
            return parquet.columns(file, wanted)
        case Kind.HDF5 | Kind.MATLAB_HDF5:
            return hdf5.columns(file, wanted, matlab=kind is Kind.MATLAB_HDF5)
        case Kind.CLASSIC:
            return hdf5.classic_columns(file, wanted)
        case Kind.MATLAB:
            return matlab.columns(file)
        case Kind.BAG:
            raise InputError(f"{file}: is a bag; allowed for pose_file is a file of columns")


def _wanted(table: RecordingTable) -> list[str]:
    """Names that may be asked for; `name[k]` also without its index."""
    times = [
        (name,) if isinstance(name, str) else name
        for name in (table.time, table.pose_time)
        if name is not None
    ]
    names = [*chain(*times), *table.force, *table.torque, *table.position, *table.orientation]
    names += ["force", "torque", "position", "orientation"]
    return [
        *names,
        *(name[: name.rindex("[")] for name in names if name.endswith("]") and "[" in name),
    ]
