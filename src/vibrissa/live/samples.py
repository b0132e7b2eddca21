"""What a source gives: samples of the wrench, and counts of what went wrong on the way."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

Nanoseconds = Int[np.ndarray, "n"]
"""Times (n,): stamps since 1970, or arrivals on the monotonic clock."""
Flags = Bool[np.ndarray, "n"]
Vectors = Float[np.ndarray, "n 3"]
Quaternions = Float[np.ndarray, "n 4"]
Wrenches = Float[np.ndarray, "n 6"]
Table = TypeVar("Table")
"""A tree of columns of equal length."""


class EndOfStreamError(Exception):
    """A source has nothing more to give."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Samples:
    """Rows of one sensor, in order.

    Attributes
    ----------
    stamp
        (n,) [ns]: when a sample was taken, increasing; on the host's clock, or a recording's own.
    sequence
        (n,): number of the sample, the sensor's own if it counts.
    force, torque
        (n, 3) [N], [N m], as `vibrissa.Sensor` says, tare included.
    valid
        (n,): false if the sensor itself reports the row as in error.
    arrival
        (n,) [ns] on the monotonic clock: when the host received it.
    position, orientation
        Pose of the sensor frame in the world, (n, 3) [m] and x, y, z, w (n, 4), if the source gives
        it; else None.
    anew
        (n,): true for the first row after the sender's numbering or clock restarted, as when the
        sensor was restarted. By default false throughout.

    Raises
    ------
    ValueError
        If columns have different lengths.
    """

    stamp: Nanoseconds
    sequence: Int[np.ndarray, "n"]
    force: Vectors
    torque: Vectors
    valid: Flags
    arrival: Nanoseconds
    position: Vectors | None = None
    orientation: Quaternions | None = None
    anew: Bool[np.ndarray, "..."] = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def __post_init__(self) -> None:
        if not self.anew.size:
            object.__setattr__(self, "anew", np.zeros(len(self), dtype=bool))
        lengths = set(map(len, jax.tree.leaves(self)))
        if len(lengths) > 1:
            raise ValueError(f"columns of {sorted(lengths)} rows; allowed is one number of rows")

    def __len__(self) -> int:
        return len(self.stamp)

    def __getitem__(self, rows: slice) -> "Samples":
        return rows_of(self, rows)


def rows_of(table: Table, rows: slice | Flags | list[int]) -> Table:
    """These rows of a table."""
    return jax.tree.map(lambda column: column[rows], table)


def joined(parts: Sequence[Table]) -> Table:
    """Concatenate tables with the same columns."""
    if len(parts) == 1:
        return parts[0]
    return jax.tree.map(lambda *columns: np.concatenate(columns), *parts)


@dataclass
class Counts:
    """What came, and what went wrong on the way here.

    Attributes
    ----------
    samples
        Passed on.
    lost
        Numbers that never came, or came too late to be put in order; where the numbering restarted,
        as many samples as would have come in the meantime.
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
        How often the numbering or the clock restarted.
    rate_changes
        How often samples came at another rate than assumed.
    status
        Bitwise OR of all status words.
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
    """What was wrong with the last line or datagram that could not be read."""

    @abstractmethod
    def open(self) -> None:
        """Start. Raise OSError if the source cannot be reached."""

    @abstractmethod
    def read(self, timeout: float) -> Samples | None:
        """Samples received, or None if there are none within `timeout` seconds; raise
        EndOfStreamError after the last.
        """

    @abstractmethod
    def close(self) -> None:
        """Release sockets and files; may be called twice, and before `open`."""
