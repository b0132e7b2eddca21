"""Rods as TOML tables: dimensions and material, and tables for rest shape, loads, support and
temperature.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, create_model

from vibrissa.io.config import (
    IN_ONE,
    Finite,
    NotNegative,
    Positive,
    Site,
    Table,
    Vector,
    number,
    one_of,
    several,
    table_of,
)
from vibrissa.mechanics.models import check_thick
from vibrissa.rod import Loads, RestShape, Rod, Support, Thermal


def _column(of: Any, description: str, least: int = 2) -> Any:
    return Annotated[tuple[of, ...], Field(min_length=least, description=description)]


_NUMBERS = _column(Finite, "a list of at least two finite numbers")
_POSITIVES = _column(NotNegative, "a list of at least two numbers of at least 0")
_VECTORS = _column(Vector, "a list of at least two rows of three finite numbers")
_SIX = Annotated[tuple[Finite, ...], several(6, "six finite numbers")]

_RESTS: dict[str, Callable[..., Any]] = {
    "arc": RestShape.arc,
    "polynomial": RestShape.polynomial,
    "parabola": RestShape.parabola,
    "points": RestShape.from_points,
    "components": RestShape.from_components,
}
_REST = {
    "radius": Positive,
    "roll": Finite,
    "coefficients": _column(Finite, "a list of at least one finite number", 1),
    "a": Finite,
    "points": _VECTORS,
    "arc_length": _NUMBERS,
    "curvature": _VECTORS,
}
RestTable = one_of(table_of(noun, _REST, kind) for kind, noun in _RESTS.items())

_STIFFNESSES = Annotated[tuple[Positive, ...], several(3, "three numbers greater than 0")]
SupportTable = one_of(
    (
        table_of(Support.rigid, {}, "rigid"),
        table_of(Support.pivot, {"stiffness": _STIFFNESSES}, "pivot"),
        table_of(
            Support.compliant,
            {
                "stiffness": Annotated[
                    tuple[_SIX, ...], several(6, "six rows of six finite numbers")
                ]
            },
            "compliant",
        ),
    )
)
LoadsTable = table_of(
    Loads, {"gravity": Vector, "wind": Vector, "fluid_density": Positive, "viscosity": Positive}
)
ThermalTable = table_of(Thermal, dict.fromkeys(("modulus_slope", "expansion", "reference"), Finite))


class DescribedTable(Table):
    """A rod with what any may have."""

    def build(self, site: Site) -> Rod:
        """Return the rod, with all that at its temperature."""
        given = self.arguments(site)
        own = {name: given.pop(name) for name in given.keys() - _DESCRIBED.keys()}
        rod: Rod = type(self).noun(**own)
        if "loads" in given:
            rod = rod.loaded(given["loads"])
        if "support" in given:
            rod = rod.on(given["support"])
        if "rest" in given:
            rod = rod.curved(given["rest"])
        rod = rod.at(given["temperature"]) if "temperature" in given else rod
        check_thick(rod)
        return rod


_DESCRIBED: dict[str, Any] = {
    "rest": (RestTable | None, None),
    "loads": (LoadsTable | None, None),
    "support": (SupportTable | None, None),
    "temperature": (Finite | None, None),  # of use [°C]
}
_POISSON = Annotated[
    float, number("a number above -1 and at most 0.5", gt=-1, le=0.5, allow_inf_nan=False)
]
_ROD = {
    **dict.fromkeys(
        (
            "length",
            "radius",
            "base_radius",
            "youngs_modulus",
            "bending_stiffness",
            "density",
            "linear_density",
            "yield_strain",
        ),
        Positive,
    ),
    **dict.fromkeys(("tip_radius", "inner_radius"), NotNegative),
    "poisson_ratio": _POISSON,
    "thermal": ThermalTable,
}
_COLUMNS = {
    "arc_length": _POSITIVES,
    **dict.fromkeys(
        ("radius", "bending_stiffness", "torsional_stiffness", "linear_density"), _POSITIVES
    ),
    "inner_radius": Annotated[
        NotNegative | _POSITIVES,
        IN_ONE,
        Field(description="a number of at least 0, or a list of them"),
    ],
}
# Wires of circular section, any rod by a table, one of given stiffness (SI), and the model's units.
_RODS: dict[str, Callable[..., Any]] = {
    "cylinder": Rod.cylinder,
    "tapered": Rod.tapered,
    "table": Rod.from_table,
    "uniform": Rod,
    "unit": Rod.unit,
}


def _table(kind: str, noun: Callable[..., Any]) -> Any:
    types = _ROD | (_COLUMNS if kind == "table" else {})
    own = table_of(noun, types, kind, DescribedTable)
    described = dict(_DESCRIBED)
    if "thermal" not in own.model_fields:
        described.pop("temperature")
    return create_model(kind, __base__=own, **described)


RodTable = one_of(_table(kind, noun) for kind, noun in _RODS.items())


def rod_of(table: dict[str, Any]) -> Rod:
    """The rod that a table [rod] of a file that was read before describes."""
    rod: Rod = TypeAdapter(RodTable).validate_python(table).build(Site(Path()))
    return rod
