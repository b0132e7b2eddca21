"""`vibrissa example`: small sets of files to begin with."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Annotated

import typer

import vibrissa as vb
from vibrissa.cli import common

_NESTED = {"sphere_60mm": "recordings/sphere_60mm"}
_MESHES = {"mug": ("../meshes", "mug.ply")}
"""Meshes beside the folder of the cases: they are copied beside the case."""


def example(
    name: Annotated[
        str | None, typer.Argument(help="Which one; without a name, all are listed.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder to write to; by default the example's name."),
    ] = None,
) -> None:
    """Copy an example, a bench with its logs or a case to scan, into a folder."""
    known = _examples()
    if name is None:
        from rich.table import Table  # noqa: PLC0415

        table = Table.grid(padding=(0, 2))
        table.add_column(no_wrap=True)
        for one, source in known.items():
            table.add_row(one, _described(source))
        common.table_console().print(table)
        return
    if name not in known:
        raise vb.io.InputError(f"example = {name!r}; allowed are {', '.join(known)}")
    from vibrissa.files import writable_folder  # noqa: PLC0415

    folder, source = output or Path(name), known[name]
    files = sorted(source.iterdir()) if source.is_dir() else [source]
    mesh_folder, mesh = _MESHES.get(name, ("", ""))
    if mesh:
        files.append(source.parent / mesh_folder / mesh)
    taken = [file.name for file in files if (folder / file.name).exists()]
    if taken:
        raise vb.io.InputError(
            f"{folder}: {taken[0]} exists already; allowed is a folder without it, by -o FOLDER"
        )
    writable_folder(folder)
    for file in files:
        shutil.copyfile(file, folder / file.name)
    if mesh:
        case = folder / source.name
        text = case.read_text(encoding="utf-8").replace(f"{mesh_folder}/{mesh}", mesh)
        case.write_text(text, encoding="utf-8")
    typer.echo(f"{len(files)} file{'s' * (len(files) > 1)}{common.into(folder)}")


def _examples() -> dict[str, Path]:
    """Folders and cases by name, in the order in which they are listed; they lie in an installed
    package, or beside `src` in a checkout.
    """
    package = Path(vb.__file__).parent
    places = (package / "examples", package.parents[1] / "examples")
    shelf = next(place for place in places if (place / "bench").is_dir())
    folders = {name: shelf / _NESTED.get(name, name) for name in ("bench", "sphere_60mm", "live")}
    return folders | {case.stem: case for case in sorted((shelf / "cases").glob("*.toml"))}


def _described(source: Path) -> str:
    """What the first line of its README, setup or case says."""
    texts = (source / "README.md", source / "setup.toml", source)
    text = next(file for file in texts if file.is_file()).read_text(encoding="utf-8")
    return re.split(r"[.:;]( |$)| \(", text.partition("\n")[0].lstrip("# "))[0]
