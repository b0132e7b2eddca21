"""What commands share: options and their checks, figures, and words for counts."""

from __future__ import annotations

import json
import math
import shutil
import sys
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from textwrap import TextWrapper
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperOption

import vibrissa as vb

if TYPE_CHECKING:
    from rich.console import Console

AsJson = Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")]
View = Annotated[bool, typer.Option("--view", help="Show it in the browser, until Ctrl-C.")]
CaseFile = Annotated[Path, typer.Argument(help="TOML file with [rod], [object] and [[trail]].")]
SetupFile = Annotated[Path, typer.Option(help="TOML file with [rod] and [sensor].")]


_PIPED = 100
"""Characters in a line of a table in a file or pipe: two side by side fit on a screen."""

contradictions: list[str] = []
"""What was warned of since the command began, one line each: how recordings contradict their
setups, and whether most rows are bad.
"""


def positive(param: TyperOption, value: float | None) -> float | None:
    """Raise InputError unless an option is omitted or a finite number greater than 0."""
    if value is not None and not 0 < value < math.inf:
        raise vb.io.InputError(
            f"{param.opts[0]} = {value}; allowed is a finite number greater than 0"
        )
    return value


def not_negative(param: TyperOption, value: float | None) -> float | None:
    """Raise InputError unless an option is omitted or a finite number of at least 0."""
    if value is not None and not 0 <= value < math.inf:
        raise vb.io.InputError(
            f"{param.opts[0]} = {value}; allowed is a finite number of at least 0"
        )
    return value


Friction = Annotated[
    float | None,
    typer.Option(
        help="Coulomb friction coefficient: 0 for none; omit it if unknown.",
        callback=not_negative,
    ),
]


def written(*suffixes: str) -> Callable[[Any], Any]:
    """Option callback: raise InputError unless the files named have one of these suffixes, by
    default those of contact files, and can be written.
    """

    def check(value: Any) -> Any:
        from vibrissa.io.contacts import SUFFIXES, checked_output  # noqa: PLC0415

        for path in [value] if isinstance(value, Path) else value or []:
            checked_output(path, suffixes or SUFFIXES)
        return value

    return check


Figure = Annotated[
    Path | None,
    typer.Option(
        help="Figure to write (PNG, PDF or SVG).", callback=written(".png", ".pdf", ".svg")
    ),
]


def draw(path: Path, make: Callable[[], Any]) -> bool:
    """Write the figure whose axes `make` returns; if there is nothing to draw, say why, and return
    False.
    """
    with vb.plot.journal():
        try:
            axes = make()
        except ValueError as error:
            say(f"vibrissa: error: {path}: {error}", err=True)
            return False
        vb.plot.save_as(axes, path)
        return True


def table_console() -> Console:
    """Standard output for tables and lists, of fixed width if it is not a terminal."""
    from rich.console import Console  # noqa: PLC0415

    width = None if sys.stdout.isatty() else _PIPED
    return Console(highlight=False, markup=False, width=width)


def counted(values: Any, words: type[IntEnum]) -> dict[str, int]:
    """How many of the values (…) equal each of these words, by name."""
    return {word.name: int((values == word).sum()) for word in words}


def counts_of(result: vb.Scan | vb.Reconstruction) -> dict[str, dict[str, int]]:
    """Kinds and status of all rows, for a summary."""
    status = counted(result.status, vb.Status)
    return {
        "kinds": counted(result.kind, vb.ContactKind),
        "status": {name: count for name, count in status.items() if count},
    }


def count_of(number: int, noun: str) -> str:
    """A number and its noun."""
    return f"{number} {noun}{'s' * (number != 1)}"


def listed(counts: dict[str, int]) -> str:
    """Counts on one line."""
    return ", ".join(f"{count} {name.lower()}" for name, count in counts.items())


def status_lines(status: dict[str, int]) -> list[str]:
    """What is wrong with rows that are not OK, and what to do about it."""
    return [
        f"{count} rows {name}: {vb.Status[name].text}"
        for name, count in status.items()
        if name != "OK"
    ]


def into(*files: object) -> str:
    """The end of a command's last line: what it wrote."""
    return " → " + ", ".join(map(str, files)) if files else ""


def say(text: str, *, err: bool = False) -> None:
    """Print lines on stdout or stderr, wrapped between words if that is a terminal."""
    if (sys.stderr if err else sys.stdout).isatty():
        width = shutil.get_terminal_size().columns
        fitted = TextWrapper(
            width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
        )
        text = "\n".join(
            line if len(line) <= width else fitted.fill(line) for line in text.splitlines()
        )
    typer.echo(text, err=err)


def warn(line: str) -> None:
    """Print a warning on stderr."""
    contradictions.append(line)
    say(f"warning: {line}", err=True)


def contacts_line(count: int, sound: int, deviation: float | None = None, unit: str = "mm") -> str:
    """How many contacts, how many of them sound, and how well they are known in the median."""
    spread = "" if deviation is None else f", median ±{deviation:.2g} {unit}"
    return f"{count} contacts, {sound} sound{spread}"


def doubt(count: int, sound: int, status: dict[str, int], causes: list[str], without: str) -> None:
    """Warn if there is no contact, or if most are not sound, and name the likeliest cause.

    Parameters
    ----------
    count, sound
        Contacts, and those whose status is OK.
    status
        Contacts by name of their status.
    causes
        What contradicts the setup, likeliest first.
    without
        The likeliest cause of there being no contact, if nothing contradicts the setup.
    """
    if count and 2 * sound >= count:
        return
    bad = {name: number for name, number in status.items() if name != "OK"}
    usual = vb.Status[max(bad, key=lambda name: bad[name])].text if bad else ""
    likely = causes[0] if causes else usual if count else without
    found = (
        f"{count - sound} of {count} contacts are not sound" if count else "no contact was found"
    )
    warn(f"{found}; likeliest cause: {brief(likely)}")


def brief(cause: str) -> str:
    """The first sentence of a warning."""
    question, asked, _ = cause.partition("? ")
    return question.partition("; ")[0] + "?" * bool(asked)


def doubt_contacts(found: vb.Reconstruction) -> None:
    """Warn if most contacts of a recording are bad, known no better than to half the rod's length,
    or if there is none: units, sign and clamp come first, then what the contacts say of the setup.
    Say if that cannot be told.
    """
    import numpy as np  # noqa: PLC0415

    contact = found.in_contact
    sound = contact & (found.status == vb.Status.OK)
    causes = list(dict.fromkeys([*found.reactions.misread, *contradictions, *found.warnings]))
    doubt(
        int(contact.sum()),
        int(sound.sum()),
        counted(found.status[contact], vb.Status),
        causes,
        "the loads never exceed the noise: the rod missed the object, the tare was taken in "
        "contact, or force_noise and torque_noise are too large",
    )
    if found.covariance is not None and sound.any():
        spread = np.median(np.sqrt(np.trace(found.covariance[sound], axis1=-2, axis2=-1)))
        share = spread / found.rod.length
        if share > 1 / 2:
            likely = brief([*causes, "loads that hardly exceed the stated noise"][0])
            warn(f"contacts are known to {share:.2g} rod lengths only; likeliest cause: {likely}")
    if found.setup_check is not None and found.setup_check.note:
        say(f"vibrissa: note: {found.setup_check.note}", err=True)


def show(summary: dict[str, Any], text: Callable[[dict[str, Any]], str], *, as_json: bool) -> None:
    """Print a summary."""
    if as_json:
        typer.echo(json.dumps(summary, indent=1))
    else:
        say(text(summary))
