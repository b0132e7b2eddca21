"""ROS 2 bags: `geometry_msgs/WrenchStamped` with `PoseStamped`, `TransformStamped` or frames from
/tf, in MCAP or SQLite.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from vibrissa.files import InputError
from vibrissa.io.recordings.containers import (
    FRAMES,
    POSE,
    TRANSFORM,
    WRENCH,
    Bag,
    bag_of,
    library,
)
from vibrissa.io.recordings.formats import Columns
from vibrissa.io.recordings.layout import pose_stream
from vibrissa.io.recordings.streams import Poses, Streams, Wrenches, interpolated, usable, within
from vibrissa.io.recordings.table import RecordingTable

Stream = TypeVar("Stream", Wrenches, Poses)


def _getter(vector: str, other: str, axes: str) -> Callable[[Any], tuple[float, ...]]:
    return attrgetter(
        *(f"{vector}.{axis}" for axis in "xyz"), *(f"{other}.{axis}" for axis in axes)
    )


_NUMBERS = {
    WRENCH: _getter("wrench.force", "wrench.torque", "xyz"),
    POSE: _getter("pose.position", "pose.orientation", "xyzw"),
    **dict.fromkeys(
        (TRANSFORM, FRAMES), _getter("transform.translation", "transform.rotation", "xyzw")
    ),
}


def streams(path: Path, table: RecordingTable, poses: Columns | None = None) -> Streams:
    """Both streams of a bag, which is a rosbag2 folder or one of its files, with or without
    metadata; only its wrenches if `poses` are given.

    Raises
    ------
    InputError
        If the bag is damaged from the start, or lacks the topics, types or frames asked for.
    """
    bag = _Bag(path, bag_of(path), table)
    topic = bag.topic("wrench_topic", WRENCH)
    wrench = _stream(Wrenches, bag.rows(topic))
    pose = bag.poses(topic) if poses is None else pose_stream(poses, table)
    return Streams(wrench, pose, notes=tuple(bag.bag.notes))


def _stream(kind: type[Stream], rows: list[tuple[float, ...]]) -> Stream:
    """A stream from rows that hold a stamp, a vector, and a vector or quaternion."""
    table = np.array(rows, dtype=np.float64)
    return kind(table[:, 0], table[:, 1:4], table[:, 4:])


@cache
def _types() -> Any:
    """Message types; the four that are read are the same in all releases of ROS 2. The code that
    unpacks them is generated once.
    """
    known = library("rosbags.typesys")
    return known.get_typestore(known.Stores.ROS2_HUMBLE)


@dataclass(frozen=True)
class _Bag:
    """Messages of a bag, interpreted according to [recording]."""

    path: Path
    bag: Bag
    table: RecordingTable

    def parts(self, topic: str) -> Iterator[tuple[Any, tuple[float, ...]]]:
        """Wrenches, poses or frames of a topic, each with its stamp [s] and numbers."""
        kind, types = self.bag.topics[topic], _types()
        for _, log_time, data in (one for one in self.bag.messages if one.topic == topic):
            try:
                content = types.deserialize_cdr(data, kind)
            # The generated code may raise anything on corrupt data.
            except Exception as error:
                raise InputError(
                    f"{self.path}: a message on {topic!r} at {log_time} ns is not a valid "
                    f"{kind} ({str(error)[:80]}); allowed are complete messages"
                ) from error
            for part in content.transforms if kind == FRAMES else [content]:
                moment = part.header.stamp
                stamp = moment.sec * 1_000_000_000 + moment.nanosec
                time = 1e-9 * (log_time if self.table.stamps == "log" else stamp)
                yield part, (time, *_NUMBERS[kind](part))

    def rows(self, topic: str) -> list[tuple[float, ...]]:
        """Stamps [s] and numbers of the messages of a topic."""
        found = [row for _, row in self.parts(topic)]
        if not found:
            raise InputError(
                f"{self.path}: no messages on {topic!r} in CDR, the encoding of ROS 2; "
                "allowed is at least one"
            )
        if len(found) > 1 and not any(stamp for stamp, *_ in found):
            raise InputError(
                f"{self.path}: the headers on {topic!r} have the stamp 0 throughout; "
                "allowed are stamps, or stamps = 'log' in [recording]"
            )
        return found

    def poses(self, wrench_topic: str) -> Poses:
        """Poses from a topic, or from the frames; without a sensor_frame, of the first frame_id
        found in a wrench.
        """
        table = self.table
        by_frames = table.fixed_frame is not None or not self.bag.of(POSE, TRANSFORM)
        if table.pose_topic is not None or not by_frames or not self.bag.of(FRAMES):
            return _stream(Poses, self.rows(self.topic("pose_topic", POSE, TRANSFORM)))
        frames = (part.header.frame_id for part, _ in self.parts(wrench_topic))
        return self.chained(table.sensor_frame or next(filter(None, frames), ""))

    def links(self) -> dict[str, tuple[str, Poses]]:
        """Parent of each frame, and its poses there; a frame that occurs only on topics whose names
        end in "static" has the last pose of those, valid at all times.
        """
        found = defaultdict[tuple[bool, str, str], list[tuple[float, ...]]](list)
        for topic in self.bag.of(FRAMES):
            for part, row in self.parts(topic):
                pair = part.child_frame_id.lstrip("/"), part.header.frame_id.lstrip("/")
                found[not topic.endswith("static"), *pair].append(row)
        links = {}
        for (moves, child, parent), rows in sorted(found.items()):
            # Several nodes may publish the same frame: each stamp counts once.
            poses = usable(_stream(Poses, rows if moves else rows[-1:]))
            if not moves:
                poses = replace(poses, time=np.full_like(poses.time, np.inf))
            if len(poses.time):
                links[child] = parent, poses
        return links

    def chained(self, sensor_frame: str) -> Poses:
        """Poses of a frame in the fixed frame, or in the root of its chain, at all stamps of links
        at which every link is known; no link is extrapolated.
        """
        links, here = self.links(), sensor_frame.lstrip("/")
        chain: list[Poses] = []
        fixed_frame = self.table.fixed_frame
        top = fixed_frame and fixed_frame.lstrip("/")
        while here != top and here in links and len(chain) <= len(links):
            here, poses = links[here]
            chain.insert(0, poses)
        if not chain or top not in {None, here} or len(chain) > len(links):
            known = sorted({*links, *(parent for parent, _ in links.values())})
            raise InputError(
                f"{self.path}: no chain of frames from fixed_frame = {fixed_frame!r} to "
                f"sensor_frame = {sensor_frame!r}; the bag holds {', '.join(known)[:300]}"
            )
        ends = f"between {here!r} and {sensor_frame!r}"
        moving = [poses for poses in chain if np.isfinite(poses.time).any()]
        if not moving:
            raise InputError(
                f"{self.path}: no frame {ends} is on /tf, all are static; "
                "allowed is a moving sensor"
            )
        time = np.unique(np.concatenate([poses.time for poses in moving]))
        time = time[np.all([within(poses, time) for poses in moving], axis=0)]
        if not len(time):
            raise InputError(
                f"{self.path}: the frames {ends} have no time in common; "
                "allowed are links that overlap"
            )
        position, turn = np.zeros(3), Rotation.identity(len(time))
        for poses in chain:
            link = interpolated(poses, time) if poses in moving else poses
            position = position + turn.apply(link.position)
            turn = turn * Rotation.from_quat(link.orientation)
        return Poses(time, position, turn.as_quat())

    def topic(self, key: str, *kinds: str) -> str:
        """The topic that the key names, or else the only one of these types."""
        name, fitting = getattr(self.table, key), self.bag.of(*kinds)
        chosen = [topic for topic in fitting if name in {None, topic}]
        if len(chosen) == 1:
            return chosen[0]
        allowed = " or ".join(kind.replace("/msg/", "/") for kind in kinds)
        topics = [f"{topic} ({kind})" for topic, kind in sorted(self.bag.topics.items())]
        held = "; ".join([", ".join(topics)[:400] or "no topics", *self.bag.notes[:2]])
        given = f"{len(fitting)} topics" if name is None else f"{key} = {name!r} is no topic"
        file = " or pose_file" if key == "pose_topic" else ""
        raise InputError(
            f"{self.path}: {given} of {allowed}; allowed is one, or {key}{file} in [recording]. "
            f"The bag holds {held}"
        )
