"""What commands share: options, checks of numbers, figures, and words for what was counted."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperOption

import vibrissa as vb

AsJson = Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")]
CaseFile = Annotated[
    Path, typer.Argument(help="TOML file with [rod], [object] and [[trail]].", show_default=False)
]
SetupFile = Annotated[
    Path, typer.Option("--setup", help="TOML file with [rod] and [sensor].", show_default=False)
]
Figure = Annotated[Path | None, typer.Option("--figure", help="Figure to write (PNG or PDF).")]


def positive(param: TyperOption, value: float | None) -> float | None:
    """Raise InputError unless an option is not given, or a finite number greater than 0."""
    if value is not None and not 0 < value < math.inf:
        raise vb.io.InputError(
            f"{param.opts[0]} = {value}; allowed is a finite number greater than 0"
        )
    return value


def not_negative(param: TyperOption, value: float | None) -> float | None:
    """Raise InputError unless an option is not given, or a finite number of at least 0."""
    if value is not None and not 0 <= value < math.inf:
        raise vb.io.InputError(
            f"{param.opts[0]} = {value}; allowed is a finite number of at least 0"
        )
    return value


Friction = Annotated[
    float | None,
    typer.Option(
        help="Coulomb's coefficient: 0 for none; left out where it is not known.",
        callback=not_negative,
    ),
]


def draw(path: Path, make: Callable[[], Any]) -> None:
    """Write the figure whose axes `make` returns."""
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("Agg")
    with vb.plot.journal():
        vb.plot.save_as(make(), path)


def counted(values: Any, words: type[IntEnum]) -> dict[str, int]:
    """How many of the values (…) are each of these, by name."""
    return {word.name: int((values == word).sum()) for word in words}


def counts_of(result: vb.Scan | vb.Reconstruction) -> dict[str, dict[str, int]]:
    """Kinds and status of all rows, for a summary."""
    status = counted(result.status, vb.Status)
    return {
        "kinds": counted(result.kind, vb.ContactKind),
        "status": {name: count for name, count in status.items() if count},
    }


def listed(counts: dict[str, int]) -> str:
    """Counts in a row."""
    return ", ".join(f"{count} {name.lower()}" for name, count in counts.items())


def status_lines(status: dict[str, int]) -> list[str]:
    """What rows say that are not OK, and what to do."""
    return [
        f"{count} rows {name}: {vb.Status[name].text}"
        for name, count in status.items()
        if name != "OK"
    ]


def show(summary: dict[str, Any], text: Callable[[dict[str, Any]], str], *, as_json: bool) -> None:
    """Print a summary."""
    typer.echo(json.dumps(summary, indent=1) if as_json else text(summary))
