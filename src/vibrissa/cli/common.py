"""What commands share: options, checks of them, figures, and words for what was counted."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperOption

import vibrissa as vb

if TYPE_CHECKING:
    from rich.console import Console

AsJson = Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")]
CaseFile = Annotated[Path, typer.Argument(help="TOML file with [rod], [object] and [[trail]].")]
SetupFile = Annotated[Path, typer.Option(help="TOML file with [rod] and [sensor].")]


contradictions: list[str] = []
"""What recordings said against their setups since the command began, a line each."""


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


def written(*suffixes: str) -> Callable[[Any], Any]:
    """Callback of an option: raise InputError unless the files it names have one of these suffixes,
    by default those of contacts, and can be written.
    """

    def check(value: Any) -> Any:
        from vibrissa.io.contacts import SUFFIXES, checked_output  # noqa: PLC0415

        for path in [value] if isinstance(value, Path) else value or []:
            checked_output(path, suffixes or SUFFIXES)
        return value

    return check


Figure = Annotated[
    Path | None,
    typer.Option(help="Figure to write (PNG or PDF).", callback=written(".png", ".pdf")),
]


def draw(path: Path, make: Callable[[], Any]) -> None:
    """Write the figure whose axes `make` returns."""
    with vb.plot.journal():
        vb.plot.save_as(make(), path)


def table_console() -> Console:
    """The standard output for tables, wide where it is not a terminal."""
    from rich.console import Console  # noqa: PLC0415

    return Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else 160)


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
