"""One call from results or files to a page in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

from vibrissa.contacts import Contacts
from vibrissa.forward import Scan
from vibrissa.inverse import Reconstruction, reconstruct
from vibrissa.io import Case, Setup
from vibrissa.reactions import Reactions
from vibrissa.shape import Shape
from vibrissa.surfaces import Surface
from vibrissa.viewer.colours import By
from vibrissa.viewer.content import Content, joined
from vibrissa.viewer.files import of_file
from vibrissa.viewer.page import Viewer, checked_colour, serve
from vibrissa.viewer.sweeps import of_case, of_contacts, of_setup, of_shape, of_sweep

Viewable: TypeAlias = (
    Scan | Reconstruction | Contacts | Reactions | Shape | Setup | Case | str | Path
)


def view(
    *what: Viewable,
    setup: Setup | None = None,
    surface: Surface | None = None,
    colour: By = "kind",
    host: str = "127.0.0.1",
    port: int = 8080,
) -> Viewer:
    """Show results or files in the browser: object, moving rods, contacts as they come, and
    surfaces fitted to them.

    Parameters
    ----------
    what
        Scans, reconstructions, contacts, reactions, shapes, setups, cases (which are scanned), or
        files of them; all on one page, side by side. Shapes are in metres unless the setup's rod is
        in the model's units.
    setup
        For recordings and reactions, which need it; its rod gives contacts from files their unit,
        its object is shown with them.
    surface
        Object to show with what knows none, in units of the rod, instead of that of the setup.
    colour
        What contacts are coloured by: "kind", "status", "force" or "uncertainty".
    host, port
        Address to serve the page at: by default only to this machine. If the port is taken, the
        next free one.

    Returns
    -------
    Viewer
        Serves the page until it is closed: `url` to open it, `wait()` to keep a script running,
        `save("scene.html")` for a file that shows the same without this program.

    Raises
    ------
    InputError
        If a file cannot be read, or the colour is not known of these contacts.
    ValueError
        If there is nothing to show, or lengths are in different units; the message says why.
    ImportError
        If `vibrissa[view]` is not installed.
    """
    content = joined([_content(one, setup, surface) for one in what])
    by = checked_colour(colour, content)
    return Viewer(serve(host, port), content, by)


def _content(what: Viewable, setup: Setup | None, surface: Surface | None) -> Content:
    known = surface if surface is not None or setup is None else setup.surface
    rod = None if setup is None else setup.rod
    match what:
        case str() | Path():
            return of_file(Path(what), setup, known)
        case Scan():
            return of_sweep(what, what.surface)
        case Reconstruction():
            return of_sweep(what, known)
        case Contacts():
            return of_contacts(what, known, rod)
        case Shape():
            return of_shape(what.mesh(), Contacts.joined(what.contacts), what.outlier, rod)
        case Reactions():
            if setup is None:
                raise ValueError("setup = None; reactions need it: allowed is their setup")
            return of_sweep(reconstruct(setup.rod, what), known)
        case Setup():
            return of_setup(what)
        case Case():
            return of_case(what)
    raise TypeError(
        f"what = {type(what).__name__}; allowed are scans, reconstructions, contacts, reactions, "
        "shapes, setups, cases and files"
    )
