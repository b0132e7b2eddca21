"""`vibrissa inspect`: how good a recording is, before anyone trusts it."""

from __future__ import annotations

import json
import math
import warnings
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import vibrissa as vb
from vibrissa.cli import common
from vibrissa.cli.progress import reporting

if TYPE_CHECKING:
    from vibrissa.sensor import Inspection

_SHOWN = 8
_SPOILING = ("saturation", "drop-out", "stuck channel", "held readings", "duplicate stamp", "gap")
"""Kinds of faults that make single rows unusable."""


def inspect(
    recording: Annotated[Path, typer.Argument(help="Sensor log.")],
    setup: common.SetupFile,
    figure: common.Figure = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Report tare, drift, noise and faults of a recording, each with its interval and count."""
    with reporting() as report:
        report("reading")
        loaded = vb.load_setup(setup, progress=report.count)
        report("inspecting")
        found = vb.io.inspect_recording(recording, loaded)
        files = []
        if figure is not None:
            report("drawing")
            figured = partial(vb.plot.recording_figure, found, loaded.sensor)
            files += [figure] * common.draw(figure, figured)
    # What makes a recording unusable, such as a wrong unit, may cause whatever else is found.
    for line in [fault.text for fault in found.unusable] or found.warnings:
        warnings.warn(f"{recording}: {line}", vb.RecordingWarning, stacklevel=2)
    _doubt_rows(found)
    if not found.unusable and found.sensor.force_noise is not None:
        # The checks of the contacts issue their own warnings, as in `reconstruct`.
        tolerances = loaded.parameter_covariance
        reactions = found.sensor.reactions(found.cleaned, found.tare, tolerances=tolerances)
        reactions = replace(reactions, misread=found.misread)
        common.doubt_contacts(vb.reconstruct(loaded.rod, reactions))
    summary = _summary(found, loaded) | {"warnings": common.contradictions}
    if as_json:
        common.show(summary, str, as_json=True)
    else:
        _print(found, summary)
        counts = summary["counts"]
        what = ", ".join(f"{count} {kind}" for kind, count in counts.items()) or "no faults"
        use = "not usable as read" if found.unusable else f"{summary['usable_rows']} usable"
        common.say(f"{summary['rows']} rows, {use}, {what}" + common.into(*files))
    if found.unusable or (figure is not None and not files):
        raise typer.Exit(1)


def _doubt_rows(found: Inspection) -> None:
    """Warn if most rows are unusable, with the fault that most of them have."""
    lost = int((~found.usable).sum())
    if 2 * lost <= len(found.usable) or found.unusable:
        return
    spoilt = {fault.kind: 0 for fault in found.faults if fault.kind in _SPOILING}
    for fault in found.faults:
        if fault.kind in spoilt:
            spoilt[fault.kind] += fault.count
    kind = max(spoilt, key=lambda kind: spoilt[kind])
    example = next(fault.text for fault in found.faults if fault.kind == kind)
    common.warn(
        f"{lost} of {len(found.usable)} rows are unusable; likeliest cause: {kind}, such as "
        f"{example}"
    )


def _summary(found: Inspection, loaded: vb.Setup) -> dict[str, Any]:
    """What is printed, ready for JSON, which has no NaN."""
    from vibrissa.sensor import CHANNEL_UNITS, CHANNELS  # noqa: PLC0415

    sensor, tare, nothing = loaded.sensor, found.tare, [None] * 6
    figures = {
        "tare": nothing if tare is None else tare.offset,
        "noise": found.noise,
        "stated_noise": nothing if sensor.force_noise is None else sensor.reading_variance**0.5,
        "drift": found.drift,
        "drift_standard_deviation": found.drift_deviation,
        "unit": CHANNEL_UNITS,
    }
    mount = None if tare is None else tare.mount
    first, last = found.cleaned.time[[0, -1]].tolist()
    summary = {
        "rows": len(found.usable),
        "usable_rows": int(found.usable.sum()),
        "usable": not found.unusable,
        "start": first,
        "duration": last - first,
        "rate": found.rate,
        "channels": {
            channel: {name: values[row] for name, values in figures.items()}
            for row, channel in enumerate(CHANNELS)
        },
        "tare": tare and {"found": tare.found, "intervals": tare.intervals, "rows": tare.counts},
        "rest": found.rest.intervals,
        "mount": mount and {"mass": mount.mass, "center": mount.center},
        "single_contact_misfit": found.single_contact_misfit,
        "notes": found.notes,
        "counts": Counter(fault.kind for fault in found.faults),
        "faults": [
            {name: value for name, value in vars(fault).items() if name != "quiet"}
            for fault in found.faults
        ],
    }
    plain: dict[str, Any] = json.loads(json.dumps(summary), parse_constant=lambda _: None)
    return plain


def _print(found: Inspection, summary: dict[str, Any]) -> None:
    from rich.table import Table  # noqa: PLC0415

    console = common.table_console()
    common.say("\n".join(_lines(found, summary)))
    table = Table("channel")
    for name in ("tare", "noise at rest", "stated", "drift a second", "± one standard deviation"):
        table.add_column(name, justify="right")
    for number, (channel, figures) in enumerate(summary["channels"].items()):
        *values, _ = figures.values()
        factor, unit = (1e3, "mN") if number < 3 else (1e6, "µN m")
        cells = ["–" if value is None else f"{factor * value:.4g}" for value in values]
        table.add_row(f"{channel} [{unit}]", *cells, end_section=number == 2)
    console.print(table)
    if not found.faults:
        return
    table = Table("finding", "channels")
    for name in ("from [s]", "to [s]", "count"):
        table.add_column(name, justify="right")
    table.add_column("what", ratio=1, overflow="fold", min_width=36)
    seen: Counter[str] = Counter()
    for fault in found.faults:
        seen[fault.kind] += 1
        if seen[fault.kind] <= _SHOWN or fault.unusable:
            table.add_row(
                f"{fault.kind} (UNUSABLE)" if fault.unusable else fault.kind,
                ", ".join(fault.channels),
                *(f"{moment - summary['start']:.4g}" for moment in (fault.start, fault.stop)),
                str(fault.count),
                fault.text,
            )
    console.print(table)
    for kind, count in seen.items():
        if count > _SHOWN:
            common.say(f"and {count - _SHOWN} more of {kind}: --json lists all")


def _lines(found: Inspection, summary: dict[str, Any]) -> list[str]:
    tare, first = found.tare, summary["start"]
    lines = [
        f"{summary['rows']} rows over {summary['duration']:.4g} s, {found.rate:.5g} a second; "
        f"{summary['usable_rows']} usable",
        *found.notes,
    ]
    if tare is None:
        return [*lines, "no tare: see the findings"]
    rest = ", ".join(
        f"{start - first:.3g} s to {stop - first:.3g} s ({count} rows)"
        for (start, stop), count in zip(tare.intervals, tare.counts, strict=True)
    )
    lines.append(f"tare {tare.found}" + (f": {rest}" if rest else ""))
    if tare.mount is not None:
        x, y, z = (1e3 * part for part in tare.mount.center)
        how = "estimated" if tare.mount.estimated else "given"
        lines.append(
            f"mount, {how}: {1e3 * tare.mount.mass:.4g} g at ({x:.3g}, {y:.3g}, {z:.3g}) mm "
            "of the sensor frame"
        )
    if math.isfinite(found.single_contact_misfit):
        lines.append(
            f"m0·f0 = 0 is violated by {found.single_contact_misfit:.2f} standard deviations in "
            "the median (0.67 is noise alone)"
        )
    return lines
