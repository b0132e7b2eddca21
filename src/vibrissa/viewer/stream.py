"""A running stream in the browser."""

import time
from dataclasses import replace

import numpy as np

from vibrissa.contacts import Contacts
from vibrissa.drawing import length_factor, length_unit
from vibrissa.inverse import Reconstruction
from vibrissa.live import Sink
from vibrissa.live.samples import Nanoseconds
from vibrissa.rod import Rod
from vibrissa.sensor import RawRecording
from vibrissa.surfaces import Surface
from vibrissa.viewer.content import Content, Instant, Rows
from vibrissa.viewer.page import Viewer, address, serve, stop
from vibrissa.viewer.scene import Scene
from vibrissa.viewer.sweeps import WHOLE, contact_rows, rods_at, rods_known, triangles_of

_PERIOD = 0.1
"""Seconds between instants at first: ten a second look smooth."""
_MOST = 600
"""Instants kept: then every second one goes, and those to come are twice as far apart."""
_CONTACTS = 4
"""Contacts of one instant that are kept."""


class ViewerSink(Sink):
    """Shows a stream in the browser as it runs: what came stays under the time slider.

    Parameters
    ----------
    rod, surface
        The rod, and the object if it is known.
    host, port
        As for `vibrissa.view`.

    Attributes
    ----------
    url
        Address to open in a browser; the page stays until `end`.

    Raises
    ------
    ImportError
        If `vibrissa[view]` is not installed.
    """

    def __init__(
        self, rod: Rod, surface: Surface | None, host: str = "127.0.0.1", port: int = 8080
    ) -> None:
        self._rod, self._period = rod, _PERIOD
        near = np.zeros((1, 3)) if surface is None else surface.nearest(np.zeros(3))[None]
        factor = length_factor(rod)
        size = factor * float(rod.length)
        object_ = triangles_of(surface, near, rod, WHOLE)
        self._content = Content(length_unit(rod), "N", size, object_, room=size / 4)
        self._server = serve(host, port)
        self.url = address(self._server)
        self._viewer: Viewer | None = None
        self._batches: list[Reconstruction] = []
        self._stamps: list[Nanoseconds] = []
        self._first: list[Instant] = []
        self._begun, self._shown = 0, 0.0
        self._low = self._high = np.zeros(3)

    @property
    def viewer(self) -> Viewer | None:
        """The page's controls, once there is something to show."""
        return self._viewer

    def wrench(self, *_: object) -> None:
        """Raw samples are not shown."""

    def contacts(self, stamp: Nanoseconds, raw: RawRecording, found: Reconstruction) -> None:  # noqa: ARG002
        """Keep rows for the next instant."""
        self._batches.append(found)
        self._stamps.append(stamp)

    def flush(self) -> None:
        """Show what came, ten times a second at most."""
        if self._batches and time.monotonic() - self._shown >= self._period:
            self._shown = time.monotonic()
            self._show(self._instant())

    def close(self) -> None:
        """Show the last rows; the page stays."""
        if self._batches:
            self._show(self._instant())

    def end(self) -> None:
        """Stop serving the page."""
        if self._viewer is not None:
            self._viewer.close()
        else:
            stop(self._server)

    def _instant(self) -> Instant:
        """The newest rod, and some of the contacts that came since the instant before."""
        stamp, newest = self._stamps[-1], self._batches[-1]
        self._begun = self._begun or int(self._stamps[0][0])
        parts = [Rows.none()]
        for moments, found in zip(self._stamps, self._batches, strict=True):
            contacts = Contacts.of(found, 1e-9 * (moments - self._begun))
            force = np.linalg.norm(found.reactions.force, axis=-1)
            parts.append(contact_rows(contacts, force, length_factor(self._rod))[0])
        self._batches, self._stamps = [], []
        known = np.flatnonzero(rods_known(newest))
        rods = rods_at(newest, rods_known(newest), known[-1:])[0] if len(known) else {}
        label = f"{1e-9 * (int(stamp[-1]) - self._begun):.2f} s"
        return Instant(label, rods, _thinned(Rows.joined(parts)))

    def _show(self, instant: Instant) -> None:
        """Add an instant to the page, which begins with the second one."""
        if self._viewer is None:
            self._begin(instant)
            return
        scene = self._viewer.scene
        scene.append(instant)
        if len(scene.instants) > _MOST:
            self._period *= 2
            scene.replace(_halved(scene.instants))
        self._make_room(scene, instant)
        self._viewer.grew()

    def _make_room(self, scene: Scene, instant: Instant) -> None:
        """Draw larger axes if an instant lies outside, with room for those to come."""
        shown = replace(self._content, instants=(instant,))
        inner = replace(shown, room=0.0).box
        if (inner[0] < self._low).any() or (inner[1] > self._high).any():
            self._low = np.minimum(self._low, shown.box[0])
            self._high = np.maximum(self._high, shown.box[1])
            scene.draw_axes(self._low, self._high)

    def _begin(self, instant: Instant) -> None:
        """Show the first instants."""
        self._first.append(instant)
        if len(self._first) < 2 or not any(one.rods for one in self._first):
            return
        content = replace(self._content, instants=tuple(self._first))
        self._low, self._high = content.box
        self._viewer = Viewer(self._server, content, "kind", growing=True)


def _thinned(rows: Rows) -> Rows:
    """A few of them, evenly spread."""
    chosen = np.linspace(0, len(rows) - 1, min(len(rows), _CONTACTS))
    return rows[np.round(chosen).astype(int)]


def _halved(instants: list[Instant]) -> list[Instant]:
    """Every second instant, with contacts of both."""
    return [
        Instant(two.label, two.rods, _thinned(Rows.joined([one.contacts, two.contacts])))
        for one, two in zip(instants[0::2], instants[1::2], strict=False)
    ]
