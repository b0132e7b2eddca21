"""`vibrissa fit`: a surface through the contacts of files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import vibrissa as vb
from vibrissa.cli import common
from vibrissa.cli.progress import reporting

if TYPE_CHECKING:
    from vibrissa.shape import Shape, ShapeMesh


def fit(
    contacts: Annotated[
        list[Path],
        typer.Argument(
            help="Contacts as `reconstruct --smooth` writes them, a sweep or more each; best .nc.",
            metavar="CONTACTS...",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="Mesh to write: .ply, .vtp or .glb (with deviations), or .stl.",
            callback=common.written(".ply", ".vtp", ".stl", ".glb"),
        ),
    ],
    figure: common.Figure = None,
    resolution: Annotated[
        float | None,
        typer.Option(
            help="Size of the mesh's cells [m]; by default a sixtieth of the object's.",
            callback=common.positive,
        ),
    ] = None,
    extrapolate: Annotated[
        bool, typer.Option("--extrapolate", help="Close the mesh where nothing was touched.")
    ] = False,
    as_json: common.AsJson = False,
) -> None:
    """Fit a surface with its uncertainty to contacts of one or many sweeps."""
    with reporting() as report:
        report("loading")
        given = [vb.read_contacts(path) for path in contacts]
        report("fitting")
        try:
            shape = vb.fit_shape(given)
            report("meshing")
            mesh = shape.mesh(resolution, extrapolate=extrapolate)
        except (ValueError, ImportError) as error:
            raise vb.io.InputError(f"{', '.join(map(str, contacts))}: {error}") from error
        vb.io.write_shape(output, mesh, fitted=shape)
    for line in shape.warnings:
        common.warn(line)
    files = [output]
    if figure is not None:
        with reporting() as report:
            report("drawing")
            files += [figure] * common.draw(figure, lambda: vb.plot.shape_figure(mesh))
    summary = _summary(shape, mesh)
    common.show(summary, lambda said: _line(said) + common.into(*files), as_json=as_json)


def _summary(shape: Shape, mesh: ShapeMesh) -> dict[str, Any]:
    import numpy as np  # noqa: PLC0415

    return {
        "contacts": int(shape.sites.size.sum()),
        "outliers": int(shape.outlier.sum()),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "median_deviation": float(np.median(mesh.deviation)),
        "warnings": shape.warnings,
    }


def _line(summary: dict[str, Any]) -> str:
    return (
        f"{summary['contacts']} contacts, {summary['outliers']} of them outliers; "
        f"{summary['faces']} triangles, median ±{summary['median_deviation']:.2g}"
    )
