"""The files of a bag: a rosbag2 folder with its metadata, MCAP and SQLite, each also compressed by
Zstandard.

MCAP (https://mcap.dev/spec) is read record by record, because a recorder that was killed leaves
neither index nor footer, and the readers of `mcap` stop at the first damaged record.
"""

import mmap
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from pathlib import Path, PurePath
from struct import Struct
from typing import Any, NamedTuple
from zlib import crc32

from vibrissa.files import InputError, reading
from vibrissa.libraries import extra_library

library = partial(extra_library, extra="recordings", need="Parquet and ROS bags need it")

WRENCH = "geometry_msgs/msg/WrenchStamped"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
FRAMES = "tf2_msgs/msg/TFMessage"
_KINDS = (WRENCH, POSE, TRANSFORM, FRAMES)
MAGIC = b"\x89MCAP0\r\n"
_ZSTD = b"\x28\xb5\x2f\xfd"
_SQLITE = b"SQLite format 3\0"
# Head of an MCAP record (opcode and length), and the opcodes used here (MCAP specification).
_HEAD = Struct("<BQ")
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 2, 3, 4, 5, 6, 15


class Message(NamedTuple):
    """One message: its topic, log time [ns] and CDR data."""

    topic: str
    log_time: int
    data: bytes


@dataclass
class Bag:
    """Contents of a bag.

    Attributes
    ----------
    topics
        Types by topic, including topics that are not read.
    messages
        Wrenches, poses and frames, in file order.
    notes
        What was damaged or cut off, one sentence each.
    """

    topics: dict[str, str] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def of(self, *kinds: str) -> list[str]:
        """Topics of these types."""
        return sorted(topic for topic, kind in self.topics.items() if kind in kinds)


def bag_of(path: Path) -> Bag:
    """Read all messages of a bag: a rosbag2 folder or one of its files, with or without metadata.

    Raises
    ------
    InputError
        If the bag has no files, or one is damaged from the start.
    """
    bag, files = Bag(), [path]
    if path.is_dir():
        listed, files = _listed(path, bag), _storage(path)
        missing = [name for name in listed if not (path / name).is_file()]
        files = [file for file in files if file.name in listed] or files
        if missing:
            bag.notes.append(
                f"{path.name}: {len(missing)} of the {len(listed)} files of the bag are missing, "
                f"first {missing[0]!r}"
            )
    if not files:
        raise InputError(f"{path}: a bag without its .mcap or .db3 files; allowed is a whole bag")
    for file in files:
        _read(file, file, bag)
    # rosbag2 may compress single messages, which then carry Zstandard's magic number.
    with reading(path, "Zstandard"):
        bag.messages = [
            message._replace(data=_unpacked(message.data, "")) for message in bag.messages
        ]
    return bag


def is_bag(folder: Path) -> bool:
    """Whether a folder holds a bag, with or without its metadata."""
    return (folder / "metadata.yaml").exists() or bool(_storage(folder))


def _storage(folder: Path) -> list[Path]:
    patterns = ("*.mcap", "*.db3", "*.mcap.zstd", "*.db3.zstd")
    found = [file for pattern in patterns for file in folder.glob(pattern)]
    # Split files are numbered without leading zeros.
    return sorted(found, key=lambda file: (len(file.name), file.name))


def _listed(path: Path, bag: Bag) -> list[str]:
    """Names of the bag's files according to its metadata."""
    yaml = library("ruamel.yaml").YAML(typ="safe", pure=True)
    try:
        content = yaml.load(path / "metadata.yaml")["rosbag2_bagfile_information"]
        return [PurePath(str(name)).name for name in content.get("relative_file_paths") or ()]
    # No file, unexpected YAML or none at all: the data files can still be read without it.
    except Exception:
        bag.notes.append(
            f"{path.name}: metadata.yaml is missing, as when a recorder was killed, or damaged; "
            "the bag's files are read as they are"
        )
        return []


def _read(file: Path, plain: Path, bag: Bag) -> None:
    """Add the messages of a file; `plain` is its decompressed copy, or the file itself."""
    with plain.open("rb") as opened:
        start = opened.read(len(_SQLITE))
    if start.startswith(_ZSTD) and file == plain:
        with tempfile.TemporaryDirectory() as folder:
            unpacked = Path(folder) / file.stem
            codec = library("zstandard").ZstdDecompressor()
            with reading(file, "Zstandard"), file.open("rb") as packed, unpacked.open("wb") as out:
                codec.copy_stream(packed, out)
            return _read(file, unpacked, bag)
    messages, notes = len(bag.messages), len(bag.notes)
    try:
        if start.startswith(MAGIC):
            with reading(file, "MCAP"):
                _read_mcap(plain, bag)
        elif start == _SQLITE:
            with reading(file, "SQLite"):
                _read_sqlite(plain, bag)
        else:
            raise InputError(
                f"{file}: begins with {start[:8]!r}; allowed are bags of MCAP or SQLite"
            )
    # What was read before the damage is kept.
    except InputError as error:
        if len(bag.messages) == messages:
            raise
        bag.notes.append(str(error))
    if len(bag.notes) > notes:
        count = len(bag.messages) - messages
        bag.notes[-1] += f"; {count} messages of wrenches and poses were recovered"
    return None


def _read_sqlite(file: Path, bag: Bag) -> None:
    with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as opened:
        bag.topics.update(opened.execute("SELECT name, type FROM topics"))
        found = opened.execute(
            "SELECT name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id "
            "WHERE type IN (?, ?, ?, ?) ORDER BY timestamp",
            _KINDS,
        )
        bag.messages.extend(map(Message._make, found))


def _read_mcap(file: Path, bag: Bag) -> None:
    records = library("mcap.records")
    types: dict[int, str] = {}
    topics: dict[int, str] = {}
    for one in mcap_records(file, bag.notes):
        match one:
            case records.Schema():
                types[one.id] = one.name
            case records.Channel():
                kind = types.get(one.schema_id, "")
                bag.topics.setdefault(one.topic, kind)
                if one.message_encoding == "cdr" and kind in _KINDS:
                    topics[one.id] = one.topic
            case records.Message() if one.channel_id in topics:
                bag.messages.append(Message(topics[one.channel_id], one.log_time, one.data))


def mcap_records(file: Path, notes: list[str]) -> Iterator[Any]:
    """Schemas, channels and messages of an MCAP file, in file order; damaged or truncated records
    are skipped, each with a sentence added to the notes.
    """
    records, streams = library("mcap.records"), library("mcap.data_stream")

    def parsed(code: int, body: bytes) -> Any:
        stream = streams.ReadDataStream(BytesIO(body))
        if code == _MESSAGE:
            return records.Message.read(stream, len(body))
        kinds = {_SCHEMA: records.Schema, _CHANNEL: records.Channel, _CHUNK: records.Chunk}
        return kinds[code].read(stream)

    with (
        file.open("rb") as opened,
        mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as content,
    ):
        whole, size = len(MAGIC), len(content)
        for code, body, end in _records(content, whole):
            is_whole = end <= size
            if is_whole and code in {_DATA_END, _FOOTER}:
                return
            try:
                parts, room = iter([(code, body, end)]), size
                if code == _CHUNK:
                    chunk = parsed(code, body)
                    unpacked = _unpacked(chunk.data, chunk.compression)
                    if is_whole and chunk.uncompressed_crc not in {0, crc32(unpacked)}:
                        raise ValueError("its checksum is wrong")
                    parts, room = _records(unpacked), len(unpacked)
                for inner, part, stop in parts:
                    if inner in {_SCHEMA, _CHANNEL, _MESSAGE} and stop <= room:
                        yield parsed(inner, part)
            except ImportError:
                raise
            # Each codec and parser raises its own errors on corrupt data.
            except Exception as error:
                if is_whole:
                    notes.append(
                        f"{file.name}: the record at byte {whole} is damaged ({error}) and left out"
                    )
            whole = end if is_whole else whole
    notes.append(
        f"{file.name}: cut off; {whole} of {size} bytes are intact, and what could be unpacked of "
        "the record after them is used"
    )


def _records(content: mmap.mmap | bytes, at: int = 0) -> Iterator[tuple[int, bytes, int]]:
    """Opcode, body and end of successive records; the last one may be cut off."""
    while at + _HEAD.size <= len(content):
        code, length = _HEAD.unpack_from(content, at)
        begin, at = at + _HEAD.size, at + _HEAD.size + length
        yield code, content[begin:at] if _SCHEMA <= code <= _CHUNK else b"", at


def _unpacked(data: bytes, compression: str) -> bytes:
    """Content of a chunk or a Zstandard frame; if truncated, what can be decompressed."""
    if compression == "zstd" or data.startswith(_ZSTD):
        return bytes(library("zstandard").ZstdDecompressor().decompressobj().decompress(data))
    if compression == "lz4":
        return bytes(library("lz4.frame").LZ4FrameDecompressor().decompress(data))
    if compression:
        raise ValueError(f"compression {compression!r} is not known")
    return data
