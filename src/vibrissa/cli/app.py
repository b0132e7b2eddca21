"""The commands, and how their errors and warnings are reported."""

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import typer
from typer.core import TyperGroup

import vibrissa as vb
from vibrissa.cli.calibrate import calibrate
from vibrissa.cli.common import contradictions, say
from vibrissa.cli.convert import convert
from vibrissa.cli.demo import demo
from vibrissa.cli.example import example
from vibrissa.cli.expect import expect
from vibrissa.cli.fit import fit
from vibrissa.cli.init import init
from vibrissa.cli.inspect import inspect
from vibrissa.cli.live import live
from vibrissa.cli.next import next_
from vibrissa.cli.reconstruct import reconstruct
from vibrissa.cli.scan import scan
from vibrissa.cli.simulate_sensor import simulate_sensor
from vibrissa.cli.view import view

_COMMANDS = {
    command.__name__.strip("_").replace("_", "-"): command
    for command in (
        demo,
        example,
        init,
        scan,
        reconstruct,
        fit,
        next_,
        view,
        inspect,
        convert,
        calibrate,
        expect,
        live,
        simulate_sensor,
    )
}
_plain = partial(
    typer.Typer, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None
)


class _Group(TyperGroup):
    """The commands, each built from its function when it is asked for: that takes longer than all
    else that `--help` does.
    """

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """Names of the commands."""
        return list(_COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002
        """Build a command."""
        if cmd_name not in _COMMANDS:
            # Names to suggest instead.
            self.commands.update(dict.fromkeys(_COMMANDS))  # type: ignore[arg-type]
            return None
        alone = _plain()
        alone.command(cmd_name)(_COMMANDS[cmd_name])
        return typer.main.get_command(alone)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        """List what the commands do: the first sentence of each."""
        rows = [
            (name, " ".join((command.__doc__ or "").split("\n\n")[0].split()))
            for name, command in _COMMANDS.items()
        ]
        with formatter.section("Commands"):
            formatter.write_dl([(name, text.split(". ")[0].rstrip(".")) for name, text in rows])


app = _plain(
    name="vibrissa",
    cls=_Group,
    help="Whisker-like tactile sensing: contact mechanics of a swept elastic rod, forward and "
    "inverse.",
    no_args_is_help=True,
)


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
