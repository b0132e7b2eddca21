"""Where contacts go."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Int

from vibrissa.inverse import Reconstruction
from vibrissa.live.samples import Nanoseconds, Vectors
from vibrissa.sensor import RawRecording


@runtime_checkable
class Sink(Protocol):
    """Takes what a stream gives, in order. An exception it raises ends the stream."""

    def wrench(
        self,
        stamp: Nanoseconds,
        sequence: Int[np.ndarray, "n"],
        force: Vectors,
        torque: Vectors,
    ) -> None:
        """Raw samples as soon as they come: stamps (n,) [ns], numbers (n,), and the wrench (n, 3)
        [N], [N m], tare included.
        """

    def contacts(self, stamp: Nanoseconds, raw: RawRecording, found: Reconstruction) -> None:
        """Rows once their pose is known and the tare is over: stamps (n,) [ns], poses and tared
        wrench, and the contacts found.
        """

    def flush(self) -> None:
        """Write out what was given so far; called at least every 50 ms."""

    def close(self) -> None:
        """Finish; called once, also after an error."""


class Callback(Sink):
    """Calls a function with stamps (n,) [ns since 1970] and contacts, batch by batch, on the thread
    of the stream.
    """

    def __init__(self, function: Callable[[Nanoseconds, Reconstruction], object]) -> None:
        self._function = function

    def contacts(
        self,
        stamp: Nanoseconds,
        raw: RawRecording,  # noqa: ARG002
        found: Reconstruction,
    ) -> None:
        """Call the function."""
        self._function(stamp, found)
