"""What every format is read to: wrenches and poses, each with stamps of its own, SI units."""

from dataclasses import dataclass, field, fields, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float, Int

Rows = TypeVar("Rows", bound="Stamped")


@dataclass(frozen=True, eq=False)
class Stamped:
    """Rows as they were recorded, not judged: stamps may stand or fall, numbers may be NaN.

    Attributes
    ----------
    time
        (n,) [s].
    line
        (n,) lines of the text that the rows stand in, from 1; None for other formats.
    """

    time: Float[np.ndarray, "n"]
    line: Int[np.ndarray, "n"] | None = field(default=None, kw_only=True)

    def place(self, row: int) -> str:
        """Say where a row is in its file."""
        return f"row {row}" if self.line is None else f"line {self.line[row]}"

    def rows(self: Rows, chosen: np.ndarray) -> Rows:
        """Some of the rows, by a mask or by numbers."""
        parts = {part.name: getattr(self, part.name) for part in fields(self)}
        return replace(
            self, **{name: part[chosen] for name, part in parts.items() if part is not None}
        )


@dataclass(frozen=True, eq=False)
class Wrenches(Stamped):
    """Stamped wrenches.

    Attributes
    ----------
    force, torque
        (n, 3) [N], [N m].
    """

    force: Float[np.ndarray, "n 3"]
    torque: Float[np.ndarray, "n 3"]

    @property
    def channels(self) -> Float[np.ndarray, "n 6"]:
        """Force, then torque."""
        return np.hstack([self.force, self.torque])


@dataclass(frozen=True, eq=False)
class Poses(Stamped):
    """Stamped poses of the sensor frame.

    Attributes
    ----------
    position
        (n, 3) [m].
    orientation
        (n, 4) quaternions x, y, z, w.
    """

    position: Float[np.ndarray, "n 3"]
    orientation: Float[np.ndarray, "n 4"]

    @property
    def finite(self) -> np.ndarray:
        """(n,) whether all numbers of a row are there."""
        numbers = np.column_stack([self.time, self.position, self.orientation])
        return np.isfinite(numbers).all(axis=1)


@dataclass(frozen=True, eq=False)
class Streams:
    """A recording before its poses are brought to the stamps of its wrenches.

    Attributes
    ----------
    wrench, pose
        The two streams.
    together
        Whether row i of both is one and the same row of the file, so that nothing needs to be
        interpolated.
    notes
        What was left out or recovered, a sentence each.
    """

    wrench: Wrenches
    pose: Poses
    together: bool = False
    notes: tuple[str, ...] = ()
