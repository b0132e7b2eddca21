"""TOML files as tables: the allowed values of each key, and one-line errors."""

import tomllib
from collections.abc import Callable, Iterable, Mapping, Set
from difflib import get_close_matches
from inspect import signature
from pathlib import Path
from reprlib import repr as shortened
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Union, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, WrapValidator, create_model
from pydantic_core import ErrorDetails

from vibrissa.files import InputError, readable
from vibrissa.numerics.progress import Progress


def number(description: str, **bounds: Any) -> Any:
    """Field of a number within pydantic's bounds; text and booleans are refused."""
    return Field(strict=True, description=description, **bounds)


def several(count: int, description: str, *, least: int | None = None) -> Any:
    """Field of a list of `count` entries, or of at least `least` and at most `count`."""
    return Field(min_length=least or count, max_length=count, description=description)


def _in_one(value: object, check: Callable[[object], object]) -> object:
    try:
        return check(value)
    except ValidationError:
        raise ValueError from None


IN_ONE = WrapValidator(_in_one)
"""For a union of types: a single error, showing the whole value, if no type fits."""

Positive = Annotated[float, number("a number greater than 0", gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, number("a number of at least 0", ge=0, allow_inf_nan=False)]
Finite = Annotated[float, number("a finite number", allow_inf_nan=False)]
Boolean = Annotated[bool, Field(strict=True, description="true or false")]
Vector = Annotated[tuple[Finite, ...], several(3, "three finite numbers")]
Lengths = Annotated[tuple[Positive, ...], several(3, "three numbers greater than 0")]
Quaternion = Annotated[tuple[Finite, ...], several(4, "a quaternion x, y, z, w of non-zero norm")]

NO_TURN = (0.0, 0.0, 0.0, 1.0)
ORIGIN = (0.0, 0.0, 0.0)
_SHOWN = 3  # findings listed in a line; the rest are only counted


class Site(NamedTuple):
    """Where tables are built: the folder of their file, and who wants to know how far that is."""

    folder: Path
    progress: Progress | None = None


class Table(BaseModel):
    """A TOML table: unknown keys are errors.

    Errors raised by the model's own validators begin with a key of this table; the table's name is
    put before it.

    Attributes
    ----------
    noun
        What the table describes, called with the keys given: all defaults are the noun's. A table
        without one is its own noun.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)
    noun: ClassVar[Any] = None

    def arguments(self, site: Site) -> dict[str, Any]:
        """Keys that the file gives, except `kind`: tables built, paths from the site's folder."""
        return {
            name: _built(getattr(self, name), site, name)
            for name in self.model_fields_set - {"kind"}
        }

    def build(self, site: Site) -> Any:
        """Return what the table describes, paths relative to the site's folder; raise ValueError
        as the noun's constructor does.
        """
        noun = type(self).noun
        return self if noun is None else noun(**self.arguments(site))


def _built(value: Any, site: Site, name: str) -> Any:
    """What a key of this name gives; errors begin with the key."""
    if isinstance(value, Table):
        try:
            return value.build(site)
        except InputError:
            raise
        except ValueError as error:
            text = str(error)
            raise ValueError(text if text.startswith(name) else f"{name}.{text}") from error
    if isinstance(value, list):
        return [_built(part, site, f"{name}[{at}]") for at, part in enumerate(value)]
    return site.folder / value if isinstance(value, Path) else value


def table_of(
    noun: Callable[..., Any], types: Mapping[str, Any], kind: str = "", base: type[Table] = Table
) -> Any:
    """Model of a table whose keys are the noun's arguments that appear in `types`, optional where
    the noun has a default. `kind`, if given, is the required value of the key `kind`.
    """
    fields: dict[str, Any] = {"kind": (Literal[kind], ...)} if kind else {}
    for name, argument in signature(noun).parameters.items():
        if name in types:
            needed = argument.default is argument.empty
            fields[name] = (types[name], ...) if needed else (types[name] | None, None)
    model = create_model(kind or noun.__name__, __base__=base, **fields)
    model.noun = noun
    return model


def one_of(tables: Iterable[type[Table]]) -> Any:
    """A choice of tables by the key `kind`."""
    choice = tuple(tables)
    *names, last = (get_args(table.model_fields["kind"].annotation)[0] for table in choice)
    description = f"{', '.join(names)} or {last}"
    return Annotated[Union[choice], Field(discriminator="kind", description=description)]  # noqa: UP007


def load(path: str | Path, model: type[Table], progress: Progress | None = None) -> Any:
    """Read a TOML file and return what its tables describe; `progress` is for meshes.

    Raises
    ------
    InputError
        If the file cannot be read or is not TOML, a key is unknown, missing or out of range, or the
        tables are inconsistent: one line with the first findings.
    """
    file = readable(Path(path))
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{file}: not valid TOML ({error}); allowed is a TOML file in UTF-8"
        ) from error
    try:
        return model.model_validate(content).build(Site(file.parent, progress))
    except ValidationError as error:
        raise InputError(f"{file}: {one_line(error, model)}") from error
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error


def one_line(error: ValidationError, model: type[Table]) -> str:
    """Unknown keys first, as they explain what is missing, then the others in order."""
    ranks = {"extra_forbidden": 0, "union_tag_not_found": 1, "missing": 1}
    errors = sorted(
        error.errors(include_url=False), key=lambda finding: ranks.get(finding["type"], 2)
    )
    schema = model.model_json_schema()
    # A list without its wrong entries is too short as well.
    within = (error["loc"] for error in errors if error["loc"])
    around = {place[:-1] for place in within if isinstance(place[-1], int)}
    errors = [error for error in errors if error["loc"] not in around]
    findings = list(dict.fromkeys(_finding(one, schema) for one in errors))
    more = len(findings) - _SHOWN
    return "; ".join(findings[:_SHOWN]) + (f" (and {more} more)" if more > 0 else "")


def _finding(error: ErrorDetails, schema: dict[str, Any]) -> str:
    place, allowed = _place(schema, error["loc"])
    match error["type"]:
        case "extra_forbidden":
            near = get_close_matches(str(error["loc"][-1]), allowed.split(", "), 1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            return f"{place}: unknown key; {hint}allowed are {allowed}"
        case "missing":
            return f"{place}: missing; allowed is {allowed}"
        case "union_tag_not_found":
            near = get_close_matches("kind", error["input"], 1)
            hint = f"{place}.{near[0]}: unknown key; did you mean 'kind'? " if near else ""
            return f"{hint}{place}.kind: missing; allowed is {allowed}"
        case "union_tag_invalid":
            return f"{place}.kind = {error['ctx']['tag']!r}: allowed is {allowed}"
        case "model_attributes_type":
            allowed = allowed if allowed.startswith("a ") else f"a table of kind {allowed}"
        case "value_error" if text := str(error["ctx"]["error"]):
            return f"{place}.{text}".removeprefix(".")
    return f"{place} = {shortened(error['input'])}: allowed is {allowed}"


def _place(schema: dict[str, Any], location: Iterable[int | str]) -> tuple[str, str]:
    """Name of a location in a file, and what is allowed there by the JSON schema of the file's
    tables; for an unknown key, the keys of its table.
    """
    place, node = "", schema
    for key in location:
        node = _resolved(schema, node)
        keys, kinds = node.get("properties", {}), node.get("discriminator", {}).get("mapping", {})
        if key in kinds:  # the kind of table that was chosen, not a key in the file
            node = {"$ref": kinds[key]}
            continue
        place += f"[{key}]" if isinstance(key, int) else f".{key}"
        if keys and key not in keys:
            return place.removeprefix("."), ", ".join(keys)
        node = keys.get(key) or node.get("items") or node.get("additionalProperties", {})
    inner = _resolved(schema, node)
    table = f"a table with {', '.join(inner.get('required', inner.get('properties', ())))}"
    described = _resolved(schema, node, until={"description"})
    allowed = table if "properties" in described else described.get("description", "a TOML table")
    return place.removeprefix("."), allowed


def _resolved(
    schema: dict[str, Any], node: dict[str, Any], until: Set[str] = frozenset()
) -> dict[str, Any]:
    """What a schema node refers to; for an optional value, the schema of the value."""
    while not until & node.keys() and ("$ref" in node or "anyOf" in node):
        name = node.get("$ref", "").rpartition("/")[2]
        node = schema["$defs"][name] if name else node["anyOf"][0]
    return node
