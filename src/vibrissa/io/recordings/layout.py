"""From named columns or arrays to streams: the only place where the names and units of [recording]
are used.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from re import fullmatch

import numpy as np
from scipy.spatial.transform import Rotation

from vibrissa.files import InputError
from vibrissa.io.recordings import units
from vibrissa.io.recordings.formats import Array, Columns
from vibrissa.io.recordings.streams import Poses, Streams, Wrenches
from vibrissa.io.recordings.table import RecordingTable, constant
from vibrissa.sensor.raw import Quaternions, Times, Vectors

# Share of rows that lack the wrench or the pose: drop-outs give less, streams of two rates more.
_OTHER_RATE = 0.3
# Two turns: a robot's last joint turns no further, but angles in degrees soon exceed this.
_LARGEST_ANGLE = 4 * np.pi


def streams(columns: Columns, table: RecordingTable, poses: Columns | None = None) -> Streams:
    """Both streams of a recording; its poses come from `poses` if they have their own file.

    If many rows hold only a wrench or only a pose, the table mixes streams of different rates,
    which are separated; if few do, their numbers count as missing.

    Raises
    ------
    InputError
        If a name is missing, an array has the wrong shape, units contradict each other, or columns
        differ in length.
    """
    layout = _Layout(columns, table)
    time = layout.time()
    force, torque = (layout.vectors(key, time) for key in ("force", "torque"))
    wrench = Wrenches(time, force, torque, line=columns.lines)
    if poses is not None or table.pose_time is not None:
        return Streams(wrench, pose_stream(poses or columns, table))
    pose = layout.poses(time)
    no_wrench = np.isnan(wrench.channels).all(axis=1)
    no_pose = np.isnan(np.hstack([pose.position, pose.orientation])).all(axis=1)
    if np.mean(no_wrench ^ no_pose) < _OTHER_RATE:
        return Streams(wrench, pose, together=True)
    note = (
        f"{np.count_nonzero(~no_wrench)} rows hold a wrench and {np.count_nonzero(~no_pose)} a "
        f"pose, of {len(time)}"
    )
    return Streams(wrench.rows(~no_wrench | no_pose), pose.rows(~no_pose), notes=(note,))


def pose_stream(columns: Columns, table: RecordingTable) -> Poses:
    """Poses with their own stamps.

    Raises
    ------
    InputError
        As `streams` does.
    """
    layout = _Layout(columns, table.of_poses)
    return layout.poses(layout.time())


@dataclass(frozen=True)
class _Layout:
    """Columns of a file, interpreted according to [recording]."""

    columns: Columns
    table: RecordingTable

    def wrong(self, key: str, names: object, finding: str, allowed: str) -> InputError:
        """Error about the names given for a key."""
        return InputError(f"{self.columns.file}: {key} = {names!r} {finding}; allowed {allowed}")

    def time(self) -> Times:
        """Stamps [s]; two names are whole seconds and nanoseconds."""
        names, parts = self.table.time, []
        in_units = ("s", "ns") if len(names) > 1 else (self.table.time_unit,)
        for name, unit in zip(names, in_units, strict=True):
            part = self.array("time", name)
            if part.ndim != 1 or not len(part):
                raise self.wrong("time", name, f"has shape {part.shape}", "is one number a row")
            parts.append(part if unit == "stamp" else self.scaled("time", (name,), part, unit))
        return np.sum(parts, axis=0)

    def poses(self, time: Times) -> Poses:
        """Poses at these stamps."""
        position, orientation = self.vectors("position", time), self.orientation(time)
        return Poses(time, position, orientation, line=self.columns.lines)

    def vectors(self, key: str, time: Times) -> Vectors:
        """Force, torque or position in SI."""
        names, numbers = self.block(key, time, 3)
        return self.scaled(key, names, numbers, getattr(self.table, f"{key}_unit"))

    def array(self, key: str, name: str) -> Array:
        """An array, or a column of one."""
        held, indexed = self.columns.arrays, fullmatch(r"(.+)\[(\d+)\]", name)
        if name in held:
            return held[name]
        if indexed is None or indexed[1] not in held:
            shown = ", ".join(self.columns.names)[:300] or "nothing"
            raise InputError(
                f"{self.columns.file}: {key} = {name!r} is not in the file; it holds {shown}"
            )
        array, column = held[indexed[1]], int(indexed[2])
        if array.ndim == 1 or column >= array.shape[1]:
            finding = f"is beyond the shape {array.shape} of {indexed[1]!r}"
            raise self.wrong(key, name, finding, "are columns that count from 0")
        return array[:, column]

    def numbers(self, key: str, name: str, rows: int) -> Array:
        """An array, or a column of one, or of a number that stands in place of a pose's name."""
        same = constant(name, self.columns.names) if key in {"position", "orientation"} else None
        return self.array(key, name) if same is None else np.full(rows, same)

    def block(self, key: str, time: Times, count: int) -> tuple[tuple[str, ...], Array]:
        """Names for a key and their numbers, one row per stamp. The names are those in the setup;
        by default those of the CSV header, or an array named like the key. An array may have one
        column per sample, as is common in MATLAB.
        """
        names: tuple[str, ...] = getattr(self.table, key)
        held = self.columns.arrays
        if key in held and names[0] not in held and key not in self.table.model_fields_set:
            names = (key,)
        arrays = [self.numbers(key, name, len(time)) for name in names]
        if len(names) == len(time) == 1:
            # A matrix of one row has been read as a vector.
            arrays[0] = arrays[0].reshape(1, -1)
        if len(time) != count and arrays[0].shape == (count, len(time)):
            arrays[0] = arrays[0].T
        lengths = sorted({len(array) for array in arrays})
        if lengths != [len(time)]:
            finding = f"has {lengths} rows, its time {len(time)}"
            raise self.wrong(key, names, finding, "is one row per stamp, or poses with a pose_time")
        block = np.column_stack(arrays)
        if block.shape[1] != count:
            raise self.wrong(key, names, f"has {block.shape[1]} columns", f"are {count}")
        return names, block

    def scaled(self, key: str, names: Sequence[str], array: Array, unit: str | None) -> Array:
        """Convert to SI from the unit that the setup or the file states; if both do, they must
        agree.
        """
        allowed = units.ALLOWED[key]
        said = {units.in_brackets(name, allowed) for name in names}
        try:
            said |= {units.known(self.columns.units.get(name), allowed) for name in names}
        except ValueError as error:
            if unit is None:
                raise InputError(
                    f"{self.columns.file}: the file says that {key} is in {error}; allowed is one "
                    f"of them, or {key}_unit in [recording]"
                ) from None
        factors = {units.factor(one): one for one in said if one is not None}
        factor = units.factor(unit) if unit else next(iter(factors), 1.0)
        if factors.keys() - {factor}:
            raise InputError(
                f"{self.columns.file}: {key}_unit = {unit!r}, but the file says "
                f"{', '.join(map(repr, sorted(factors.values())))}; allowed is the unit that it has"
            )
        return array * factor

    def orientation(self, time: Times) -> Quaternions:
        """Quaternions x, y, z, w, as they are: their norms are checked later."""
        form, unit = self.table.orientation_form, self.table.angle_unit
        names, numbers = self.block("orientation", time, 4 if form in {"xyzw", "wxyz"} else 3)
        if form in {"xyzw", "wxyz"}:
            self.check_order(names, form)
            return numbers if form == "xyzw" else np.roll(numbers, -1, axis=1)
        angles = self.scaled("angle", names, numbers, unit)
        largest = np.abs(angles[np.isfinite(angles)]).max(initial=0.0)
        if unit is None and largest > _LARGEST_ANGLE:
            finding = f"reaches {largest:.4g} rad, as if in degrees"
            allowed = "are radians, or angle_unit in [recording]"
            raise self.wrong("orientation", names, finding, allowed)
        if form == "rotation_vector":
            return Rotation.from_rotvec(angles).as_quat()
        return Rotation.from_euler("xyz", angles).as_quat()

    def check_order(self, names: Sequence[str], form: str) -> None:
        """Check the order that names ending in w, x, y and z imply; q0 to q3 leave open whether the
        scalar part comes first, as both conventions are in use.
        """
        ends = [fullmatch(r"(.*?)[\[(_]?(\w)[\])]?", name.strip().lower()) for name in names]
        stems, order = {end and end[1] for end in ends}, "".join(end[2] for end in ends if end)
        stated = "orientation_form" in self.table.model_fields_set
        if sorted(order) == sorted(form) and order != form:
            other = f", or the form {order!r}" if order in {"xyzw", "wxyz"} else ""
            finding = f"with orientation_form = {form!r}"
            allowed = f"are names in the order of the form{other}"
        elif not stated and len(stems) == 1 and order in {"0123", "1234"}:
            finding = "does not say whether the scalar part w comes first or last"
            allowed = "are such names with orientation_form = 'wxyz' or 'xyzw' in [recording]"
        else:
            return
        raise self.wrong("orientation", names, finding, allowed)
