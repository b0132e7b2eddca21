"""What can be saved of an MCAP file that was cut or damaged: by a machine that lost power, a disk,
a copy made while it grew.
"""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from vibrissa.files import InputError, readable
from vibrissa.io.errors import writable
from vibrissa.io.rosbag.growing import MAGIC
from vibrissa.io.rosbag.library import library


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
    mcap, records = library("mcap.writer"), library("mcap.records")
    schemas, channels, count = {0: 0}, {}, 0
    with source.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise InputError(
                f"{source}: does not begin as MCAP does; allowed is an MCAP file, cut or not"
            )
        with writable(out).open("wb") as copy:
            writer = mcap.Writer(copy, compression=mcap.CompressionType.NONE)
            writer.start(profile="ros2", library="vibrissa")
            for record in _whole_records(stream, source.stat().st_size):
                match record:
                    case records.Schema() if record.id not in schemas:
                        schemas[record.id] = writer.register_schema(
                            record.name, record.encoding, record.data
                        )
                    case records.Channel() if (
                        record.id not in channels and record.schema_id in schemas
                    ):
                        channels[record.id] = writer.register_channel(
                            record.topic,
                            record.message_encoding,
                            schemas[record.schema_id],
                            record.metadata,
                        )
                    case records.Message() if record.channel_id in channels:
                        count += 1
                        writer.add_message(
                            channels[record.channel_id],
                            record.log_time,
                            record.data,
                            record.publish_time,
                            record.sequence,
                        )
            writer.finish()
    return count


def _whole_records(stream: IO[bytes], size: int) -> Iterator[Any]:
    """Records up to the first that is not whole, also those in chunks; none is longer than the
    file.
    """
    reader = library("mcap.stream_reader").StreamReader(
        stream, skip_magic=True, validate_crcs=True, record_size_limit=size
    )
    with suppress(Exception):  # whatever `mcap` raises where bytes are damaged
        yield from reader.records
