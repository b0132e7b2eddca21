"""The parts that setups and cases are made of, as TOML tables: names, types and what is allowed."""

import tomllib
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vibrissa.io.errors import InputError, readable
from vibrissa.rod import Rod
from vibrissa.surfaces import Ellipsoid, EllipticCylinder, EllipticParaboloid, Plane, Sphere, Surface

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, description="a number greater than 0")]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, description="a number of at least 0")]
Finite = Annotated[float, Field(allow_inf_nan=False, description="a finite number")]
Vector = Annotated[tuple[Finite, Finite, Finite], Field(description="three finite numbers")]
Quaternion = Annotated[tuple[Finite, Finite, Finite, Finite], Field(description="a quaternion x, y, z, w of non-zero norm")]

NO_TURN = (0.0, 0.0, 0.0, 1.0)
ORIGIN = (0.0, 0.0, 0.0)


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
            length=self.length, radius=self.radius, youngs_modulus=self.youngs_modulus, density=self.density, yield_strain=self.yield_strain
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
        return Rod(self.length, self.bending_stiffness, self.radius, self.linear_density, self.yield_strain)


class UnitRod(Table):
    """The model's units, L = EI = 1."""

    kind: Literal["unit"]

    def build(self) -> Rod:
        """Return the rod."""
        return Rod.unit()


RodTable = Annotated[CylinderRod | UniformRod | UnitRod, Field(discriminator="kind", description="cylinder, uniform or unit")]


class PlacedTable(Table):
    """Rotation and translation, which any object may have."""

    rotation: Quaternion = NO_TURN
    translation: Vector = ORIGIN

    def placed(self, surface: Surface) -> Surface:
        """Return the surface where the table puts it."""
        return surface if (self.rotation, self.translation) == (NO_TURN, ORIGIN) else surface.placed(self.rotation, self.translation)


class ParaboloidTable(PlacedTable):
    """Solid z > a x² + b y² + h."""

    kind: Literal["elliptic_paraboloid"]
    a: Finite
    b: Finite
    h: Finite

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(EllipticParaboloid(self.a, self.b, self.h))


class SphereTable(PlacedTable):
    """A ball."""

    kind: Literal["sphere"]
    center: Vector
    radius: Positive

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(Sphere(self.center, self.radius))


class EllipsoidTable(PlacedTable):
    """An ellipsoid with its axes along x, y, z before it is turned."""

    kind: Literal["ellipsoid"]
    center: Vector
    semi_axes: tuple[Positive, Positive, Positive]

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(Ellipsoid(self.center, self.semi_axes))


class EllipticCylinderTable(PlacedTable):
    """A cylinder without ends along y before it is turned."""

    kind: Literal["elliptic_cylinder"]
    center: Vector
    semi_axes: tuple[Positive, Positive]

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(EllipticCylinder(self.center, self.semi_axes))


class PlaneTable(PlacedTable):
    """A half space."""

    kind: Literal["plane"]
    point: Vector
    normal: Vector

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(Plane(self.point, self.normal))


ObjectTable = Annotated[
    ParaboloidTable | SphereTable | EllipsoidTable | EllipticCylinderTable | PlaneTable,
    Field(discriminator="kind", description="elliptic_paraboloid, sphere, ellipsoid, elliptic_cylinder or plane"),
]

Model = TypeVar("Model", bound=Table)


def load_table(path: Path, model: type[Model]) -> Model:
    """Read a TOML file as a model.

    Raises
    ------
    InputError
        If the file cannot be read, is not TOML, or a key is missing, unknown or out of range: one line with the first finding.
    """
    readable(path)
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid TOML ({error}); allowed is a TOML file in UTF-8") from error
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{path}: {_one_line(error, model)}") from error


def _one_line(error: ValidationError, model: type[Table]) -> str:
    findings = error.errors(include_url=False)
    first = findings[0]
    tag = {part for table in _tables(model) for part in (table.model_fields["kind"].annotation.__args__ if "kind" in table.model_fields else ())}  # type: ignore[union-attr]
    where = ".".join(str(part) for part in first["loc"] if part not in tag)
    more = f" (and {len(findings) - 1} more)" if len(findings) > 1 else ""
    allowed = _allowed(first["loc"], model)
    match first["type"]:
        case "extra_forbidden":
            return f"{where}: unknown key; allowed are {allowed}{more}"
        case "missing" | "union_tag_not_found":
            name = f"{where}.kind" if first["type"] == "union_tag_not_found" else where
            return f"{name}: missing; allowed is {allowed}{more}"
        case _:
            value = first.get("input")
            return f"{where} = {value!r}: {first['msg'][:1].lower()}{first['msg'][1:]}; allowed is {allowed}{more}"


def _tables(model: type[Table]) -> list[type[Table]]:
    """All tables in a model, itself first."""
    found = [model]
    for field in model.model_fields.values():
        for table in _table_types(field.annotation):
            found += [part for part in _tables(table) if part not in found]
    return found


def _table_types(annotation: object) -> list[type[Table]]:
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return [annotation]
    return [table for part in getattr(annotation, "__args__", ()) for table in _table_types(part)]


def _allowed(location: tuple[int | str, ...], model: type[Table]) -> str:
    """What the schema says of the place where validation failed."""
    name = str(next((part for part in reversed(location) if isinstance(part, str)), ""))
    holders = [table for table in _tables(model) if name in table.model_fields]
    parents = _holder(location, model)
    if parents is not None and name not in parents.model_fields:
        return ", ".join(parents.model_fields)
    field = (parents if parents is not None and name in parents.model_fields else holders[0]).model_fields[name] if holders else None
    if field is None:
        return "what the documentation of the file says"
    if field.description:
        return field.description
    for part in field.metadata:
        if getattr(part, "description", None):
            return str(part.description)
    nested = [str(getattr(part, "description", "")) for inner in getattr(field.annotation, "__args__", ()) for part in getattr(inner, "__metadata__", ())]
    choices = getattr(field.annotation, "__args__", ())
    described = [text for text in nested if text]
    return described[0] if described else " or ".join(repr(choice) for choice in choices if not isinstance(choice, type)) or str(field.annotation)


def _holder(location: tuple[int | str, ...], model: type[Table]) -> type[Table] | None:
    """The table that holds the last key of a location."""
    here: list[type[Table]] = [model]
    for part in location[:-1]:
        if isinstance(part, int):
            continue
        named = [table for table in here if part in table.model_fields]
        if named:
            here = _table_types(named[0].model_fields[part].annotation) or here
        else:
            tagged = [table for table in here if "kind" in table.model_fields and part in getattr(table.model_fields["kind"].annotation, "__args__", ())]
            here = tagged or here
    return here[0] if len(here) == 1 or location else None
