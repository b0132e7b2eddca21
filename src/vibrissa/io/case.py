"""One simulation: rod, object and trails (`case.toml`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from vibrissa.io import objects, trails
from vibrissa.io.config import NotNegative, RodTable, Table, load_table
from vibrissa.io.errors import InputError
from vibrissa.io.objects import ObjectTable
from vibrissa.io.trails import TrailTable
from vibrissa.rod import Rod
from vibrissa.surfaces import Surface
from vibrissa.trail import Trail


@dataclass(frozen=True)
class Case:
    """What `scan` needs."""

    rod: Rod
    surface: Surface
    trail: Trail
    friction: float = 0.0
    finite_radius: bool = False


class ContactTable(Table):
    """Between rod and object."""

    friction: NotNegative = 0.0
    finite_radius: Annotated[bool, Field(strict=True, description="true or false")] = False


class CaseFile(Table):
    """The whole file."""

    rod: RodTable
    object: ObjectTable
    contact: ContactTable = ContactTable()
    trail: Annotated[
        list[TrailTable], Field(min_length=1, description="at least one table [[trail]]")
    ]


def load_case(path: str | Path) -> Case:
    """Read a case from TOML: tables [rod], [object], one or more [[trail]] of equal length, and
    [contact] if there is friction or a finite radius.

    Raises
    ------
    InputError
        If the file cannot be read, a key is missing, unknown or out of range, or the trails differ
        in length or hold more than 10,000,000 positions.
    """
    file = Path(path)
    table = load_table(file, CaseFile)
    try:
        trails.check_count(table.trail)
        sweeps = [trails.built(trail, file.parent) for trail in table.trail]
        trail = sweeps[0] if len(sweeps) == 1 else Trail.stack(sweeps)
        rod = table.rod.build()
        if table.contact.finite_radius and rod.radius is None:
            raise ValueError(
                "contact.finite_radius = true: rod.radius is missing; allowed is a number greater than 0"
            )
        return Case(
            rod,
            objects.built(table.object, file.parent),
            trail,
            table.contact.friction,
            table.contact.finite_radius,
        )
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error
