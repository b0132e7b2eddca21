"""One simulation: rod, object and trails (`case.toml`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, cast

from pydantic import Field, model_validator

from vibrissa.io.config import Boolean, NotNegative, RodTable, Table, load
from vibrissa.io.objects import ObjectTable
from vibrissa.io.trails import TrailTable
from vibrissa.rod import Rod
from vibrissa.surfaces import Surface
from vibrissa.trail import Trail

MOST_POSITIONS = 10_000_000  # what `scan` can hold in some GB of memory


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
    finite_radius: Boolean = False


class CaseFile(Table):
    """The whole file."""

    rod: RodTable  # type: ignore[valid-type]
    object: ObjectTable  # type: ignore[valid-type]
    contact: ContactTable = ContactTable()
    trail: Annotated[
        list[TrailTable],  # type: ignore[valid-type]
        Field(min_length=1, description="at least one table [[trail]]"),
    ]

    @model_validator(mode="after")
    def _fits(self) -> "CaseFile":
        if self.contact.finite_radius and getattr(self.rod, "radius", None) is None:
            raise ValueError(
                "contact.finite_radius = true: rod.radius is missing; "
                "allowed is a number greater than 0"
            )
        count = sum(
            getattr(trail, "count", 0) * getattr(trail, "trails", 1) for trail in self.trail
        )
        if count > MOST_POSITIONS:
            raise ValueError(
                f"trail.count: {count} positions in all; allowed are at most {MOST_POSITIONS}"
            )
        return self

    def build(self, folder: Path) -> Case:
        """Return the case; several trails become one of several sweeps."""
        given = self.arguments(folder)
        first, *others = given["trail"]
        return Case(
            given["rod"],
            given["object"],
            Trail.stack([first, *others]) if others else first,
            self.contact.friction,
            self.contact.finite_radius,
        )


def load_case(path: str | Path) -> Case:
    """Read a case from TOML: tables [rod], [object], one or more [[trail]] of equal length, and
    [contact] if there is friction or a finite radius.

    Raises
    ------
    InputError
        If the file cannot be read, a key is unknown, missing or out of range, or the trails differ
        in length or hold more than 10,000,000 positions.
    """
    return cast(Case, load(path, CaseFile))
