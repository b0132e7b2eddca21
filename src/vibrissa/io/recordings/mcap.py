"""MCAP, record by record, as far as the file is whole: a recorder that was killed leaves neither
index nor end.

Format: https://mcap.dev/spec. Libraries ask for the end of the file, or take the sizes it claims on
trust; here each is held against what is there first.
"""

import mmap
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from struct import Struct, error
from zlib import crc32

from vibrissa.io.errors import InputError
from vibrissa.io.recordings.libraries import library, zstandard
from vibrissa.io.recordings.limits import Budget
from vibrissa.io.recordings.messages import KINDS, Bag, Message

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 2, 3, 4, 5, 6, 15
_READ = frozenset({_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK})
_PREFIX, _LENGTH, _SIZE, _TWO = Struct("<BQ"), Struct("<I"), Struct("<Q"), Struct("<HH")
_MESSAGE_HEAD, _CHUNK_HEAD = Struct("<HIQQ"), Struct("<QQQI")

Content = mmap.mmap | bytes


class _DamageError(Exception):
    """A record that cannot be what it says it is."""


@dataclass
class _Walk:
    """What has been learnt on the way through one file."""

    bag: Bag
    budget: Budget
    schemas: dict[int, str] = field(default_factory=dict)
    channels: dict[int, tuple[str, bool]] = field(default_factory=dict)


def read(file: Path, bag: Bag) -> None:
    """Add the messages of an MCAP file to a bag; what is damaged or cut off is left out, and noted.

    Raises
    ------
    InputError
        If it is no MCAP file, or unpacks to more than allowed.
    """
    with file.open("rb") as opened:
        if opened.read(len(MAGIC)) != MAGIC:
            raise InputError(f"{file}: does not begin as MCAP does; allowed is MCAP, version 0")
        with mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as content:
            _read(file, content, _Walk(bag, Budget(file)))


def _read(file: Path, content: Content, walk: _Walk) -> None:
    before, at = len(walk.bag.messages), len(MAGIC)
    for kind, body, whole, end in _records(content, at):
        if kind in {_DATA_END, _FOOTER} and whole:
            return
        try:
            if kind == _CHUNK:
                _chunk(body, walk, whole=whole)
            elif whole:
                _record(kind, body, walk)
        except _DamageError as damage:
            if not whole:
                break
            walk.bag.notes.append(
                f"{file.name}: the record at byte {at} is damaged ({damage}) and left out"
            )
        at = end if whole else at
    count = len(walk.bag.messages) - before
    walk.bag.notes.append(
        f"{file.name}: cut off; whole are {at} of {len(content)} bytes and what could be unpacked of the record after them, {count} messages of wrenches and poses in all"
    )


def _records(content: Content, start: int) -> Iterator[tuple[int, bytes, bool, int]]:
    """Kind, body where it is of use, whether the record is whole, and where it ends; the last one
    may not be whole.
    """
    at = start
    while at + _PREFIX.size <= len(content):
        kind, length = _PREFIX.unpack_from(content, at)
        end = at + _PREFIX.size + length
        body = content[at + _PREFIX.size : min(end, len(content))] if kind in _READ else b""
        yield kind, body, end <= len(content), end
        if end > len(content):
            return
        at = end


def _record(kind: int, body: bytes, walk: _Walk) -> None:
    try:
        if kind == _SCHEMA:
            number = int.from_bytes(_exactly(body, 0, 2), "little")
            walk.schemas[number] = _text(body, 2)[0]
        elif kind == _CHANNEL:
            number, schema = _TWO.unpack_from(body)
            topic, at = _text(body, _TWO.size)
            encoding, _ = _text(body, at)
            kind_of_message = walk.schemas.get(schema, "")
            walk.channels[number] = topic, encoding == "cdr" and kind_of_message in KINDS
            walk.bag.topics.setdefault(topic, kind_of_message)
        elif kind == _MESSAGE:
            number, _, log_time, _ = _MESSAGE_HEAD.unpack_from(body)
            topic, is_read = walk.channels.get(number, ("", False))
            if is_read:
                walk.bag.messages.append(Message(topic, log_time, body[_MESSAGE_HEAD.size :]))
    except (error, UnicodeDecodeError) as reason:
        raise _DamageError(str(reason)) from reason


def _chunk(body: bytes, walk: _Walk, *, whole: bool) -> None:
    """Records inside a chunk; of one that is cut off, those that are whole."""
    try:
        _, _, size, checksum = _CHUNK_HEAD.unpack_from(body)
        compression, at = _text(body, _CHUNK_HEAD.size)
        (packed_size,) = _SIZE.unpack_from(body, at)
    except (error, UnicodeDecodeError) as reason:
        raise _DamageError(str(reason)) from reason
    packed = body[at + _SIZE.size : at + _SIZE.size + packed_size]
    walk.budget.take(size, "a chunk")
    records = _unpacked(compression, packed, size)
    if whole and len(records) != size:
        raise _DamageError(f"{len(records)} bytes where {size} are claimed")
    if whole and checksum and crc32(records) != checksum:
        raise _DamageError("its checksum is wrong")
    for kind, inner, inner_whole, _ in _records(records, 0):
        if inner_whole and kind != _CHUNK:
            _record(kind, inner, walk)


def _unpacked(compression: str, packed: bytes, size: int) -> bytes:
    """At most `size` bytes; fewer where the end is missing."""
    if compression == "":
        return packed[:size]
    if compression not in {"lz4", "zstd"}:
        raise _DamageError(f"compression {compression[:20]!r} is not known")
    codec = (
        zstandard().ZstdDecompressor()
        if compression == "zstd"
        else library("lz4.frame").LZ4FrameDecompressor()
    )
    try:
        return bytes(codec.decompress(packed, size))
    # Either codec has an error of its own for broken data.
    except Exception as reason:
        raise _DamageError(f"{compression}: {reason}") from reason


def _text(body: bytes, at: int) -> tuple[str, int]:
    (length,) = _LENGTH.unpack_from(body, at)
    start = at + _LENGTH.size
    return str(_exactly(body, start, length), "utf-8"), start + length


def _exactly(body: bytes, start: int, length: int) -> bytes:
    part = body[start : start + length]
    if len(part) < length:
        raise _DamageError("a text is longer than its record")
    return part
