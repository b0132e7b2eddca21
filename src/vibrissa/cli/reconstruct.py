"""`vibrissa reconstruct`: a recording to contacts."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vibrissa.inverse import Reconstruction, Touch

_NOISE_ONLY = "error bars hold noise only: state how well rod, clamp, gains and clocks are known in [tolerances] of the setup, or calibrate it"

_SAG = 2e-3
"""Of the rod's length: 0.1 mm on 50 mm, twice what smoothed contacts are known to."""


def reconstruct(
    recording: Annotated[
        Path,
        typer.Argument(
            help="Log of the sensor: CSV, Parquet, HDF5, NetCDF, .mat, rosbag2 or MCAP.",
            show_default=False,
        ),
    ],
    setup: Annotated[
        Path, typer.Option("--setup", help="TOML file with [rod] and [sensor].", show_default=False)
    ],
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output", "-o", help="Contacts to write: .ply, .csv or .nc; may be given again."
        ),
    ] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Figure to write (PNG or PDF).")
    ] = None,
    friction: Annotated[
        float | None,
        typer.Option(
            "--friction", help="Coulomb's coefficient: 0 for none; left out where it is not known."
        ),
    ] = None,
    smooth: Annotated[
        bool,
        typer.Option(
            "--smooth", help="Smooth the contacts along the sweep; needs the sensor's noise."
        ),
    ] = False,
    find_friction: Annotated[
        bool, typer.Option("--estimate-friction", help="Estimate it from how the contacts move.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Find where the rod touched, from a recording of forces and torques alone."""
    from vibrissa.cli.progress import reporting  # noqa: PLC0415
    from vibrissa.cli.said import listening  # noqa: PLC0415
    from vibrissa.io.contacts import checked_output, write_contacts  # noqa: PLC0415
    from vibrissa.io.errors import InputError  # noqa: PLC0415
    from vibrissa.io.recordings.read import read_recording  # noqa: PLC0415
    from vibrissa.io.setup import load_setup  # noqa: PLC0415

    for path in output or []:
        checked_output(path)
    if figure is not None:
        checked_output(figure, (".png", ".pdf"))
    if friction is not None and not 0 <= friction < float("inf"):
        raise InputError(f"--friction = {friction}; allowed is a finite number of at least 0")
    loaded = load_setup(setup)
    if smooth and loaded.sensor.force_noise is None:
        raise InputError(
            f"--smooth: {setup} gives no noise; allowed is a [sensor] with force_noise and torque_noise"
        )
    with listening() as said, reporting() as report:
        report("reading")
        reactions = read_recording(recording, loaded)
        report("loading")
        from vibrissa.inverse import reconstruct as run  # noqa: PLC0415

        report("reconstructing")
        found = run(loaded.rod, reactions, friction=friction)
        estimated = _estimated(found) if find_friction else {}
        if smooth:
            from vibrissa.inverse import smooth as smoothed  # noqa: PLC0415

            report("smoothing")
            found = smoothed(found, progress=lambda done, count: report.share(done / count))
        for path in output or []:
            report(f"writing {path}")
            write_contacts(path, found, progress=report.share)
        if figure is not None:
            report(f"drawing {figure}")
            _draw(found, figure)
    summary = (
        _summary(found) | estimated | {"warnings": list(dict.fromkeys([*said, *found.warnings]))}
    )
    typer.echo(json.dumps(summary, indent=1) if as_json else _text(summary))


def _summary(found: "Reconstruction") -> dict[str, object]:
    import numpy as np  # noqa: PLC0415

    from vibrissa.contacts import ContactKind, Status  # noqa: PLC0415

    contact = found.in_contact
    summary: dict[str, object] = {
        "samples": found.kind.size,
        "kinds": {kind.name: int(np.sum(found.kind == kind)) for kind in ContactKind},
        "status": {
            status.name: int(np.sum(found.status == status))
            for status in Status
            if np.any(found.status == status)
        },
    }
    if found.friction is not None:
        summary["friction"] = found.friction
        summary["normal_half_angle"] = found.normal_half_angle
    if found.covariance is not None and contact.any():
        summary["unit"] = found.rod.unit_of("length")
        deviations = np.sqrt(np.linalg.eigvalsh(found.covariance[contact]))
        summary["median_standard_deviations"] = np.median(deviations, axis=0).tolist()
        residual = found.single_contact_residual[
            contact & np.isfinite(found.single_contact_residual)
        ]
        summary["single_contact_residual_rms"] = float(np.sqrt(np.mean(residual**2)))
    notes = (
        [_NOISE_ONLY]
        if found.covariance is not None and found.reactions.setup_errors is None
        else []
    )
    sag = found.rod.own_sag()
    if sag is not None and sag > _SAG * found.rod.length:
        notes.append(
            f"the rod's own weight, which is left out, bends it by {'' if found.rod.linear_density else 'at least '}{1e3 * sag:.2g} mm where it lies level: "
            "keep it upright, or allow for it with clamp_orientation in [tolerances]"
        )
    if notes:
        summary["notes"] = notes
    if found.smoothing is not None:
        summary["contacts"] = [_touch(found, touch) for touch in found.smoothing[0].touches]
        summary["outliers"] = int(found.smoothing[0].outlier.sum())
    return summary


def _touch(found: "Reconstruction", touch: "Touch") -> dict[str, object]:
    """Times [s], or numbers of samples where the recording has no time."""
    import numpy as np  # noqa: PLC0415

    time = np.arange(found.kind.size) if found.reactions.time is None else found.reactions.time
    names = ("start", "start_deviation", "end", "end_deviation")
    times = {
        name: [float(time[row]) for row in getattr(touch, name)] for name in ("changes", "jumps")
    }
    return {name: getattr(touch, name) for name in names} | times


def _estimated(found: "Reconstruction") -> dict[str, object]:
    from vibrissa.inverse import estimate_friction  # noqa: PLC0415

    try:
        estimate = estimate_friction(found)
    except ValueError as error:
        return {"friction_estimate": None, "friction_estimate_fails": str(error)}
    return {
        "friction_estimate": estimate.friction,
        "friction_standard_error": estimate.standard_error,
        "friction_window": estimate.window,
    }


def _text(summary: dict[str, object]) -> str:
    from vibrissa.contacts import Status  # noqa: PLC0415

    kinds, status = summary["kinds"], summary["status"]
    assert isinstance(kinds, dict)
    assert isinstance(status, dict)
    lines = [
        f"{summary['samples']} samples: "
        + ", ".join(f"{count} {name.lower()}" for name, count in kinds.items())
    ]
    lines += [
        f"{count} rows {name}: {Status[name].text}"
        for name, count in status.items()
        if name != "OK"
    ]
    deviations = summary.get("median_standard_deviations")
    if isinstance(deviations, list):
        factor, unit = (1e3, "mm") if summary["unit"] == "m" else (1.0, "L")
        shown = ", ".join(f"{factor * value:.3g}" for value in deviations)
        lines.append(f"standard deviations of the points along their axes, median: {shown} {unit}")
        lines.append(
            f"m0·f0 = 0 is violated by {summary['single_contact_residual_rms']:.2f} standard deviations (rms; 1 is noise alone)"
        )
    contacts = summary.get("contacts")
    if isinstance(contacts, list):
        lines += [_contact_line(contact) for contact in contacts]
        lines.append(f"{summary['outliers']} outliers")
    notes = summary.get("notes")
    lines += notes if isinstance(notes, list) else []
    if "normal_half_angle" in summary:
        lines.append(
            f"the object's normals lie within {summary['normal_half_angle']:.4g} rad of the contact forces"
        )
    if "friction_estimate" in summary:
        lines.append(_friction_line(summary))
    return "\n".join(lines)


def _contact_line(contact: dict[str, object]) -> str:
    def instant(name: str, otherwise: str) -> str:
        time, deviation = contact[name], contact[f"{name}_deviation"]
        return otherwise if time is None else f"{time:.4f} ± {deviation:.4f} s"

    line = f"contact from {instant('start', 'before the first sample')} to {instant('end', 'after the last sample')}"
    for name, word in (("changes", "changes of phase"), ("jumps", "jumps")):
        times = contact[name]
        if isinstance(times, list) and times:
            line += f"; {word} at " + ", ".join(f"{time:.3f}" for time in times) + " s"
    return line


def _friction_line(summary: dict[str, object]) -> str:
    if summary["friction_estimate"] is None:
        return f"friction cannot be estimated: {summary['friction_estimate_fails']}"
    return (
        f"friction from how the contacts move: {summary['friction_estimate']:.3f} ± {summary['friction_standard_error']:.3f} "
        f"(motions over {summary['friction_window']} samples)"
    )


def _draw(found: "Reconstruction", path: Path) -> None:
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("Agg")
    from vibrissa import plot  # noqa: PLC0415

    with plot.journal():
        plot.save_as(plot.contacts_figure(found), path)
