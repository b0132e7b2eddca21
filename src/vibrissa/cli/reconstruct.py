"""`vibrissa reconstruct`: from a recording to contacts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import vibrissa as vb
from vibrissa.cli import common
from vibrissa.cli.progress import reporting

_NOISE_ONLY = (
    "error bars hold noise only: state how well rod, clamp, gains and clocks are known in "
    "[tolerances] of the setup, or calibrate it"
)
_SAG = 2e-3  # of the rod's length: 0.1 mm on 50 mm, twice the accuracy of smoothed contacts


def reconstruct(
    recording: Annotated[
        Path,
        typer.Argument(
            help="Sensor log: CSV, Parquet, HDF5, NetCDF, .mat, rosbag2 or MCAP.",
        ),
    ],
    setup: common.SetupFile,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            help="Contacts to write: .ply, .csv, .nc, .parquet, .vtp (ParaView), .pcd (PCL), "
            ".mcap (ROS) or .mat; repeatable.",
            callback=common.written(),
        ),
    ] = None,
    figure: common.Figure = None,
    friction: common.Friction = None,
    smooth: Annotated[
        bool,
        typer.Option(
            "--smooth", help="Smooth the contacts along the sweep; needs the sensor's noise."
        ),
    ] = False,
    find_friction: Annotated[
        bool,
        typer.Option("--estimate-friction", help="Estimate friction from how the contacts move."),
    ] = False,
    as_json: common.AsJson = False,
) -> None:
    """Find where the rod touched, from a recording of forces and torques alone."""
    with reporting() as report:
        report("reading")
        loaded = vb.load_setup(setup, progress=report.count)
        if smooth and loaded.sensor.force_noise is None:
            raise vb.io.InputError(
                f"--smooth: {setup} gives no noise; allowed is a [sensor] with force_noise and "
                "torque_noise"
            )
        reactions = vb.read_recording(recording, loaded)
        report("reconstructing")
        found = vb.reconstruct(loaded.rod, reactions, friction=friction)
        estimated = _estimated(found) if find_friction else {}
        if smooth:
            report("smoothing")
            found = vb.smooth(found, progress=report.count)
        for path in output or []:
            report(f"writing {path}")
            vb.write_contacts(path, found, progress=report.count)
    common.doubt_contacts(found)
    warnings = list(dict.fromkeys([*common.contradictions, *found.warnings]))
    summary = _summary(found) | estimated | {"warnings": warnings}
    files = list(output or [])
    if figure is not None:
        with reporting() as report:
            report(f"drawing {figure}")
            files += [figure] * common.draw(figure, lambda: vb.plot.contacts_figure(found))
    last = _last_line(found) + common.into(*files)
    common.show(summary, lambda said: f"{_text(said)}\n{last}", as_json=as_json)
    if figure is not None and figure not in files:
        raise typer.Exit(1)


def _last_line(found: vb.Reconstruction) -> str:
    import numpy as np  # noqa: PLC0415

    contact = found.in_contact
    sound = contact & (found.status == vb.Status.OK)
    deviation = None
    factor, unit = (1e3, "mm") if found.rod.units == "SI" else (1.0, "L")
    if found.covariance is not None and contact.any():
        # Of the contacts that can be trusted, if there are any.
        rows = sound if sound.any() else contact
        spread = np.sqrt(np.trace(found.covariance[rows], axis1=-2, axis2=-1))
        deviation = factor * float(np.median(spread))
    return common.contacts_line(int(contact.sum()), int(sound.sum()), deviation, unit)


def _summary(found: vb.Reconstruction) -> dict[str, Any]:
    import numpy as np  # noqa: PLC0415

    contact, rod = found.in_contact, found.rod
    summary: dict[str, Any] = {"samples": found.kind.size, **common.counts_of(found)}
    if found.friction is not None:
        summary["friction"] = found.friction
        summary["normal_half_angle"] = found.normal_half_angle
    notes = []
    if found.covariance is not None:
        if contact.any():
            summary["unit"] = rod.unit_of("length")
            deviations = np.sqrt(np.linalg.eigvalsh(found.covariance[contact]))
            summary["median_standard_deviations"] = np.median(deviations, axis=0).tolist()
            residual = found.single_contact_residual[contact]
            square = np.mean(residual[np.isfinite(residual)] ** 2)
            summary["single_contact_residual_rms"] = float(np.sqrt(square))
        if found.reactions.setup_errors is None:
            notes.append(_NOISE_ONLY)
    sag = rod.own_sag()
    if sag is not None and sag > _SAG * rod.length:
        notes.append(
            "the rod's own weight, which is left out, bends it by "
            f"{'' if rod.linear_density else 'at least '}{1e3 * sag:.2g} mm where it lies level: "
            "keep it upright, or allow for it with clamp_orientation in [tolerances]"
        )
    if notes:
        summary["notes"] = notes
    if found.smoothing is not None:
        summary["contacts"] = [_touch(found, touch) for touch in found.smoothing[0].touches]
        summary["outliers"] = int(found.smoothing[0].outlier.sum())
    return summary


def _touch(found: vb.Reconstruction, touch: vb.Touch) -> dict[str, Any]:
    """Times [s], or sample numbers if the recording has no time."""
    time = range(found.kind.size) if found.reactions.time is None else found.reactions.time
    names = ("start", "start_deviation", "end", "end_deviation")
    return {name: getattr(touch, name) for name in names} | {
        name: [float(time[row]) for row in getattr(touch, name)] for name in ("changes", "jumps")
    }


def _estimated(found: vb.Reconstruction) -> dict[str, Any]:
    try:
        estimate = vb.estimate_friction(found)
    except ValueError as error:
        return {"friction_estimate": None, "friction_estimate_fails": str(error)}
    return {
        "friction_estimate": estimate.friction,
        "friction_standard_error": estimate.standard_error,
        "friction_window": estimate.window,
    }


def _text(summary: dict[str, Any]) -> str:
    lines = [f"{summary['samples']} samples: {common.listed(summary['kinds'])}"]
    lines += common.status_lines(summary["status"])
    if "unit" in summary:
        factor, unit = (1e3, "mm") if summary["unit"] == "m" else (1.0, "L")
        deviations = summary["median_standard_deviations"]
        shown = ", ".join(f"{factor * value:.3g}" for value in deviations)
        lines += [
            f"standard deviations of the points along their axes, median: {shown} {unit}",
            f"m0·f0 = 0 is violated by {summary['single_contact_residual_rms']:.2f} standard "
            "deviations (rms; 1 is noise alone)",
        ]
    if "contacts" in summary:
        lines += map(_contact_line, summary["contacts"])
        lines.append(f"{summary['outliers']} outliers")
    lines += summary.get("notes", [])
    if "normal_half_angle" in summary:
        lines.append(
            f"the object's normals lie within {summary['normal_half_angle']:.4g} rad of the "
            "contact forces"
        )
    if "friction_estimate_fails" in summary:
        lines.append(f"friction cannot be estimated: {summary['friction_estimate_fails']}")
    elif "friction_estimate" in summary:
        lines.append(
            f"friction from how the contacts move: {summary['friction_estimate']:.3f} ± "
            f"{summary['friction_standard_error']:.3f} (motions over "
            f"{summary['friction_window']} samples)"
        )
    return "\n".join(lines)


def _contact_line(contact: dict[str, Any]) -> str:
    def instant(name: str, otherwise: str) -> str:
        time, deviation = contact[name], contact[f"{name}_deviation"]
        return otherwise if time is None else f"{time:.4f} ± {deviation:.4f} s"

    start = instant("start", "before the first sample")
    line = f"contact from {start} to {instant('end', 'after the last sample')}"
    for name, word in (("changes", "changes of phase"), ("jumps", "jumps")):
        if contact[name]:
            line += f"; {word} at " + ", ".join(f"{time:.3f}" for time in contact[name]) + " s"
    return line
