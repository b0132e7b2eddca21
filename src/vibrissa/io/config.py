"""The parts that setups and cases are made of, as TOML tables: names, types and what is allowed."""

import tomllib
from pathlib import Path
from re import split
from typing import Annotated, Literal, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from vibrissa.io.errors import InputError, readable
from vibrissa.rod import Rod

Positive = Annotated[
    float, Field(strict=True, gt=0, allow_inf_nan=False, description="a number greater than 0")
]
NotNegative = Annotated[
    float, Field(strict=True, ge=0, allow_inf_nan=False, description="a number of at least 0")
]
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False, description="a finite number")]
Vector = Annotated[tuple[Finite, Finite, Finite], Field(description="three finite numbers")]
Quaternion = Annotated[
    tuple[Finite, Finite, Finite, Finite],
    Field(description="a quaternion x, y, z, w of non-zero norm"),
]

NO_TURN = (0.0, 0.0, 0.0, 1.0)
ORIGIN = (0.0, 0.0, 0.0)
_LONGEST_VALUE = 80
_LARGEST_FILE = 16 * 2**20
_MOST_POINTS = 200


class Table(BaseModel):
    """A TOML table: unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)


class CylinderRod(Table):
    """A wire of circular section, SI units."""

    kind: Literal["cylinder"]
    length: Positive
    radius: Positive
    youngs_modulus: Positive
    density: Positive | None = None
    yield_strain: Positive | None = None

    def build(self) -> Rod:
        """Return the rod."""
        return Rod.cylinder(
            length=self.length,
            radius=self.radius,
            youngs_modulus=self.youngs_modulus,
            density=self.density,
            yield_strain=self.yield_strain,
        )


class UniformRod(Table):
    """A rod by its stiffness, SI units."""

    kind: Literal["uniform"]
    length: Positive
    bending_stiffness: Positive
    radius: Positive | None = None
    linear_density: Positive | None = None
    yield_strain: Positive | None = None

    def build(self) -> Rod:
        """Return the rod."""
        return Rod(
            self.length, self.bending_stiffness, self.radius, self.linear_density, self.yield_strain
        )


class UnitRod(Table):
    """The model's units, L = EI = 1."""

    kind: Literal["unit"]

    def build(self) -> Rod:
        """Return the rod."""
        return Rod.unit()


RodTable = Annotated[
    CylinderRod | UniformRod | UnitRod,
    Field(discriminator="kind", description="cylinder, uniform or unit"),
]


Model = TypeVar("Model", bound=Table)


def load_table(path: Path, model: type[Model]) -> Model:
    """Read a TOML file as a model.

    Raises
    ------
    InputError
        If the file cannot be read, is not TOML, or a key is missing, unknown or out of range: one
        line with the first finding.
    """
    readable(path)
    size = path.stat().st_size
    if size > _LARGEST_FILE:
        raise InputError(f"{path}: {size} bytes; allowed is TOML of at most {_LARGEST_FILE} bytes")
    try:
        text = path.read_text(encoding="utf-8")
        _check_keys(path, text)
        content = tomllib.loads(text)
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: not valid TOML ({error}); allowed is a TOML file in UTF-8"
        ) from error
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{path}: {_one_line(error, model)}") from error


def _check_keys(path: Path, text: str) -> None:
    """The parser's time and memory go with the square of a dotted key's length."""
    stretches = (
        part
        for line in text.splitlines()
        if not line.lstrip().startswith("#")
        for part in split(r"[,=\[\]{}]", line)
    )
    most = max((part.count(".") for part in stretches), default=0)
    if most > _MOST_POINTS:
        raise InputError(
            f"{path}: {most} points in a row of names; allowed are at most {_MOST_POINTS}"
        )


def _one_line(error: ValidationError, model: type[Table]) -> str:
    findings = error.errors(include_url=False)
    first = findings[0]
    where, allowed = _place(first["loc"], model)
    more = f" (and {len(findings) - 1} more)" if len(findings) > 1 else ""
    match first["type"]:
        case "extra_forbidden":
            return f"{where}: unknown key; allowed are {allowed}{more}"
        case "missing":
            return f"{where}: missing; allowed is {allowed}{more}"
        case "union_tag_not_found":
            return f"{where}.kind: missing; allowed is {allowed}{more}"
        case "union_tag_invalid":
            return f"{where}.kind = {first['ctx']['tag']!r}: allowed is {allowed}{more}"
        case _:
            value = _shown(first.get("input"))
            return f"{where} = {value if len(value) < _LONGEST_VALUE else value[:_LONGEST_VALUE] + '…'}: allowed is {allowed}{more}"


def _shown(value: object) -> str:
    try:
        return repr(value)
    except (ValueError, RecursionError):
        # Python writes no number of more than 4300 digits, and nothing that is nested too deeply.
        return "a value too long to be written"


def _place(location: tuple[int | str, ...], model: type[Table]) -> tuple[str, str]:
    """Name of a place in the file, and what the schema allows there."""
    names: list[str] = []
    here, choices, field = model, [model], None
    for part in location:
        if isinstance(part, int):
            names[-1] += f"[{part}]"
            continue
        tagged = [table for table in choices if part in _tags(table)]
        if part in here.model_fields:
            names.append(part)
            field = here.model_fields[part]
            choices = _tables_in(field.annotation) or choices
            here = choices[0] if len(choices) == 1 else here
        elif tagged:
            # The location names which table of a union was taken; that is no key of the file.
            here, choices = tagged[0], tagged
        else:
            names.append(part)
            return ".".join(names), ", ".join(here.model_fields)
    return ".".join(names), _described(field, of_an_item=isinstance(location[-1], int))


def _tables_in(annotation: object) -> list[type[Table]]:
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return [annotation]
    return [table for part in get_args(annotation) for table in _tables_in(part)]


def _tags(table: type[Table]) -> tuple[str, ...]:
    return get_args(table.model_fields["kind"].annotation) if "kind" in table.model_fields else ()


def _described(field: FieldInfo | None, *, of_an_item: bool) -> str:
    """What a field's own schema says it allows; of an item of a list, and where need be, that of
    the type inside it.
    """
    if field is None:
        return "a TOML table"
    if field.description and not of_an_item:
        return field.description
    nested = [
        part.description
        for inner in get_args(field.annotation)
        for part in get_args(inner)
        if getattr(part, "description", None)
    ]
    if nested:
        return str(nested[0])
    if field.description:
        return field.description
    tables = _tables_in(field.annotation)
    if tables:
        fields = tables[0].model_fields
        return "a table with " + ", ".join(
            [name for name, inner in fields.items() if inner.is_required()] or fields
        )
    return " or ".join(map(repr, get_args(field.annotation))) or str(field.annotation)
