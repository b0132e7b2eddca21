"""The table [recording] of a setup: where a recording's numbers are, in which units and on which
clock.
"""

from collections.abc import Iterable
from math import isfinite
from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field, StringConstraints

from vibrissa.io.config import IN_ONE, Finite, Positive, Table, several
from vibrissa.io.recordings import units

Name = Annotated[
    str,
    StringConstraints(strict=True, min_length=1),
    Field(description="the name of a column, array or topic"),
]


def _listed(value: object) -> object:
    return (value,) if isinstance(value, str) else value


def constant(name: str, names: Iterable[str]) -> float | None:
    """The number that stands in place of a name, in a file with given names; None if it is a name,
    as all are in a file that numbers its columns.
    """
    if any(constant(held, ()) is not None for held in names):
        return None
    try:
        number = float(name)
    except ValueError:
        return None
    return number if isfinite(number) else None


def _names_or_numbers(value: object) -> object:
    listed = _listed(value)
    if not isinstance(listed, list | tuple):
        return listed
    return [str(one) if type(one) in {int, float} else one for one in listed]


def _one_or(count: str) -> str:
    return f"one name, of an array with a column for each, or a list of {count} names"


Names = Annotated[tuple[Name, ...], BeforeValidator(_listed)]
Names3 = Annotated[Names, several(3, _one_or("three"), least=1)]
PoseNames = Annotated[tuple[Name, ...], BeforeValidator(_names_or_numbers)]
Positions = Annotated[
    PoseNames, several(3, f"{_one_or('three')}; numbers for what does not change", least=1)
]
Orientations = Annotated[
    PoseNames, several(4, f"{_one_or('three or four')}, or numbers if it does not turn", least=1)
]
TimeNames = Annotated[
    Names,
    several(
        2,
        "the name of a column or array, or a list of two, of whole seconds and of nanoseconds",
        least=1,
    ),
]
TimeUnit = Annotated[
    units.Time | Literal["stamp"],
    Field(
        description=f"one of {', '.join(units.TIME)}, "
        "or stamp for dates of ISO 8601 such as 2026-11-21T20:00:00.125Z"
    ),
]
Decimal = Annotated[Literal[".", ","], Field(description="a point or a comma")]
Lines = Annotated[
    int, Field(strict=True, ge=0, le=10_000, description="a whole number from 0 to 10,000")
]


def _one_of(choices: Any) -> Any:
    return Field(description=f"one of {', '.join(get_args(choices))}")


class RecordingTable(Table):
    """Layout of recordings; all keys are optional.

    Attributes
    ----------
    time, force, torque, position, orientation
        Names of columns or arrays. `"log/ft[2]"` is the third column of the array `ft` in the group
        or struct `log`. Two names for the time are whole seconds and nanoseconds. Numbers instead
        of names of `position` and `orientation` hold for all rows, as on a linear stage.
    time_unit, force_unit, torque_unit, position_unit, angle_unit
        Their units; by default what the file's own attributes say, else SI.
    orientation_form
        What the orientation's numbers are.
    pose_time, pose_time_unit, pose_file, pose_decimal, pose_skip_lines
        Stamps of the poses if they have their own, and the file they are in, relative to the
        recording's folder; `{name}` in it stands for the recording's name without its suffix.
    delimiter, decimal, skip_lines, encoding
        For text; by default the delimiter is inferred from the header line. A pose file's decimal
        sign and lines to skip default to those of the recording.
    wrench_topic, pose_topic, fixed_frame, sensor_frame, stamps
        For bags: topics, or frames of /tf; stamps from the message headers, or the log times.
    time_offset
        Added to the stamps of the poses to map them to the clock of the wrench: a pose stamped t
        belongs to the wrench stamped t + time_offset [s]; "estimate" finds it from the data.
    largest_offset
        Bound on an estimated offset [s].
    longest_gap
        Longest time between two poses over which they are interpolated [s].
    """

    time: TimeNames = ("time",)
    time_unit: TimeUnit | None = None
    force: Names3 = ("fx", "fy", "fz")
    force_unit: Annotated[units.Force, _one_of(units.Force)] | None = None
    torque: Names3 = ("tx", "ty", "tz")
    torque_unit: Annotated[units.Torque, _one_of(units.Torque)] | None = None
    position: Positions = ("px", "py", "pz")
    position_unit: Annotated[units.Length, _one_of(units.Length)] | None = None
    orientation: Orientations = ("qx", "qy", "qz", "qw")
    orientation_form: Annotated[
        Literal["xyzw", "wxyz", "rotation_vector", "roll_pitch_yaw"],
        Field(
            description="xyzw or wxyz (quaternions), rotation_vector, "
            "or roll_pitch_yaw (about the fixed axes x, then y, then z)"
        ),
    ] = "xyzw"
    angle_unit: Annotated[units.Angle, _one_of(units.Angle)] | None = None
    pose_time: TimeNames | None = None
    pose_time_unit: TimeUnit | None = None
    pose_file: Name | None = None
    pose_decimal: Decimal | None = None
    pose_skip_lines: Lines | None = None
    delimiter: (
        Annotated[
            Literal[",", ";", "\t", " ", "|"],
            Field(description="a comma, semicolon, tab, space or bar"),
        ]
        | None
    ) = None
    decimal: Decimal = "."
    skip_lines: Lines = 0
    encoding: Annotated[
        Literal["utf-8", "utf-16", "latin-1", "cp1252"],
        Field(description="utf-8, utf-16, latin-1 or cp1252"),
    ] = "utf-8"
    wrench_topic: Name | None = None
    pose_topic: Name | None = None
    fixed_frame: Name | None = None
    sensor_frame: Name | None = None
    stamps: Annotated[Literal["header", "log"], Field(description="header or log")] = "header"
    time_offset: Annotated[
        Finite | Literal["estimate"],
        IN_ONE,
        Field(description="a finite number of seconds, or 'estimate'"),
    ] = 0.0
    largest_offset: Positive = 1.0
    longest_gap: Positive = 0.2

    @property
    def of_poses(self) -> "RecordingTable":
        """Layout of poses that have their own stamps or file."""
        names = ("time", "time_unit", "decimal", "skip_lines")
        given = {name: getattr(self, f"pose_{name}") for name in names}
        own = {name: value for name, value in given.items() if value is not None}
        return self.model_copy(update=own)
