"""What a recording's own names and numbers say about its layout: a first table [recording]."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from re import fullmatch
from typing import Any

import numpy as np

from vibrissa.files import InputError, reading, split, text_of
from vibrissa.io.recordings import formats, units
from vibrissa.io.recordings.formats import BAG, TEXT, kind_of
from vibrissa.io.recordings.names import QUANTITIES, Group, groups, part_of, unit_of
from vibrissa.io.recordings.table import constant
from vibrissa.io.recordings.text import DELIMITERS, LONGEST_PREAMBLE
from vibrissa.io.recordings.write import COLUMNS

POSE = ("position", "orientation")
_WIDE = (6, 7)
"""Columns of an array that holds a wrench or a pose."""
_ENCODINGS = ("utf-8", "cp1252")
_ROWS = 400
_SLOWEST = 5.0
"""Rows a second: no log of a wrench is slower; one of 5000 a second in ms looks like one in s."""
_MOST_FAST = 2e5
_LARGEST_ANGLE = 2 * np.pi
# What numbers may be in if nobody says so; the likeliest first.
_UNITS = {"force": ("N", "mN"), "torque": ("N m", "N mm"), "position": ("m", "mm")}


@dataclass(frozen=True, eq=False)
class Layout:
    """What is known of a recording's layout.

    Attributes
    ----------
    keys
        Keys of [recording] and their values.
    undecided
        Keys that names and numbers leave open, with the values they may have, likeliest first.
    several
        Quantities for which there are several sets of columns.
    names
        All columns of the file, and of the file of poses.
    """

    keys: dict[str, Any] = field(default_factory=dict)
    undecided: dict[str, tuple[Any, ...]] = field(default_factory=dict)
    several: dict[str, list[tuple[str, ...]]] = field(default_factory=dict)
    names: tuple[str, ...] = ()

    @property
    def missing(self) -> list[str]:
        """Quantities without columns; none for a bag, which has topics."""
        return [name for name in QUANTITIES if self.names and name not in self.keys]

    @property
    def unplaced(self) -> list[str]:
        """Columns that belong to no quantity."""
        placed = {name for quantity in QUANTITIES for name in self.keys.get(quantity, ())}
        return [name for name in self.names if name not in placed]

    def all_keys(self) -> Iterator[dict[str, Any]]:
        """The keys, with each combination of values for those that are undecided."""
        for values in product(*self.undecided.values()):
            yield self.keys | dict(zip(self.undecided, values, strict=True))

    def given(self, keys: Mapping[str, Any]) -> "Layout":
        """The layout with these keys in place of what was proposed or left open."""

        def others(old: Mapping[str, Any]) -> dict[str, Any]:
            return {key: value for key, value in old.items() if key not in keys}

        return replace(
            self,
            keys=self.keys | dict(keys),
            undecided=others(self.undecided),
            several=others(self.several),
        )


def proposed_layout(path: str | Path, keys: Mapping[str, Any]) -> Layout:
    """Layout of a recording, and of a file of poses next to it, by their names and numbers.

    Parameters
    ----------
    path
        A recording of any format that is read.
    keys
        What is known already: keys of [recording]. Names given here are looked up, not guessed.

    Raises
    ------
    InputError
        If a file cannot be read, or a text has no line of names, or a name twice.
    """
    file = Path(path)
    if kind_of(file) == BAG:
        return Layout(dict(keys))
    log = _read(file, keys)
    found = _proposed(log, keys, QUANTITIES)
    if [name.lower() for name in log.names] == list(COLUMNS):
        # The layout that is read without [recording] is in SI units.
        si = {"force_unit": "N", "torque_unit": "N m", "position_unit": "m"}
        found = found.given(si | {"time_unit": "s"})
    poses = _poses_beside(file, keys, log)
    if poses is not None:
        found = _with_poses(found, _proposed(poses, keys, ("time", *POSE)), poses, file)
    return found.given(keys)


@dataclass(frozen=True, eq=False)
class _Log:
    """Names of a file, and some of its numbers by name; text that is no number is kept."""

    file: Path
    names: tuple[str, ...]
    numbers: Mapping[str, Any]
    arrays: tuple[str, ...] = ()
    stated: Mapping[str, str | None] = field(default_factory=dict)
    keys: Mapping[str, Any] = field(default_factory=dict)

    @property
    def groups(self) -> dict[str, list[Group]]:
        """Sets of columns that may be each quantity."""
        return groups(self.names, self.arrays)


def _read(file: Path, keys: Mapping[str, Any]) -> _Log:
    kind = kind_of(file)
    return _text(file, keys) if kind == TEXT else _arrays(file, kind)


def _arrays(file: Path, kind: str) -> _Log:
    """Names of a binary file; wide arrays column by column."""
    held = formats.columns(file, kind, ())
    numbers: dict[str, Any] = {}
    stated: dict[str, str | None] = {}
    for name in held.names:
        try:
            one = formats.columns(file, kind, (name,))
        except InputError:  # not numbers: nothing that is looked for
            continue
        array = one.arrays[name]
        wide = array.ndim == 2 and array.shape[1] in _WIDE
        for column in range(array.shape[1]) if wide else (None,):
            own = name if column is None else f"{name}[{column}]"
            numbers[own] = array if column is None else array[:, column]
            stated[own] = one.units.get(name)
    arrays = tuple(name for name, held in numbers.items() if np.ndim(held) == 2)
    return _Log(file, tuple(numbers), numbers, arrays, stated)


def _text(file: Path, given: Mapping[str, Any]) -> _Log:
    """Names of a text file, and what it holds below them."""
    text, encoding = _decoded(file)
    lines = text.splitlines()
    above, delimiter, names = _header(file, lines, given)
    keys: dict[str, Any] = {} if encoding == "utf-8" else {"encoding": encoding}
    rows = [split(line, delimiter) for line in lines[above + 1 :] if line.strip()][: _ROWS + 1]
    cells = {
        name: [row[place] for row in rows if place < len(row)]
        for place, name in enumerate(names)
        if name
    }
    comma = delimiter != "," and any(
        fullmatch(r"-?\d+,\d+([eE][-+]?\d+)?", cell) for row in rows[:20] for cell in row
    )
    if comma:
        keys["decimal"] = ","
    below = {name: column[0] for name, column in cells.items() if column}
    is_units = any(map(units.is_unit, (cell.strip(" []()") for cell in below.values())))
    stated = {name: cell.strip(" []()") for name, cell in below.items()} if is_units else {}
    numbers = {name: column[bool(is_units) :] for name, column in cells.items()}
    if comma:
        numbers = {
            name: [cell.replace(",", ".") for cell in column] for name, column in numbers.items()
        }
    return _Log(file, tuple(name for name in names if name), numbers, (), stated, keys)


def _header(
    file: Path, lines: Sequence[str], given: Mapping[str, Any]
) -> tuple[int, str, list[str]]:
    """Index of the line of names, its delimiter and the names: those that give the most quantities,
    or columns of them; names that the user gives count.
    """
    wanted = {name for quantity in QUANTITIES for name in given.get(quantity, ())}
    best, header = (0, 0), (0, "", [""])
    for number, content in enumerate(lines[:LONGEST_PREAMBLE]):
        for delimiter in given.get("delimiter", DELIMITERS):
            with reading(file, "text"):
                names = [name.strip() for name in split(content.lstrip("#% \t"), delimiter)]
            found = [sets[0].names for sets in groups(names).values() if sets]
            found += [(name,) for name in wanted.intersection(names)]
            score = len(found), sum(map(len, found))
            if score > best:
                best, header = score, (number, delimiter, names)
    number, _, names = header
    if not best[0]:
        raise InputError(
            f"{file}: no line names a time, a force or a position; allowed are columns with names "
            "above the numbers, unknown ones by --layout KEY=NAMES"
        )
    for name in names:
        if names.count(name) > 1 and (name in wanted or part_of(name)):
            raise InputError(
                f"{file}, line {number + 1}: column {name!r} occurs {names.count(name)} times; "
                "allowed is once"
            )
    return header


def _decoded(file: Path) -> tuple[str, str]:
    """Content of a text file, and its encoding."""
    if file.read_bytes()[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return text_of(file, "utf-16"), "utf-16"
    try:
        return text_of(file), "utf-8"
    except InputError:
        return text_of(file, _ENCODINGS[1]), _ENCODINGS[1]


def _proposed(log: _Log, keys: Mapping[str, Any], wanted: tuple[str, ...]) -> Layout:
    """What the names of one file say, as far as it is not known already."""
    found, layout = log.groups, Layout(dict(log.keys), names=log.names)
    for quantity in wanted:
        options = found[quantity]
        if quantity in keys:
            names = tuple(keys[quantity])
            options = [
                next(
                    (one for one in options if one.names == names),
                    _named(quantity, names, log.names),
                )
            ]
        if len(options) > 1:
            layout.several[quantity] = [one.names for one in options]
        elif options and all(
            name in log.names or constant(name, log.names) is not None for name in options[0].names
        ):
            _add(layout, options[0], log)
    return layout


def _named(quantity: str, names: tuple[str, ...], held: tuple[str, ...]) -> Group:
    """Columns that the user names."""
    forms: tuple[str, ...] = ()
    if quantity == "orientation":
        forms = ("rotation_vector", "roll_pitch_yaw") if len(names) == 3 else ("xyzw", "wxyz")
        # Numbers are those of a setup.
        forms = ("xyzw",) if len(names) == 4 and constant(names[3], held) is not None else forms
    measured = next((name for name in names if constant(name, held) is None), "")
    return Group(quantity, names, forms, unit_of(measured, quantity))


def _add(layout: Layout, group: Group, log: _Log) -> None:
    """Put columns into a layout, with their form and unit."""
    layout.keys[group.quantity] = list(group.names)
    if group.quantity == "time":
        if len(group.names) == 1:
            _put(layout, "time_unit", _time_units(group, log))
        return
    if group.forms:
        _put(layout, "orientation_form", group.forms)
    is_angle = group.quantity == "orientation" and not {"xyzw", "wxyz"} & set(group.forms)
    if group.quantity in _UNITS or is_angle:
        kind = "angle" if is_angle else group.quantity
        stated = group.unit or units.known_or_none(
            log.stated.get(group.names[0]) or "", units.ALLOWED[kind]
        )
        options = (stated,) if stated else _UNITS.get(kind) or _angle_units(group, log)
        _put(layout, f"{kind}_unit", options)


def _put(layout: Layout, key: str, options: tuple[str, ...]) -> None:
    if len(options) == 1:
        layout.keys[key] = options[0]
    else:
        layout.undecided[key] = options


def _floats(log: _Log, name: str) -> np.ndarray:
    """Some of the numbers of a column; none if it holds text."""
    try:
        return np.asarray([cell for cell in log.numbers.get(name, ()) if cell != ""], float)
    except ValueError:
        return np.zeros(0)


def _angle_units(group: Group, log: _Log) -> tuple[str, ...]:
    """Degrees if the angles exceed a turn in radians, else either."""
    largest = max(np.abs(_floats(log, name)).max(initial=0.0) for name in group.names)
    return ("deg",) if largest > _LARGEST_ANGLE else ("rad", "deg")


def _time_units(group: Group, log: _Log) -> tuple[str, ...]:
    """The unit stated, or the coarsest in which there are more than a few rows a second."""
    name = group.names[0]
    stated = group.unit or units.known_or_none(log.stated.get(name) or "", units.TIME)
    if stated:
        return (stated,)
    stamps = _floats(log, name)
    if not len(stamps):
        return ("stamp",)
    steps = np.diff(stamps)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    return next(
        ((unit,) for unit in ("s", "ms", "us") if usual * units.factor(unit) < 1 / _SLOWEST),
        ("ns",),
    )


def _poses_beside(file: Path, keys: Mapping[str, Any], log: _Log) -> _Log | None:
    """A file of poses: the one named, or the only one whose name begins with the recording's."""
    if "pose_file" in keys:
        return _read(file.parent / keys["pose_file"].replace("{name}", file.stem), keys)
    if any(log.groups[quantity] for quantity in POSE) or set(POSE) & set(keys):
        return None
    beside = sorted(file.parent.glob(f"{file.stem}?*{file.suffix}"))
    fitting = []
    for other in beside:
        try:
            one = _read(other, keys)
        except InputError:
            continue
        if all(one.groups[quantity] for quantity in POSE):
            fitting.append(one)
    return fitting[0] if len(fitting) == 1 else None


def _with_poses(found: Layout, poses: Layout, log: _Log, file: Path) -> Layout:
    """A layout with that of the file of its poses, whose own keys begin with `pose_`."""
    keys, undecided = dict(found.keys), dict(found.undecided)
    for key, value in poses.keys.items():
        if key in {"time", "time_unit", "decimal"}:
            if keys.get(key) != value:
                keys[f"pose_{key}"] = value
        elif key != "encoding":
            keys[key] = value
    if "decimal" in found.keys and "decimal" not in poses.keys:
        keys["pose_decimal"] = "."
    named = log.file.name
    if log.file.parent == file.parent and named.startswith(file.stem):
        named = "{name}" + named.removeprefix(file.stem)
    keys["pose_file"] = named
    several = {**found.several, **{key: poses.several[key] for key in POSE if key in poses.several}}
    return Layout(keys, undecided | poses.undecided, several, (*found.names, *log.names))
