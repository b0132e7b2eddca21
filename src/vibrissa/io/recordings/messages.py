"""Messages of a bag, still packed: what every container of them is read to."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

WRENCH = "geometry_msgs/msg/WrenchStamped"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
FRAMES = "tf2_msgs/msg/TFMessage"
KINDS = frozenset({WRENCH, POSE, TRANSFORM, FRAMES})
"""Types of the messages that are read; the rest of a bag is passed over."""


class Message(NamedTuple):
    """One message: its topic, the time of its logging [ns], and its CDR."""

    topic: str
    log_time: int
    data: bytes


@dataclass
class Bag:
    """What was found in a bag so far.

    Attributes
    ----------
    topics
        Types by topic, also of those that are not read.
    messages
        Of the types that are read, in the order of the file.
    notes
        What was damaged or cut off, a sentence each.
    """

    topics: dict[str, str] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def of(self, *kinds: str) -> list[str]:
        """Topics of these types."""
        return sorted(topic for topic, kind in self.topics.items() if kind in kinds)

    def on(self, topic: str) -> Iterator[Message]:
        """Messages of a topic."""
        return (message for message in self.messages if message.topic == topic)
