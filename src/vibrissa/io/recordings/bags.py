"""ROS 2 bags: `geometry_msgs/WrenchStamped` with `PoseStamped`, `TransformStamped` or the frames of
/tf, from MCAP or SQLite.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from vibrissa.files import InputError
from vibrissa.io.recordings.containers import bag_of, is_bag
from vibrissa.io.recordings.frames import Link, Pair, chained
from vibrissa.io.recordings.libraries import library
from vibrissa.io.recordings.messages import FRAMES, POSE, TRANSFORM, WRENCH, Bag, Message
from vibrissa.io.recordings.streams import Poses, Streams, Wrenches
from vibrissa.io.recordings.table import RecordingTable

__all__ = ["is_bag", "streams"]

Numbers = Callable[[Any], tuple[float, ...]]
Row = tuple[float, tuple[float, ...]]
"""A stamp, and a vector and a vector or quaternion."""


def _getter(vector: str, other: str, axes: str) -> Numbers:
    return attrgetter(
        *(f"{vector}.{axis}" for axis in "xyz"), *(f"{other}.{axis}" for axis in axes)
    )


_NUMBERS: dict[str, Numbers] = {
    WRENCH: _getter("wrench.force", "wrench.torque", "xyz"),
    POSE: _getter("pose.position", "pose.orientation", "xyzw"),
    TRANSFORM: _getter("transform.translation", "transform.rotation", "xyzw"),
}


def streams(path: Path, table: RecordingTable, poses: Poses | None = None) -> Streams:
    """Both streams of a bag: a folder of rosbag2, or one of its files, also without its metadata;
    or its wrenches alone, where the poses are given.

    Raises
    ------
    InputError
        If the bag is damaged from its start, or topics, types or frames are not those asked for.
    """
    bag = _Bag(path, bag_of(path), table)
    wrench = bag.wrenches()
    return Streams(wrench, bag.poses() if poses is None else poses, notes=tuple(bag.bag.notes))


def _arrays(rows: list[Row]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps, the vectors, and what follows them."""
    stamps, numbers = zip(*rows, strict=True)
    first, second = np.split(np.array(numbers, dtype=np.float64), [3], axis=1)
    return np.array(stamps, dtype=np.float64), first, second


@cache
def _types() -> Any:
    """Types of messages; the four that are read have been the same in all of ROS 2. Code to unpack
    them is generated once.
    """
    known = library("rosbags.typesys")
    return known.get_typestore(known.Stores.ROS2_HUMBLE)


@dataclass(frozen=True)
class _Bag:
    """Messages of a bag by what [recording] says of them."""

    path: Path
    bag: Bag
    table: RecordingTable

    def contents(self, topic: str) -> Iterator[tuple[Message, Any]]:
        """Messages of a topic, packed and unpacked."""
        kind, types = self.bag.topics[topic], _types()
        for message in self.bag.on(topic):
            try:
                yield message, types.deserialize_cdr(message.data, kind)
            # The generated code of a message meets damage wherever it is: struct, indices, texts.
            except Exception as error:
                raise InputError(
                    f"{self.path}: a message on {topic!r} at {message.log_time} ns is no {kind} "
                    f"({str(error)[:80]}); allowed are whole messages"
                ) from error

    def stamp(self, message: Message, header: Any) -> float:
        """Stamp of a message [s]."""
        if self.table.stamps == "log":
            return message.log_time * 1e-9
        return float((header.stamp.sec * 1_000_000_000 + header.stamp.nanosec) * 1e-9)

    def rows(self, topic: str) -> list[Row]:
        """Stamps [s] and numbers of the messages on a topic."""
        numbers = _NUMBERS[self.bag.topics[topic]]
        found = [
            (self.stamp(message, content.header), numbers(content))
            for message, content in self.contents(topic)
        ]
        if not found:
            raise InputError(
                f"{self.path}: no messages on {topic!r} in CDR, the encoding of ROS 2; "
                "allowed is at least one"
            )
        if len(found) > 1 and not any(stamp for stamp, _ in found):
            raise InputError(
                f"{self.path}: the headers on {topic!r} have the stamp 0 throughout; "
                "allowed are stamps, or stamps = 'log' in [recording]"
            )
        return found

    def wrenches(self) -> Wrenches:
        """The wrenches."""
        topic = self.topic(self.table.wrench_topic, "wrench_topic", WRENCH)
        return Wrenches(*_arrays(self.rows(topic)))

    def wrench_frame(self) -> str:
        """The frame that the wrenches are given in, by the first message that names one."""
        topic = self.topic(self.table.wrench_topic, "wrench_topic", WRENCH)
        frames = (content.header.frame_id for _, content in self.contents(topic))
        return next(filter(None, frames), "")

    def poses(self) -> Poses:
        """Poses of a topic, or of the frames."""
        table = self.table
        by_frames = table.fixed_frame is not None or not self.bag.of(POSE, TRANSFORM)
        if table.pose_topic is None and by_frames and self.bag.of(FRAMES):
            sensor_frame = table.sensor_frame or self.wrench_frame()
            return chained(self.path, self.links(), table.fixed_frame, sensor_frame)
        topic = self.topic(table.pose_topic, "pose_topic", POSE, TRANSFORM)
        return Poses(*_arrays(self.rows(topic)))

    def links(self) -> dict[Pair, Link]:
        """Poses of frames in their parents; of topics whose name ends in "static" the last one
        holds for all times, unless the frame also moves.
        """
        found: dict[tuple[bool, Pair], list[Row]] = {}
        for topic in self.bag.of(FRAMES):
            for message, content in self.contents(topic):
                for part in content.transforms:
                    pair = part.header.frame_id.lstrip("/"), part.child_frame_id.lstrip("/")
                    row = self.stamp(message, part.header), _NUMBERS[TRANSFORM](part)
                    found.setdefault((not topic.endswith("static"), pair), []).append(row)
        links = {}
        for (moves, pair), rows in sorted(found.items()):
            poses = Poses(*_arrays(rows))
            # Several nodes may publish one frame: each stamp counts once.
            chosen = np.unique(poses.time, return_index=True)[1] if moves else np.array([-1])
            links[pair] = Link(poses.rows(chosen), is_fixed=not moves)
        return links

    def topic(self, name: str | None, key: str, *kinds: str) -> str:
        """The topic that is named, or the only one of these types."""
        fitting = self.bag.of(*kinds)
        allowed = " or ".join(kind.replace("/msg/", "/") for kind in kinds)
        topics = (f"{topic} ({kind})" for topic, kind in sorted(self.bag.topics.items()))
        held = "; ".join([", ".join(topics)[:400] or "no topics", *self.bag.notes[:2]])
        if name in fitting:
            return str(name)
        if name is not None:
            raise InputError(
                f"{self.path}: {key} = {name!r} is no topic of {allowed}; the bag holds {held}"
            )
        if len(fitting) != 1:
            file = " or pose_file" if key == "pose_topic" else ""
            raise InputError(
                f"{self.path}: {len(fitting)} topics of {allowed}; allowed is one, or {key}{file} "
                f"in [recording]. The bag holds {held}"
            )
        return fitting[0]
