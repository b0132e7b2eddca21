"""`vibrissa calibrate`: recordings over a known object to a calibrated setup."""

import json
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from vibrissa.calibration import Calibration


def calibrate(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            help="Logs of the sensor, each with a start free of contact.", show_default=False
        ),
    ],
    setup: Annotated[
        Path,
        typer.Option(
            "--setup",
            help="TOML file with [rod], [sensor] and, where it is known, the swept [object].",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Calibrated setup to write (.toml).")
    ] = None,
    free: Annotated[
        str | None,
        typer.Option(
            "--free",
            help="What to calibrate, NAME,NAME,...; by default rod, clamp, tare and drift.",
        ),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            "--prior", help="NAME=DEVIATION of a free parameter, SI units; may be given again."
        ),
    ] = None,
    friction: Annotated[
        float, typer.Option("--friction", help="Coulomb's coefficient: 0 for none.")
    ] = 0.0,
    report: Annotated[
        Path | None,
        typer.Option("--report", help="Folder for figures of the residuals and a summary."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Find stiffness, length and mount of the rod from sweeps over an object, best over one that is
    known.
    """
    from vibrissa.cli.progress import reporting  # noqa: PLC0415
    from vibrissa.contacts import RecordingWarning  # noqa: PLC0415
    from vibrissa.files import InputError, writable_folder  # noqa: PLC0415
    from vibrissa.io.calibration import source_document, write_calibration  # noqa: PLC0415
    from vibrissa.io.calibration_report import summary  # noqa: PLC0415
    from vibrissa.io.contacts import checked_output  # noqa: PLC0415
    from vibrissa.io.recordings.read import read_recording  # noqa: PLC0415
    from vibrissa.io.setup import load_setup  # noqa: PLC0415

    if output is not None:
        checked_output(output, (".toml",))
    if report is not None:
        writable_folder(report)
    places = [recording.resolve() for recording in recordings]
    for recording, place in zip(recordings, places, strict=True):
        if places.count(place) > 1:
            raise InputError(f"{recording}: is given twice; allowed is each recording once")
    loaded = load_setup(setup)
    if output is not None:
        source_document(setup)
    priors = _priors(prior or [])
    reactions = [read_recording(recording, loaded) for recording in recordings]
    names = None if free is None else [name.strip() for name in free.split(",")]
    with reporting() as step:
        step("loading")
        from vibrissa.calibration import CalibrationError  # noqa: PLC0415
        from vibrissa.calibration import calibrate as run  # noqa: PLC0415

        step("calibrating")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RecordingWarning)
                found = run(reactions, loaded, free=names, prior=priors, friction=friction)
        except CalibrationError as error:
            print(f"vibrissa: error: {_named(str(error), recordings)}", file=sys.stderr)  # noqa: T201
            raise typer.Exit(1) from None
        except ValueError as error:
            raise InputError(str(error)) from error
        found = replace(found, warnings=[_named(line, recordings) for line in found.warnings])
        for line in found.warnings:
            warnings.warn(line, RecordingWarning, stacklevel=1)
        step("writing")
        if output is not None:
            write_calibration(output, found, setup, recordings)
        if report is not None:
            _write_report(report, found)
    typer.echo(json.dumps(summary(found), indent=1) if as_json else _text(found))


def _priors(texts: list[str]) -> dict[str, float]:
    from vibrissa.files import InputError  # noqa: PLC0415

    priors: dict[str, float] = {}
    for text in texts:
        name, deviation = _prior(text)
        if name in priors:
            raise InputError(f"--prior = {text!r}: {name!r} is given twice; allowed is each once")
        priors[name] = deviation
    return priors


def _prior(text: str) -> tuple[str, float]:
    from vibrissa.files import InputError  # noqa: PLC0415

    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise InputError(f"--prior = {text!r}; allowed is NAME=DEVIATION with a number") from None


def _named(text: str, recordings: list[Path]) -> str:
    """Files in place of their numbers."""
    for index, recording in enumerate(recordings):
        text = text.replace(f"recordings[{index}]", str(recording))
    return text


def _text(found: "Calibration[Any]") -> str:
    from vibrissa.io.calibration_report import findings, table  # noqa: PLC0415

    rows = table(found)
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = [
        "  ".join(
            cell.rjust(width) if column > 1 else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]
    return "\n".join([line.rstrip() for line in lines] + findings(found))


def _write_report(folder: Path, found: "Calibration[Any]") -> None:
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("Agg")
    from vibrissa import plot  # noqa: PLC0415
    from vibrissa.io.calibration_report import write_summary  # noqa: PLC0415

    write_summary(folder, found)
    with plot.journal():
        plot.save_as(plot.residuals_over_time(found), folder / "residuals_over_time.png")
        plot.save_as(plot.residual_histogram(found), folder / "residual_histogram.png")
        plot.save_as(plot.residuals_over_force(found), folder / "residuals_over_force.png")
        plot.save_as(plot.parameter_correlation(found), folder / "parameter_correlation.png")
