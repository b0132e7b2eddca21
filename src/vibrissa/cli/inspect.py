"""`vibrissa inspect`: what a recording is worth, before anyone trusts it."""

import json
import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vibrissa.io import Setup
    from vibrissa.sensor import Inspection

_SHOWN = 8


def inspect(
    recording: Annotated[Path, typer.Argument(help="Log of the sensor.", show_default=False)],
    setup: Annotated[
        Path, typer.Option("--setup", help="TOML file with [rod] and [sensor].", show_default=False)
    ],
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Figure to write (PNG or PDF).")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Tare, drift, noise and faults of a recording: each with its interval and count."""
    from vibrissa.cli.progress import reporting  # noqa: PLC0415
    from vibrissa.io.contacts import checked_output  # noqa: PLC0415
    from vibrissa.io.recordings.read import inspect_recording  # noqa: PLC0415
    from vibrissa.io.setup import load_setup  # noqa: PLC0415

    if figure is not None:
        checked_output(figure, (".png", ".pdf"))
    loaded = load_setup(setup)
    with reporting() as report:
        report("inspecting")
        found = inspect_recording(recording, loaded)
        if figure is not None:
            report("drawing")
            _draw(found, loaded, figure)
    said = _said(recording, found, loaded)
    summary = _summary(found, loaded) | {"warnings": said}
    if as_json:
        typer.echo(json.dumps(summary, indent=1, allow_nan=False))
    else:
        _print(found, loaded, summary)
    if found.unusable:
        raise typer.Exit(1)


def _said(recording: Path, found: "Inspection", loaded: "Setup") -> list[str]:
    """What the recording says against its setup, as `reconstruct` would: the lines of the
    inspection, and those of its contacts where there are any.
    """
    import warnings  # noqa: PLC0415

    from vibrissa.cli.said import listening  # noqa: PLC0415
    from vibrissa.contacts import RecordingWarning  # noqa: PLC0415

    with listening() as said:
        for line in found.warnings:
            warnings.warn(f"{recording}: {line}", RecordingWarning, stacklevel=2)
        if not found.unusable and found.sensor.force_noise is not None:
            from vibrissa.inverse import reconstruct as run  # noqa: PLC0415

            # The checks of the contacts warn by themselves.
            run(
                loaded.rod,
                found.sensor.reactions(
                    found.cleaned, found.tare, tolerances=loaded.parameter_covariance
                ),
            )
    return said


def _summary(found: "Inspection", loaded: "Setup") -> dict[str, object]:
    from vibrissa.sensor import CHANNEL_UNITS, CHANNELS  # noqa: PLC0415

    sensor, first = loaded.sensor, float(found.cleaned.time[0])
    stated = sensor.reading_variance**0.5 if sensor.force_noise is not None else [None] * 6
    tare = found.tare
    return {
        "rows": len(found.usable),
        "usable_rows": int(found.usable.sum()),
        "usable": not found.unusable,
        "start": first,
        "duration": float(found.cleaned.time[-1]) - first,
        "rate": _number(found.rate),
        "channels": {
            name: {
                "tare": _number(tare.offset[channel]) if tare is not None else None,
                "noise": _number(found.noise[channel]),
                "stated_noise": _number(stated[channel]),
                "drift": _number(found.drift[channel]),
                "drift_standard_deviation": _number(found.drift_deviation[channel]),
                "unit": CHANNEL_UNITS[channel],
            }
            for channel, name in enumerate(CHANNELS)
        },
        "tare": None
        if tare is None
        else {
            "found": tare.found,
            "intervals": [list(part) for part in tare.intervals],
            "rows": list(tare.counts),
        },
        "rest": [list(part) for part in found.rest.intervals],
        "mount": None
        if tare is None or tare.mount is None
        else {"mass": tare.mount.mass, "center": list(tare.mount.center)},
        "single_contact_misfit": _number(found.single_contact_misfit),
        "notes": list(found.notes),
        "counts": dict(Counter(str(fault.kind) for fault in found.faults)),
        "faults": [
            {
                "kind": str(fault.kind),
                "channels": list(fault.channels),
                "start": _number(fault.start),
                "stop": _number(fault.stop),
                "count": fault.count,
                "unusable": fault.unusable,
                "text": fault.text,
            }
            for fault in found.faults
        ],
    }


def _number(value: object) -> float | None:
    """A number for JSON, which knows no NaN."""
    return None if value is None or not math.isfinite(float(str(value))) else float(str(value))


def _print(found: "Inspection", loaded: "Setup", summary: dict[str, object]) -> None:
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    from vibrissa.sensor import CHANNELS  # noqa: PLC0415

    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=160)
    first, sensor = float(found.cleaned.time[0]), loaded.sensor
    lines = [
        f"{summary['rows']} rows over {summary['duration']:.4g} s, {found.rate:.5g} a second; {summary['usable_rows']} usable",
        *found.notes,
        _tare_line(found, first),
    ]
    if found.tare is not None and found.tare.mount is not None:
        x, y, z = (1e3 * part for part in found.tare.mount.center)
        how = "estimated" if found.tare.mount.estimated else "given"
        lines.append(
            f"mount, {how}: {1e3 * found.tare.mount.mass:.4g} g at ({x:.3g}, {y:.3g}, {z:.3g}) mm of the sensor frame"
        )
    if math.isfinite(found.single_contact_misfit):
        lines.append(
            f"m0·f0 = 0 is violated by {found.single_contact_misfit:.2f} standard deviations in the median (0.67 is noise alone)"
        )
    for line in lines:
        console.print(line, soft_wrap=True, markup=False)
    table = Table()
    for name in (
        "channel",
        "tare",
        "noise at rest",
        "stated",
        "drift a second",
        "± one standard deviation",
    ):
        table.add_column(name, justify="left" if name == "channel" else "right")
    for channel, name in enumerate(CHANNELS):
        factor, unit = (1e3, "mN") if channel < 3 else (1e6, "µN m")
        stated = sensor.reading_variance[channel] ** 0.5 if sensor.force_noise is not None else None
        tare = None if found.tare is None else found.tare.offset[channel]
        numbers = (
            tare,
            found.noise[channel],
            stated,
            found.drift[channel],
            found.drift_deviation[channel],
        )
        table.add_row(
            f"{name} [{unit}]",
            *(_shown(value, factor) for value in numbers),
            end_section=channel == 2,
        )
    console.print(table, markup=False)
    _print_faults(found, first)


def _tare_line(found: "Inspection", first: float) -> str:
    if found.tare is None:
        return "no tare: see the findings"
    parts = [
        f"{start - first:.3g} s to {stop - first:.3g} s ({count} rows)"
        for (start, stop), count in zip(found.tare.intervals, found.tare.counts, strict=True)
    ]
    return f"tare {found.tare.found}" + (": " + ", ".join(parts) if parts else "")


def _shown(value: float | None, factor: float) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{factor * value:.4g}"


def _print_faults(found: "Inspection", first: float) -> None:
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=160)
    if not found.faults:
        console.print("no faults found")
        return
    table = Table()
    for name in ("finding", "channels", "from [s]", "to [s]", "count"):
        table.add_column(name, justify="left" if name in {"finding", "channels"} else "right")
    table.add_column("what", ratio=1, overflow="fold")
    left: Counter[str] = Counter()
    for fault in found.faults:
        kind = str(fault.kind)
        left[kind] += 1
        if left[kind] <= _SHOWN or fault.unusable:
            word = f"{kind} (UNUSABLE)" if fault.unusable else kind
            table.add_row(
                word,
                ", ".join(fault.channels),
                f"{fault.start - first:.4g}",
                f"{fault.stop - first:.4g}",
                str(fault.count),
                fault.text,
            )
    console.print(table, markup=False)
    for kind, count in left.items():
        if count > _SHOWN:
            console.print(f"and {count - _SHOWN} more of {kind}: --json lists all", markup=False)


def _draw(found: "Inspection", loaded: "Setup", path: Path) -> None:
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("Agg")
    from vibrissa import plot  # noqa: PLC0415

    with plot.journal():
        plot.save_as(plot.recording_figure(found, loaded.sensor), path)
