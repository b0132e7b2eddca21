"""What a stream did, in figures and in words."""

from dataclasses import asdict, dataclass, field

from vibrissa.contacts import ContactKind
from vibrissa.live.samples import Counts

_MOST_WARNINGS = 100
"""A stream that falters for hours must not fill the memory with that."""


@dataclass
class Report:
    """What a stream did.

    Attributes
    ----------
    counts
        Of the source.
    contacts
        Rows with a contact, by kind.
    rows
        Rows given to the sinks.
    unused
        Samples recorded, but left without a row: the stream ended before the tare was over, or
        before their pose came.
    overflow
        Samples thrown away because this process could not keep up.
    without_pose
        Rows whose pose was not known.
    malformed_poses, misplaced_poses
        Datagrams of the pose stream that could not be read; poses whose stamps lie more than a
        second from their arrival.
    seconds
        From the first sample to the end.
    cpu_share
        Of one core, over that time.
    latency_median, latency_999
        From the arrival of a sample to its contact [s], and its 99.9th percentile; without rows
        that waited for the tare, or behind such. None if there were none.
    moved_during_tare
        Whether the wrench varied by more than three times its noise while it was tared.
    silent
        Whether the stream ended because the source fell silent.
    silences, silent_seconds
        How often a running source gave nothing for half a second or more, and for how long
        altogether.
    unsure, zero_changes
        Rows flagged because a sensor had been restarted and its zero was not known; how often the
        zero had changed, and was taken anew.
    warnings
        What was said while it ran, and what the figures above say at the end, one line each.
    """

    counts: Counts
    contacts: dict[str, int] = field(default_factory=lambda: {kind.name: 0 for kind in ContactKind})
    rows: int = 0
    unused: int = 0
    overflow: int = 0
    without_pose: int = 0
    malformed_poses: int = 0
    misplaced_poses: int = 0
    seconds: float = 0.0
    cpu_share: float = 0.0
    latency_median: float | None = None
    latency_999: float | None = None
    moved_during_tare: bool = False
    silent: bool = False
    silences: int = 0
    silent_seconds: float = 0.0
    unsure: int = 0
    zero_changes: int = 0
    warnings: list[str] = field(default_factory=list)

    def as_dict(self) -> dict[str, object]:
        """All figures, for JSON."""
        return asdict(self)

    def warn(self, text: str) -> bool:
        """Keep a warning; return whether there was room for it."""
        room = len(self.warnings) < _MOST_WARNINGS
        if room:
            self.warnings.append(text)
        return room

    def losses(self) -> list[str]:
        """What the figures say against the stream, one line each; nothing if all is well."""
        counts = self.counts
        said = {
            f"{counts.lost} samples are lost, in {counts.gaps} gaps": counts.lost,
            f"{counts.invalid} samples are in error, as the sensor says": counts.invalid,
            f"{counts.malformed} datagrams or lines could not be read": counts.malformed,
            f"{self.overflow} samples were thrown away: this computer does not keep up": (
                self.overflow
            ),
            "samples came at another rate than the setup says: stamps follow the rate seen": (
                counts.rate_changes
            ),
            f"{self.without_pose} rows have no pose": self.without_pose,
            f"{self.misplaced_poses} poses are stamped more than a second from their arrival: "
            "set both clocks, or leave the stamp out": self.misplaced_poses,
            f"{self.unsure} rows came while the sensor's zero was not known after a restart; "
            "their status says so": self.unsure,
        }
        return [text for text, count in said.items() if count]
