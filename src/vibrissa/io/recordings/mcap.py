"""MCAP, record by record, as far as the file is whole: a recorder that was killed leaves neither
index nor end.

Format: https://mcap.dev/spec. The readers of `mcap` stop at the first damage; so its records are
taken one by one.
"""

import mmap
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple
from zlib import crc32

from vibrissa.io.recordings.arrays import reading
from vibrissa.io.recordings.libraries import library
from vibrissa.io.recordings.messages import KINDS, Bag, Message

MAGIC = b"\x89MCAP0\r\n"
# Operation code and length before each record; the codes of the specification.
_HEAD = Struct("<BQ")
_FOOTER, _CHUNK, _DATA_END = 2, 6, 15
_NAMES = {3: "Schema", 4: "Channel", 5: "Message", _CHUNK: "Chunk"}


class _Record(NamedTuple):
    """A record of the file or of a chunk, where it ends there, and whether it does."""

    code: int
    body: bytes
    end: int
    is_whole: bool


def read(file: Path, bag: Bag) -> None:
    """Add the messages of an MCAP file to a bag; what is damaged or cut off is left out, and noted.

    Raises
    ------
    InputError
        If it is no MCAP file.
    """
    with (
        reading(file, "MCAP"),
        file.open("rb") as opened,
        mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as content,
    ):
        contents = _Contents(bag)
        before, whole = len(bag.messages), len(MAGIC)
        for record in _records(content, whole):
            if record.is_whole and record.code in {_DATA_END, _FOOTER}:
                return
            try:
                contents.take(record)
            except ImportError:
                raise
            # Each codec and parser has errors of its own for damage.
            except Exception as error:
                if record.is_whole:
                    bag.notes.append(
                        f"{file.name}: the record at byte {whole} is damaged ({error}) and left out"
                    )
            whole = record.end if record.is_whole else whole
    bag.notes.append(
        f"{file.name}: cut off; whole are {whole} of {file.stat().st_size} bytes and what could be "
        f"unpacked of the record after them, {len(bag.messages) - before} messages of wrenches and "
        "poses in all"
    )


def _records(content: mmap.mmap | bytes, start: int = 0) -> Iterator[_Record]:
    """Records end to end; the last one may be cut off."""
    at, end = start, start
    while at + _HEAD.size <= len(content) >= end:
        code, length = _HEAD.unpack_from(content, at)
        end = at + _HEAD.size + length
        body = content[at + _HEAD.size : end] if code in _NAMES else b""
        yield _Record(code, body, end, end <= len(content))
        at = end


class _Contents:
    """Messages of one file, by the schemas and channels that come before them."""

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._records, self._stream = library("mcap.records"), library("mcap.data_stream")
        self._types: dict[int, str] = {}
        self._topics: dict[int, str] = {}

    def take(self, record: _Record) -> None:
        """Add what a record holds; of a chunk that is cut off, what can be unpacked."""
        if record.code not in _NAMES or not (record.is_whole or record.code == _CHUNK):
            return
        stream = self._stream.ReadDataStream(BytesIO(record.body))
        kind = getattr(self._records, _NAMES[record.code])
        match _NAMES[record.code]:
            case "Message":
                message = kind.read(stream, len(record.body))
                if message.channel_id in self._topics:
                    topic = self._topics[message.channel_id]
                    self._bag.messages.append(Message(topic, message.log_time, message.data))
            case "Schema":
                schema = kind.read(stream)
                self._types[schema.id] = schema.name
            case "Channel":
                channel = kind.read(stream)
                type_of_message = self._types.get(channel.schema_id, "")
                self._bag.topics.setdefault(channel.topic, type_of_message)
                if channel.message_encoding == "cdr" and type_of_message in KINDS:
                    self._topics[channel.id] = channel.topic
            case "Chunk":
                chunk = kind.read(stream)
                content = _unpacked(chunk)
                checksum = chunk.uncompressed_crc
                if record.is_whole and checksum and crc32(content) != checksum:
                    raise ValueError("its checksum is wrong")
                for inner in _records(content):
                    if inner.is_whole and inner.code != _CHUNK:
                        self.take(inner)


def _unpacked(chunk: Any) -> bytes:
    """Content of a chunk; less of it where its end is missing."""
    data: bytes = chunk.data
    match chunk.compression:
        case "":
            return data
        case "zstd":
            return unpacked_zstd(data)
        case "lz4":
            return bytes(library("lz4.frame").LZ4FrameDecompressor().decompress(data))
        case other:
            raise ValueError(f"compression {other!r} is not known")


def unpacked_zstd(data: bytes) -> bytes:
    """Content of one frame of Zstandard, as far as it is there."""
    return bytes(library("zstandard").ZstdDecompressor().decompressobj().decompress(data))
