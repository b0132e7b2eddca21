"""The surface of a running stream, fitted again and again as contacts come."""

import threading
import time
from dataclasses import replace

import numpy as np

from vibrissa.contacts import Contacts, Status
from vibrissa.drawing import length_factor
from vibrissa.inverse import Reconstruction
from vibrissa.rod import Rod
from vibrissa.shape import fit_shape
from vibrissa.viewer.content import WIDE, Fitted
from vibrissa.viewer.sweeps import fitted_of

_MOST = 1000
"""Contacts kept; of more, every other one goes, and only every other one to come is kept."""
_CELLS = 30
"""Edges of the mesh's cells in the extent of the contacts."""
_PAUSE, _SHARE = 1.0, 0.25
"""Seconds between fits, at least, and share of the time that they take, at most."""


class GrowingSurface:
    """Fits surfaces in a thread of its own, so that neither the stream nor the page waits.

    Parameters
    ----------
    rod
        That of the stream.
    """

    def __init__(self, rod: Rod) -> None:
        self._factor, self._widest = length_factor(rod), WIDE * float(rod.length)
        self._kept: list[Contacts] = []
        self._size, self._count, self._every = 0, 0, 1
        self._newest: Fitted | None = None
        self._grew = False
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="viewer surface", daemon=True)
        self._thread.start()

    def add(self, found: Reconstruction) -> None:
        """Keep contacts for the next fit: those with status OK, and not so uncertain that their
        extent would be no measure of the object's.
        """
        sound = found.in_contact & (found.status == Status.OK)
        if found.covariance is not None:
            variance = np.trace(found.covariance, axis1=1, axis2=2)
            sound &= ~(variance > self._widest**2)
        numbers = self._count + np.arange(sound.sum())
        rows = np.flatnonzero(sound)[numbers % self._every == 0]
        self._count += len(numbers)
        if not len(rows):
            return
        with self._lock:
            self._kept.append(Contacts.of(found, found.reactions.time)[rows])
            self._size, self._grew = self._size + len(rows), True
            if self._size > _MOST:
                self._kept = [Contacts.joined(self._kept)[::2]]
                self._size, self._every = len(self._kept[0]), 2 * self._every

    def take(self) -> Fitted | None:
        """Return the newest surface, unless it was taken before."""
        with self._lock:
            newest, self._newest = self._newest, None
        return newest

    def close(self) -> None:
        """Return when a surface is fitted to all contacts there are."""
        self._closed.set()
        self._thread.join()

    def _run(self) -> None:
        pause = _PAUSE
        while not self._closed.wait(pause):
            begun = time.monotonic()
            self._fit()
            pause = max((1 / _SHARE - 1) * (time.monotonic() - begun), _PAUSE)
        self._fit()

    def _fit(self) -> None:
        """Fit to all contacts, if some came; where that fails, the surface stays as it was."""
        with self._lock:
            if not self._grew:
                return
            self._kept, self._grew = [Contacts.joined(self._kept)], False
            # Parts are batches, not sweeps.
            contacts = replace(self._kept[0], sweep=None)
        try:
            shape = fit_shape(contacts)
            mesh = shape.mesh(shape.extent / _CELLS)
            fitted = fitted_of(mesh, contacts.point[shape.outlier], self._factor)
        except ValueError:  # too few contacts, or in one place
            return
        with self._lock:
            self._newest = fitted
