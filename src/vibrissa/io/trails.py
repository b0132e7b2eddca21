"""Motions of the clamp as TOML tables [[trail]]."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from vibrissa.io.config import NO_TURN, Finite, Quaternion, Table, Vector
from vibrissa.trail import Trail

MOST_POSITIONS = 10_000_000
Count = Annotated[
    int,
    Field(
        strict=True,
        ge=1,
        le=10_000_000,
        description="a whole number of at least 1, and at most 10,000,000",
    ),
]
Quaternions = Annotated[
    tuple[Quaternion, ...],
    Field(
        min_length=1, description="a list of one quaternion x, y, z, w, or one for each position"
    ),
]


class LineTable(Table):
    """Equally spaced positions on a line."""

    kind: Literal["line"]
    start: Vector
    stop: Vector
    count: Count
    axis: Vector = (0.0, 0.0, 1.0)

    def build(self) -> Trail:
        """Return the trail."""
        return Trail.line(start=self.start, stop=self.stop, count=self.count, axis=self.axis)


class RasterTable(Table):
    """Parallel lines, each moved on by `step`."""

    kind: Literal["raster"]
    start: Vector
    stop: Vector
    count: Count
    step: Vector
    trails: Count
    axis: Vector = (0.0, 0.0, 1.0)

    def build(self) -> Trail:
        """Return the trails."""
        return Trail.raster(
            start=self.start,
            stop=self.stop,
            count=self.count,
            step=self.step,
            trails=self.trails,
            axis=self.axis,
        )


class PosesTable(Table):
    """Positions, and one orientation for all or one each."""

    kind: Literal["poses"]
    position: Annotated[
        tuple[Vector, ...],
        Field(min_length=1, description="a list of at least one position of three finite numbers"),
    ]
    orientation: Quaternions = (NO_TURN,)

    def build(self) -> Trail:
        """Return the trail."""
        return Trail(
            self.position, self.orientation[0] if len(self.orientation) == 1 else self.orientation
        )


class ArcTable(Table):
    """Positions on a circular arc."""

    kind: Literal["arc"]
    center: Vector
    axis: Vector
    start: Vector
    angle: Finite
    count: Count
    orientation: Quaternion | None = None
    rod_axis: Vector | None = None
    turning: Annotated[bool, Field(strict=True, description="true or false")] = False

    def build(self) -> Trail:
        """Return the trail."""
        return Trail.arc(
            center=self.center,
            axis=self.axis,
            start=self.start,
            angle=self.angle,
            count=self.count,
            orientation=self.orientation,
            rod_axis=self.rod_axis,
            turning=self.turning,
        )


class WhiskTable(Table):
    """A clamp that turns about a pivot axis."""

    kind: Literal["whisk"]
    pivot: Vector
    axis: Vector
    position: Vector
    start_angle: Finite
    stop_angle: Finite
    count: Count
    orientation: Quaternion | None = None
    rod_axis: Vector | None = None

    def build(self) -> Trail:
        """Return the trail."""
        return Trail.whisk(
            pivot=self.pivot,
            axis=self.axis,
            position=self.position,
            start_angle=self.start_angle,
            stop_angle=self.stop_angle,
            count=self.count,
            orientation=self.orientation,
            rod_axis=self.rod_axis,
        )


class SplineTable(Table):
    """A smooth curve through way-points."""

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

    def build(self) -> Trail:
        """Return the trail."""
        turns = (
            self.orientations[0]
            if self.orientations is not None and len(self.orientations) == 1
            else self.orientations
        )
        return Trail.spline(self.points, self.count, orientations=turns, rod_axis=self.rod_axis)


class CsvTable(Table):
    """Poses from a file."""

    kind: Literal["csv"]
    path: Annotated[
        str,
        StringConstraints(strict=True, min_length=1),
        Field(description="the path of a CSV file, seen from the case's folder"),
    ]

    def build(self, folder: Path) -> Trail:
        """Return the trail; a path that is not absolute starts at `folder`."""
        return Trail.from_csv(folder / self.path)


TrailTable = Annotated[
    LineTable | RasterTable | PosesTable | ArcTable | WhiskTable | SplineTable | CsvTable,
    Field(discriminator="kind", description="line, raster, poses, arc, whisk, spline or csv"),
]


def check_count(tables: list[TrailTable]) -> None:
    """Raise ValueError if trails hold more positions than memory should be asked for."""
    count = sum(
        table.count * (table.trails if isinstance(table, RasterTable) else 1)
        for table in tables
        if not isinstance(table, PosesTable | CsvTable)
    )
    if count > MOST_POSITIONS:
        raise ValueError(f"trail: {count} positions in all; allowed are at most {MOST_POSITIONS}")


def built(table: TrailTable, folder: Path) -> Trail:
    """Trail of a table in a file of this folder; raise ValueError as the trail's own constructor
    does.
    """
    return table.build(folder) if isinstance(table, CsvTable) else table.build()
