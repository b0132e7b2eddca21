"""A recording in another format, which the same rod and sensor read back to the same numbers, but
for the rounding of bags: stamps to a nanosecond, quaternions to unit norm.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from vibrissa.files import InputError, writable, writable_folder
from vibrissa.io.calibration import set_files
from vibrissa.io.recordings.align import Recording
from vibrissa.io.recordings.read import read_raw
from vibrissa.io.recordings.streams import Poses, in_gap, usable
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.io.recordings.write import COLUMNS
from vibrissa.io.setup import Setup, load_setup
from vibrissa.libraries import extra_library, writer
from vibrissa.sensor import RawRecording

if TYPE_CHECKING:
    import pandas

BAG_FOLDER = "rosbag2:"
SUFFIXES = (".csv", ".parquet", ".nc", ".mat", ".mcap")
TARGETS = "x.csv, x.parquet, x.nc, x.mat, x.mcap and rosbag2:FOLDER"
_ROWS = "x.csv, x.parquet, x.nc and x.mat"
_UNITS = {
    "time": "s",
    "position": "m",
    "orientation": "1",
    "force": "N",
    "torque": "N m",
}
# Messages between two log times that are exact: a few hundredths of a second of a fast sensor.
_BLOCK = 64
_SECOND = 1e9


class Converted(NamedTuple):
    """What was written: rows, the recording, its setup, and what was left out on reading."""

    rows: int
    recording: Path
    setup: Path
    notes: tuple[str, ...]


def convert_recording(path: str | Path, setup: str | Path, target: str | Path) -> Converted:
    """Write a recording in another format, tare included, in SI units and under the names that are
    read without a table [recording]; sign, frame and reference point stay as logged.

    There is a row per wrench, with the pose interpolated at its stamp, on the wrench's clock.
    Columns that the setup does not name are left out. If the setup has a table [recording], which
    describes the original, a copy without it is written next to the new file, as `NAME_setup.toml`.

    Parameters
    ----------
    path
        The recording.
    setup
        The setup (TOML) that reads it.
    target
        File ending in .csv, .parquet, .nc, .mat or .mcap, or rosbag2:FOLDER.

    Raises
    ------
    InputError
        If a file cannot be read or written, the target is none of these, would replace the
        recording or the setup, or a library that its format needs is not installed; if the target
        is a bag, whose poses are found by their stamps alone, and rows would lose theirs or be
        given another.
    """
    loaded, out = load_setup(setup), checked_target(target)
    fitting = Path(setup)
    if loaded.recording is not None:
        fitting = out.with_name(f"{out.stem}_setup.toml")
    written = [out] if loaded.recording is None else [out, fitting]
    sources = {Path(path).resolve(), Path(setup).resolve()}
    for file in written:
        if file.resolve() in sources:
            raise InputError(f"{file}: would replace what is converted; allowed is another name")
    recording = read_raw(path, loaded)
    try:
        _write(str(target), out, recording, loaded)
        if loaded.recording is not None:
            _write_setup(fitting, Path(setup))
    except ImportError as error:
        raise InputError(f"{out}: {error}") from error
    except OSError as error:
        raise InputError(
            f"{out}: cannot be written ({error.strerror or error}); "
            "allowed is a file that can be written"
        ) from error
    return Converted(len(recording.raw.time), out, fitting, recording.notes)


def checked_target(target: str | Path) -> Path:
    """The file or folder to write to; raise InputError if it is of no known kind, or cannot be."""
    text = str(target)
    if text.startswith(BAG_FOLDER) and text != BAG_FOLDER:
        return writable_folder(Path(text.removeprefix(BAG_FOLDER)))
    if Path(text).suffix.lower() not in SUFFIXES:
        raise InputError(f"{text!r}: is no format to convert to; allowed are {TARGETS}")
    try:
        writer(Path(text).suffix.lower())
    except ImportError as error:
        raise InputError(f"{text}: {error}") from error
    return writable(Path(text))


def _write(target: str, out: Path, recording: Recording, loaded: Setup) -> None:
    raw = recording.marked
    match "" if target.startswith(BAG_FOLDER) else out.suffix.lower():
        case ".csv":
            _table(raw).to_csv(out, index=False, na_rep="nan", lineterminator="\n")
        case ".parquet":
            _table(raw).to_parquet(out, index=False)
        case ".nc":
            _write_netcdf(out, raw)
        case ".mat":
            from scipy.io import savemat  # noqa: PLC0415

            savemat(out, {name: getattr(raw, name) for name in _UNITS}, oned_as="column")
        case suffix:
            _check_poses(out, raw, loaded)
            _write_bag(out, raw, loaded.sensor.wrench_frame, folder=suffix == "")


def _table(raw: RawRecording) -> "pandas.DataFrame":
    import pandas  # noqa: PLC0415

    rows = np.column_stack([raw.time, raw.position, raw.orientation, raw.wrench])
    return pandas.DataFrame(rows, columns=list(COLUMNS))


def _write_netcdf(out: Path, raw: RawRecording) -> None:
    import xarray  # noqa: PLC0415

    axes = {"time": (), "orientation": ("component",)}
    xarray.Dataset(
        {
            name: (("row", *axes.get(name, ("axis",))), getattr(raw, name), {"units": unit})
            for name, unit in _UNITS.items()
        }
    ).to_netcdf(out, engine="h5netcdf")


def _check_poses(out: Path, raw: RawRecording, loaded: Setup) -> None:
    """Refuse rows that a bag would give another pose than their own, or leave out."""
    time, table = np.round(raw.time * _SECOND) / _SECOND, loaded.recording or RecordingTable()
    poses = Poses(time, raw.position, raw.orientation)
    pose, known = np.hstack([raw.position, raw.orientation]), usable(poses)
    _, first, same = np.unique(time, return_index=True, return_inverse=True)
    unstamped = np.isnan(time)
    # A gap that is too long to interpolate over is one in the bag, too.
    gap = in_gap(known, time, table.longest_gap) if len(known.time) else unstamped
    rows = {
        "share a stamp with a row of another pose": poses.finite
        & (pose[first[same]] != pose).any(axis=1),
        "have no pose": ~poses.finite & ~unstamped & ~gap,
        "have no stamp": unstamped,
    }
    found = [f"{lost.sum()} {words}" for words, lost in rows.items() if lost.any()]
    if found:
        raise InputError(
            f"{out}: of {len(time)} rows {' and '.join(found)}; a bag finds poses by their stamps "
            f"and would lose or invent some; allowed are {_ROWS}"
        )


def _write_bag(out: Path, raw: RawRecording, frame: str, *, folder: bool) -> None:
    from vibrissa.io.rosbag import McapSink, Rosbag2Sink  # noqa: PLC0415

    stamped = np.isfinite(raw.time)
    stamp = np.round(raw.time[stamped] * _SECOND).astype(np.int64)
    pose, orientation = raw.position[stamped], raw.orientation[stamped]
    force, torque = raw.force[stamped], raw.torque[stamped]
    sink = (Rosbag2Sink if folder else McapSink)(out, wrench_frame=frame)
    try:
        for first in range(0, len(stamp), _BLOCK):
            own = slice(first, first + _BLOCK)
            rows = np.arange(first, min(first + _BLOCK, len(stamp)))
            sink.wrench(stamp[own], rows, force[own], torque[own])
            sink.poses(stamp[own], pose[own], orientation[own])
    finally:
        sink.close()


def _write_setup(file: Path, source: Path) -> None:
    """The setup without what describes the original; the longest gap still holds."""
    library = extra_library("tomlkit", extra="calibrate", need="a setup beside the file needs it")
    document: Any = library.parse(source.read_text(encoding="utf-8"))
    table = document.pop("recording")
    if "longest_gap" in table:
        document["recording"] = {"longest_gap": table["longest_gap"]}
    folders = source.parent.resolve(), file.parent.resolve()
    if folders[0] != folders[1]:
        set_files(document, *folders)
    file.write_text(document.as_string(), encoding="utf-8")
