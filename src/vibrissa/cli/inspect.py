"""`vibrissa inspect`: what a recording is worth, before anyone trusts it."""

import json
import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
        _print(found, summary)
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


def _summary(found: "Inspection", loaded: "Setup") -> dict[str, Any]:
    """What is printed, for JSON, which knows no NaN."""
    from vibrissa.sensor import CHANNEL_UNITS, CHANNELS  # noqa: PLC0415

    sensor, tare, nothing = loaded.sensor, found.tare, [None] * 6
    channels = zip(
        nothing if tare is None else tare.offset,
        found.noise,
        nothing if sensor.force_noise is None else sensor.reading_variance**0.5,
        found.drift,
        found.drift_deviation,
        CHANNEL_UNITS,
        strict=True,
    )
    names = ("tare", "noise", "stated_noise", "drift", "drift_standard_deviation", "unit")
    mount = None if tare is None else tare.mount
    first, last = map(float, found.cleaned.time[[0, -1]])
    of_fault = ("kind", "channels", "start", "stop", "count", "unusable", "text")
    summary = {
        "rows": len(found.usable),
        "usable_rows": int(found.usable.sum()),
        "usable": not found.unusable,
        "start": first,
        "duration": last - first,
        "rate": found.rate,
        "channels": {
            channel: dict(zip(names, numbers, strict=True))
            for channel, numbers in zip(CHANNELS, channels, strict=True)
        },
        "tare": tare and {"found": tare.found, "intervals": tare.intervals, "rows": tare.counts},
        "rest": found.rest.intervals,
        "mount": mount and {"mass": mount.mass, "center": mount.center},
        "single_contact_misfit": found.single_contact_misfit,
        "notes": found.notes,
        "counts": Counter(str(fault.kind) for fault in found.faults),
        "faults": [{name: getattr(fault, name) for name in of_fault} for fault in found.faults],
    }
    return {name: _plain(value) for name, value in summary.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


def _print(found: "Inspection", summary: dict[str, Any]) -> None:
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=160)
    first = summary["start"]
    lines = [
        f"{summary['rows']} rows over {summary['duration']:.4g} s, {found.rate:.5g} a second; "
        f"{summary['usable_rows']} usable",
        *found.notes,
        _tare_line(found, first),
    ]
    if found.tare is not None and found.tare.mount is not None:
        x, y, z = (1e3 * part for part in found.tare.mount.center)
        how = "estimated" if found.tare.mount.estimated else "given"
        lines.append(
            f"mount, {how}: {1e3 * found.tare.mount.mass:.4g} g at ({x:.3g}, {y:.3g}, {z:.3g}) mm "
            "of the sensor frame"
        )
    if math.isfinite(found.single_contact_misfit):
        lines.append(
            f"m0·f0 = 0 is violated by {found.single_contact_misfit:.2f} standard deviations in "
            "the median (0.67 is noise alone)"
        )
    for line in lines:
        console.print(line, soft_wrap=True, markup=False)
    table = Table("channel")
    for name in ("tare", "noise at rest", "stated", "drift a second", "± one standard deviation"):
        table.add_column(name, justify="right")
    for number, (channel, values) in enumerate(summary["channels"].items()):
        factor, unit = (1e3, "mN") if number < 3 else (1e6, "µN m")
        cells = [
            "–" if value is None else f"{factor * value:.4g}"
            for name, value in values.items()
            if name != "unit"
        ]
        table.add_row(f"{channel} [{unit}]", *cells, end_section=number == 2)
    console.print(table, markup=False)
    if not found.faults:
        console.print("no faults found")
        return
    table = Table("finding", "channels")
    for name in ("from [s]", "to [s]", "count"):
        table.add_column(name, justify="right")
    table.add_column("what", ratio=1, overflow="fold")
    seen: Counter[str] = Counter()
    for fault in found.faults:
        kind = str(fault.kind)
        seen[kind] += 1
        if seen[kind] <= _SHOWN or fault.unusable:
            table.add_row(
                f"{kind} (UNUSABLE)" if fault.unusable else kind,
                ", ".join(fault.channels),
                f"{fault.start - first:.4g}",
                f"{fault.stop - first:.4g}",
                str(fault.count),
                fault.text,
            )
    console.print(table, markup=False)
    for kind, count in seen.items():
        if count > _SHOWN:
            console.print(f"and {count - _SHOWN} more of {kind}: --json lists all", markup=False)


def _tare_line(found: "Inspection", first: float) -> str:
    if found.tare is None:
        return "no tare: see the findings"
    parts = [
        f"{start - first:.3g} s to {stop - first:.3g} s ({count} rows)"
        for (start, stop), count in zip(found.tare.intervals, found.tare.counts, strict=True)
    ]
    return f"tare {found.tare.found}" + (": " + ", ".join(parts) if parts else "")


def _draw(found: "Inspection", loaded: "Setup", path: Path) -> None:
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("Agg")
    from vibrissa import plot  # noqa: PLC0415

    with plot.journal():
        plot.save_as(plot.recording_figure(found, loaded.sensor), path)
