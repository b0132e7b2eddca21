"""From named columns or arrays to streams: the one place where the names and units of [recording]
are used.
"""

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
# Two turns.
_LARGEST_ANGLE = 4 * np.pi


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
    lines
        (n,) lines of the text that the rows stand in, from 1; None for other formats.
    """

    file: Path
    names: Sequence[str]
    get: Callable[[str], Array]
    unit: Callable[[str], str | None] = lambda _name: None
    lines: np.ndarray | None = None


def streams(columns: Columns, table: RecordingTable, poses: Columns | None = None) -> Streams:
    """Both streams of a recording; its poses from `poses` where they have a file of their own.

    Raises
    ------
    InputError
        If a name is missing, an array is no numbers or of another shape, or columns differ in
        length.
    """
    time = _time(columns, table.time, table.time_unit)
    force = _block(columns, table, "force", table.force_unit, units.FORCE)
    torque = _block(columns, table, "torque", table.torque_unit, units.TORQUE)
    wrench = _stream(columns, time, [("force", force), ("torque", torque)])
    if poses is not None or table.pose_time is not None:
        return Streams(wrench, pose_stream(poses or columns, table))
    return _one_table(columns, wrench, _poses(columns, table, time))


def pose_stream(columns: Columns, table: RecordingTable) -> Stream:
    """Poses with stamps of their own.

    Raises
    ------
    InputError
        As `streams` does.
    """
    return _poses(
        columns,
        table,
        _time(columns, table.pose_time or table.time, table.pose_time_unit or table.time_unit),
    )


def _poses(columns: Columns, table: RecordingTable, time: Float[np.ndarray, "n"]) -> Stream:
    position = _block(columns, table, "position", table.position_unit, units.LENGTH)
    return _stream(
        columns, time, [("position", position), ("orientation", _orientation(columns, table))]
    )


def _one_table(columns: Columns, wrench: Stream, pose: Stream) -> Streams:
    """Rows of which many hold only a wrench or only a pose are streams of different rates, written
    into one table; of a few, the numbers are missing.
    """
    if len(pose.time) != len(wrench.time):
        raise InputError(
            f"{columns.file}: position has {len(pose.time)} rows, force {len(wrench.time)}; allowed are poses as often, or pose_time"
        )
    no_wrench, no_pose = (np.all(np.isnan(stream.values), axis=1) for stream in (wrench, pose))
    if np.mean(no_wrench ^ no_pose) < _OTHER_RATE:
        return Streams(wrench, pose, together=True)
    notes = (
        f"{np.count_nonzero(~no_wrench)} rows hold a wrench and {np.count_nonzero(~no_pose)} a pose, of {len(wrench.time)}",
    )
    return Streams(wrench.rows(~no_wrench | no_pose), pose.rows(~no_pose), notes=notes)


def _stream(
    columns: Columns,
    time: Float[np.ndarray, "n"],
    blocks: Sequence[tuple[str, Float[np.ndarray, "_ _"]]],
) -> Stream:
    for name, block in blocks:
        if len(block) != len(time):
            raise InputError(
                f"{columns.file}: {name} has {len(block)} rows, its time {len(time)}; allowed is one row a stamp"
            )
    if not 0 < len(time) <= MOST_ROWS:
        raise InputError(
            f"{columns.file}: {len(time) or 'no'} rows; allowed are 1 to {MOST_ROWS} samples"
        )
    return Stream(time, np.column_stack([block for _, block in blocks]), columns.lines)


def _time(
    columns: Columns, name: str | tuple[str, str], unit: str | None
) -> Float[np.ndarray, "n"]:
    """Stamps [s]; of two names, whole seconds and nanoseconds."""
    if not isinstance(name, str):
        seconds, nanoseconds = (
            _time(columns, part, own) for part, own in zip(name, ("s", "ns"), strict=True)
        )
        return seconds + nanoseconds
    time = _array(columns, name, "time")
    if time.ndim != 1:
        raise InputError(
            f"{columns.file}: time = {name!r} has shape {time.shape}; allowed is one number a row"
        )
    if unit == "stamp":
        return time
    return _scaled(columns, [name], "time", time, unit, units.TIME)


def _block(
    columns: Columns, table: RecordingTable, key: str, unit: str | None, allowed: dict[str, float]
) -> Float[np.ndarray, "n 3"]:
    names = _names(columns, table, key)
    return _scaled(columns, names, key, _together(columns, names, key, 3), unit, allowed)


def _names(columns: Columns, table: RecordingTable, key: str) -> tuple[str, ...]:
    """Names that the setup gives; where it gives none, those of the CSV header, or an array that is
    called what it is.
    """
    names: tuple[str, ...] = getattr(table, key)
    by_default = key not in table.model_fields_set
    return (
        (key,) if by_default and names[0] not in columns.names and key in columns.names else names
    )


def _together(
    columns: Columns, names: Sequence[str], key: str, count: int
) -> Float[np.ndarray, "n k"]:
    arrays = [_array(columns, name, key) for name in names]
    if len({len(array) for array in arrays}) > 1:
        raise InputError(
            f"{columns.file}: {key} = {list(names)} have {[len(array) for array in arrays]} rows; allowed are columns of equal length"
        )
    if (
        len(arrays) == 1
        and arrays[0].ndim == 2
        and arrays[0].shape[1] != count == arrays[0].shape[0]
    ):
        # As MATLAB often holds them: a column a sample.
        arrays = [arrays[0].T]
    block = np.column_stack(arrays)
    if block.shape[1] != count:
        raise InputError(
            f"{columns.file}: {key} = {list(names)} has {block.shape[1]} columns; allowed are {count}"
        )
    return block


def _array(columns: Columns, name: str, key: str) -> Array:
    indexed = fullmatch(r"(.+)\[(\d{1,4})\]", name)
    plain = indexed[1] if indexed and name not in columns.names else name
    if plain not in columns.names:
        raise InputError(
            f"{columns.file}: {key} = {name!r} is not in the file; it holds {_some(columns.names)}"
        )
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
        raise InputError(
            f"{columns.file}: {key} = {name!r}, but {plain!r} has shape {array.shape}; columns count from 0"
        )
    return array[:, column]


def _scaled(
    columns: Columns,
    names: Sequence[str],
    key: str,
    array: Array,
    unit: str | None,
    allowed: dict[str, float],
) -> Array:
    """In SI, by the unit of the setup, or by what the file itself says; where both speak they have
    to agree.
    """
    stated = _stated(columns, names, key, unit, allowed)
    if unit is None and len({allowed[one] for one in stated}) > 1:
        raise InputError(
            f"{columns.file}: the units of {key} are {sorted(stated)}; allowed is one unit"
        )
    other = next(
        (one for one in stated if unit is not None and allowed[one] != allowed[unit]), None
    )
    if other is not None:
        raise InputError(
            f"{columns.file}: {key}_unit = {unit!r}, but the file says {other!r}; allowed is the unit that it has"
        )
    factor = allowed[unit or next(iter(stated), None) or next(iter(allowed))]
    return array if factor == 1 else array * factor


def _stated(
    columns: Columns, names: Sequence[str], key: str, unit: str | None, allowed: dict[str, float]
) -> set[str]:
    """Units that attributes of the arrays name, or brackets at the ends of their names."""
    found = {units.in_brackets(name, allowed) for name in names}
    for name in names:
        try:
            found.add(units.known(columns.unit(name), allowed))
        except ValueError as error:
            if unit is None:
                raise InputError(
                    f"{columns.file}: the file says that {name!r} is in {error}; allowed is one of them, or {key}_unit in [recording]"
                ) from None
    return {one for one in found if one is not None}


def _orientation(columns: Columns, table: RecordingTable) -> Float[np.ndarray, "n 4"]:
    """Quaternions x, y, z, w, as they are: their norms are judged later."""
    names, form = _names(columns, table, "orientation"), table.orientation_form
    if form in {"xyzw", "wxyz"}:
        _check_order(columns, names, form)
        if "orientation_form" not in table.model_fields_set:
            _check_numbered(columns, names)
        numbers = _together(columns, names, "orientation", 4)
        return numbers if form == "xyzw" else np.roll(numbers, -1, axis=1)
    numbers = _together(columns, names, "orientation", 3)
    angles = _scaled(columns, names, "angle", numbers, table.angle_unit, units.ANGLE)
    largest = float(np.max(np.abs(angles), initial=0.0, where=np.isfinite(angles)))
    if table.angle_unit is None and largest > _LARGEST_ANGLE:
        raise InputError(
            f"{columns.file}: orientation = {list(names)} reaches {largest:.4g} rad, as of degrees; allowed are radians, or angle_unit in [recording]"
        )
    known = np.all(np.isfinite(angles), axis=1)
    rotation = (
        Rotation.from_rotvec(angles[known])
        if form == "rotation_vector"
        else Rotation.from_euler("xyz", angles[known])
    )
    quaternion = np.full((len(angles), 4), np.nan)
    quaternion[known] = rotation.as_quat()
    return quaternion


def _check_order(columns: Columns, names: Sequence[str], form: str) -> None:
    """Names that end in w, x, y and z say themselves in which order they are."""
    order = "".join(name.strip().lower()[-1:] for name in names)
    if sorted(order) == sorted(form) and order != form:
        raise InputError(
            f"{columns.file}: orientation = {list(names)} with orientation_form = {form!r}; allowed are names in the order of the form, or the form {order!r}"
            if order in {"xyzw", "wxyz"}
            else f"{columns.file}: orientation = {list(names)}; allowed are names in the order of orientation_form = {form!r}"
        )


def _check_numbered(columns: Columns, names: Sequence[str]) -> None:
    """Names such as q0 to q3 leave open whether the scalar part comes first, and both are in use."""
    ends = [fullmatch(r"(.*?)[\[(_]?(\d)[\])]?", name.strip()) for name in names]
    places = [int(end[2]) for end in ends if end]
    if (
        len(places) == 4
        and places in ([0, 1, 2, 3], [1, 2, 3, 4])
        and len({end[1] for end in ends if end}) == 1
    ):
        raise InputError(
            f"{columns.file}: orientation = {list(names)} does not say whether the scalar part w comes first or last; allowed are such names with "
            "orientation_form = 'wxyz' or 'xyzw' in [recording]"
        )


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(names[:20])[:300]
    return (shown or "nothing") + (f" and {len(names) - 20} more" if len(names) > 20 else "")
