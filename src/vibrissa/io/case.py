"""One simulation: rod, object and trails (`case.toml`)."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from vibrissa.io.config import (
    Boolean,
    Finite,
    NotNegative,
    Quaternion,
    Site,
    Table,
    Vector,
    load,
    number,
    one_of,
    table_of,
)
from vibrissa.io.objects import ObjectTable
from vibrissa.io.rod import RodTable
from vibrissa.numerics.progress import Progress
from vibrissa.rod import Rod
from vibrissa.surfaces import Surface
from vibrissa.trail import Trail

Count = Annotated[int, number("a whole number of at least 1", ge=1)]


class MotionTable(Table):
    """Where the clamp goes; a list of one orientation holds for all positions."""

    def arguments(self, site: Site) -> dict[str, Any]:
        """Keys of the table, with a single orientation taken out of its list."""
        given = super().arguments(site)
        for name in given.keys() & {"orientation", "orientations"}:
            given[name] = given[name][0] if len(given[name]) == 1 else given[name]
        return given


def _several(of: Any, least: int, description: str) -> Any:
    return Annotated[tuple[of, ...], Field(min_length=least, description=description)]


_TURNS = _several(Quaternion, 1, "a list of one quaternion x, y, z, w, or one for each position")
_TYPES = {
    **dict.fromkeys(("start", "stop", "axis", "step", "center", "rod_axis", "pivot"), Vector),
    **dict.fromkeys(("count", "trails"), Count),
    **dict.fromkeys(("angle", "start_angle", "stop_angle"), Finite),
    "position": Vector,
    "orientation": Quaternion,
    "orientations": _TURNS,
    "turning": Boolean,
    "points": _several(Vector, 2, "a list of at least two way-points of three finite numbers"),
    "path": Annotated[
        Path, Field(description="the path of a CSV file, relative to the case's folder")
    ],
}
_POSES = {
    "position": _several(Vector, 1, "a list of at least one position of three finite numbers"),
    "orientation": _TURNS,
}
_KINDS: dict[str, Callable[..., Any]] = {
    "line": Trail.line,
    "raster": Trail.raster,
    "poses": Trail,
    "arc": Trail.arc,
    "whisk": Trail.whisk,
    "spline": Trail.spline,
    "csv": Trail.from_csv,
}
TrailTable = one_of(
    table_of(noun, _TYPES | (_POSES if kind == "poses" else {}), kind, MotionTable)
    for kind, noun in _KINDS.items()
)

MOST_POSITIONS = 10_000_000  # what `scan` can hold in a few GB of memory


@dataclass(frozen=True)
class Case:
    """The input of `scan`."""

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
        given = {"radius", "base_radius"} & self.rod.model_fields_set  # type: ignore[attr-defined]
        if self.contact.finite_radius and not given:
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

    def build(self, site: Site) -> Case:
        """Return the case; several trails are stacked into one."""
        given = self.arguments(site)
        first, *others = given["trail"]
        trail = Trail.stack([first, *others]) if others else first
        return Case(given["rod"], given["object"], trail, **self.contact.model_dump())


def load_case(path: str | Path, *, progress: Progress | None = None) -> Case:
    """Read a case from TOML: tables [rod] and [object], one or more [[trail]] of equal length, and
    [contact] if there is friction or a finite radius. `progress` is as for `Mesh`.

    Raises
    ------
    InputError
        If the file cannot be read, a key is unknown, missing or out of range, or the trails differ
        in length or hold more than 10,000,000 positions.
    """
    return load(path, CaseFile, progress)
