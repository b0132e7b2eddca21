"""`vibrissa scan`: from a case file to support reactions."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer

import vibrissa as vb
from vibrissa.cli import common
from vibrissa.cli.progress import reporting

_SHOWN = 6
_DEEP = 20.0
"""Rod lengths: no object is so large beside its rod, unless it is in millimetres."""


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
    with reporting() as report:
        report("loading")
        loaded = vb.load_case(case, progress=report.count)
        if speed is not None and loaded.rod.linear_density is None:
            raise vb.io.InputError(
                f"{case}: rod.density: missing; allowed is a number greater than 0, needed for "
                "--speed"
            )
        _check_start(case, loaded)
        report("scanning")
        result = vb.scan(
            loaded.rod,
            loaded.surface,
            loaded.trail,
            friction=loaded.friction,
            finite_radius=loaded.finite_radius,
            progress=report.count,
        )
        if output is not None:
            report("writing")
            vb.io.write_dataset(output, result.to_dataset())
    contact = result.in_contact
    sound = contact & (result.status == vb.Status.OK)
    found = int(contact.sum()), int(sound.sum())
    common.doubt(*found, common.counted(result.status[contact], vb.Status), [], _missed(loaded))
    files = [] if output is None else [output]
    if figure is not None:
        with reporting() as report:
            report("drawing")
            several = result.kind.ndim == 2
            along = vb.plot.reactions_over_plane if several else vb.plot.reactions_along
            files += [figure] * common.draw(figure, lambda: along(result))
    last = common.contacts_line(*found) + common.into(*files)
    common.show(
        _summary(result, speed), lambda said: f"{_text(result, said)}\n{last}", as_json=as_json
    )
    if not result.solved.any() or (figure is not None and figure not in files):
        raise typer.Exit(1)


def _check_start(case: Path, loaded: vb.Case) -> None:
    """A rod clamped inside the object at the start of a trail is a mistake in the case, not a
    failed row.
    """
    starts = loaded.trail.position.reshape(-1, loaded.trail.count, 3)[:, 0]
    for lane, level in enumerate(loaded.surface.levels(starts)):
        if level < 0:
            deep = -level > _DEEP * loaded.rod.length
            hint = f"; it is {-level:.3g} deep there: in millimetres?" if deep else ""
            raise vb.io.InputError(
                f"{case}: trail[{lane}] starts at {starts[lane].tolist()}, where the rod is "
                f"clamped inside the object; allowed is outside{hint}"
            )


def _missed(loaded: vb.Case) -> str:
    """Why the rod may have touched nothing: its length against its distance from the object."""
    unit = loaded.rod.unit_of("length").replace("1", "L")
    nearest = float(loaded.surface.distances(loaded.trail.position.reshape(-1, 3)).min())
    text = f"the clamp comes no closer than {nearest:.3g} {unit} to the object"
    if nearest > loaded.rod.length:
        return (
            f"{text}, and the rod is {loaded.rod.length:.3g} {unit} long: is a length or a place "
            "in millimetres?"
        )
    return f"{text}, which the rod could reach: check the trail's axis and where it runs"


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


def _event_lines(result: vb.Scan) -> list[str]:
    """Events by kind, and the first few one by one."""
    kinds = Counter(event.kind.name for event in result.events)
    lines = [f"{len(result.events)} events: {common.listed(kinds)}"] if kinds else []
    for event in result.events[:_SHOWN]:
        place = ", ".join(f"{value:.9g}" for value in event.clamp)
        lines.append(
            f"trail {event.trail}: {event.kind.name} at {event.parameter:.9f} of it, "
            f"clamp ({place})"
        )
    if len(result.events) > _SHOWN:
        lines.append(f"and {len(result.events) - _SHOWN} more events: --json lists all")
    return lines


def _text(result: vb.Scan, summary: dict[str, Any]) -> str:
    lines = [f"{summary['positions']} positions: {common.listed(summary['kinds'])}"]
    if result.friction > 0:
        moving = {name: count for name, count in summary["motions"].items() if name != "NONE"}
        lines.append(f"friction {result.friction:g}: {common.listed(moving)}")
    if summary["largest_force"] is not None:
        unit = result.rod.unit_of("force").replace("1", "EI/L²")
        lines.append(f"largest support force {summary['largest_force']:.6g} {unit}")
    lines += common.status_lines(summary["status"])
    lines += _event_lines(result)
    validity = summary.get("quasi_static")
    if validity:
        verdict = "holds" if validity["holds"] else "does not hold"
        lines.append(
            f"quasi-static assumption {verdict}: first natural frequency "
            f"{validity['natural_frequency']:.4g} Hz, reactions change at "
            f"{validity['sweep_frequency']:.4g} 1/s, ratio {validity['ratio']:.2g}"
        )
    return "\n".join(lines)
