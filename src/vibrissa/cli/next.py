"""`vibrissa next`: which sweep to drive next."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import vibrissa as vb
from vibrissa.cli import common
from vibrissa.cli.progress import reporting

if TYPE_CHECKING:
    from vibrissa.shape import NextSweep, Shape

_SHOWN = 5


def next_(
    shape: Annotated[
        Path,
        typer.Argument(
            help="What is known so far: .ply of `vibrissa fit`, or contacts.", metavar="SHAPE"
        ),
    ],
    case: Annotated[
        Path,
        typer.Argument(
            help="TOML file whose [rod] will be swept along one of its [[trail]]s; the shape takes "
            "the place of its [object].",
            metavar="CASE",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Poses of the best, .csv.", callback=common.written(".csv")
        ),
    ] = None,
    around: Annotated[
        bool,
        typer.Option(
            "--around", help="Each trail from sixty stands all around the object's middle."
        ),
    ] = False,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Distance [m] within which the surface is to be known; by default, the mean "
            "deviation counts.",
            callback=common.positive,
        ),
    ] = None,
    clearance: Annotated[
        float, typer.Option(help="Distance [m] that the clamp keeps from the object.", min=0)
    ] = 0.0,
    as_json: common.AsJson = False,
) -> None:
    """Rank sweeps by the uncertainty of a surface that they are expected to take away."""
    with reporting() as report:
        report("loading")
        loaded = vb.load_case(case, progress=report.count)
        known = vb.io.read_shape(shape)
        trails = _around(loaded.trail, known) if around else loaded.trail
        report("planning")
        try:
            ranked = vb.next_sweep(
                known,
                loaded.rod,
                trails,
                tolerance=tolerance,
                clearance=clearance,
                friction=loaded.friction,
            )
            if output is not None:
                ranked.best.to_csv(output)
        except ValueError as error:
            raise vb.io.InputError(f"{case}: {error}") from error
    files = [] if output is None else [output]
    summary = _summary(ranked, tolerance)
    common.show(summary, lambda said: _text(said) + common.into(*files), as_json=as_json)


def _around(trail: vb.Trail, shape: Shape) -> vb.Trail:
    """The trails turned about the contacts' middle by the rotations of an icosahedron."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415

    middle = (shape.sites.touched.min(axis=0) + shape.sites.touched.max(axis=0)) / 2
    turns = Rotation.create_group("I")
    return vb.Trail.stack([trail.placed(turn, middle - turn.apply(middle)) for turn in turns])


def _summary(ranked: NextSweep, tolerance: float | None) -> dict[str, Any]:
    return {
        "candidates": len(ranked.order),
        "refused": int((ranked.status != vb.Status.OK).sum()),
        "unknown": ranked.unknown,
        "tolerance": tolerance,
        "best": [
            {
                "trail": int(row),
                "gain": float(ranked.gain[row]),
                "start": ranked.candidates.position[row, 0].tolist(),
                "stop": ranked.candidates.position[row, -1].tolist(),
                "status": vb.Status(ranked.status[row]).name,
                "touches": bool(len(ranked.contacts[row])),
            }
            for row in ranked.order[:_SHOWN]
        ],
    }


def _text(summary: dict[str, Any]) -> str:
    within = summary["tolerance"]
    what = (
        f"mean deviation {summary['unknown']:.2g} m"
        if within is None
        else f"{100 * summary['unknown']:.3g} % not known to {within:.2g} m"
    )
    lines = [f"{what}; {summary['candidates']} sweeps, {summary['refused']} of them refused"]
    for each in summary["best"]:
        start, stop = ([round(1e3 * x, 1) for x in each[end]] for end in ("start", "stop"))
        gain = f"{100 * each['gain']:.3g} %" if within else f"{each['gain']:.2g} m"
        lines.append(
            f"  trail {each['trail']}, {start} to {stop} mm: less {gain}"
            + ("" if each["status"] == "OK" else f" ({each['status']})")
            + ("" if each["touches"] else ", touches nothing")
        )
    return "\n".join(lines)
