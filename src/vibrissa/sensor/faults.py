"""What is wrong with a recording: findings, each with its channels, interval and count."""

from dataclasses import dataclass
from enum import StrEnum

from vibrissa.sensor.raw import Interval, Times


class FaultKind(StrEnum):
    """What can be wrong with a recording.

    `SATURATION`: readings at the range, or flat-topped. `DROP_OUT`: rows without numbers, or of
    zeros between other readings. `STUCK`: a channel that repeats its value longer than noise and
    resolution allow. `GAP`: samples missing between two stamps. `DUPLICATE`, `BACKWARD`: a stamp
    equal to one before, or earlier. `UNITS`: numbers that cannot be in metres, newtons, newton
    metres, seconds, or no unit quaternions. `NOISE`: larger or smaller at rest than stated.
    `DRIFT`: the offset moves by more than stated. `POSE_JUMP`: the robot's pose jumps. `REST`: no
    rest for the tare. `TARE`: forces and moments that belong to no single contact. `HELD`: rows
    that repeat the reading above them in all channels. `MOUNT`: a sign, clamp or reference point of
    the setup that the readings contradict. `HUM`: a line in the spectrum at rest. `POSE_NOISE`:
    poses scatter by more than stated.
    """

    SATURATION = "saturation"
    DROP_OUT = "drop-out"
    STUCK = "stuck channel"
    GAP = "gap"
    DUPLICATE = "duplicate stamp"
    BACKWARD = "backward stamp"
    UNITS = "units"
    NOISE = "noise"
    DRIFT = "drift"
    POSE_JUMP = "pose jump"
    REST = "no rest"
    TARE = "no single contact"
    HELD = "held readings"
    MOUNT = "mount"
    HUM = "hum"
    POSE_NOISE = "pose noise"


@dataclass(frozen=True)
class Fault:
    """One finding over one interval.

    Attributes
    ----------
    kind
        What it is.
    channels
        Names of `vibrissa.sensor.CHANNELS`, or of the pose ("position", "orientation", "time").
    start, stop
        First and last stamp concerned [s], on the recording's clock.
    count
        Rows concerned; of a gap, samples missing.
    text
        One sentence with the figures.
    unusable
        Whether the recording cannot be used at all.
    quiet
        Whether an inspection lists it without a warning.
    """

    kind: FaultKind
    channels: tuple[str, ...]
    start: float
    stop: float
    count: int
    text: str
    unusable: bool = False
    quiet: bool = False

    @classmethod
    def over(
        cls,
        kind: FaultKind,
        channels: tuple[str, ...],
        stamps: Times | Interval,
        text: str,
        count: int | None = None,
        *,
        unusable: bool = False,
        quiet: bool = False,
    ) -> "Fault":
        """A finding from the first to the last of these stamps (n,); it concerns n rows, unless
        `count` says otherwise.
        """
        rows = len(stamps) if count is None else count
        span = float(stamps[0]), float(stamps[-1])
        return cls(kind, channels, *span, rows, text, unusable, quiet)
