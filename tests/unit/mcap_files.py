"""Bags in MCAP for tests, written by hand after the format's specification: small, and with a
choice of packing, order and damage.
"""

import zlib
from struct import pack

import numpy as np
from bench_files import recording_table, recording_text
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
WRENCH, POSE, FRAMES = (
    "geometry_msgs/msg/WrenchStamped",
    "geometry_msgs/msg/PoseStamped",
    "tf2_msgs/msg/TFMessage",
)
MAGIC = b"\x89MCAP0\r\n"


def _geometry(name, *fields):
    return TYPES[f"geometry_msgs/msg/{name}"](*fields)


def header(seconds: float, frame: str):
    nanoseconds = round(seconds * 1e9)
    stamp = TYPES["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp, frame)


def wrench_message(row: np.ndarray, frame: str = "sensor") -> bytes:
    """CDR of a row as `bench_files.HEADER` names it."""
    numbers = [float(number) for number in row[8:]]
    wrench = _geometry(
        "Wrench", _geometry("Vector3", *numbers[:3]), _geometry("Vector3", *numbers[3:])
    )
    return bytes(
        STORE.serialize_cdr(_geometry("WrenchStamped", header(row[0], frame), wrench), WRENCH)
    )


def pose_message(row: np.ndarray) -> bytes:
    numbers = [float(number) for number in row[1:8]]
    pose = _geometry(
        "Pose", _geometry("Point", *numbers[:3]), _geometry("Quaternion", *numbers[3:])
    )
    return bytes(STORE.serialize_cdr(_geometry("PoseStamped", header(row[0], "world"), pose), POSE))


def frame_message(seconds: float, parent: str, child: str, position, quaternion) -> bytes:
    place = _geometry(
        "Transform",
        _geometry("Vector3", *map(float, position)),
        _geometry("Quaternion", *map(float, quaternion)),
    )
    link = _geometry("TransformStamped", header(seconds, parent), child, place)
    return bytes(STORE.serialize_cdr(TYPES[FRAMES]([link]), FRAMES))


def text(value: str) -> bytes:
    return pack("<I", len(value.encode())) + value.encode()


def record(kind: int, body: bytes) -> bytes:
    return pack("<BQ", kind, len(body)) + body


def schema(number: int, name: str) -> bytes:
    return record(3, pack("<H", number) + text(name) + text("ros2msg") + text(""))


def channel(number: int, topic: str, encoding: str = "cdr") -> bytes:
    return record(4, pack("<HH", number, number) + text(topic) + text(encoding) + text(""))


def message(number: int, log_time: int, data: bytes) -> bytes:
    return record(5, pack("<HIQQ", number, 0, log_time, log_time) + data)


def packed(
    records: bytes, packing: str, *, claimed: int | None = None, checksum: int | None = None
) -> bytes:
    """A chunk, or the records as they are."""
    if packing == "none":
        return records
    if packing == "zstd":
        import zstandard

        content, name = zstandard.compress(records), "zstd"
    elif packing == "lz4":
        import lz4.frame

        content, name = lz4.frame.compress(records), "lz4"
    else:
        content, name = records, ""
    check = zlib.crc32(records) if checksum is None else checksum
    size = len(records) if claimed is None else claimed
    return record(
        6, pack("<QQQI", 0, 2**62, size, check) + text(name) + pack("<Q", len(content)) + content
    )


def whole(data: bytes) -> bytes:
    """A file around its data, without index."""
    return (
        MAGIC
        + record(1, text("ros2") + text(""))
        + data
        + record(15, pack("<I", 0))
        + record(2, pack("<QQI", 0, 0, 0))
        + MAGIC
    )


def definitions(topics: list[tuple[str, str]]) -> bytes:
    return b"".join(
        schema(number, kind) + channel(number, topic)
        for number, (topic, kind) in enumerate(topics, start=1)
    )


def mcap_bytes(
    rows: int = 40, packing: str = "none", *, frames: bool = False, chunks: int = 1
) -> bytes:
    """The recording of `bench_files` as a bag; poses as `/pose`, or with `frames` as world, arm
    and, static, sensor.
    """
    table = np.genfromtxt(recording_text(recording_table(rows)).splitlines()[1:], delimiter=",")
    topics = (
        [("/wrench", WRENCH), ("/tf", FRAMES), ("/tf_static", FRAMES)]
        if frames
        else [("/wrench", WRENCH), ("/pose", POSE)]
    )
    entries = (
        [message(3, 0, frame_message(0, "arm", "sensor", (0, 0, 0.1), (0, 0, 0, 1)))]
        if frames
        else []
    )
    for row in table:
        stamp = round(row[0] * 1e9)
        entries.append(message(1, stamp, wrench_message(row)))
        pose = (
            frame_message(row[0], "world", "arm", row[1:4] - [0, 0, 0.1], row[4:8])
            if frames
            else pose_message(row)
        )
        entries.append(message(2, stamp, pose))
    pieces = [b"".join(part) for part in np.array_split(np.array(entries, dtype=object), chunks)]
    return whole(b"".join(packed(definitions(topics) + piece, packing) for piece in pieces))
