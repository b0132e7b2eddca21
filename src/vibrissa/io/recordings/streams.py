"""What every format is read to: wrenches and poses, each with stamps of its own, SI units."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")


@dataclass(frozen=True, eq=False)
class Stream:
    """Stamped rows as they were recorded: not judged, so that stamps may stand or fall and numbers
    may be NaN.

    Attributes
    ----------
    time
        (n,) [s].
    values
        (n, k): force [N] and torque [N m], or position [m] and quaternion x, y, z, w.
    line
        (n,) lines of the text that the rows stand in, from 1; None for other formats.
    """

    time: Float[np.ndarray, "n"]
    values: Float[np.ndarray, "n k"]
    line: np.ndarray | None = None

    def place(self, row: int) -> str:
        """Say where a row is in its file."""
        return f"row {row}" if self.line is None else f"line {self.line[row]}"

    def rows(self, chosen: np.ndarray) -> "Stream":
        """Some of the rows, by a mask or by numbers."""
        return Stream(
            self.time[chosen], self.values[chosen], None if self.line is None else self.line[chosen]
        )


@dataclass(frozen=True, eq=False)
class Streams:
    """A recording before its poses are brought to the stamps of its wrenches.

    Attributes
    ----------
    wrench, pose
        Rows of `WRENCH` and of `POSE`.
    together
        Whether row i of both is one and the same row of the file, so that nothing needs to be
        interpolated.
    notes
        What was left out or recovered, a sentence each.
    """

    wrench: Stream
    pose: Stream
    together: bool = False
    notes: tuple[str, ...] = field(default=())
