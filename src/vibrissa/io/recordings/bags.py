"""ROS 2 bags: `geometry_msgs/WrenchStamped` with `PoseStamped`, `TransformStamped` or the frames of
/tf, from MCAP or SQLite.
"""

import sqlite3
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path, PurePath
from typing import Any
from urllib.parse import quote

import numpy as np

from vibrissa.files import InputError
from vibrissa.io.recordings import mcap, messages
from vibrissa.io.recordings.frames import Edges, chained
from vibrissa.io.recordings.libraries import library, zstandard
from vibrissa.io.recordings.limits import Budget
from vibrissa.io.recordings.messages import Bag, Message
from vibrissa.io.recordings.streams import Stream, Streams
from vibrissa.io.recordings.table import RecordingTable

_LARGEST_METADATA = 16 * 2**20
_NANOSECONDS = 1e-9


def streams(path: Path, table: RecordingTable, poses: Stream | None = None) -> Streams:
    """Both streams of a bag: a folder of rosbag2, or one of its files, also without its metadata;
    or its wrenches alone, where the poses are given.

    Raises
    ------
    InputError
        If the bag is damaged from its start, or topics, types or frames are not those asked for.
    """
    bag = Bag()
    for file, packed in _files(path, bag):
        _read(file, bag, packed=packed)
    decoded = _decoder(path, _types())
    wrench, frame = _wrenches(path, bag, table, decoded)
    return Streams(
        wrench,
        _poses(path, bag, table, decoded, frame) if poses is None else poses,
        notes=tuple(bag.notes),
    )


@cache
def _types() -> Any:
    """Types of messages; the four that are read have been the same in all of ROS 2. Code to unpack
    them is generated once.
    """
    known = library("rosbags.typesys")
    return known.get_typestore(known.Stores.ROS2_HUMBLE)


def is_bag(folder: Path) -> bool:
    """Whether a folder holds a bag, with or without its metadata."""
    return (folder / "metadata.yaml").exists() or any(_storage(folder))


def _storage(folder: Path) -> list[Path]:
    found = [
        file
        for pattern in ("*.mcap", "*.db3", "*.mcap.zstd", "*.db3.zstd")
        for file in folder.glob(pattern)
    ]
    return sorted(found, key=lambda file: (len(file.name), file.name))


def _files(path: Path, bag: Bag) -> list[tuple[Path, bool]]:
    """Files of a bag, and whether their messages are packed one by one."""
    if not path.is_dir():
        return [(path, False)]
    metadata = _metadata(path, bag)
    listed = [path / PurePath(str(name)).name for name in metadata.get("relative_file_paths") or []]
    missing = [file.name for file in listed if not file.is_file()]
    if missing:
        bag.notes.append(
            f"{path.name}: {len(missing)} of the {len(listed)} files of the bag are missing, first {missing[0]!r}"
        )
    present = [file for file in listed if file.is_file()] or _storage(path)
    if not present:
        raise InputError(f"{path}: a bag without its .mcap or .db3 files; allowed is a whole bag")
    return [
        (file, str(metadata.get("compression_mode", "")).lower() == "message") for file in present
    ]


def _metadata(path: Path, bag: Bag) -> dict[str, Any]:
    file = path / "metadata.yaml"
    if not file.is_file():
        bag.notes.append(
            f"{path.name}: metadata.yaml is missing, as where a recorder was killed; its files are read as they are"
        )
        return {}
    if file.stat().st_size > _LARGEST_METADATA:
        raise InputError(
            f"{file}: {file.stat().st_size} bytes; allowed are at most {_LARGEST_METADATA}"
        )
    yaml = library("ruamel.yaml")
    try:
        found = yaml.YAML(typ="safe", pure=True).load(file.read_text(encoding="utf-8"))[
            "rosbag2_bagfile_information"
        ]
        return dict(found)
    # YAML of any kind, or none: the files beside it still say what they hold.
    except Exception:
        bag.notes.append(
            f"{path.name}: metadata.yaml is damaged; the bag's files are read as they are"
        )
        return {}


def _read(file: Path, bag: Bag, *, packed: bool) -> None:
    with tempfile.TemporaryDirectory() as folder:
        plain = _unpacked(file, Path(folder)) if file.suffix == ".zstd" else file
        with plain.open("rb") as opened:
            start = opened.read(16)
        if start.startswith(mcap.MAGIC):
            first = len(bag.messages)
            mcap.read(plain, bag)
        elif start == b"SQLite format 3\0":
            first = len(bag.messages)
            _read_sqlite(plain, bag)
        else:
            raise InputError(
                f"{file}: begins with {start[:8]!r}; allowed are bags of MCAP or SQLite"
            )
        if packed:
            budget = Budget(file)
            bag.messages[first:] = [
                Message(topic, time, _small(file, data, budget))
                for topic, time, data in bag.messages[first:]
            ]


def _unpacked(file: Path, folder: Path) -> Path:
    """Copy of a compressed file, of bounded size."""
    plain, budget = folder / file.stem, Budget(file)
    codec = zstandard().ZstdDecompressor()
    with file.open("rb") as packed, plain.open("wb") as out:
        try:
            while not codec.eof:
                piece = packed.read(2**20) if codec.needs_input else b""
                if codec.needs_input and not piece:
                    break
                part = codec.decompress(piece, 2**22)
                budget.take(len(part), "what is compressed")
                out.write(part)
        except zstandard().ZstdError as error:
            raise InputError(
                f"{file}: damaged Zstandard ({error}); allowed is a whole file"
            ) from error
    return plain


def _small(file: Path, data: bytes, budget: Budget) -> bytes:
    try:
        plain: bytes = zstandard().ZstdDecompressor().decompress(data, budget.left + 1)
    except zstandard().ZstdError as error:
        raise InputError(
            f"{file}: a damaged message ({error}); allowed are messages packed by Zstandard"
        ) from error
    budget.take(len(plain), "what is compressed")
    return plain


def _read_sqlite(file: Path, bag: Bag) -> None:
    """Through `rosbags`, after a look at what the database holds: a view can stand for rows without
    end.
    """
    if any(letter in str(file) for letter in "?#%"):
        raise InputError(
            f"{file}: has one of ?, # and % in its path; allowed are other names for SQLite"
        )
    before = len(bag.messages)
    try:
        with sqlite3.connect(
            f"file:{quote(str(file.resolve()))}?mode=ro&immutable=1", uri=True
        ) as database:
            strange = database.execute(
                "SELECT type, name FROM sqlite_master WHERE type NOT IN ('table', 'index')"
            ).fetchone()
        database.close()
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise InputError(f"{file}: damaged SQLite ({error}); allowed is a bag") from error
    if strange is not None:
        raise InputError(
            f"{file}: holds the {strange[0]} {str(strange[1])[:40]!r}; allowed are tables and indexes"
        )
    reader = library("rosbags.rosbag2").Reader.STORAGE_PLUGINS[".db3"](file)
    try:
        reader.open()
        chosen = [
            connection for connection in reader.connections if connection.msgtype in messages.KINDS
        ]
        bag.topics.update(
            {connection.topic: connection.msgtype for connection in reader.connections}
        )
        for connection, time, data in reader.messages(chosen) if chosen else ():
            bag.messages.append(Message(connection.topic, int(time), bytes(data)))
        reader.close()
    # SQLite finds damage where it comes to it, in its own errors or in values of other types than
    # the tables say.
    except Exception as error:
        if len(bag.messages) == before:
            raise InputError(
                f"{file}: damaged SQLite ({str(error)[:200]}); allowed is a bag"
            ) from error
        bag.notes.append(
            f"{file.name}: damaged ({str(error)[:100]}); recovered are {len(bag.messages) - before} messages of wrenches and poses"
        )


Decoder = Callable[[Message, str], Any]


def _decoder(path: Path, store: Any) -> Decoder:
    def decoded(message: Message, kind: str) -> Any:
        try:
            return store.deserialize_cdr(message.data, kind)
        # The generated code of a message meets damage wherever it is: struct, indices, texts.
        except Exception as error:
            raise InputError(
                f"{path}: a message on {message.topic!r} at {message.log_time} ns is no {kind} ({str(error)[:80]}); allowed are whole messages"
            ) from error

    return decoded


def _wrenches(path: Path, bag: Bag, table: RecordingTable, decoded: Decoder) -> tuple[Stream, str]:
    """The wrenches, and the frame that they are given in."""
    topic = _topic(path, bag, table.wrench_topic, "wrench_topic", messages.WRENCH)
    rows, frame = [], ""
    for message in bag.on(topic):
        content = decoded(message, messages.WRENCH)
        force, torque = content.wrench.force, content.wrench.torque
        frame = frame or content.header.frame_id
        rows.append(
            (
                _stamp(message, content.header, table),
                force.x,
                force.y,
                force.z,
                torque.x,
                torque.y,
                torque.z,
            )
        )
    return _stream(path, topic, rows, 6), frame


def _poses(path: Path, bag: Bag, table: RecordingTable, decoded: Decoder, frame: str) -> Stream:
    by_frames = table.pose_topic is None and (
        table.fixed_frame is not None or not bag.of(messages.POSE, messages.TRANSFORM)
    )
    if by_frames and bag.of(messages.FRAMES):
        pose = chained(
            path, _edges(bag, table, decoded), table.fixed_frame, table.sensor_frame or frame
        )
        if not len(pose.time):
            raise InputError(
                f"{path}: the frames between {table.fixed_frame!r} and {table.sensor_frame or frame!r} have no time in common; allowed are links that overlap"
            )
        return pose
    topic = _topic(path, bag, table.pose_topic, "pose_topic", messages.POSE, messages.TRANSFORM)
    kind = bag.topics[topic]
    rows = []
    for message in bag.on(topic):
        content = decoded(message, kind)
        place, turn = (
            (content.pose.position, content.pose.orientation)
            if kind == messages.POSE
            else (content.transform.translation, content.transform.rotation)
        )
        rows.append(
            (
                _stamp(message, content.header, table),
                place.x,
                place.y,
                place.z,
                turn.x,
                turn.y,
                turn.z,
                turn.w,
            )
        )
    return _stream(path, topic, rows, 7)


def _edges(bag: Bag, table: RecordingTable, decoded: Decoder) -> Edges:
    """Poses of frames in their parents by (parent, child); of topics whose name ends in "static"
    the last one holds for all times.
    """
    moving: dict[tuple[str, str], list[tuple[float, ...]]] = {}
    fixed: dict[tuple[str, str], tuple[float, ...]] = {}
    for topic in bag.of(messages.FRAMES):
        for message in bag.on(topic):
            for part in decoded(message, messages.FRAMES).transforms:
                pair = (part.header.frame_id.lstrip("/"), part.child_frame_id.lstrip("/"))
                place, turn = part.transform.translation, part.transform.rotation
                row = (
                    _stamp(message, part.header, table),
                    place.x,
                    place.y,
                    place.z,
                    turn.x,
                    turn.y,
                    turn.z,
                    turn.w,
                )
                if topic.endswith("static"):
                    fixed[pair] = row
                else:
                    moving.setdefault(pair, []).append(row)
    return Edges(
        {pair: _sorted(rows) for pair, rows in moving.items()},
        {pair: np.array(row[1:]) for pair, row in fixed.items()},
    )


def _sorted(rows: list[tuple[float, ...]]) -> Stream:
    """Several nodes may publish one frame: by their stamps, each once."""
    table = np.array(rows, dtype=np.float64)
    _, first = np.unique(table[:, 0], return_index=True)
    return Stream(table[first, 0], table[first, 1:])


def _stamp(message: Message, header: Any, table: RecordingTable) -> float:
    nanoseconds = (
        message.log_time
        if table.stamps == "log"
        else header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
    )
    return nanoseconds * _NANOSECONDS


def _stream(path: Path, topic: str, rows: Sequence[tuple[float, ...]], width: int) -> Stream:
    if not rows:
        raise InputError(
            f"{path}: no messages on {topic!r} in CDR, the encoding of ROS 2; allowed is at least one"
        )
    table = np.array(rows, dtype=np.float64).reshape(-1, width + 1)
    if len(table) > 1 and not table[:, 0].any():
        raise InputError(
            f"{path}: the headers on {topic!r} have the stamp 0 throughout; allowed are stamps, or stamps = 'log' in [recording]"
        )
    return Stream(table[:, 0], table[:, 1:])


def _topic(path: Path, bag: Bag, name: str | None, key: str, *kinds: str) -> str:
    fitting = bag.of(*kinds)
    allowed = " or ".join(kind.replace("/msg/", "/") for kind in kinds)
    held = (
        ", ".join(f"{topic} ({kind})" for topic, kind in sorted(bag.topics.items())) or "no topics"
    )[:400]
    held += "".join(f"; {note}" for note in bag.notes[:2])
    if name is None and len(fitting) == 1:
        return fitting[0]
    if name is None:
        file = " or pose_file" if key == "pose_topic" else ""
        raise InputError(
            f"{path}: {len(fitting)} topics of {allowed}; allowed is one, or {key}{file} in [recording]. The bag holds {held}"
        )
    if name not in fitting:
        raise InputError(f"{path}: {key} = {name!r} is no topic of {allowed}; the bag holds {held}")
    return name
