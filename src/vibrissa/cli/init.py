"""`vibrissa init`: a first setup, from a recording and what was measured at the bench."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import vibrissa as vb
from vibrissa.cli import common

if TYPE_CHECKING:
    from vibrissa.io.first_setup import Bench
    from vibrissa.io.recordings.decide import Decision
    from vibrissa.io.recordings.propose import Layout

_ARM = 2.0
"""Longest length on a bench [m], a robot arm's reach: more is in millimetres."""
_NONE = "none"
_SIGNS = ("on_sensor", "on_rod")


def init(
    recording: Annotated[Path, typer.Argument(help="Sensor log that begins without contact.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Setup to write.")] = Path(
        "setup.toml"
    ),
    length: Annotated[
        str | None, typer.Option(help="Free length of the rod: in m, or as 50mm.")
    ] = None,
    radius: Annotated[
        str | None, typer.Option(help="Radius of the rod: in m, or as 0.25mm.")
    ] = None,
    youngs_modulus: Annotated[
        str | None, typer.Option(help="In Pa, or as 206GPa: steel 206, nitinol about 60.")
    ] = None,
    clamp_position: Annotated[
        str | None,
        typer.Option(help="Where the rod leaves its clamp, in the sensor's axes: x,y,z in m."),
    ] = None,
    clamp_orientation: Annotated[
        str | None,
        typer.Option(help="Quaternion x,y,z,w that turns +z to the rod's; default 0,0,0,1."),
    ] = None,
    sensor: Annotated[
        str | None,
        typer.Option(help="Preset of the sensor; default none: noise as in the recording."),
    ] = None,
    wrench: Annotated[
        str | None,
        typer.Option(help="on_sensor or on_rod; by default what the recording tells."),
    ] = None,
    layout: Annotated[
        list[str] | None,
        typer.Option(help="KEY=VALUE of [recording], as force=A,B,C or position_unit=mm."),
    ] = None,
) -> None:
    """Write a first setup: ask for rod, clamp and sensor, and look at a recording for the rest."""
    from vibrissa.files import writable  # noqa: PLC0415
    from vibrissa.io.first_setup import setup_text  # noqa: PLC0415

    if output.exists():
        raise vb.io.InputError(f"{output}: exists already; allowed is a new file, by -o FILE")
    found = _layout(recording, _keys(layout or []))
    bench = _bench(
        {
            "length": length,
            "radius": radius,
            "youngs-modulus": youngs_modulus,
            "clamp-position": clamp_position,
            "clamp-orientation": clamp_orientation,
            "sensor": sensor,
        }
    )
    sign = None if wrench is None else _one_of("--wrench", _SIGNS)(wrench)
    decision, sign = _decided(recording, found, bench, sign)
    text = setup_text(bench, sign, decision, recording.name)
    writable(output).write_text(text, encoding="utf-8")
    vb.load_setup(output)
    _report(recording, decision, sign, output)


def _value(
    option: str, given: str | None, words: str, read: Callable[[str], Any], default: str | None
) -> Any:
    """What an option says, or else the person at the terminal, or else the default."""
    if given is not None:
        return read(given)
    if not sys.stdin.isatty():
        if default is None:
            raise vb.io.InputError(f"{option}: missing; allowed is {words}")
        return read(default)

    def again(text: str) -> Any:
        try:
            return read(text)
        except vb.io.InputError as error:
            raise typer.BadParameter(str(error)) from error

    return typer.prompt(f"{words} ({option})", default=default, value_proc=again, err=True)


def _bench(given: dict[str, str | None]) -> Bench:
    """Rod, clamp and sensor."""
    from vibrissa.io.first_setup import Bench  # noqa: PLC0415
    from vibrissa.sensor import PRESETS  # noqa: PLC0415

    def asked(name: str, words: str, unit: str, count: int = 1, default: str | None = None) -> Any:
        read = _numbers(f"--{name}", unit, count)
        return _value(f"--{name}", given[name], words, read, default)

    (length,) = asked("length", "the rod's free length from clamp to tip [m], or as 50mm", "m")
    (radius,) = asked("radius", "the rod's radius [m], or as 0.25mm", "m")
    (modulus,) = asked("youngs-modulus", "Young's modulus [Pa], or as 206GPa", "Pa")
    words = "where the rod leaves its clamp, in the sensor's axes: x,y,z [m], or as 0,0,25mm"
    position = asked("clamp-position", words, "m", 3)
    words = "quaternion x,y,z,w that turns the sensor's +z to the rod's direction"
    orientation = asked("clamp-orientation", words, "dimensionless", 4, "0,0,0,1")
    names = (*PRESETS, _NONE)
    words = f"the sensor's preset: {', '.join(names)}"
    preset = _value("--sensor", given["sensor"], words, _one_of("--sensor", names), _NONE)
    bench = Bench(length, radius, modulus, position, orientation, preset.removeprefix(_NONE))
    _parts(bench)
    return bench


def _parts(bench: Bench) -> tuple[vb.Rod, vb.sensor.Sensor]:
    """Rod and sensor of a bench; the sensor's sign is not known yet."""
    from vibrissa.sensor import PRESETS, Sensor  # noqa: PLC0415

    try:
        rod = vb.Rod.cylinder(
            length=bench.length, radius=bench.radius, youngs_modulus=bench.youngs_modulus
        )
        figures = PRESETS.get(bench.preset, {})
        place = bench.clamp_position, bench.clamp_orientation
        return rod, Sensor(*place, "on_sensor", tare_seconds=None, **figures)
    except ValueError as error:
        raise vb.io.InputError(str(error)) from error


def _numbers(option: str, unit: str, count: int) -> Callable[[str], tuple[float, ...]]:
    """Read so many numbers, with a unit or without."""
    from vibrissa.io.recordings.units import numbers_in  # noqa: PLC0415

    def read(text: str) -> tuple[float, ...]:
        try:
            found = tuple(numbers_in(text, unit))
        except ValueError:
            found = ()
        if len(found) != count:
            many = "a number" if count == 1 else f"{count} numbers"
            plain = "" if unit == "dimensionless" else f" in {unit}, or with a unit behind"
            raise vb.io.InputError(f"{option} = {text!r}; allowed is {many}{plain}")
        if unit == "m" and max(map(abs, found)) > _ARM:
            raise vb.io.InputError(
                f"{option} = {text!r}: that is in metres; allowed are up to {_ARM:g} m, or with a "
                "unit behind, such as 50mm"
            )
        return found

    return read


def _one_of(option: str, allowed: tuple[str, ...]) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in allowed:
            raise vb.io.InputError(f"{option} = {text!r}; allowed is {', '.join(allowed)}")
        return text

    return read


def _keys(given: list[str]) -> dict[str, Any]:
    """Keys of [recording] from KEY=VALUE."""
    from pydantic import ValidationError  # noqa: PLC0415

    from vibrissa.io.config import one_line  # noqa: PLC0415
    from vibrissa.io.recordings.table import RecordingTable  # noqa: PLC0415

    keys: dict[str, Any] = {}
    for one in given:
        key, equal, text = one.partition("=")
        if not equal:
            raise vb.io.InputError(f"--layout = {one!r}; allowed is KEY=VALUE")
        keys[key.strip()] = _names(text) if key.strip() in _quantities() else _toml(text)
    try:
        RecordingTable.model_validate(keys)
    except ValidationError as error:
        raise vb.io.InputError(f"--layout {one_line(error, RecordingTable)}") from error
    return keys


def _quantities() -> tuple[str, ...]:
    from vibrissa.io.recordings.names import QUANTITIES  # noqa: PLC0415

    return QUANTITIES


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _toml(text: str) -> Any:
    """A number where the text is one, else the text."""
    import tomllib  # noqa: PLC0415

    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _layout(recording: Path, keys: dict[str, Any]) -> Layout:
    """Columns of all quantities: proposed by their names, confirmed or corrected at a terminal."""
    from vibrissa.io.recordings.propose import proposed_layout  # noqa: PLC0415

    found = proposed_layout(recording, keys)
    if not found.names:
        return found
    if found.missing and not sys.stdin.isatty():
        raise vb.io.InputError(f"{recording}: {_unplaced(found)}")
    said: dict[str, Any] = {}
    for quantity in _quantities():
        if quantity in keys:
            continue
        proposed = found.keys.get(quantity)
        words = f"the columns of {quantity}"
        if not proposed:
            words += f", of {_choices(found, quantity)}"
        default = ",".join(proposed) if proposed else None
        names = _value(f"--layout {quantity}=NAMES", None, words, _names, default)
        if names != proposed:
            said[quantity] = names
    return proposed_layout(recording, keys | said) if said else found


def _choices(found: Layout, quantity: str) -> str:
    """What may be the columns of a quantity: the sets that fit, else all that have no place."""
    several = [", ".join(names) for names in found.several.get(quantity, [])]
    return " or of ".join(several) or ", ".join(found.unplaced)[:300]


def _unplaced(found: Layout) -> str:
    """Which quantities have no columns, which columns have no place, and how to place them."""
    options = " ".join(f"--layout {quantity}=NAMES" for quantity in found.missing)
    several = [
        f"{quantity} may be that of {_choices(found, quantity)}"
        for quantity in found.missing
        if quantity in found.several
    ]
    unknown = [quantity for quantity in found.missing if quantity not in found.several]
    if unknown:
        rest = ", ".join(found.unplaced)[:300] or "none"
        several.append(f"no columns found for {', '.join(unknown)}, columns left over: {rest}")
    return f"{'; '.join(several)}; allowed is {options}, names separated by commas"


def _decided(recording: Path, found: Layout, bench: Bench, sign: Any) -> tuple[Decision, Any]:
    """What the numbers decide; the rest by the person at the terminal."""
    from vibrissa.io.recordings.decide import decided  # noqa: PLC0415

    rod, sensor = _parts(bench)
    decision = decided(recording, found, rod, sensor, sign)
    _check_usable(recording, decision)
    said: dict[str, Any] = {}
    for key, values in decision.undecided.items():
        option = "--wrench" if key == "wrench" else f"--layout {key}=VALUE"
        words = f"{' or '.join(values)}: the recording does not tell ({decision.reason})"
        said[key] = _value(option, None, words, _one_of(option, values), None)
    sign = said.pop("wrench", decision.wrench)
    if said:
        return _decided(recording, found.given(said), bench, sign)
    return decision, sign


def _check_usable(recording: Path, decision: Decision) -> None:
    """Raise InputError if no setup makes a recording of the log."""
    from vibrissa.sensor import FaultKind  # noqa: PLC0415

    for fault in decision.inspection.unusable if decision.inspection else ():
        text = fault.text
        if fault.kind is FaultKind.REST:
            text = (
                "is too short, or begins in contact or under a changing load; "
                "allowed is a log that begins at rest and free of contact"
            )
        raise vb.io.InputError(f"{recording}: {text}; no setup is written")


def _report(recording: Path, decision: Decision, sign: str, output: Path) -> None:
    """Warn of what does not fit, and say what was found and written."""
    keys, found = decision.keys, decision.inspection
    if decision.reason:
        common.warn(f"{recording}: {decision.reason}")
    units = [
        f"{name} in {keys[f'{name}_unit']}"
        for name in ("time", "force", "torque", "position", "angle")
        if keys.get(f"{name}_unit", "stamp") != "stamp"
    ]
    rows = "no rows"
    if found:
        rows = common.count_of(len(found.usable), "row")
        rows += "" if found.usable.all() else f", {int(found.usable.sum())} usable"
    typer.echo(", ".join([rows, *units, f"wrench {sign}"]) + common.into(output))
