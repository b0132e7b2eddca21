"""`vibrissa scan`: a case file to support reactions."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vibrissa.forward import Scan
    from vibrissa.io import Case


def scan(
    case: Annotated[
        Path,
        typer.Argument(help="TOML file with [rod], [object] and [[trail]].", show_default=False),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="NetCDF file to write.")
    ] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Figure to write (PNG or PDF).")
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option("--speed", help="Speed of the clamp [m/s]: is the sweep quasi-static?"),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Sweep a rod along an object: equilibria, support reactions and events."""
    from vibrissa.cli.progress import reporting  # noqa: PLC0415
    from vibrissa.io.case import load_case  # noqa: PLC0415
    from vibrissa.io.contacts import checked_output  # noqa: PLC0415

    if output is not None:
        checked_output(output, (".nc",))
    if figure is not None:
        checked_output(figure, (".png", ".pdf"))
    loaded = load_case(case)
    _check_speed(loaded.rod.linear_density, speed, case)
    with reporting() as report:
        report("loading")
        from vibrissa.forward import scan as run  # noqa: PLC0415
        from vibrissa.io.contacts import write_dataset  # noqa: PLC0415

        report("scanning")
        _check_start(case, loaded)
        result = run(
            loaded.rod,
            loaded.surface,
            loaded.trail,
            friction=loaded.friction,
            finite_radius=loaded.finite_radius,
        )
        if output is not None:
            report("writing")
            write_dataset(output, result.to_dataset())
        if figure is not None:
            _draw(result, figure)
    summary = _summary(result, speed)
    typer.echo(json.dumps(summary, indent=1) if as_json else _text(result, summary))
    if not result.solved.any():
        raise typer.Exit(1)


def _check_speed(linear_density: float | None, speed: float | None, case: Path) -> None:
    from vibrissa.io.errors import InputError  # noqa: PLC0415

    if speed is None:
        return
    if not 0 < speed < float("inf"):
        raise InputError(f"--speed = {speed}; allowed is a finite number greater than 0")
    if linear_density is None:
        raise InputError(
            f"{case}: rod.density: missing; allowed is a number greater than 0, needed for --speed"
        )


def _check_start(case: Path, loaded: "Case") -> None:
    """A rod clamped inside the object at the start of a trail is a mistake in the case, not a row
    that fails.
    """
    from vibrissa.io.errors import InputError  # noqa: PLC0415

    starts = loaded.trail.position.reshape(-1, loaded.trail.count, 3)[:, 0]
    for lane, level in enumerate(loaded.surface.levels(starts)):
        if level < 0:
            raise InputError(
                f"{case}: trail[{lane}] starts at {starts[lane].tolist()}, where the rod is clamped inside the object; allowed is outside"
            )


def _summary(result: "Scan", speed: float | None) -> dict[str, object]:
    import numpy as np  # noqa: PLC0415

    from vibrissa.contacts import ContactKind, Motion, Status  # noqa: PLC0415

    force = np.linalg.norm(result.reactions.force, axis=-1)
    summary: dict[str, object] = {
        "positions": result.kind.size,
        "friction": result.friction,
        "motions": {motion.name: int(np.sum(result.motion == motion)) for motion in Motion},
        "kinds": {kind.name: int(np.sum(result.kind == kind)) for kind in ContactKind},
        "status": {
            status.name: int(np.sum(result.status == status))
            for status in Status
            if np.any(result.status == status)
        },
        "largest_force": float(np.nanmax(force)) if np.isfinite(force).any() else None,
        "events": [
            {
                "kind": event.kind.name,
                "trail": event.trail,
                "parameter": event.parameter,
                "clamp": event.clamp.tolist(),
                "point": event.point.tolist(),
            }
            for event in result.events
        ],
    }
    if speed is not None:
        validity = result.quasi_static(speed)
        summary["quasi_static"] = {
            name: getattr(validity, name)
            for name in ("natural_frequency", "sweep_frequency", "ratio", "holds")
        }
    return summary


def _text(result: "Scan", summary: dict[str, object]) -> str:
    from vibrissa.contacts import Status  # noqa: PLC0415

    kinds, status = summary["kinds"], summary["status"]
    assert isinstance(kinds, dict)
    assert isinstance(status, dict)
    force = result.rod.unit_of("force")
    unit = "EI/L²" if force == "1" else force
    lines = [
        f"{summary['positions']} positions: "
        + ", ".join(f"{count} {name.lower()}" for name, count in kinds.items())
    ]
    motions = summary["motions"]
    if result.friction > 0 and isinstance(motions, dict):
        moving = ", ".join(
            f"{count} {name.lower()}" for name, count in motions.items() if name != "NONE"
        )
        lines.append(f"friction {result.friction:g}: {moving}")
    if summary["largest_force"] is not None:
        lines.append(f"largest support force {summary['largest_force']:.6g} {unit}")
    lines += [
        f"{count} rows {name}: {Status[name].text}"
        for name, count in status.items()
        if name != "OK"
    ]
    for event in result.events:
        place = ", ".join(f"{value:.9g}" for value in event.clamp)
        lines.append(
            f"trail {event.trail}: {event.kind.name} at {event.parameter:.9f} of it, clamp ({place})"
        )
    validity = summary.get("quasi_static")
    if isinstance(validity, dict):
        verdict = "holds" if validity["holds"] else "does not hold"
        lines.append(
            f"quasi-static assumption {verdict}: first natural frequency {validity['natural_frequency']:.4g} Hz, "
            f"reactions change at {validity['sweep_frequency']:.4g} 1/s, ratio {validity['ratio']:.2g}"
        )
    return "\n".join(lines)


def _draw(result: "Scan", path: Path) -> None:
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("Agg")
    from vibrissa import plot  # noqa: PLC0415

    with plot.journal():
        axes = (
            plot.reactions_over_plane(result)
            if result.kind.ndim == 2
            else plot.reactions_along(result)
        )
        plot.save_as(axes, path)
