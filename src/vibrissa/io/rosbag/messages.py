"""ROS 2 messages as CDR: a wrench, a pose, a cloud of contacts."""

from typing import Any

import numpy as np
from jaxtyping import Float
from mcap.records import Message
from rosbags.typesys import Stores, get_typestore

from vibrissa.inverse import Reconstruction
from vibrissa.io.clouds import Columns
from vibrissa.io.contacts import DEVIATIONS, columns, structured
from vibrissa.io.rosbag.growing import Channel, Messages, Stamps, packed

WRENCH, POSE, CONTACTS = range(3)
TYPES = (
    "geometry_msgs/msg/WrenchStamped",
    "geometry_msgs/msg/PoseStamped",
    "sensor_msgs/msg/PointCloud2",
)
TOPICS = ("/vibrissa/wrench", "/vibrissa/pose", "/vibrissa/contacts")
QOS = """\
- history: 1
  depth: 100
  reliability: 1
  durability: 2
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
"""
"""QoS of all topics: keep the last 100, reliable, volatile."""

_NORMAL = [f"normal_{axis}" for axis in "xyz"]
POINT = np.dtype(
    {
        "names": ["x", "y", "z", *_NORMAL, *DEVIATIONS, "arc_length", "kind", "status", "time"],
        "formats": ["<f4"] * 10 + ["u1", "u1", "<f8"],
    },
    align=True,
)
"""A point of a cloud; `time` is in seconds after the header's stamp."""

_SECOND = 1_000_000_000
# Head of a message record (MCAP specification), then the beginning of a stamped message in CDR.
_HEAD = {
    "opcode": "u1",
    "length": "<u8",
    "channel": "<u2",
    "sequence": "<u4",
    "log_time": "<u8",
    "publish_time": "<u8",
    "encapsulation": "V4",
    "sec": "<i4",
    "nanosec": "<u4",
}
DATATYPES = {"<f4": 7, "<f8": 8, "|u1": 2}
"""Of sensor_msgs/msg/PointField."""


class MessageWriter:
    """Message records for MCAP, channel by channel.

    Wrenches and poses are messages of fixed length: `rosbags` serialises one record, and stamps and
    numbers are put into copies of it, many messages at once.

    Parameters
    ----------
    wrench_frame, world_frame
        Frame names: of the wrench, and of poses and contacts.
    """

    def __init__(self, wrench_frame: str = "sensor", world_frame: str = "world") -> None:
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._world, self._counts = world_frame, [0] * len(TOPICS)
        self._patterns = {
            WRENCH: self._pattern(WRENCH, 6, wrench_frame),
            POSE: self._pattern(POSE, 7, world_frame),
        }
        self._fields = point_fields(self._store, POINT)
        # rosbags generates the code for a type on first use.
        self._cloud_data(np.zeros(1, dtype=POINT), 0, is_dense=True)

    def channels(self) -> list[Channel]:
        """The three topics."""
        return [
            Channel(topic, kind, self._store.generate_msgdef(kind, ros_version=2)[0])
            for topic, kind in zip(TOPICS, TYPES, strict=True)
        ]

    def _new(self, message_type: str, *values: Any) -> Any:
        return self._store.types[message_type](*values)

    def _header(self, frame: str, stamp: int) -> Any:
        moment = self._new("builtin_interfaces/msg/Time", *divmod(stamp, _SECOND))
        return self._new("std_msgs/msg/Header", moment, frame)

    def _pattern(self, channel: int, count: int, frame: str) -> np.ndarray:
        """One record (1,) of a message that consists of a header and `count` numbers."""
        header = self._store.serialize_cdr(self._header(frame, 0), "std_msgs/msg/Header")
        # CDR aligns numbers to their size, counted from the end of the encapsulation header.
        padding = -(len(header) - 4) % 8
        data = bytes(header) + bytes(padding + 8 * count)
        record = packed(Message(channel + 1, 0, data, 0, 0))
        head = list(_HEAD.items())
        between = len(record) - np.dtype(head).itemsize - 8 * count
        kind = [*head, ("frame", f"V{between}"), ("numbers", "<f8", (count,))]
        return np.frombuffer(record, dtype=kind)

    def stamped(
        self,
        channel: int,
        stamp: Stamps,
        log_time: Stamps,
        numbers: Float[np.ndarray, "n k"],
        sequence: Stamps | None = None,
    ) -> Messages:
        """Wrenches (n, 6), with the sensor's sequence numbers, or sensor-frame poses (n, 7)."""
        records = np.repeat(self._patterns[channel], len(stamp))
        if sequence is None:
            sequence = self._counts[channel] + np.arange(len(stamp))
            self._counts[channel] += len(stamp)
        records["sequence"] = sequence % (1 << 32)
        # MCAP has no times before 1970; the message header does.
        records["log_time"], records["publish_time"] = log_time, np.maximum(stamp, 0)
        records["sec"], records["nanosec"] = np.divmod(stamp, _SECOND)
        records["numbers"] = numbers
        offset = np.arange(len(stamp)) * records.itemsize
        return Messages(channel, log_time, offset, records.tobytes())

    def cloud(self, stamp: Stamps, found: Reconstruction, log_time: int) -> Messages:
        """One cloud of the rows with a contact, with the stamp of the first; empty if there are
        none.
        """
        rows = found.in_contact
        named = {name: part[rows] for name, part in columns(found).items()}
        return self.points(stamp[rows], named, log_time, is_dense=found.covariance is not None)

    def points(
        self, stamp: Stamps, named: Columns, log_time: int | None = None, *, is_dense: bool
    ) -> Messages:
        """One cloud of these contacts, columns by name; by default, its log time is its stamp."""
        if not len(stamp):
            nothing = np.empty(0, dtype=np.int64)
            return Messages(CONTACTS, nothing, nothing, b"")
        first = int(stamp[0])
        known = {f"normal_{axis}": named[f"n{axis}"] for axis in "xyz"}
        known |= {**named, "time": (stamp - first) * 1e-9}
        points = structured(POINT, known, np.ones(len(stamp), dtype=bool))
        data = self._cloud_data(points, first, is_dense=is_dense)
        sequence = self._counts[CONTACTS]
        self._counts[CONTACTS] += 1
        published = max(first, 0)
        logged = published if log_time is None else log_time
        record = packed(Message(CONTACTS + 1, logged, data, published, sequence))
        return Messages(CONTACTS, np.array([logged]), np.array([0]), record)

    def _cloud_data(self, points: np.ndarray, stamp: int, *, is_dense: bool) -> bytes:
        header = self._header(self._world, stamp)
        cloud = cloud_message(self._store, header, points, self._fields, is_dense=is_dense)
        return bytes(self._store.serialize_cdr(cloud, TYPES[CONTACTS]))


def point_fields(store: Any, point: np.dtype[np.void]) -> list[Any]:
    """Descriptions of a point's fields in a cloud."""
    described = store.types["sensor_msgs/msg/PointField"]
    return [
        described(name, offset, DATATYPES[kind.str], 1)
        for name, (kind, offset, *_) in (point.fields or {}).items()
    ]


def cloud_message(
    store: Any, header: Any, points: np.ndarray, fields: list[Any], *, is_dense: bool
) -> Any:
    """Structured points as a `PointCloud2`."""
    shape = 1, len(points), fields, False, points.itemsize, points.nbytes
    return store.types[TYPES[CONTACTS]](header, *shape, points.view(np.uint8), is_dense)
