"""One simulation: rod, object and trails (`case.toml`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from vibrissa.io.config import NotNegative, Quaternion, RodTable, Table, Vector, load_table
from vibrissa.io.errors import InputError
from vibrissa.io.objects import ObjectTable
from vibrissa.rod import Rod
from vibrissa.surfaces import Surface
from vibrissa.trail import Trail

Count = Annotated[int, Field(strict=True, ge=1, le=10_000_000, description="a whole number of at least 1, and at most 10,000,000")]


@dataclass(frozen=True)
class Case:
    """What `scan` needs."""

    rod: Rod
    surface: Surface
    trail: Trail
    friction: float = 0.0
    finite_radius: bool = False


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
        return Trail.raster(start=self.start, stop=self.stop, count=self.count, step=self.step, trails=self.trails, axis=self.axis)


class PosesTable(Table):
    """Positions, and one orientation for all or one each."""

    kind: Literal["poses"]
    position: Annotated[tuple[Vector, ...], Field(min_length=1, description="a list of at least one position of three finite numbers")]
    orientation: Annotated[
        tuple[Quaternion, ...], Field(min_length=1, description="a list of one quaternion x, y, z, w, or one for each position")
    ] = ((0.0, 0.0, 0.0, 1.0),)

    def build(self) -> Trail:
        """Return the trail."""
        return Trail(self.position, self.orientation[0] if len(self.orientation) == 1 else self.orientation)


TrailTable = Annotated[LineTable | RasterTable | PosesTable, Field(discriminator="kind", description="line, raster or poses")]


class ContactTable(Table):
    """Between rod and object."""

    friction: NotNegative = 0.0
    finite_radius: Annotated[bool, Field(strict=True, description="true or false")] = False


class CaseFile(Table):
    """The whole file."""

    rod: RodTable
    object: ObjectTable
    contact: ContactTable = ContactTable()
    trail: Annotated[list[TrailTable], Field(min_length=1, description="at least one table [[trail]]")]


def load_case(path: str | Path) -> Case:
    """Read a case from TOML: tables [rod], [object], one or more [[trail]] of equal length, and [contact] if there is friction or a finite radius.

    Raises
    ------
    InputError
        If the file cannot be read, a key is missing, unknown or out of range, or the trails differ in length.
    """
    file = Path(path)
    table = load_table(file, CaseFile)
    try:
        trails = [trail.build() for trail in table.trail]
        trail = trails[0] if len(trails) == 1 else Trail.stack(trails)
        return Case(table.rod.build(), table.object.build(), trail, table.contact.friction, table.contact.finite_radius)
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error
