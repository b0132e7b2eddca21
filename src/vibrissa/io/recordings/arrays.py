"""From named columns or arrays to streams: the one place where the names and units of [recording] are used."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from re import fullmatch

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from vibrissa.files import InputError
from vibrissa.io.recordings import units
from vibrissa.io.recordings.streams import Stream, Streams
from vibrissa.io.recordings.table import RecordingTable

MOST_ROWS = 10_000_000
Array = Float[np.ndarray, "n"] | Float[np.ndarray, "n k"]

# Share of rows without a wrench or without a pose.
_OTHER_RATE = 0.3


@dataclass(frozen=True)
class Columns:
    """A file that holds named columns (n,) or arrays (n, k).

    Attributes
    ----------
    file
        For messages.
    names
        What it holds.
    get
        Gives one by its name, as floats; times of a type of their own in seconds.
    unit
        What the file says of its unit, or None.
    first_line
        Line of the text that the first row stands in; None for other formats.
    """

    file: Path
    names: Sequence[str]
    get: Callable[[str], Array]
    unit: Callable[[str], str | None] = lambda _name: None
    first_line: int | None = None


def streams(columns: Columns, table: RecordingTable, poses: Columns | None = None) -> Streams:
    """Both streams of a recording; its poses from `poses` where they have a file of their own.

    Raises
    ------
    InputError
        If a name is missing, an array is no numbers or of another shape, or columns differ in length.
    """
    time = _time(columns, table.time, table.time_unit)
    force = _block(columns, table, "force", table.force_unit, units.FORCE)
    torque = _block(columns, table, "torque", table.torque_unit, units.TORQUE)
    wrench = _stream(columns, time, [("force", force), ("torque", torque)])
    other = poses or columns
    # A file of its own has stamps of its own.
    name = table.pose_time or (table.time if poses else None)
    pose_time = time if name is None else _time(other, name, table.pose_time_unit or table.time_unit)
    position = _block(other, table, "position", table.position_unit, units.LENGTH)
    pose = _stream(other, pose_time, [("position", position), ("orientation", _orientation(other, table))])
    return Streams(wrench, pose) if name is not None else _one_table(columns, wrench, pose)


def _one_table(columns: Columns, wrench: Stream, pose: Stream) -> Streams:
    """Rows of which many hold only a wrench or only a pose are streams of different rates, written into one table; of a few, the numbers are missing."""
    if len(pose.time) != len(wrench.time):
        raise InputError(
            f"{columns.file}: position has {len(pose.time)} rows, force {len(wrench.time)}; allowed are poses as often, or pose_time"
        )
    no_wrench, no_pose = (np.all(np.isnan(stream.values), axis=1) for stream in (wrench, pose))
    if np.mean(no_wrench ^ no_pose) < _OTHER_RATE:
        return Streams(wrench, pose, together=True)
    notes = (f"{np.count_nonzero(~no_wrench)} rows hold a wrench and {np.count_nonzero(~no_pose)} a pose, of {len(wrench.time)}",)
    return Streams(wrench.rows(~no_wrench | no_pose), pose.rows(~no_pose), notes=notes)


def _stream(columns: Columns, time: Float[np.ndarray, "n"], blocks: Sequence[tuple[str, Float[np.ndarray, "_ _"]]]) -> Stream:
    for name, block in blocks:
        if len(block) != len(time):
            raise InputError(f"{columns.file}: {name} has {len(block)} rows, its time {len(time)}; allowed is one row a stamp")
    if not 0 < len(time) <= MOST_ROWS:
        raise InputError(f"{columns.file}: {len(time) or 'no'} rows; allowed are 1 to {MOST_ROWS} samples")
    line = None if columns.first_line is None else columns.first_line + np.arange(len(time))
    return Stream(time, np.column_stack([block for _, block in blocks]), line)


def _time(columns: Columns, name: str, unit: str | None) -> Float[np.ndarray, "n"]:
    time = _array(columns, name, "time")
    if time.ndim != 1:
        raise InputError(f"{columns.file}: time = {name!r} has shape {time.shape}; allowed is one number a row")
    if unit == "stamp":
        return time
    return _scaled(columns, [name], "time", time, unit, units.TIME)


def _block(columns: Columns, table: RecordingTable, key: str, unit: str | None, allowed: dict[str, float]) -> Float[np.ndarray, "n 3"]:
    names = _names(columns, table, key)
    return _scaled(columns, names, key, _together(columns, names, key, 3), unit, allowed)


def _names(columns: Columns, table: RecordingTable, key: str) -> tuple[str, ...]:
    """Names that the setup gives; where it gives none, those of the CSV header, or an array that is called what it is."""
    names: tuple[str, ...] = getattr(table, key)
    by_default = key not in table.model_fields_set
    return (key,) if by_default and names[0] not in columns.names and key in columns.names else names


def _together(columns: Columns, names: Sequence[str], key: str, count: int) -> Float[np.ndarray, "n k"]:
    arrays = [_array(columns, name, key) for name in names]
    if len({len(array) for array in arrays}) > 1:
        raise InputError(
            f"{columns.file}: {key} = {list(names)} have {[len(array) for array in arrays]} rows; allowed are columns of equal length"
        )
    block = np.column_stack(arrays)
    if block.shape[1] != count:
        raise InputError(f"{columns.file}: {key} = {list(names)} has {block.shape[1]} columns; allowed are {count}")
    return block


def _array(columns: Columns, name: str, key: str) -> Array:
    indexed = fullmatch(r"(.+)\[(\d{1,4})\]", name)
    plain = indexed[1] if indexed and name not in columns.names else name
    if plain not in columns.names:
        raise InputError(f"{columns.file}: {key} = {name!r} is not in the file; it holds {_some(columns.names)}")
    array = columns.get(plain)
    if array.ndim not in {1, 2} or len(array) > MOST_ROWS:
        raise InputError(
            f"{columns.file}: {key} = {name!r} has shape {array.shape}; allowed are (n,) and (n, k) of at most {MOST_ROWS} rows"
        )
    if plain == name:
        return array
    assert indexed is not None
    column = int(indexed[2])
    if array.ndim == 1 or column >= array.shape[1]:
        raise InputError(f"{columns.file}: {key} = {name!r}, but {plain!r} has shape {array.shape}; columns count from 0")
    return array[:, column]


def _scaled(columns: Columns, names: Sequence[str], key: str, array: Array, unit: str | None, allowed: dict[str, float]) -> Array:
    """In SI, by the unit of the setup, or by what the file itself says; where both speak they have to agree."""
    stated = {units.known(columns.unit(name), allowed) for name in names} - {None}
    if unit is None and len(stated) > 1:
        raise InputError(f"{columns.file}: the units of {key} are {sorted(map(str, stated))}; allowed is one unit")
    other = next((one for one in stated if unit is not None and allowed[str(one)] != allowed[unit]), None)
    if other is not None:
        raise InputError(f"{columns.file}: {key}_unit = {unit!r}, but the file says {other!r}; allowed is the unit that it has")
    factor = allowed[unit or next(iter(stated), None) or next(iter(allowed))]
    return array if factor == 1 else array * factor


def _orientation(columns: Columns, table: RecordingTable) -> Float[np.ndarray, "n 4"]:
    """Quaternions x, y, z, w, as they are: their norms are judged later."""
    names, form = _names(columns, table, "orientation"), table.orientation_form
    if form in {"xyzw", "wxyz"}:
        numbers = _together(columns, names, "orientation", 4)
        return numbers if form == "xyzw" else np.roll(numbers, -1, axis=1)
    numbers = _together(columns, names, "orientation", 3)
    angles = _scaled(columns, names, "angle", numbers, table.angle_unit, units.ANGLE)
    known = np.all(np.isfinite(angles), axis=1)
    rotation = Rotation.from_rotvec(angles[known]) if form == "rotation_vector" else Rotation.from_euler("xyz", angles[known])
    quaternion = np.full((len(angles), 4), np.nan)
    quaternion[known] = rotation.as_quat()
    return quaternion


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(names[:20])[:300]
    return (shown or "nothing") + (f" and {len(names) - 20} more" if len(names) > 20 else "")
