"""Motions of the clamp as TOML tables [[trail]]."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from vibrissa.io.config import Boolean, Finite, Quaternion, Table, Vector, number
from vibrissa.trail import Trail

Count = Annotated[int, number("a whole number of at least 1", ge=1)]
Quaternions = Annotated[
    tuple[Quaternion, ...],
    Field(
        min_length=1, description="a list of one quaternion x, y, z, w, or one for each position"
    ),
]


class MotionTable(Table):
    """Where the clamp goes; one orientation in a list holds for all positions."""

    def arguments(self, folder: Path) -> dict[str, Any]:
        """Keys of the table, a single orientation out of its list."""
        given = super().arguments(folder)
        for name in given.keys() & {"orientation", "orientations"}:
            given[name] = given[name][0] if len(given[name]) == 1 else given[name]
        return given


class LineTable(MotionTable):
    """Equally spaced positions on a line."""

    noun = Trail.line
    kind: Literal["line"]
    start: Vector
    stop: Vector
    count: Count
    axis: Vector | None = None


class RasterTable(MotionTable):
    """Parallel lines, each moved on by `step`."""

    noun = Trail.raster
    kind: Literal["raster"]
    start: Vector
    stop: Vector
    count: Count
    axis: Vector | None = None
    step: Vector
    trails: Count


class PosesTable(MotionTable):
    """Positions, and one orientation for all or one each."""

    noun = Trail
    kind: Literal["poses"]
    position: Annotated[
        tuple[Vector, ...],
        Field(min_length=1, description="a list of at least one position of three finite numbers"),
    ]
    orientation: Quaternions | None = None


class ArcTable(MotionTable):
    """Positions on a circular arc."""

    noun = Trail.arc
    kind: Literal["arc"]
    center: Vector
    axis: Vector
    start: Vector
    angle: Finite
    count: Count
    orientation: Quaternion | None = None
    rod_axis: Vector | None = None
    turning: Boolean = False


class WhiskTable(MotionTable):
    """A clamp that turns about a pivot axis."""

    noun = Trail.whisk
    kind: Literal["whisk"]
    pivot: Vector
    axis: Vector
    position: Vector
    start_angle: Finite
    stop_angle: Finite
    count: Count
    orientation: Quaternion | None = None
    rod_axis: Vector | None = None


class SplineTable(MotionTable):
    """A smooth curve through way-points."""

    noun = Trail.spline
    kind: Literal["spline"]
    points: Annotated[
        tuple[Vector, ...],
        Field(
            min_length=2, description="a list of at least two way-points of three finite numbers"
        ),
    ]
    count: Count
    orientations: Quaternions | None = None
    rod_axis: Vector | None = None


class CsvTable(MotionTable):
    """Poses from a file."""

    noun = Trail.from_csv
    kind: Literal["csv"]
    path: Annotated[Path, Field(description="the path of a CSV file, seen from the case's folder")]


TrailTable = Annotated[
    LineTable | RasterTable | PosesTable | ArcTable | WhiskTable | SplineTable | CsvTable,
    Field(discriminator="kind", description="line, raster, poses, arc, whisk, spline or csv"),
]
