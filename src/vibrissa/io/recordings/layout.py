"""From named columns or arrays to streams: the one place where the names and units of [recording]
are used.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from re import fullmatch

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from vibrissa.files import InputError
from vibrissa.io.recordings import units
from vibrissa.io.recordings.arrays import Array, Columns
from vibrissa.io.recordings.streams import Poses, Streams, Wrenches
from vibrissa.io.recordings.table import RecordingTable

# Share of rows without a wrench or without a pose: drop-outs are fewer, streams of two rates more.
_OTHER_RATE = 0.3
# Two turns: an arm's last joint turns no further, and degrees soon do.
_LARGEST_ANGLE = 4 * np.pi
# Names in messages, of files that hold hundreds.
_MOST_SHOWN = 20


def streams(columns: Columns, table: RecordingTable, poses: Columns | None = None) -> Streams:
    """Both streams of a recording; its poses from `poses` where they have a file of their own.

    Raises
    ------
    InputError
        If a name is missing, an array is of another shape, units contradict each other, or columns
        differ in length.
    """
    layout = _Layout(columns, table)
    time = layout.time(table.time, table.time_unit)
    force = layout.vectors("force", table.force_unit, units.FORCE)
    torque = layout.vectors("torque", table.torque_unit, units.TORQUE)
    layout.check_lengths(time, force=force, torque=torque)
    wrench = Wrenches(time, force, torque, line=columns.lines)
    if poses is not None or table.pose_time is not None:
        return Streams(wrench, pose_stream(poses or columns, table))
    return _one_table(wrench, layout.poses(time))


def pose_stream(columns: Columns, table: RecordingTable) -> Poses:
    """Poses with stamps of their own.

    Raises
    ------
    InputError
        As `streams` does.
    """
    layout = _Layout(columns, table)
    unit = table.pose_time_unit or table.time_unit
    return layout.poses(layout.time(table.pose_time or table.time, unit))


def _one_table(wrench: Wrenches, pose: Poses) -> Streams:
    """Rows of which many hold only a wrench or only a pose are streams of different rates, written
    into one table; of a few, the numbers are missing.
    """
    no_wrench = np.isnan(wrench.channels).all(axis=1)
    no_pose = np.isnan(pose.position).all(axis=1) & np.isnan(pose.orientation).all(axis=1)
    if np.mean(no_wrench ^ no_pose) < _OTHER_RATE:
        return Streams(wrench, pose, together=True)
    note = (
        f"{np.count_nonzero(~no_wrench)} rows hold a wrench and {np.count_nonzero(~no_pose)} a "
        f"pose, of {len(wrench.time)}"
    )
    return Streams(wrench.rows(~no_wrench | no_pose), pose.rows(~no_pose), notes=(note,))


@dataclass(frozen=True)
class _Layout:
    """Columns of a file by what [recording] says of them."""

    columns: Columns
    table: RecordingTable

    def wrong(self, key: str, names: object, finding: str, allowed: str) -> InputError:
        """What is said of the names under a key."""
        return InputError(f"{self.columns.file}: {key} = {names!r} {finding}; allowed {allowed}")

    def check_lengths(self, time: np.ndarray, **parts: np.ndarray) -> None:
        """Raise InputError unless there is a row for each stamp."""
        for key, part in parts.items():
            if len(part) != len(time):
                raise InputError(
                    f"{self.columns.file}: {key} has {len(part)} rows, its time {len(time)}; "
                    "allowed is one row a stamp, or poses with a pose_time"
                )
        if not len(time):
            raise InputError(f"{self.columns.file}: no rows; allowed is at least one sample")

    def time(self, name: str | tuple[str, str], unit: str | None) -> Float[np.ndarray, "n"]:
        """Stamps [s]; of two names, whole seconds and nanoseconds."""
        if not isinstance(name, str):
            return self.time(name[0], "s") + self.time(name[1], "ns")
        time = self.array("time", name)
        if time.ndim != 1:
            raise self.wrong("time", name, f"has shape {time.shape}", "is one number a row")
        return time if unit == "stamp" else self.scaled("time", [name], time, unit, units.TIME)

    def poses(self, time: Float[np.ndarray, "n"]) -> Poses:
        """Poses with these stamps."""
        position = self.vectors("position", self.table.position_unit, units.LENGTH)
        orientation = self.orientation()
        self.check_lengths(time, position=position, orientation=orientation)
        return Poses(time, position, orientation, line=self.columns.lines)

    def vectors(
        self, key: str, unit: str | None, allowed: Sequence[str]
    ) -> Float[np.ndarray, "n 3"]:
        """Force, torque or position in SI."""
        names = self.names(key)
        return self.scaled(key, names, self.together(key, names, 3), unit, allowed)

    def names(self, key: str) -> tuple[str, ...]:
        """Names that the setup gives; where it gives none, those of the CSV header, or an array
        that is called what it is.
        """
        names: tuple[str, ...] = getattr(self.table, key)
        held = self.columns.arrays
        stated = key in self.table.model_fields_set or names[0] in held or key not in held
        return names if stated else (key,)

    def array(self, key: str, name: str) -> Array:
        """One array, or the column of one."""
        indexed = fullmatch(r"(.+)\[(\d+)\]", name)
        plain = indexed[1] if indexed and name not in self.columns.arrays else name
        if plain not in self.columns.arrays:
            names = self.columns.names
            more = f" and {len(names) - _MOST_SHOWN} more" * (len(names) > _MOST_SHOWN)
            shown = ", ".join(names[:_MOST_SHOWN])[:300] or "nothing"
            raise InputError(
                f"{self.columns.file}: {key} = {name!r} is not in the file; it holds {shown}{more}"
            )
        array = self.columns.arrays[plain]
        if indexed is None or plain == name:
            return array
        column = int(indexed[2])
        if array.ndim == 1 or column >= array.shape[1]:
            finding = f"is beyond the shape {array.shape} of {plain!r}"
            raise self.wrong(key, name, finding, "are columns that count from 0")
        return array[:, column]

    def together(self, key: str, names: Sequence[str], count: int) -> Float[np.ndarray, "n k"]:
        """Columns beside each other, or one array of them."""
        arrays = [self.array(key, name) for name in names]
        lengths = [len(array) for array in arrays]
        if len(set(lengths)) > 1:
            raise self.wrong(key, list(names), f"have {lengths} rows", "are equal lengths")
        block = np.column_stack(arrays)
        if len(arrays) == 1 and len(block) == count != block.shape[1]:
            # As MATLAB often holds them: a column a sample.
            block = block.T
        if block.shape[1] != count:
            raise self.wrong(key, list(names), f"has {block.shape[1]} columns", f"are {count}")
        return block

    def scaled(
        self, key: str, names: Sequence[str], array: Array, unit: str | None, allowed: Sequence[str]
    ) -> Array:
        """In SI, by the unit of the setup, or by what the file itself says; where both speak they
        have to agree.
        """
        said = {units.in_brackets(name, allowed) for name in names}
        for name in names:
            try:
                said.add(units.known(self.columns.units.get(name), allowed))
            except ValueError as error:
                if unit is None:
                    raise InputError(
                        f"{self.columns.file}: the file says that {name!r} is in {error}; allowed "
                        f"is one of them, or {key}_unit in [recording]"
                    ) from None
        factors = {units.factor(one): one for one in said if one is not None}
        if unit is None and len(factors) > 1:
            found = sorted(factors.values())
            raise InputError(
                f"{self.columns.file}: the units of {key} are {found}; allowed is one unit"
            )
        factor = units.factor(unit) if unit else next(iter(factors), 1.0)
        other = next((one for found, one in factors.items() if found != factor), None)
        if other is not None:
            raise InputError(
                f"{self.columns.file}: {key}_unit = {unit!r}, but the file says {other!r}; "
                "allowed is the unit that it has"
            )
        return array if factor == 1 else array * factor

    def orientation(self) -> Float[np.ndarray, "n 4"]:
        """Quaternions x, y, z, w, as they are: their norms are judged later."""
        names, form = self.names("orientation"), self.table.orientation_form
        if form in {"xyzw", "wxyz"}:
            self.check_order(names, form)
            numbers = self.together("orientation", names, 4)
            return numbers if form == "xyzw" else np.roll(numbers, -1, axis=1)
        unit = self.table.angle_unit
        numbers = self.together("orientation", names, 3)
        angles = self.scaled("angle", names, numbers, unit, units.ANGLE)
        known = np.isfinite(angles).all(axis=1)
        largest = np.abs(angles[known]).max(initial=0.0)
        if unit is None and largest > _LARGEST_ANGLE:
            finding = f"reaches {largest:.4g} rad, as of degrees"
            allowed = "are radians, or angle_unit in [recording]"
            raise self.wrong("orientation", list(names), finding, allowed)
        turned = (
            Rotation.from_rotvec(angles[known])
            if form == "rotation_vector"
            else Rotation.from_euler("xyz", angles[known])
        )
        quaternion = np.full((len(angles), 4), np.nan)
        quaternion[known] = turned.as_quat()
        return quaternion

    def check_order(self, names: Sequence[str], form: str) -> None:
        """Names that end in w, x, y and z say in which order they are; q0 to q3 leave open whether
        the scalar part comes first, and both are in use.
        """
        order = "".join(name.strip().lower()[-1:] for name in names)
        if sorted(order) == sorted(form) and order != form:
            other = f", or the form {order!r}" if order in {"xyzw", "wxyz"} else ""
            raise self.wrong(
                "orientation",
                list(names),
                f"with orientation_form = {form!r}",
                f"are names in the order of the form{other}",
            )
        ends = [fullmatch(r"(.*?)[\[(_]?(\d)[\])]?", name.strip()) for name in names]
        stems, digits = {end and end[1] for end in ends}, "".join(end[2] for end in ends if end)
        stated = "orientation_form" in self.table.model_fields_set
        if not stated and len(stems) == 1 and digits in {"0123", "1234"}:
            raise self.wrong(
                "orientation",
                list(names),
                "does not say whether the scalar part w comes first or last",
                "are such names with orientation_form = 'wxyz' or 'xyzw' in [recording]",
            )
