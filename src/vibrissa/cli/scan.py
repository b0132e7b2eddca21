"""`vibrissa scan`: from a case file to support reactions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import vibrissa as vb
from vibrissa.cli import common
from vibrissa.cli.progress import reporting


def scan(
    case: common.CaseFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="NetCDF file to write.", callback=common.written(".nc")
        ),
    ] = None,
    figure: common.Figure = None,
    speed: Annotated[
        float | None,
        typer.Option(
            help="Clamp speed [m/s]: is the sweep quasi-static?", callback=common.positive
        ),
    ] = None,
    as_json: common.AsJson = False,
) -> None:
    """Sweep a rod along an object: equilibria, support reactions and events."""
    loaded = vb.load_case(case)
    if speed is not None and loaded.rod.linear_density is None:
        raise vb.io.InputError(
            f"{case}: rod.density: missing; allowed is a number greater than 0, needed for --speed"
        )
    with reporting() as report:
        report("loading")
        _check_start(case, loaded)
        report("scanning")
        result = vb.scan(
            loaded.rod,
            loaded.surface,
            loaded.trail,
            friction=loaded.friction,
            finite_radius=loaded.finite_radius,
        )
        if output is not None:
            report("writing")
            vb.io.write_dataset(output, result.to_dataset())
        if figure is not None:
            several = result.kind.ndim == 2
            along = vb.plot.reactions_over_plane if several else vb.plot.reactions_along
            common.draw(figure, lambda: along(result))
    common.show(_summary(result, speed), lambda said: _text(result, said), as_json=as_json)
    if not result.solved.any():
        raise typer.Exit(1)


def _check_start(case: Path, loaded: vb.Case) -> None:
    """A rod clamped inside the object at the start of a trail is a mistake in the case, not a
    failed row.
    """
    starts = loaded.trail.position.reshape(-1, loaded.trail.count, 3)[:, 0]
    for lane, level in enumerate(loaded.surface.levels(starts)):
        if level < 0:
            raise vb.io.InputError(
                f"{case}: trail[{lane}] starts at {starts[lane].tolist()}, where the rod is "
                "clamped inside the object; allowed is outside"
            )


def _summary(result: vb.Scan, speed: float | None) -> dict[str, Any]:
    import numpy as np  # noqa: PLC0415

    force = np.linalg.norm(result.reactions.force, axis=-1)
    summary = {
        "positions": result.kind.size,
        "friction": result.friction,
        "motions": common.counted(result.motion, vb.Motion),
        **common.counts_of(result),
        "largest_force": float(np.nanmax(force)) if np.isfinite(force).any() else None,
        "events": [
            vars(event)
            | {
                "kind": event.kind.name,
                "clamp": event.clamp.tolist(),
                "point": event.point.tolist(),
            }
            for event in result.events
        ],
    }
    if speed is not None:
        validity = result.quasi_static(speed)
        names = ("natural_frequency", "sweep_frequency", "ratio", "holds")
        summary["quasi_static"] = {name: getattr(validity, name) for name in names}
    return summary


def _text(result: vb.Scan, summary: dict[str, Any]) -> str:
    lines = [f"{summary['positions']} positions: {common.listed(summary['kinds'])}"]
    if result.friction > 0:
        moving = {name: count for name, count in summary["motions"].items() if name != "NONE"}
        lines.append(f"friction {result.friction:g}: {common.listed(moving)}")
    if summary["largest_force"] is not None:
        unit = result.rod.unit_of("force").replace("1", "EI/L²")
        lines.append(f"largest support force {summary['largest_force']:.6g} {unit}")
    lines += common.status_lines(summary["status"])
    for event in result.events:
        place = ", ".join(f"{value:.9g}" for value in event.clamp)
        lines.append(
            f"trail {event.trail}: {event.kind.name} at {event.parameter:.9f} of it, "
            f"clamp ({place})"
        )
    validity = summary.get("quasi_static")
    if validity:
        verdict = "holds" if validity["holds"] else "does not hold"
        lines.append(
            f"quasi-static assumption {verdict}: first natural frequency "
            f"{validity['natural_frequency']:.4g} Hz, reactions change at "
            f"{validity['sweep_frequency']:.4g} 1/s, ratio {validity['ratio']:.2g}"
        )
    return "\n".join(lines)
