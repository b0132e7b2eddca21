"""`vibrissa view`: results and files in the browser."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

import vibrissa as vb
from vibrissa.cli import common
from vibrissa.cli.live_parts import say, working
from vibrissa.cli.progress import reporting

if TYPE_CHECKING:
    from vibrissa.viewer.colours import By


@contextmanager
def opened(address: str = "127.0.0.1") -> Iterator[None]:
    """Raise InputError for whatever keeps a page from being made: nothing to show, a library that
    is missing, an address that cannot be used.
    """
    from vibrissa.libraries import extra_library  # noqa: PLC0415

    try:
        # Before anyone waits for what is to be shown.
        extra_library("viser", extra="view", need="the viewer needs it")
        yield
    except vb.io.InputError:
        raise
    except OSError as error:
        raise vb.io.InputError(
            f"{address}: {error.strerror or error}; allowed is an address of this machine"
        ) from error
    except (ValueError, ImportError) as error:
        raise vb.io.InputError(str(error)) from error


def _page(path: Path | None) -> Path | None:
    from vibrissa.viewer.page import page_file  # noqa: PLC0415

    return None if path is None else page_file(path)


def view(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Scans, reconstructions, contacts, shapes, recordings, setups and cases.",
            metavar="FILE...",
        ),
    ],
    setup: Annotated[
        Path | None,
        typer.Option(help="TOML file with [rod] and [sensor], which a recording needs."),
    ] = None,
    colour: Annotated[
        str, typer.Option(help="Colour contacts by kind, status, force or uncertainty.")
    ] = "kind",
    save: Annotated[
        Path | None,
        typer.Option(help="HTML file to write instead, which needs no server.", callback=_page),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to serve the page at.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port, or the next free one.", min=1, max=65535)] = 8080,
) -> None:
    """Show object, bending rod, contacts and fitted surface in the browser, until Ctrl-C."""
    loaded = None if setup is None else vb.load_setup(setup)
    with reporting() as report:
        report("loading")
        with opened(f"{host}:{port}"):
            by = cast("By", colour)  # it is checked there
            viewer = vb.view(*files, setup=loaded, colour=by, host=host, port=port)
    with viewer:
        content = viewer.content
        said = f"{len(content.contacts)} contacts, {len(content.instants)} instants"
        if save is not None:
            typer.echo(said + common.into(viewer.save(save)))
            return
        typer.echo(said + common.into(viewer.url))
        until_interrupt()


def until_interrupt() -> None:
    """Wait until SIGINT or SIGTERM."""
    say("open the page in a browser; Ctrl-C ends")
    with working() as stop:
        stop.wait()
