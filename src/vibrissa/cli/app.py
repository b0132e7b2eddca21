"""The commands' names, and what happens to their errors."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import typer

import vibrissa as vb
from vibrissa.cli.calibrate import calibrate
from vibrissa.cli.demo import demo
from vibrissa.cli.inspect import inspect
from vibrissa.cli.live import live
from vibrissa.cli.reconstruct import reconstruct
from vibrissa.cli.said import of_setup, one_line
from vibrissa.cli.scan import scan
from vibrissa.cli.simulate_sensor import simulate_sensor

app = typer.Typer(
    name="vibrissa",
    help="Whisker-like tactile sensing: contact mechanics of a swept elastic rod, forward and "
    "inverse.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for command in (demo, scan, reconstruct, inspect, live, simulate_sensor, calibrate):
    app.command(command.__name__.replace("_", "-"))(command)


@app.callback(invoke_without_command=True)
def _version(
    *, version: bool = typer.Option(False, "--version", help="Print the version and exit.")
) -> None:
    if version:
        typer.echo(vb.__version__)
        raise typer.Exit


def main() -> None:
    """Run a command; exit status 2 for wrong input, in one line, and 1 for failed work."""
    try:
        with _warnings_in_one_line():
            app()
    except ValueError as error:
        if not isinstance(error, vb.io.InputError):
            raise
        print(f"vibrissa: error: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(2)


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """Print each warning once, on stderr, without the place in the code that it comes from:
    `warning: ...` where a recording contradicts its setup.
    """
    said: set[str] = set()

    def show(
        message: Warning | str, category: type[Warning], *_place: object, **_more: object
    ) -> None:
        line = one_line(message)
        if line not in said:
            said.add(line)
            print(f"{'' if of_setup(category) else 'vibrissa: '}warning: {line}", file=sys.stderr)  # noqa: T201

    with warnings.catch_warnings():
        # Each line, also one that two files share; `show` passes over those that were said.
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield
