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
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from jaxtyping import Int

from vibrissa.io.rosbag.disk import Disk
from vibrissa.io.rosbag.library import library

PAGE = 4096
"""Bytes of the smallest memory page in use: a write within one page is never torn by a kill."""
ROOM = 1 << 20
"""By which a file grows at least, in bytes: some seconds of a sensor at 7000 samples a second."""

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # of every record: opcode and length
_PRIVATE = 0x80  # opcode: from here on, readers skip records
_FOOTER_BYTES = _HEAD.size + 20 + len(MAGIC)


class Channel(NamedTuple):
    """A topic: its name, the type of its messages, and the type's definition (ros2msg), as ROS 2
    names them.
    """

    topic: str
    message_type: str
    definition: str


class Messages(NamedTuple):
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
        self._records = records = library("mcap.records")
        self._builder = library("mcap.data_stream").RecordBuilder
        self._disk, self.channels = disk, tuple(channels)
        self._schemas: list[Any] = []
        self._topics: list[Any] = []
        self._chunks: list[Any] = []
        for number, (topic, kind, definition) in enumerate(channels, start=1):
            self._schemas.append(
                records.Schema(id=number, name=kind, encoding="ros2msg", data=definition.encode())
            )
            self._topics.append(
                records.Channel(
                    id=number,
                    schema_id=number,
                    topic=topic,
                    message_encoding="cdr",
                    metadata={"offered_qos_profiles": qos},
                )
            )
        self._counts = [0] * len(channels)
        self._data_end = self._bytes([records.DataEnd(data_section_crc=0)])
        declarations = self._bytes([*self._schemas, *self._topics])
        self._index = self._data_end + declarations
        head = MAGIC + self._bytes([records.Header(profile="ros2", library="vibrissa")])
        head += declarations
        self._room = _head_place(len(head))
        self._size = _whole_pages(self._room + ROOM)
        self._disk.write(head + _filler(self._room - len(head)) + self._room_head(self._room), 0)
        self._disk.write(self._index + self._footer(self._index_start), self._index_place)

    def _bytes(self, records: Sequence[Any]) -> bytes:
        stream = self._builder()
        for record in records:
            record.write(stream)
        return bytes(stream.end())

    @property
    def _index_place(self) -> int:
        """Where the end of the data stands, and behind it the index."""
        return self._size - _FOOTER_BYTES - len(self._index)

    @property
    def _index_start(self) -> int:
        return self._index_place + len(self._data_end)

    def _room_head(self, place: int) -> bytes:
        """Head of the record that reaches from a place to the end of the data."""
        return _HEAD.pack(_PRIVATE, self._index_place - place - _HEAD.size)

    def _footer(self, start: int, offsets: int = 0) -> bytes:
        footer = self._records.Footer(
            summary_start=start, summary_offset_start=offsets, summary_crc=0
        )
        return self._bytes([footer]) + MAGIC

    def append(self, blocks: Sequence[Messages]) -> None:
        """Add a chunk; log times must not be before those of the last one. Raise OSError where the
        disk does.
        """
        blocks = [block for block in blocks if len(block.log_time)]
        if not blocks:
            return
        data = b"".join(block.data for block in blocks)
        chunk = self._records.Chunk(
            compression="",
            data=data,
            message_start_time=min(int(block.log_time[0]) for block in blocks),
            message_end_time=max(int(block.log_time[-1]) for block in blocks),
            uncompressed_crc=crc32(data),
            uncompressed_size=len(data),
        )
        written = self._bytes([chunk])
        length, places = len(written), {}
        indexes = self._message_indexes(blocks)
        for index in indexes:
            places[index.channel_id] = self._room + len(written)
            written += self._bytes([index])
        self._put(written)
        self._chunks.append(
            self._records.ChunkIndex(
                chunk_length=length,
                chunk_start_offset=self._room,
                compression="",
                compressed_size=len(data),
                uncompressed_size=len(data),
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                message_index_length=len(written) - length,
                message_index_offsets=places,
            )
        )
        for index in indexes:
            self._counts[index.channel_id - 1] += len(index.records)
        self._room = _head_place(self._room + len(written))

    def _message_indexes(self, blocks: Sequence[Messages]) -> list[Any]:
        rows: dict[int, list[tuple[int, int]]] = {}
        begin = 0
        for block in blocks:
            own = rows.setdefault(block.channel + 1, [])
            own += zip(block.log_time.tolist(), (block.offset + begin).tolist(), strict=True)
            begin += len(block.data)
        return [
            self._records.MessageIndex(channel_id=channel, records=own)
            for channel, own in sorted(rows.items())
        ]

    def _put(self, written: bytes) -> None:
        """Records in place of the room, and the rest of the room behind them; their first head is
        what makes them count, and comes last.
        """
        end = self._room + len(written)
        rest = _head_place(end)
        if rest + _HEAD.size > self._index_place:
            self._grow(rest + _HEAD.size)
        behind = written[_HEAD.size :] + _filler(rest - end) + self._room_head(rest)
        self._disk.write(behind, self._room + _HEAD.size)
        self._disk.write(written[: _HEAD.size], self._room)

    def _grow(self, data_end: int) -> None:
        start, size = self._index_start, self._size
        self._size = max(_whole_pages(data_end + len(self._index) + _FOOTER_BYTES), size + ROOM)
        footer = self._size - _FOOTER_BYTES
        try:
            self._disk.write(self._footer(start), footer)
            self._disk.write(self._index, self._index_place)
        except OSError:
            # Of a disk that is full: the old index still holds, and nothing may be written over it.
            self._size = size
            raise
        self._disk.write(self._room_head(self._room), self._room)
        self._disk.write(struct.pack("<Q", self._index_start), footer + _HEAD.size)

    @property
    def message_counts(self) -> tuple[int, ...]:
        """Messages of each channel so far."""
        return tuple(self._counts)

    @property
    def time_range(self) -> tuple[int, int]:
        """First and last log time [ns]; zeros without messages."""
        if not self._chunks:
            return 0, 0
        return self._chunks[0].message_start_time, self._chunks[-1].message_end_time

    def close(self) -> None:
        """Write the whole index of chunks, cut off the room that is left, and close the file."""
        end = self._room + _HEAD.size
        tail = self._tail(end)
        if end + len(tail) > self._index_place:
            self._grow(end + len(tail))
        self._disk.write(tail, end)
        self._disk.truncate(end + len(tail))
        self._disk.write(_HEAD.pack(_PRIVATE, 0), self._room)
        self._disk.close()

    def _tail(self, place: int) -> bytes:
        """End of the data, index of everything, footer."""
        first, last = self.time_range
        statistics = self._records.Statistics(
            attachment_count=0,
            channel_count=len(self._topics),
            channel_message_counts=dict(enumerate(self._counts, start=1)),
            chunk_count=len(self._chunks),
            message_count=sum(self._counts),
            message_end_time=last,
            message_start_time=first,
            metadata_count=0,
            schema_count=len(self._schemas),
        )
        tail, offsets = self._data_end, []
        for group in (self._schemas, self._topics, [statistics], self._chunks):
            data = self._bytes(group)
            if data:
                offsets.append(
                    self._records.SummaryOffset(
                        group_opcode=data[0],
                        group_start=place + len(tail),
                        group_length=len(data),
                    )
                )
            tail += data
        footer = self._footer(place + len(self._data_end), place + len(tail))
        return tail + self._bytes(offsets) + footer


def _whole_pages(size: int) -> int:
    return -(-size // PAGE) * PAGE


def _head_place(place: int) -> int:
    """First place from here on at which the head of a record lies within a page; it is here, or far
    enough for a filler in front of it.
    """
    while (place % PAGE) > PAGE - _HEAD.size:
        place += _HEAD.size
    return place


def _filler(size: int) -> bytes:
    """Nothing, or an empty record that readers skip."""
    return _HEAD.pack(_PRIVATE, size - _HEAD.size) + bytes(size - _HEAD.size) if size else b""
