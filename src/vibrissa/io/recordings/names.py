"""What the columns of a log are called: from a file's names to time, force, torque, position and
orientation.
"""

import unicodedata
from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from re import compile as pattern
from re import finditer, sub
from typing import NamedTuple

from vibrissa.io.recordings import units

XYZ, QUATERNION = ("x", "y", "z"), ("x", "y", "z", "w")
QUANTITIES = ("time", "force", "torque", "position", "orientation")
_WORDS = {
    "force": "f force forces kraft kraefte fuerza forza effort ft wrench",
    "torque": "t m tau tq trq torque torques moment moments drehmoment couple par coppia mom",
    "position": "p pos position posicion posizione lage ort translation pose tcp tool flange robot "
    "ee effector arm stage gantry actual sensor",
    "orientation": "q quat quaternion orientation ori rot rotation rotvec rv r euler rpy",
    "time": "t time zeit temps tiempo tempo timestamp timestamps stamp clock elapsed seconds",
}
_MEANING = {
    quantity: frozenset(words.split()) for quantity, words in reversed(list(_WORDS.items()))
}
_KNOWN = frozenset().union(*_MEANING.values())
_OTHER_WORDS = (
    "target cmd command commanded desired setpoint soll std sigma vel velocity speed acc accel "
    "acceleration gyro omega error joint status sequence"
)
_OTHERS = frozenset(_OTHER_WORDS.split())
"""Of columns that hold something else of the same name."""
_ANGLES = (("roll", "pitch", "yaw"), ("w", "p", "r"), ("c", "b", "a"))
"""About the fixed axes x, y and z: also as robots of FANUC and of KUKA name them."""
_NUMBERS = pattern(r"(?:[-+.,;:|\d\s]|[eE](?=[-+\d]))*")
"""Cells of the thousand rows that are no header, also where they are split at the wrong places."""
_WHOLE = (("sec", "secs"), ("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"))


class Part(NamedTuple):
    """A column: what it is part of, which part, and its unit if the name states one."""

    name: str
    quantity: str
    template: str
    component: str
    unit: str | None


class Group(NamedTuple):
    """Columns that give one quantity, the forms that their numbers may have, and their unit."""

    quantity: str
    names: tuple[str, ...]
    forms: tuple[str, ...] = ()
    unit: str | None = None


def groups(names: Sequence[str], arrays: Collection[str] = ()) -> dict[str, list[Group]]:
    """All sets of columns that may be each quantity, by their names; none if nothing fits.
    `arrays` are the names that hold several columns each.
    """
    names = [name for name in names if not _NUMBERS.fullmatch(name)]
    together = defaultdict[tuple[str, str], dict[str, Part]](dict)
    for part in filter(None, map(part_of, names)):
        if part.component or part.quantity == "time" or part.name in arrays:
            together[part.quantity, part.template].setdefault(part.component, part)
    found: dict[str, list[Group]] = {quantity: [] for quantity in QUANTITIES}
    for (quantity, _), parts in together.items():
        for group in _of(quantity, parts):
            found[group.quantity].append(group)
    found["orientation"] += _angles(names)
    found["time"] = _whole_and_fraction(names) or found["time"]
    return found


def unit_of(name: str, quantity: str) -> str | None:
    """Unit in brackets at the end of a name, or behind its last separator: `t_ms` or `t/ms`."""
    allowed = units.ALLOWED["angle" if quantity == "orientation" else quantity]
    _, last = _cut(name)
    return units.in_brackets(name, allowed) or (
        units.known_or_none(last, allowed) if last else None
    )


def _cut(name: str) -> tuple[str, str]:
    """A name before its last separator, and what may be a unit behind it."""
    plain = sub(r"[\[(].*", "", name)
    first, _, last = sub(r"[ /]", "_", plain).rstrip("_").rpartition("_")
    return first, last if first and len(last) < 6 else ""


def part_of(name: str) -> Part | None:
    """What a column is, None if its name says nothing."""
    tokens = _tokens(name)
    stem, last = _cut(name)
    # The m of `x_m` is a unit, that of `log/m` a moment.
    if units.is_unit(last) and any(_components(_tokens(stem))):
        tokens = _tokens(stem)
    words = [token for token, _ in tokens]
    if _OTHERS.intersection(words):
        return None
    for component, place, joined in _components(tokens):
        told = [joined] if joined else words[::-1]
        quantity = next((kind for word in told for kind in _kinds(word, component)), None)
        if quantity is None and component in XYZ:
            quantity = "position" if words == [component] else _told_by_unit(name)
        if quantity is not None:
            template = name[: place[0]] + "\0" + name[place[1] :]
            return Part(name, quantity, template, component, unit_of(name, quantity))
    quantity = next((kind for word in words[::-1] for kind in _kinds(word, "")), None)
    # A name without a component is one array, or the time.
    return None if quantity is None else Part(name, quantity, name, "", unit_of(name, quantity))


def _told_by_unit(name: str) -> str | None:
    """The vector that is in the unit of this name, if it states one: `UR5 X [mm]` is a position."""
    vectors = ("force", "torque", "position")
    return next((quantity for quantity in vectors if unit_of(name, quantity)), None)


def _tokens(name: str) -> list[tuple[str, tuple[int, int]]]:
    """Words and numbers of a name in lower case, with their places; without its unit."""
    plain = "".join(unicodedata.normalize("NFKD", one)[0] for one in name)
    if any(units.in_brackets(name, allowed) for allowed in units.ALLOWED.values()):
        plain = sub(r"[\[(][^\[(]*$", "", plain)
    # A word ends where a capital follows a small letter, as in forceX.
    found = finditer(r"[A-Z]*[a-z]+|[A-Z]+|\d+", plain)
    return [(one[0].lower(), one.span()) for one in found]


def _components(
    tokens: Sequence[tuple[str, tuple[int, int]]],
) -> Iterable[tuple[str, tuple[int, int], str]]:
    """Candidates for the component of a name: its text, its place, and the word it is joined to.
    `fx` is one; then single letters, and numbers last.
    """
    for token, (_, stop) in reversed(tokens):
        if token[-1] in QUATERNION and token[:-1] in _KNOWN:
            yield token[-1], (stop - 1, stop), token[:-1]
    yield from ((token, place, "") for token, place in reversed(tokens) if token in QUATERNION)
    yield from ((token, place, "") for token, place in reversed(tokens) if token in set("0123456"))


def _kinds(word: str, component: str) -> Iterable[str]:
    """Quantities that a word means with this component: `t` is a time, `tx` a torque."""
    for kind, words in _MEANING.items():
        if word in words and (kind != "time" or not component):
            yield kind


def _of(quantity: str, parts: dict[str, Part]) -> Iterable[Group]:
    """The quantities that parts of one name make up."""
    unit = next((part.unit for part in parts.values() if part.unit), None)
    if set(parts) == {""}:
        forms = ("xyzw", "wxyz") if quantity == "orientation" else ()
        yield Group(quantity, (parts[""].name,), forms, unit)
        return
    numbered = sorted((key for key in parts if key.isdigit()), key=int)
    letters = QUATERNION if quantity == "orientation" and "w" in parts else XYZ
    if set(letters) <= set(parts):
        names = tuple(parts[key].name for key in letters)
        yield Group(quantity, names, _forms(quantity, names, letters), unit)
    elif numbered and [*map(int, numbered)] == [*range(int(numbered[0]), int(numbered[-1]) + 1)]:
        yield from _numbered(quantity, tuple(parts[key].name for key in numbered), unit)


def _numbered(quantity: str, names: tuple[str, ...], unit: str | None) -> Iterable[Group]:
    """Columns that are numbered: three or four of one quantity, six of a wrench, six or seven of a
    pose.
    """
    second = {"force": "torque", "position": "orientation"}.get(quantity, "")
    if len(names) == 3 or (len(names), quantity) == (4, "orientation"):
        yield Group(quantity, names, _forms(quantity, names, ()), unit)
    elif second and (len(names) == 6 or (len(names), quantity) == (7, "position")):
        yield Group(quantity, names[:3], (), unit)
        yield Group(second, names[3:], _forms(second, names[3:], ()))


def _forms(quantity: str, names: tuple[str, ...], letters: Sequence[str]) -> tuple[str, ...]:
    """Forms that the numbers of an orientation may have."""
    if quantity != "orientation":
        return ()
    if len(names) == 4:
        return ("xyzw",) if letters else ("xyzw", "wxyz")
    is_vector = any({"rotvec", "rv"} & {word for word, _ in _tokens(name)} for name in names)
    return ("rotation_vector",) if is_vector else ("rotation_vector", "roll_pitch_yaw")


def _angles(names: Sequence[str]) -> list[Group]:
    """Three angles named by their axes' letters or words."""
    last: dict[str, str] = {}
    for name in names:
        stem, unit = _cut(name)
        in_angles = units.known_or_none(unit, units.ALLOWED["angle"])
        tokens = _tokens(stem if in_angles else name)
        if tokens and (len(tokens[-1][0]) > 1 or len(tokens) == 1):
            last[tokens[-1][0]] = name
    chosen = [tuple(last[word] for word in words) for words in _ANGLES if set(words) <= set(last)]
    return [
        Group("orientation", three, ("roll_pitch_yaw",), unit_of(three[0], "orientation"))
        for three in chosen
    ]


def _whole_and_fraction(names: Sequence[str]) -> list[Group]:
    """Whole seconds and nanoseconds."""
    parts = [
        next((name for name in names if (end := _tokens(name)) and end[-1][0] in words), None)
        for words in _WHOLE
    ]
    return [Group("time", tuple(filter(None, parts)))] if all(parts) else []
