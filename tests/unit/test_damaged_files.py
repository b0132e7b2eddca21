"""Hypothesis damages good files, and writes bad ones: the readers take them or say in one line what
is wrong, nothing else.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bench_files import CASE, RECORDING, SETUP
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import vibrissa as vb
from vibrissa.io import InputError

TORN = settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def setup(tmp_path_factory: pytest.TempPathFactory) -> vb.Setup:
    file = tmp_path_factory.mktemp("setup") / "setup.toml"
    file.write_text(SETUP)
    return vb.load_setup(file)


def taken_or_refused(read: Callable[[Path], object], folder: Path, content: bytes) -> None:
    file = folder / "damaged"
    file.write_bytes(content)
    try:
        read(file)
    except InputError as error:
        message = str(error)
        assert message.startswith(str(file))
        assert len(message.splitlines()) == 1
        assert "allowed" in message


@st.composite
def damaged(draw: st.DrawFn, good: str) -> bytes:
    """A good file with one to three stretches cut out, overwritten, doubled or moved."""
    content = good.encode()
    for _ in range(draw(st.integers(1, 3))):
        first = draw(st.integers(0, len(content)))
        last = min(len(content), first + draw(st.integers(0, 40)))
        put = draw(
            st.one_of(
                st.just(b""),
                st.binary(max_size=8),
                st.text(alphabet="0123456789.-+eE,\n[]\"='#_ ainf", max_size=8).map(str.encode),
                st.just(content[first:last] * 2),
            )
        )
        content = content[:first] + put + content[last:]
    return content


# Only the trail of poses: a digit more in a count asks for nothing but memory.
FIXED_CASE = CASE[: CASE.index("[[trail]]")] + CASE[CASE.rindex("[[trail]]") :]


@TORN
@given(content=st.one_of(st.binary(max_size=200), damaged(RECORDING)))
def test_recordings(tmp_path: Path, setup: vb.Setup, content: bytes) -> None:
    taken_or_refused(lambda file: vb.read_recording(file, setup), tmp_path, content)


@pytest.mark.parametrize("column", ["time", "px", "qx", "fx", "tx"])
@pytest.mark.parametrize("value", ["1e300", "-1e200", "1e-320"])
def test_numbers_beyond_their_squares(
    tmp_path: Path, setup: vb.Setup, column: str, value: str
) -> None:
    lines = [line.split(",") for line in RECORDING.splitlines()]
    lines[16][lines[0].index(column)] = value
    content = "\n".join(map(",".join, lines)) + "\n"
    taken_or_refused(lambda file: vb.read_recording(file, setup), tmp_path, content.encode())


@TORN
@given(content=st.one_of(st.binary(max_size=200), damaged(SETUP)))
def test_setups(tmp_path: Path, content: bytes) -> None:
    taken_or_refused(vb.load_setup, tmp_path, content)


@TORN
@given(content=damaged(FIXED_CASE))
def test_cases(tmp_path: Path, content: bytes) -> None:
    taken_or_refused(vb.load_case, tmp_path, content)


NUMBERS = st.one_of(
    st.integers(-3, 3),
    st.floats(),
    st.sampled_from([1e308, 1e200, 1e-200, 5e-324, 10**400, -(10**400)]),
)
VALUES = st.recursive(
    st.one_of(NUMBERS, st.booleans(), st.text(max_size=5)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=3), inner, max_size=2)
    ),
    max_leaves=4,
)
KEYS = (
    "kind",
    "length",
    "radius",
    "youngs_modulus",
    "bending_stiffness",
    "density",
    "yield_strain",
    "linear_density",
)
SENSOR = {
    "clamp_position": [0.0, 0.0, 0.025],
    "clamp_orientation": [0.0, 0.0, 0.0, 1.0],
    "wrench": "on_sensor",
}
RODS = (
    {"kind": "cylinder", "length": 0.05, "radius": 2.5e-4, "youngs_modulus": 2e11},
    {"kind": "uniform", "length": 0.05, "bending_stiffness": 6e-4},
    {"kind": "unit"},
)
OBJECTS = (
    {"kind": "sphere", "center": [0, 0, 1], "radius": 0.5},
    {"kind": "ellipsoid", "center": [0, 0, 1], "semi_axes": [0.1, 0.2, 0.3]},
    {
        "kind": "elliptic_cylinder",
        "center": [0, 0, 1],
        "semi_axes": [0.1, 0.2],
        "rotation": [0, 0, 0, 1],
    },
    {"kind": "plane", "point": [0, 0, 1], "normal": [0, 0, -1], "translation": [0, 0, 0]},
    {"kind": "elliptic_paraboloid", "a": 0.5, "b": 1, "h": 0.4},
)


def toml(value: Any) -> str:
    """A value as inline TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + "".join(f"\\U{ord(letter):08x}" for letter in value) + '"'
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(key)} = {toml(part)}" for key, part in value.items()) + "}"
    return str(value)


@st.composite
def strange_setups(draw: st.DrawFn) -> bytes:
    """A good setup in which one or two values are others, of any type and size, or keys are missing
    or new.
    """
    tables: dict[str, Any] = {
        "rod": dict(draw(st.sampled_from(RODS))),
        "sensor": dict(SENSOR),
        "object": dict(draw(st.sampled_from(OBJECTS))),
    }
    for _ in range(draw(st.integers(1, 2))):
        table = tables[draw(st.sampled_from(sorted(tables)))]
        key = draw(st.one_of(st.sampled_from(sorted(table) or ["kind"]), st.sampled_from(KEYS)))
        if draw(st.booleans()) and key in table:
            old = table[key]
            if isinstance(old, list) and draw(st.booleans()):
                table[key] = [*old[:-1], draw(VALUES)]
            else:
                table[key] = draw(VALUES)
        elif draw(st.booleans()):
            table.pop(key, None)
        else:
            table[key] = draw(VALUES)
    return "\n".join(f"{toml(name)} = {toml(table)}" for name, table in tables.items()).encode()


@TORN
@given(content=strange_setups())
def test_strange_values_in_setups(tmp_path: Path, content: bytes) -> None:
    taken_or_refused(vb.load_setup, tmp_path, content)
