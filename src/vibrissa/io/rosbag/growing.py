"""An MCAP file that opens at any moment of its being written.

The file ends, from its first moment on, with an index of the channels, a footer and the closing
mark. Before them stands one record of a private kind, which readers skip: the room for what comes.
A chunk of messages is written into that room, where no reader sees it, with a new record for the
rest of the room behind it; then nine bytes, the head of the old record, are overwritten with the
head of the chunk. Where the room does not suffice, the file is made longer by one write of a footer
that points to the old index; then the new index is written in front of it, the head of the room's
record is overwritten with its new length, and last the eight bytes of the footer that say where the
index is.

A process can be killed between two pages of a write, not within one. Each write that takes effect
lies within a page; all others lie where no reader looks. So the file is whole after each of them,
and holds all chunks whose heads were written. This holds for a process that ends, not for a machine
that loses power: nothing waits for the disk.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from zlib import crc32

import numpy as np
from jaxtyping import Int

from vibrissa.io.rosbag.disk import Disk
from vibrissa.io.rosbag.library import library

PAGE = 4096
ROOM = 1 << 20
"""By which a file grows at least, in bytes."""

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_PRIVATE, _CHUNK, _DATA_END = 0x80, 0x06, 0x0F
_FOOTER_BYTES = 9 + 20 + len(_MAGIC)
_INDEX = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


@dataclass(frozen=True)
class Channel:
    """A topic: its name, the type of its messages, and the type's definition (ros2msg).

    Attributes
    ----------
    topic, message_type, definition
        As ROS 2 names them.
    """

    topic: str
    message_type: str
    definition: str


@dataclass(frozen=True, eq=False)
class Messages:
    """Message records of one channel, end to end.

    Attributes
    ----------
    channel
        Index of the channel.
    log_time
        (n,) [ns].
    offset
        (n,) of each record in `data`.
    data
        The records.
    """

    channel: int
    log_time: Int[np.ndarray, "n"]
    offset: Int[np.ndarray, "n"]
    data: bytes


class GrowingFile:
    """Chunks of messages, appended so that the file is whole after each.

    Parameters
    ----------
    disk
        An empty file.
    channels
        Its topics.
    qos
        Quality of service of each topic, as rosbag2 writes it.

    Raises
    ------
    ImportError
        If `mcap` is missing.
    """

    def __init__(self, disk: Disk, channels: Sequence[Channel], qos: str) -> None:
        self._records = library("mcap.records")
        self._builder = library("mcap.data_stream").RecordBuilder
        self._disk = disk
        self.channels = tuple(channels)
        self._declarations = [*self._schemas(channels), *self._channels(channels, qos)]
        self._chunks: list[Any] = []
        self._message_counts = dict.fromkeys(range(1, len(channels) + 1), 0)
        self._first_time, self._last_time = 2**63 - 1, 0
        self._index = self._bytes([self._records.DataEnd(data_section_crc=0), *self._declarations])
        self._begin()

    def _schemas(self, channels: Sequence[Channel]) -> list[Any]:
        return [
            self._records.Schema(
                id=number,
                name=channel.message_type,
                encoding="ros2msg",
                data=channel.definition.encode(),
            )
            for number, channel in enumerate(channels, start=1)
        ]

    def _channels(self, channels: Sequence[Channel], qos: str) -> list[Any]:
        return [
            self._records.Channel(
                id=number,
                schema_id=number,
                topic=channel.topic,
                message_encoding="cdr",
                metadata={"offered_qos_profiles": qos},
            )
            for number, channel in enumerate(channels, start=1)
        ]

    def _bytes(self, records: Sequence[Any]) -> bytes:
        stream = self._builder()
        for record in records:
            record.write(stream)
        return bytes(stream.end())

    def _begin(self) -> None:
        head = _MAGIC + self._bytes(
            [self._records.Header(profile="ros2", library="vibrissa"), *self._declarations]
        )
        self._room = _head_place(len(head))
        self._size = _whole_pages(self._room + ROOM)
        filler = _filler(self._room - len(head))
        room = self._size - len(self._index) - _FOOTER_BYTES - self._room - _HEAD.size
        self._disk.write(head + filler + _HEAD.pack(_PRIVATE, room), 0)
        self._disk.write(self._index + self._footer(self._index_start), self._index_place)

    @property
    def _index_place(self) -> int:
        """Where the end of the data stands, and behind it the index."""
        return self._size - _FOOTER_BYTES - len(self._index)

    @property
    def _index_start(self) -> int:
        return self._index_place + _HEAD.size + 4

    def _footer(self, start: int, offsets: int = 0) -> bytes:
        return (
            self._bytes(
                [
                    self._records.Footer(
                        summary_start=start, summary_offset_start=offsets, summary_crc=0
                    )
                ]
            )
            + _MAGIC
        )

    def append(self, blocks: Sequence[Messages]) -> None:
        """Add a chunk; log times must not be before those of the last one. Raise OSError where the
        disk does.
        """
        blocks = [block for block in blocks if len(block.log_time)]
        if not blocks:
            return
        body, indexes, length = self._chunk(blocks)
        behind = self._room + _HEAD.size + len(body)
        room = _head_place(behind)
        if room + _HEAD.size > self._index_place:
            self._grow(room + _HEAD.size + len(self._index) + _FOOTER_BYTES)
        rest = _HEAD.pack(_PRIVATE, self._index_place - room - _HEAD.size)
        self._disk.write(body + _filler(room - behind) + rest, self._room + _HEAD.size)
        self._disk.write(_HEAD.pack(_CHUNK, length), self._room)
        self._note(blocks, indexes, length)
        self._room = room

    def _grow(self, least: int) -> None:
        old, size = self._index_start, self._size
        self._size = max(_whole_pages(least), self._size + ROOM)
        try:
            self._disk.write(self._footer(old), self._size - _FOOTER_BYTES)
            self._disk.write(self._index, self._index_place)
        except OSError:
            # Of a disk that is full: the old index still holds, and nothing may be written over it.
            self._size = size
            raise
        self._disk.write(
            _HEAD.pack(_PRIVATE, self._index_place - self._room - _HEAD.size), self._room
        )
        self._disk.write(
            struct.pack("<Q", self._index_start), self._size - _FOOTER_BYTES + _HEAD.size
        )

    def _chunk(self, blocks: Sequence[Messages]) -> tuple[bytes, dict[int, tuple[int, int]], int]:
        """Body of a chunk record and the indexes behind it; place of each index in the body; length
        of the record.
        """
        data = b"".join(block.data for block in blocks)
        times = (
            [int(block.log_time[0]) for block in blocks],
            [int(block.log_time[-1]) for block in blocks],
        )
        stream = self._builder()
        self._records.Chunk(
            compression="",
            data=data,
            message_start_time=min(times[0]),
            message_end_time=max(times[1]),
            uncompressed_crc=crc32(data),
            uncompressed_size=len(data),
        ).write(stream)
        body = bytes(stream.end())[_HEAD.size :]
        length, parts, places = len(body), [body], {}
        for channel in sorted({block.channel for block in blocks}):
            index = self._message_index(channel, blocks)
            places[channel + 1] = (
                sum(map(len, parts)),
                (len(index) - _HEAD.size - 6) // _INDEX.itemsize,
            )
            parts.append(index)
        return b"".join(parts), places, length

    def _message_index(self, channel: int, blocks: Sequence[Messages]) -> bytes:
        rows, begin = [], 0
        for block in blocks:
            if block.channel == channel:
                row = np.empty(len(block.log_time), dtype=_INDEX)
                row["log_time"], row["offset"] = block.log_time, block.offset + begin
                rows.append(row)
            begin += len(block.data)
        data = np.concatenate(rows).tobytes()
        return _HEAD.pack(0x07, 6 + len(data)) + struct.pack("<HI", channel + 1, len(data)) + data

    def _note(
        self, blocks: Sequence[Messages], indexes: dict[int, tuple[int, int]], length: int
    ) -> None:
        """Remember the chunk for the index that the file gets when it is closed."""
        body = self._room + _HEAD.size
        first, last = (
            min(int(block.log_time[0]) for block in blocks),
            max(int(block.log_time[-1]) for block in blocks),
        )
        size = sum(len(block.data) for block in blocks)
        self._first_time, self._last_time = min(self._first_time, first), max(self._last_time, last)
        for channel, (_, count) in indexes.items():
            self._message_counts[channel] += count
        self._chunks.append(
            self._records.ChunkIndex(
                chunk_length=_HEAD.size + length,
                chunk_start_offset=self._room,
                compression="",
                compressed_size=size,
                uncompressed_size=size,
                message_start_time=first,
                message_end_time=last,
                message_index_length=sum(
                    _HEAD.size + 6 + count * _INDEX.itemsize for _, count in indexes.values()
                ),
                message_index_offsets={
                    channel: body + place for channel, (place, _) in indexes.items()
                },
            )
        )

    @property
    def message_counts(self) -> tuple[int, ...]:
        """Messages of each channel so far."""
        return tuple(self._message_counts.values())

    @property
    def time_range(self) -> tuple[int, int] | None:
        """First and last log time [ns]; None without messages."""
        return (self._first_time, self._last_time) if sum(self._message_counts.values()) else None

    def close(self) -> None:
        """Write the whole index of chunks, cut off the room that is left, and close the file."""
        end = self._room + _HEAD.size
        tail = self._tail(end)
        if end + len(tail) > self._index_place:
            self._grow(end + len(tail) + len(self._index) + _FOOTER_BYTES)
        self._disk.write(tail, end)
        self._disk.truncate(end + len(tail))
        self._disk.write(_HEAD.pack(_PRIVATE, 0), self._room)
        self._disk.close()

    def _tail(self, place: int) -> bytes:
        """End of the data, index of everything, footer."""
        first, last = self.time_range or (0, 0)
        statistics = self._records.Statistics(
            attachment_count=0,
            channel_count=len(self._message_counts),
            channel_message_counts=self._message_counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._message_counts.values()),
            message_end_time=last,
            message_start_time=first,
            metadata_count=0,
            schema_count=len(self._declarations) - len(self._message_counts),
        )
        end = self._bytes([self._records.DataEnd(data_section_crc=0)])
        count = len(self._message_counts)
        groups = [
            (0x03, self._declarations[:count]),
            (0x04, self._declarations[count:]),
            (0x0B, [statistics]),
            (0x08, self._chunks),
        ]
        start = place + len(end)
        parts: list[bytes] = []
        offsets: list[Any] = []
        for kind, group in groups:
            data = self._bytes(group)
            if data:
                begin = start + sum(map(len, parts))
                offsets.append(
                    self._records.SummaryOffset(
                        group_opcode=kind, group_start=begin, group_length=len(data)
                    )
                )
            parts.append(data)
        behind = start + sum(map(len, parts))
        return end + b"".join(parts) + self._bytes(offsets) + self._footer(start, behind)


def _whole_pages(size: int) -> int:
    return -(-size // PAGE) * PAGE


def _head_place(place: int) -> int:
    """First place from here on at which the head of a record lies within a page; as a filler needs
    room, not just behind.
    """
    while (place % PAGE) > PAGE - _HEAD.size:
        place += _HEAD.size
    return place


def _filler(size: int) -> bytes:
    """Nothing, or an empty record that readers skip."""
    return _HEAD.pack(_PRIVATE, size - _HEAD.size) + bytes(size - _HEAD.size) if size else b""
