"""What can be saved of an MCAP file that was cut or damaged: by a machine that lost power, a disk,
a copy made while it grew.
"""

import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from vibrissa.io.errors import InputError, readable, writable
from vibrissa.io.rosbag.library import library

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_LARGEST = 1 << 26
_PARSED = (0x03, 0x04, 0x05, 0x06)
_FOOTER = 0x02


def mend(path: str | Path, target: str | Path) -> int:
    """Copy all whole messages up to the first damage into a new MCAP file, and return how many.

    A file that was only killed needs no mending: it is whole.

    Raises
    ------
    InputError
        If the file cannot be read, is no MCAP file, or the target cannot be written.
    ImportError
        If `mcap` is missing.
    """
    source, out = readable(Path(path)), Path(target)
    if out.exists():
        raise InputError(f"{out}: is there already; allowed is a new file")
    writer_module, stream_reader = library("mcap.writer"), library("mcap.stream_reader")
    count = 0
    with source.open("rb") as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise InputError(
                f"{source}: does not begin as MCAP does; allowed is an MCAP file, cut or not"
            )
        with writable(out).open("wb") as target_stream:
            writer = writer_module.Writer(
                target_stream, compression=writer_module.CompressionType.NONE
            )
            writer.start(profile="ros2", library="vibrissa")
            schemas: dict[int, int] = {0: 0}
            channels: dict[int, int] = {}
            for record in _whole_records(stream, stream_reader):
                count += _copied(record, writer, schemas, channels)
            writer.finish()
    return count


def _copied(record: Any, writer: Any, schemas: dict[int, int], channels: dict[int, int]) -> bool:
    """Write a record under the numbers of the new file; whether it was a message."""
    match type(record).__name__:
        case "Schema" if record.id not in schemas:
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        case "Channel" if record.id not in channels and record.schema_id in schemas:
            channels[record.id] = writer.register_channel(
                record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
            )
        case "Message" if record.channel_id in channels:
            writer.add_message(
                channels[record.channel_id],
                record.log_time,
                record.data,
                record.publish_time,
                record.sequence,
            )
            return True
    return False


def _whole_records(stream: Any, stream_reader: Any) -> Iterator[Any]:
    """Schemas, channels and messages, also those in chunks, until something is not as it should be."""
    while True:
        head = stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return
        kind, length = _HEAD.unpack(head)
        if kind == _FOOTER or length > _LARGEST:
            return
        body = stream.read(length)
        if len(body) < length:
            return
        if kind in _PARSED:
            try:
                yield from _parsed(head + body, kind, stream_reader)
            except Exception:
                return


def _parsed(data: bytes, kind: int, stream_reader: Any) -> list[Any]:
    reader = stream_reader.StreamReader(
        io.BytesIO(data), skip_magic=True, emit_chunks=True, record_size_limit=_LARGEST
    )
    record = next(iter(reader.records))
    if kind != 0x06:
        return [record]
    if record.uncompressed_size > _LARGEST:
        raise ValueError(f"chunk of {record.uncompressed_size} bytes; allowed are {_LARGEST}")
    return list(stream_reader.breakup_chunk(record, validate_crc=True))
