"""ROS 2 messages as CDR: a wrench, a pose, a cloud of contacts."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from vibrissa.inverse import Reconstruction
from vibrissa.io.rosbag.growing import Channel, Messages
from vibrissa.io.rosbag.library import library

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
"""Of all topics: keep the last 100, reliable, volatile."""

FIELDS = (
    "x",
    "y",
    "z",
    "normal_x",
    "normal_y",
    "normal_z",
    "deviation_x",
    "deviation_y",
    "deviation_z",
    "arc_length",
)
"""Of a point, 32-bit floats; then come `kind` and `status`, bytes, and `time`, a 64-bit float:
seconds after the header's stamp.
"""
POINT = np.dtype(
    [
        *((name, "<f4") for name in FIELDS),
        ("kind", "u1"),
        ("status", "u1"),
        ("padding", "V6"),
        ("time", "<f8"),
    ]
)

_SECOND = 1_000_000_000
_MESSAGE_HEAD = [
    ("opcode", "u1"),
    ("length", "<u8"),
    ("channel", "<u2"),
    ("sequence", "<u4"),
    ("log_time", "<u8"),
    ("publish_time", "<u8"),
]
_MESSAGE = 0x05
_BESIDE_DATA = 22
_FLOAT32, _FLOAT64, _UINT8 = 7, 8, 2


class MessageWriter:
    """Message records for MCAP, channel by channel.

    Wrenches and poses have a fixed length: a message that `rosbags` serialised is the pattern, into
    which stamps and numbers are put, many messages at once.

    Parameters
    ----------
    wrench_frame, world_frame
        Names of the frames of the wrench, and of poses and contacts.

    Raises
    ------
    ImportError
        If `rosbags` is missing.
    """

    def __init__(self, wrench_frame: str = "sensor", world_frame: str = "world") -> None:
        typesys = library("rosbags.typesys")
        self._store: Any = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        self._world = world_frame
        self._patterns = {
            WRENCH: self._pattern(WRENCH, self._wrench(wrench_frame), 6),
            POSE: self._pattern(POSE, self._pose(world_frame), 7),
        }
        self._fields = self._point_fields()
        self._sequence = [0, 0, 0]
        # rosbags builds its code for a type when it first meets it.
        self._cloud_bytes(np.zeros(1, dtype=POINT), 0, is_dense=True)

    def channels(self) -> list[Channel]:
        """The three topics."""
        return [
            Channel(topic, kind, self._store.generate_msgdef(kind, ros_version=2)[0])
            for topic, kind in zip(TOPICS, TYPES, strict=True)
        ]

    def _type(self, name: str) -> Any:
        return self._store.types[name]

    def _header(self, frame: str, stamp: int = 0) -> Any:
        moment = self._type("builtin_interfaces/msg/Time")(
            sec=stamp // _SECOND, nanosec=stamp % _SECOND
        )
        return self._type("std_msgs/msg/Header")(stamp=moment, frame_id=frame)

    def _wrench(self, frame: str) -> Any:
        vector = self._type("geometry_msgs/msg/Vector3")(x=0.0, y=0.0, z=0.0)
        wrench = self._type("geometry_msgs/msg/Wrench")(force=vector, torque=vector)
        return self._type(TYPES[WRENCH])(header=self._header(frame), wrench=wrench)

    def _pose(self, frame: str) -> Any:
        point, turn = (
            self._type("geometry_msgs/msg/Point")(x=0.0, y=0.0, z=0.0),
            self._type("geometry_msgs/msg/Quaternion"),
        )
        pose = self._type("geometry_msgs/msg/Pose")(
            position=point, orientation=turn(x=0.0, y=0.0, z=0.0, w=1.0)
        )
        return self._type(TYPES[POSE])(header=self._header(frame), pose=pose)

    def _pattern(self, channel: int, message: Any, numbers: int) -> np.ndarray:
        """One record (1,): CDR's four bytes, the stamp, the frame's name, and the numbers at the
        end.
        """
        data = bytes(self._store.serialize_cdr(message, TYPES[channel]))
        between = len(data) - 12 - 8 * numbers
        body = [
            ("start", "V4"),
            ("sec", "<i4"),
            ("nanosec", "<u4"),
            ("frame", f"V{between}"),
            ("numbers", "<f8", (numbers,)),
        ]
        kind = np.dtype([*_MESSAGE_HEAD, *body])
        record = np.zeros(1, dtype=kind)
        record["opcode"], record["length"], record["channel"] = (
            _MESSAGE,
            _BESIDE_DATA + len(data),
            channel + 1,
        )
        record["start"], record["frame"] = data[:4], data[12 : 12 + between]
        return record

    def wrenches(
        self,
        stamp: Int[np.ndarray, "n"],
        sequence: Int[np.ndarray, "n"],
        force: Float[np.ndarray, "n 3"],
        torque: Float[np.ndarray, "n 3"],
        log_time: Int[np.ndarray, "n"],
    ) -> Messages:
        """Raw samples, under the sensor's own numbers."""
        return self._stamped(
            WRENCH, stamp, log_time, np.concatenate([force, torque], axis=1), sequence
        )

    def poses(
        self,
        stamp: Int[np.ndarray, "n"],
        position: Float[np.ndarray, "n 3"],
        orientation: Float[np.ndarray, "n 4"],
        log_time: Int[np.ndarray, "n"],
    ) -> Messages:
        """Poses of the sensor frame."""
        return self._stamped(
            POSE,
            stamp,
            log_time,
            np.concatenate([position, orientation], axis=1),
            self._numbered(POSE, len(stamp)),
        )

    def _stamped(
        self,
        channel: int,
        stamp: np.ndarray,
        log_time: np.ndarray,
        numbers: np.ndarray,
        sequence: np.ndarray,
    ) -> Messages:
        records = np.repeat(self._patterns[channel], len(stamp))
        records["sequence"] = sequence % (1 << 32)
        # MCAP knows no time before 1970; the header does.
        records["log_time"], records["publish_time"] = log_time, np.maximum(stamp, 0)
        records["sec"], records["nanosec"] = stamp // _SECOND, stamp % _SECOND
        records["numbers"] = numbers
        return Messages(
            channel,
            log_time,
            np.arange(len(stamp), dtype=np.int64) * records.itemsize,
            records.tobytes(),
        )

    def _numbered(self, channel: int, count: int) -> Int[np.ndarray, "n"]:
        first = self._sequence[channel]
        self._sequence[channel] += count
        return np.arange(first, first + count, dtype=np.int64)

    def cloud(self, stamp: Int[np.ndarray, "n"], found: Reconstruction, log_time: int) -> Messages:
        """One cloud of the rows with a contact, stamped as the first of them; nothing where there
        is none.
        """
        rows = np.flatnonzero(found.in_contact)
        if not len(rows):
            return Messages(CONTACTS, np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), b"")
        points = _points(stamp, found, rows)
        first = int(stamp[rows[0]])
        data = self._cloud_bytes(points, first, is_dense=found.covariance is not None)
        head = np.zeros(1, dtype=_MESSAGE_HEAD)
        head["opcode"], head["length"], head["channel"] = (
            _MESSAGE,
            _BESIDE_DATA + len(data),
            CONTACTS + 1,
        )
        head["sequence"] = self._numbered(CONTACTS, 1)
        head["log_time"], head["publish_time"] = log_time, max(first, 0)
        return Messages(
            CONTACTS, np.array([log_time]), np.zeros(1, dtype=np.int64), head.tobytes() + data
        )

    def _cloud_bytes(self, points: np.ndarray, stamp: int, *, is_dense: bool) -> bytes:
        message = self._type(TYPES[CONTACTS])(
            header=self._header(self._world, stamp),
            height=1,
            width=len(points),
            fields=self._fields,
            is_bigendian=False,
            point_step=POINT.itemsize,
            row_step=POINT.itemsize * len(points),
            data=points.view(np.uint8).reshape(-1),
            is_dense=is_dense,
        )
        return bytes(self._store.serialize_cdr(message, TYPES[CONTACTS]))

    def _point_fields(self) -> list[Any]:
        kinds = {"<f4": _FLOAT32, "<f8": _FLOAT64, "|u1": _UINT8}
        parts = [
            (name, part[0].str, part[1])
            for name, part in (POINT.fields or {}).items()
            if name != "padding"
        ]
        field = self._type("sensor_msgs/msg/PointField")
        return [
            field(name=name, offset=offset, datatype=kinds[kind], count=1)
            for name, kind, offset in parts
        ]


def _points(
    stamp: Int[np.ndarray, "n"], found: Reconstruction, rows: Int[np.ndarray, "k"]
) -> np.ndarray:
    points = np.zeros(len(rows), dtype=POINT)
    deviation = np.full((len(rows), 3), np.nan)
    if found.covariance is not None:
        deviation = np.sqrt(np.diagonal(found.covariance[rows], axis1=-2, axis2=-1))
    values = np.column_stack(
        [found.point[rows], found.normal[rows], deviation, found.arc_length[rows]]
    )
    for column, name in enumerate(FIELDS):
        points[name] = values[:, column]
    points["kind"], points["status"] = found.kind[rows], found.status[rows]
    points["time"] = (stamp[rows] - stamp[rows[0]]) * 1e-9
    return points
