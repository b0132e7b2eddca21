"""`vibrissa calibrate`: from recordings over a known object to a calibrated setup."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import vibrissa as vb
from vibrissa.cli import common
from vibrissa.cli.progress import reporting

if TYPE_CHECKING:
    from vibrissa.calibration import Calibration

_FIGURES = (
    "residuals_over_time",
    "residual_histogram",
    "residuals_over_force",
    "parameter_correlation",
)


def calibrate(
    recordings: Annotated[
        list[Path],
        typer.Argument(help="Sensor logs, each starting free of contact."),
    ],
    setup: Annotated[
        Path,
        typer.Option(
            help="TOML file with [rod], [sensor] and, if it is known, the swept [object]."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Calibrated setup to write (.toml).",
            callback=common.written(".toml"),
        ),
    ] = None,
    free: Annotated[
        str | None,
        typer.Option(
            help="What to calibrate, NAME,NAME,...; by default rod, clamp, tare and drift."
        ),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(help="NAME=DEVIATION of a free parameter, SI units; repeatable."),
    ] = None,
    friction: Annotated[
        float, typer.Option(help="Coulomb friction coefficient: 0 for none.")
    ] = 0.0,
    report: Annotated[
        Path | None, typer.Option(help="Folder for figures of the residuals and a summary.")
    ] = None,
    as_json: common.AsJson = False,
) -> None:
    """Find the rod's stiffness, length and mount from sweeps over an object, preferably a known
    one.
    """
    from vibrissa.files import writable_folder  # noqa: PLC0415
    from vibrissa.io.calibration import source_document  # noqa: PLC0415
    from vibrissa.io.calibration_report import summary, write_summary  # noqa: PLC0415

    if report is not None:
        writable_folder(report)
    places = [recording.resolve() for recording in recordings]
    for recording, place in zip(recordings, places, strict=True):
        if places.count(place) > 1:
            raise vb.io.InputError(f"{recording}: is given twice; allowed is each recording once")
    priors = _priors(prior or [])
    names = None if free is None else [name.strip() for name in free.split(",")]
    with reporting() as step:
        step("reading")
        loaded = vb.load_setup(setup, progress=step.count)
        if output is not None:
            source_document(setup)
        reactions = [vb.read_recording(recording, loaded) for recording in recordings]
        step("calibrating")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", vb.RecordingWarning)
                found = vb.calibrate(
                    reactions,
                    loaded,
                    free=names,
                    prior=priors,
                    friction=friction,
                    progress=step.count,
                )
        except vb.CalibrationError as error:
            common.say(f"vibrissa: error: {_named(str(error), recordings)}", err=True)
            raise typer.Exit(1) from None
        except ValueError as error:
            raise vb.io.InputError(str(error)) from error
        found = replace(found, warnings=[_named(line, recordings) for line in found.warnings])
        for line in found.warnings:
            warnings.warn(line, vb.RecordingWarning, stacklevel=1)
        step("writing")
        if output is not None:
            vb.io.write_calibration(output, found, setup, recordings)
        if report is not None:
            write_summary(report, found)
            for name in _FIGURES:
                common.draw(report / f"{name}.png", partial(getattr(vb.plot, name), found))
    files = [path for path in (output, report) if path is not None]
    ratio = found.fitness.reduced_chi_square**0.5
    last = (
        f"{common.count_of(len(found.estimates), 'parameter')} from "
        f"{common.count_of(len(recordings), 'recording')}, residuals {ratio:.2f} times the noise"
        + common.into(*files)
    )
    common.show(summary(found), lambda _: f"{_text(found)}\n{last}", as_json=as_json)


def _priors(texts: list[str]) -> dict[str, float]:
    priors: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name.strip() in priors:
            raise vb.io.InputError(
                f"--prior = {text!r}: {name.strip()!r} is given twice; allowed is each once"
            )
        try:
            priors[name.strip()] = float(value)
        except ValueError:
            raise vb.io.InputError(
                f"--prior = {text!r}; allowed is NAME=DEVIATION with a number"
            ) from None
    return priors


def _named(text: str, recordings: list[Path]) -> str:
    """The text with file names in place of recording numbers."""
    for index, recording in enumerate(recordings):
        text = text.replace(f"recordings[{index}]", str(recording))
    return text


def _text(found: Calibration[Any]) -> str:
    from vibrissa.io.calibration_report import findings, table  # noqa: PLC0415

    columns = []
    for column, cells in enumerate(zip(*table(found), strict=True)):
        width = max(map(len, cells))
        columns.append([f"{cell:{'>' if column > 1 else '<'}{width}}" for cell in cells])
    lines = ["  ".join(row).rstrip() for row in zip(*columns, strict=True)]
    return "\n".join(lines + findings(found))
