"""What a source gives: samples of the wrench, and a count of what went wrong on the way."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


class EndOfStreamError(Exception):
    """A source has nothing more to give."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Rows of one sensor, in order.

    Attributes
    ----------
    stamp
        (n,) [ns]: when a sample was taken, increasing; by the host's clock, or by a recording's
        own.
    sequence
        (n,): number of the sample, from the sensor where it counts.
    force, torque
        (n, 3) [N], [N m], as `vibrissa.Sensor` says, tare included.
    valid
        (n,): false where the sensor itself says that the row is in error.
    arrival
        (n,) [ns] of the monotonic clock: when the host had it.
    position, orientation
        Pose of the sensor frame in the world, (n, 3) [m] and x, y, z, w (n, 4), where the source
        knows; else None.
    anew
        (n,): true for the first row after the sender's numbers or clock began anew, as those of a
        sensor that was restarted do; None for none.

    Raises
    ------
    ValueError
        If shapes do not fit.
    """

    stamp: Int[np.ndarray, "n"]
    sequence: Int[np.ndarray, "n"]
    force: Float[np.ndarray, "n 3"]
    torque: Float[np.ndarray, "n 3"]
    valid: Bool[np.ndarray, "n"]
    arrival: Int[np.ndarray, "n"]
    position: Float[np.ndarray, "n 3"] | None = None
    orientation: Float[np.ndarray, "n 4"] | None = None
    anew: Bool[np.ndarray, "n"] | None = None

    def __post_init__(self) -> None:
        count = len(self.stamp)
        for name, shape in (
            ("sequence", ()),
            ("force", (3,)),
            ("torque", (3,)),
            ("valid", ()),
            ("arrival", ()),
        ):
            if getattr(self, name).shape != (count, *shape):
                raise ValueError(
                    f"{name} has shape {getattr(self, name).shape}; allowed is {(count, *shape)}"
                )
        if (self.position is None) != (self.orientation is None):
            raise ValueError(
                "position and orientation: one is given without the other; allowed are both or none"
            )

    def __len__(self) -> int:
        return len(self.stamp)

    def rows(self, first: int, last: int) -> "Samples":
        """Rows from `first` up to, not including, `last`."""
        part = slice(first, last)
        return Samples(
            self.stamp[part],
            self.sequence[part],
            self.force[part],
            self.torque[part],
            self.valid[part],
            self.arrival[part],
            None if self.position is None else self.position[part],
            None if self.orientation is None else self.orientation[part],
            None if self.anew is None else self.anew[part],
        )

    @property
    def restarts(self) -> Bool[np.ndarray, "n"]:
        """`anew`, false (n,) where it is not given."""
        return np.zeros(len(self), dtype=bool) if self.anew is None else self.anew


def joined(parts: Sequence[Samples]) -> Samples:
    """One after the other.

    Raises
    ------
    ValueError
        If there is none, or only some have poses.
    """
    if not parts:
        raise ValueError("parts is empty; allowed are samples")
    if len(parts) == 1:
        return parts[0]
    posed = {part.position is not None for part in parts}
    if len(posed) > 1:
        raise ValueError("parts: some have poses and some none; allowed are samples of one source")
    names = [
        "stamp",
        "sequence",
        "force",
        "torque",
        "valid",
        "arrival",
        *(("position", "orientation") if posed.pop() else ()),
    ]
    columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return Samples(**columns, anew=np.concatenate([part.restarts for part in parts]))


@dataclass
class Counts:
    """What came, and what went wrong on the way here.

    Attributes
    ----------
    samples
        Given on.
    lost
        Numbers that never came, or too late to be put in order; where the numbers began anew, as
        many as the time without samples would have held.
    gaps
        How often numbers were missing.
    late
        Of the lost, those that came after all.
    reordered
        Put back in order.
    duplicates
        Came a second time.
    malformed
        Datagrams or lines that could not be read.
    flagged
        Samples whose status was not zero.
    invalid
        Samples that the sensor says are in error.
    restarts
        How often the numbers, or the clock, began anew.
    rate_changes
        How often samples came at another rate than was known.
    status
        All status words together, bit by bit.
    """

    samples: int = 0
    lost: int = 0
    gaps: int = 0
    late: int = 0
    reordered: int = 0
    duplicates: int = 0
    malformed: int = 0
    flagged: int = 0
    invalid: int = 0
    restarts: int = 0
    rate_changes: int = 0
    status: int = 0


class Source(ABC):
    """Where samples come from. Used by one thread: `open`, then `read` until it raises, then
    `close`.
    """

    counts: Counts
    waits = False
    """Whether it can be left unread for a while without loss, as a file can."""
    recorded = False
    """Whether pauses are those of a recording, not of a sensor that fell silent."""
    complaint = ""
    """What was wrong with the last of what could not be read."""

    @abstractmethod
    def open(self) -> None:
        """Begin. Raise OSError where the source cannot be reached."""

    @abstractmethod
    def read(self, timeout: float) -> Samples | None:
        """Samples that have come, or None where there is none within `timeout` seconds; raise
        EndOfStreamError after the last.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of sockets and files; may be called twice, and before `open`."""
