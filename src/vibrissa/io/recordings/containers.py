"""The files of a bag: a folder of rosbag2 with its metadata, MCAP, SQLite, and all of them packed
by Zstandard.

MCAP (https://mcap.dev/spec) is read record by record, because a recorder that was killed leaves
neither index nor end, and the readers of `mcap` stop at the first damage.
"""

import mmap
import tempfile
from collections.abc import Iterator
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
_KINDS = {WRENCH, POSE, TRANSFORM, FRAMES}
_MAGIC = b"\x89MCAP0\r\n"
_ZSTD = b"\x28\xb5\x2f\xfd"
_SQLITE = b"SQLite format 3\0"
# Of an MCAP record: opcode and length, and the opcodes that matter here (the specification).
_HEAD = Struct("<BQ")
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 2, 3, 4, 5, 6, 15


class Message(NamedTuple):
    """One message: its topic, the time of its logging [ns], and its CDR."""

    topic: str
    log_time: int
    data: bytes


@dataclass
class Bag:
    """What was found in a bag.

    Attributes
    ----------
    topics
        Types by topic, including topics that are not read.
    messages
        Wrenches, poses and frames, in the order of the files.
    notes
        What was damaged or cut off, a sentence each.
    """

    topics: dict[str, str] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def of(self, *kinds: str) -> list[str]:
        """Topics of these types."""
        return sorted(topic for topic, kind in self.topics.items() if kind in kinds)


def bag_of(path: Path) -> Bag:
    """All messages of a bag: a folder of rosbag2, or one of its files, also without its metadata.

    Raises
    ------
    InputError
        If the bag has no files, or one is damaged from its start.
    """
    bag, metadata, files = Bag(), {}, [path]
    if path.is_dir():
        metadata = _metadata(path, bag)
        names = metadata.get("relative_file_paths") or ()
        listed = [path / PurePath(str(name)).name for name in names]
        files = [file for file in listed if file.is_file()] or _storage(path)
        if missing := [file.name for file in listed if not file.is_file()]:
            bag.notes.append(
                f"{path.name}: {len(missing)} of the {len(listed)} files of the bag are missing, "
                f"first {missing[0]!r}"
            )
    if not files:
        raise InputError(f"{path}: a bag without its .mcap or .db3 files; allowed is a whole bag")
    for file in files:
        _read(file, file, bag)
    if str(metadata.get("compression_mode", "")).lower() == "message":
        with reading(path, "Zstandard"):
            bag.messages = [
                message._replace(data=_unpacked("zstd", message.data)) for message in bag.messages
            ]
    return bag


def is_bag(folder: Path) -> bool:
    """Whether a folder holds a bag, with or without its metadata."""
    return (folder / "metadata.yaml").exists() or bool(_storage(folder))


def _storage(folder: Path) -> list[Path]:
    patterns = ("*.mcap", "*.db3", "*.mcap.zstd", "*.db3.zstd")
    found = [file for pattern in patterns for file in folder.glob(pattern)]
    # Parts are numbered without leading zeros.
    return sorted(found, key=lambda file: (len(file.name), file.name))


def _metadata(path: Path, bag: Bag) -> dict[str, Any]:
    yaml = library("ruamel.yaml").YAML(typ="safe", pure=True)
    try:
        return dict(yaml.load(path / "metadata.yaml")["rosbag2_bagfile_information"])
    # No file, YAML of any kind, or none: the files beside it still say what they hold.
    except Exception:
        bag.notes.append(
            f"{path.name}: metadata.yaml is missing, as where a recorder was killed, or damaged; "
            "the bag's files are read as they are"
        )
        return {}


def _read(file: Path, plain: Path, bag: Bag) -> None:
    """Add the messages of a file; `plain` is where it lies unpacked."""
    with plain.open("rb") as opened:
        start = opened.read(len(_SQLITE))
    before = len(bag.messages)
    if start.startswith(_MAGIC):
        with reading(file, "MCAP"):
            _read_mcap(plain, bag)
    elif start == _SQLITE:
        try:
            with reading(file, "SQLite"):
                _read_sqlite(plain, bag)
        # SQLite finds damage where it comes to it: what was read before it counts.
        except InputError as error:
            count = len(bag.messages) - before
            if not count:
                raise
            bag.notes.append(f"{error}; recovered are {count} messages of wrenches and poses")
    elif start.startswith(_ZSTD) and file == plain:
        with tempfile.TemporaryDirectory() as folder:
            unpacked = Path(folder) / file.stem
            codec = library("zstandard").ZstdDecompressor()
            with reading(file, "Zstandard"), file.open("rb") as packed, unpacked.open("wb") as out:
                codec.copy_stream(packed, out)
            _read(file, unpacked, bag)
    else:
        raise InputError(f"{file}: begins with {start[:8]!r}; allowed are bags of MCAP or SQLite")


def _read_sqlite(file: Path, bag: Bag) -> None:
    reader = library("rosbags.rosbag2").Reader.STORAGE_PLUGINS[".db3"](file)
    reader.open()
    bag.topics.update((one.topic, one.msgtype) for one in reader.connections)
    chosen = [one for one in reader.connections if one.msgtype in _KINDS]
    for one, time, data in reader.messages(chosen) if chosen else ():
        bag.messages.append(Message(one.topic, int(time), bytes(data)))
    reader.close()


def _read_mcap(file: Path, bag: Bag) -> None:
    """Add the messages of an MCAP file; what is damaged or cut off is left out, and noted."""
    records, streams = library("mcap.records"), library("mcap.data_stream")
    types: dict[int, str] = {}
    topics: dict[int, str] = {}

    def take(code: int, body: bytes, *, is_whole: bool) -> None:
        """Add what a record holds; of a chunk that is cut off, what can be unpacked."""
        stream = streams.ReadDataStream(BytesIO(body))
        if code == _CHUNK:
            chunk = records.Chunk.read(stream)
            content, checksum = _unpacked(chunk.compression, chunk.data), chunk.uncompressed_crc
            if is_whole and checksum and crc32(content) != checksum:
                raise ValueError("its checksum is wrong")
            for inner, part, end in _records(content):
                if inner != _CHUNK and end <= len(content):
                    take(inner, part, is_whole=True)
        elif code == _MESSAGE and is_whole:
            message = records.Message.read(stream, len(body))
            if message.channel_id in topics:
                found = Message(topics[message.channel_id], message.log_time, message.data)
                bag.messages.append(found)
        elif code == _SCHEMA and is_whole:
            schema = records.Schema.read(stream)
            types[schema.id] = schema.name
        elif code == _CHANNEL and is_whole:
            channel = records.Channel.read(stream)
            kind = types.get(channel.schema_id, "")
            bag.topics.setdefault(channel.topic, kind)
            if channel.message_encoding == "cdr" and kind in _KINDS:
                topics[channel.id] = channel.topic

    with (
        file.open("rb") as opened,
        mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as content,
    ):
        before, whole, size = len(bag.messages), len(_MAGIC), len(content)
        for code, body, end in _records(content, whole):
            is_whole = end <= size
            if is_whole and code in {_DATA_END, _FOOTER}:
                return
            try:
                take(code, body, is_whole=is_whole)
            except ImportError:
                raise
            # Each codec and parser has errors of its own for damage.
            except Exception as error:
                if is_whole:
                    bag.notes.append(
                        f"{file.name}: the record at byte {whole} is damaged ({error}) and left out"
                    )
            whole = end if is_whole else whole
    bag.notes.append(
        f"{file.name}: cut off; whole are {whole} of {size} bytes and what could be unpacked of "
        f"the record after them, {len(bag.messages) - before} messages of wrenches and poses in all"
    )


def _records(content: mmap.mmap | bytes, at: int = 0) -> Iterator[tuple[int, bytes, int]]:
    """Opcode, body and end of records one after the other; the last one may be cut off."""
    while at + _HEAD.size <= len(content):
        code, length = _HEAD.unpack_from(content, at)
        begin, at = at + _HEAD.size, at + _HEAD.size + length
        yield code, content[begin:at] if _SCHEMA <= code <= _CHUNK else b"", at


def _unpacked(compression: str, data: bytes) -> bytes:
    """Content of a chunk or of one Zstandard frame; of a truncated one, what can be unpacked."""
    match compression:
        case "":
            return data
        case "zstd":
            codec = library("zstandard").ZstdDecompressor().decompressobj()
        case "lz4":
            codec = library("lz4.frame").LZ4FrameDecompressor()
        case other:
            raise ValueError(f"compression {other!r} is not known")
    return bytes(codec.decompress(data))
