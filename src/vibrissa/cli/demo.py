"""`vibrissa demo`: the paper, end to end."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import vibrissa as vb
from vibrissa.cli import common
from vibrissa.cli.progress import reporting
from vibrissa.cli.view import opened, until_interrupt

if TYPE_CHECKING:
    from vibrissa.paper import Demo


def demo(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for figures, tables and datasets.")
    ] = Path("demo"),
    see: common.View = False,
    as_json: common.AsJson = False,
) -> None:
    """Reproduce the whole paper: figures 2, 3a and 3b, checks of its statements, and the sweeps it
    suggests.
    """
    from vibrissa.files import writable_folder  # noqa: PLC0415

    folder = writable_folder(output)
    with opened() if see else nullcontext(), reporting() as report:
        report("loading")
        from vibrissa.paper import run_demo  # noqa: PLC0415

        result = run_demo(folder, report, report.count)
        viewer = vb.view(result.found, surface=result.scan.surface) if see else None
    if as_json:
        summary = {
            "statements": [part._asdict() for part in result.statements],
            "coverage": result.coverage,
            "files": [str(path) for path in result.files],
        }
        common.show(summary, str, as_json=True)
    else:
        _print(result, folder)
    if viewer is not None:
        with viewer:
            viewer.play()
            typer.echo(viewer.url, err=True)
            until_interrupt()
    if not all(part.holds for part in result.statements):
        raise typer.Exit(1)


def _print(result: Demo, folder: Path) -> None:
    from rich.table import Table  # noqa: PLC0415

    table = Table(title="Statements of the paper's section III", title_justify="left")
    for name, ratio in (("statement", 5), ("measured here", 6)):
        table.add_column(name, ratio=ratio, overflow="fold")
    table.add_column("holds")
    for part in result.statements:
        table.add_row(part.statement, part.measured, "yes" if part.holds else "NO")
    common.table_console().print(table)
    shares = ", ".join(f"{name} {share:.1%}" for name, share in result.coverage.items())
    common.say(f"Coverage of |x| ≤ 1, |y| ≤ 0.7 within 0.05 L of a contact: {shares}")
    held = sum(part.holds for part in result.statements)
    common.say(
        f"{held} of {len(result.statements)} statements hold, "
        f"{common.count_of(len(result.files), 'file')}" + common.into(folder)
    )
