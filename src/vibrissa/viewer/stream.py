"""A running stream in the browser."""

import threading
from dataclasses import replace
from typing import NamedTuple

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
from vibrissa.viewer.growing import GrowingSurface
from vibrissa.viewer.page import Viewer, address, serve, stop
from vibrissa.viewer.scene import Scene
from vibrissa.viewer.sweeps import WHOLE, contact_rows, rods_at, rods_known, triangles_of

_PERIOD = 0.1
"""Seconds between instants at first: ten a second look smooth."""
_MOST = 600
"""Instants kept: then every second one goes, and those to come are twice as far apart."""
_NOTHING = np.zeros((0, 3, 3))
_CONTACTS = 4
"""Contacts of one instant that are kept."""


class _Batch(NamedTuple):
    """Rows as the stream gives them."""

    stamp: Nanoseconds
    found: Reconstruction


class ViewerSink(Sink):
    """Shows a stream in the browser as it runs: what came stays under the time slider, and the
    surface fitted to the contacts grows.

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
        self._surface = GrowingSurface(rod)
        self.url = address(self._server)
        self._viewer: Viewer | None = None
        self._batches: list[_Batch] = []
        self._first: list[Instant] = []
        self._begun = 0
        self._low = self._high = np.zeros(3)
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="viewer sink", daemon=True)
        self._thread.start()

    @property
    def viewer(self) -> Viewer | None:
        """The page's controls, once there is something to show."""
        return self._viewer

    def wrench(self, *_: object) -> None:
        """Raw samples are not shown."""

    def contacts(self, stamp: Nanoseconds, raw: RawRecording, found: Reconstruction) -> None:  # noqa: ARG002
        """Keep rows for the next instant."""
        with self._lock:
            self._batches.append(_Batch(stamp, found))

    def flush(self) -> None:
        """Nothing: a thread of its own draws, so that the stream does not wait for it."""

    def close(self) -> None:
        """Show the last rows, and the surface fitted to all contacts; the page stays."""
        self._closed.set()
        self._thread.join()
        self._draw()
        self._surface.close()
        self._draw()

    def end(self) -> None:
        """Stop serving the page."""
        self._closed.set()
        self._thread.join()
        self._surface.close()
        if self._viewer is not None:
            self._viewer.close()
        else:
            stop(self._server)

    def _run(self) -> None:
        while not self._closed.wait(self._period):
            self._draw()

    def _draw(self) -> None:
        """Show what came since the last time."""
        with self._lock:
            batches, self._batches = self._batches, []
        if batches:
            self._show(self._instant(batches))
        for batch in batches:
            self._surface.add(batch.found)
        if self._viewer is not None and (fitted := self._surface.take()) is not None:
            self._viewer.refit(fitted)

    def _instant(self, batches: list[_Batch]) -> Instant:
        """The newest rod, and some of the contacts that came since the instant before."""
        self._begun = self._begun or int(batches[0].stamp[0])
        parts = [Rows.none()]
        for stamp, found in batches:
            contacts = Contacts.of(found, 1e-9 * (stamp - self._begun))
            force = np.linalg.norm(found.reactions.force, axis=-1)
            parts.append(contact_rows(contacts, force, length_factor(self._rod))[0])
        stamp, newest = batches[-1]
        known = rods_known(newest)
        last = np.flatnonzero(known)[-1:]
        rods = rods_at(newest, known, last)[0] if len(last) else {}
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
        if not instant.rods:
            return
        shown = Content(self._content.unit, "", self._content.size, _NOTHING, instants=(instant,))
        low, high = shown.box
        if (low < self._low).any() or (high > self._high).any():
            room = self._content.room
            self._low = np.minimum(self._low, low - room)
            self._high = np.maximum(self._high, high + room)
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
    """Every second instant, the newest among them, with contacts of both."""
    odd = len(instants) % 2
    pairs = zip(instants[odd::2], instants[odd + 1 :: 2], strict=True)
    return instants[:odd] + [
        Instant(two.label, two.rods, _thinned(Rows.joined([one.contacts, two.contacts])))
        for one, two in pairs
    ]
