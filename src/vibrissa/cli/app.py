"""The commands, and how their errors and warnings are reported."""

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import typer

import vibrissa as vb
from vibrissa.cli.calibrate import calibrate
from vibrissa.cli.common import contradictions, say
from vibrissa.cli.convert import convert
from vibrissa.cli.demo import demo
from vibrissa.cli.example import example
from vibrissa.cli.expect import expect
from vibrissa.cli.init import init
from vibrissa.cli.inspect import inspect
from vibrissa.cli.live import live
from vibrissa.cli.reconstruct import reconstruct
from vibrissa.cli.scan import scan
from vibrissa.cli.simulate_sensor import simulate_sensor
from vibrissa.cli.view import view

app = typer.Typer(
    name="vibrissa",
    help="Whisker-like tactile sensing: contact mechanics of a swept elastic rod, forward and "
    "inverse.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for command in (
    demo,
    example,
    init,
    scan,
    reconstruct,
    view,
    inspect,
    convert,
    calibrate,
    expect,
    live,
    simulate_sensor,
):
    app.command(command.__name__.replace("_", "-"))(command)


@app.callback(invoke_without_command=True)
def _version(
    *, version: bool = typer.Option(False, "--version", help="Print the version and exit.")
) -> None:
    if version:
        typer.echo(vb.__version__)
        raise typer.Exit


def main() -> None:
    """Run a command; exit status 2 and a one-line message for invalid input, 1 for failed work."""
    os.environ["MPLBACKEND"] = "Agg"  # figures go to files
    try:
        with _warnings_in_one_line():
            app()
    except ValueError as error:
        if not isinstance(error, vb.io.InputError):
            raise
        say(f"vibrissa: error: {error}", err=True)
        sys.exit(2)


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """Print each warning once, on stderr, without its place in the code: just `warning: ...` if a
    recording contradicts its setup.
    """
    contradictions.clear()
    said: set[str] = set()

    def show(
        message: Warning | str, category: type[Warning], *_place: object, **_more: object
    ) -> None:
        from vibrissa.contacts import RecordingNote, RecordingWarning  # noqa: PLC0415

        line = " ".join(str(message).split())
        if line in said:
            return
        said.add(line)
        prefix = "vibrissa: "
        if issubclass(category, RecordingWarning) and not issubclass(category, RecordingNote):
            prefix = ""
            contradictions.append(line)
        say(f"{prefix}warning: {line}", err=True)

    with warnings.catch_warnings():
        # Every line, even one that two files share; `show` skips repetitions.
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield
