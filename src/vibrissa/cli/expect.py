"""`vibrissa expect`: the contact error to expect from a sensor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

import vibrissa as vb
from vibrissa.cli import common
from vibrissa.cli.progress import reporting

if TYPE_CHECKING:
    from vibrissa.design import ExpectedError


def expect(
    case: common.CaseFile,
    sensor: Annotated[str, typer.Option(help="Name of a preset, such as ati_nano17_si_12_0_12.")],
    figure: common.Figure = None,
    rate: Annotated[
        float, typer.Option(help="Samples per second.", callback=common.positive)
    ] = 1000.0,
    speed: Annotated[
        float | None,
        typer.Option(help="Clamp speed [m/s]; without it, no lag.", callback=common.positive),
    ] = None,
    as_json: common.AsJson = False,
) -> None:
    """Map the contact error to expect from a sensor along the trails of a case."""
    from vibrissa.sensor import preset  # noqa: PLC0415

    with reporting() as report:
        report("loading")
        loaded = vb.load_case(case, progress=report.count)
        if loaded.rod.units != "SI":
            raise vb.io.InputError(
                f"{case}: rod.kind = 'unit'; allowed is any other kind: a sensor has units"
            )
        report("scanning")
        try:
            error = vb.expected_error(
                loaded.rod,
                loaded.surface,
                loaded.trail,
                preset(sensor),
                rate=rate,
                speed=speed,
                friction=loaded.friction,
                finite_radius=loaded.finite_radius,
                progress=report.count,
            )
        except ValueError as failure:
            raise vb.io.InputError(str(failure)) from failure
    summary = _summary(error)
    if not summary["detected"]:
        common.warn(
            "no contact is detected: the loads stay below this sensor's noise, or the rod misses "
            "the object; a stiffer rod, a closer trail or a finer sensor helps"
        )
    files = []
    if figure is not None:
        with reporting() as report:
            report("drawing")
            files += [figure] * common.draw(figure, lambda: vb.plot.expected_error_map(error))
    common.show(summary, lambda said: _line(said, sensor) + common.into(*files), as_json=as_json)
    if not summary["detected"]:
        raise typer.Exit(1)


def _summary(error: ExpectedError) -> dict[str, Any]:
    import numpy as np  # noqa: PLC0415

    seen = error.detected
    longest = error.semi_axes[..., -1][seen]
    return {
        "positions": seen.size,
        "contacts": int(error.scan.in_contact.sum()),
        "detected": int(seen.sum()),
        "saturated": int(error.saturated.sum()),
        "median_root_mean_square": float(np.median(error.root_mean_square[seen]))
        if seen.any()
        else None,
        "median_longest_semi_axis": float(np.median(longest)) if seen.any() else None,
        "unit": "m",
    }


def _line(summary: dict[str, Any], sensor: str) -> str:
    text = f"{sensor}: {summary['detected']} of {summary['contacts']} contacts detected"
    if summary["saturated"]:
        text += f", {summary['saturated']} saturated"
    if summary["detected"]:
        text += (
            f", median ±{1e3 * summary['median_root_mean_square']:.2g} mm "
            f"(longest semi-axis at 95 %: {1e3 * summary['median_longest_semi_axis']:.2g} mm)"
        )
    return text
