"""An MCAP file that can be opened at any moment while it is being written.

From the start, the file ends with an index of the channels, a footer and the closing magic bytes.
Before them lies one record with a private opcode, which readers skip: room for what is to come. A
chunk of messages is written into that room, where no reader sees it, followed by a new record for
the rest of the room; then nine bytes, the head of the old record, are overwritten with the head of
the chunk. If the room does not suffice, the file is extended by a single write of a footer that
points to the old index; then the new index is written before that footer, the head of the room's
record is overwritten with its new length, and finally the eight bytes of the footer that locate the
index.

A process can be killed between two pages of a write, but not within one. Every write that takes
effect lies within a page; all others go where no reader looks. So the file is valid after each of
them, and holds all chunks whose heads were written. This covers a killed process, not a machine
that loses power: there is no fsync.
"""

import struct
from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from jaxtyping import Int
from mcap import records
from mcap.data_stream import RecordBuilder

from vibrissa.io.disk import FileDisk

PAGE = 4096
"""Bytes of the smallest memory page in use: a write within a page is never torn by a kill."""
ROOM = 1 << 20
"""Least growth of a file, in bytes: a few seconds of a sensor at 7000 samples per second."""

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # of every record: opcode and length
_ALIGNMENT = 16  # of heads that are overwritten: divides a page, and is longer than a head
_PRIVATE = 0x80  # readers skip records with opcodes from here on
_FOOTER_BYTES = _HEAD.size + 20 + len(MAGIC)


Stamps = Int[np.ndarray, "n"]


class Channel(NamedTuple):
    """A topic: its name, its message type, and the type's definition (ros2msg), as in ROS 2."""

    topic: str
    message_type: str
    definition: str


class Messages(NamedTuple):
    """Message records of one channel, back to back.

    Attributes
    ----------
    channel
        Index of the channel.
    log_time
        (n,) [ns].
    offset
        Offset (n,) of each record in `data`.
    data
        The records.
    """

    channel: int
    log_time: Stamps
    offset: Stamps
    data: bytes


class GrowingFile:
    """Chunks of messages, appended so that the file is valid after each.

    Parameters
    ----------
    disk
        An empty file.
    channels
        Its topics.
    qos
        Quality of service of each topic, as rosbag2 writes it.

    Attributes
    ----------
    message_counts
        Number of messages in each channel so far.
    """

    def __init__(self, disk: FileDisk, channels: Sequence[Channel], qos: str) -> None:
        self._disk, self.channels = disk, tuple(channels)
        self.message_counts = [0] * len(channels)
        self._chunks: list[records.ChunkIndex] = []
        numbered = list(enumerate(channels, start=1))
        schemas = [
            records.Schema(number, definition.encode(), "ros2msg", kind)
            for number, (_, kind, definition) in numbered
        ]
        topics = [
            records.Channel(number, topic, "cdr", {"offered_qos_profiles": qos}, number)
            for number, (topic, *_) in numbered
        ]
        declarations, self._data_end = packed(*schemas, *topics), packed(records.DataEnd(0))
        self._index = self._data_end + declarations
        head = MAGIC + packed(records.Header("ros2", "vibrissa")) + declarations
        self._room = _behind(len(head))
        self._size = _rounded_up(self._room + ROOM, PAGE)
        self._disk.write(head + _filler(self._room - len(head)) + self._room_head(self._room), 0)
        self._disk.write(self._index + _footer(self._index_start), self._index_place)

    @property
    def _index_place(self) -> int:
        """Offset of the data-end record, which the index follows."""
        return self._size - _FOOTER_BYTES - len(self._index)

    @property
    def _index_start(self) -> int:
        return self._index_place + len(self._data_end)

    def _room_head(self, place: int) -> bytes:
        """Head of the record that extends from `place` to the end of the data."""
        return _HEAD.pack(_PRIVATE, self._index_place - place - _HEAD.size)

    def append(self, blocks: Sequence[Messages]) -> None:
        """Add a chunk, with log times no earlier than those of the last one. Raise OSError if
        writing fails.
        """
        content, rows = b"", defaultdict[int, list[tuple[int, int]]](list)
        for block in blocks:
            offsets = (block.offset + len(content)).tolist()
            rows[block.channel] += zip(block.log_time.tolist(), offsets, strict=True)
            content += block.data
        if not content:
            return
        times = [time for own in rows.values() for time, _ in own]
        first, last, size = min(times), max(times), len(content)
        written = packed(records.Chunk("", content, last, first, crc32(content), size))
        start, length, places = self._room, len(written), {}
        for channel, own in sorted(rows.items()):
            places[channel + 1] = start + len(written)
            written += packed(records.MessageIndex(channel + 1, own))
        self._put(written)
        self._chunks.append(
            records.ChunkIndex(
                chunk_length=length,
                chunk_start_offset=start,
                compression="",
                compressed_size=size,
                uncompressed_size=size,
                message_start_time=first,
                message_end_time=last,
                message_index_length=len(written) - length,
                message_index_offsets=places,
            )
        )
        for channel, own in rows.items():
            self.message_counts[channel] += len(own)

    def _put(self, written: bytes) -> None:
        """Put records into the room, followed by the rest of the room; the first record's head,
        which makes them visible, is written last.
        """
        end = self._room + len(written)
        rest = _behind(end)
        self._reserve(rest + _HEAD.size)
        behind = written[_HEAD.size :] + _filler(rest - end) + self._room_head(rest)
        self._disk.write(behind, self._room + _HEAD.size)
        self._disk.write(written[: _HEAD.size], self._room)
        self._room = rest

    def _reserve(self, data_end: int) -> None:
        """Extend the file if needed, so that the data may reach this offset."""
        if data_end <= self._index_place:
            return
        start, size = self._index_start, self._size
        self._size = max(
            _rounded_up(data_end + len(self._index) + _FOOTER_BYTES, PAGE), size + ROOM
        )
        footer = self._size - _FOOTER_BYTES
        try:
            self._disk.write(_footer(start), footer)
            self._disk.write(self._index, self._index_place)
        except OSError:
            # The disk is full: the old index is still valid and must not be overwritten.
            self._size = size
            raise
        self._disk.write(self._room_head(self._room), self._room)
        self._disk.write(struct.pack("<Q", self._index_start), footer + _HEAD.size)

    @property
    def time_range(self) -> tuple[int, int]:
        """First and last log time [ns]; zeros without messages."""
        if not self._chunks:
            return 0, 0
        return self._chunks[0].message_start_time, self._chunks[-1].message_end_time

    def close(self) -> None:
        """Write the complete chunk index, cut off the remaining room, and close the file."""
        first, last = self.time_range
        count = len(self.channels)
        statistics = records.Statistics(
            attachment_count=0,
            channel_count=count,
            channel_message_counts=dict(enumerate(self.message_counts, start=1)),
            chunk_count=len(self._chunks),
            message_count=sum(self.message_counts),
            message_end_time=last,
            message_start_time=first,
            metadata_count=0,
            schema_count=count,
        )
        end = self._room + _HEAD.size
        tail = self._index + packed(statistics, *self._chunks)
        tail += _footer(end + len(self._data_end))
        self._reserve(end + len(tail))
        self._disk.write(tail, end)
        self._disk.truncate(end + len(tail))
        self._disk.write(_HEAD.pack(_PRIVATE, 0), self._room)
        self._disk.close()


def packed(*some: records.McapRecord) -> bytes:
    """Records as bytes of a file."""
    stream: Any = RecordBuilder()
    for record in some:
        record.write(stream)
    return bytes(stream.end())


def _footer(index_start: int) -> bytes:
    return packed(records.Footer(index_start, 0, 0)) + MAGIC


def _rounded_up(size: int, unit: int) -> int:
    return -(-size // unit) * unit


def _behind(place: int) -> int:
    """Next offset at which a record's head lies within a page, with room for a filler before it."""
    return _rounded_up(place + _HEAD.size, _ALIGNMENT)


def _filler(size: int) -> bytes:
    """An empty record that readers skip."""
    return _HEAD.pack(_PRIVATE, size - _HEAD.size) + bytes(size - _HEAD.size)
