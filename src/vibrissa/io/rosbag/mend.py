"""Recovering an MCAP file that was truncated or damaged: by a power failure, a bad disk, or being
copied while it grew.
"""

from itertools import takewhile
from pathlib import Path

from mcap import records
from mcap.writer import CompressionType, Writer

from vibrissa.files import InputError, readable, writable
from vibrissa.io.recordings.containers import MAGIC, mcap_records


def mend(path: str | Path, target: str | Path) -> int:
    """Copy all complete messages before the first damage to a new MCAP file, and return how many.

    A file whose writer was merely killed needs no mending: it is valid.

    Raises
    ------
    InputError
        If the file cannot be read or is not MCAP, or the target exists or cannot be written.
    """
    source, out = readable(Path(path)), Path(target)
    if out.exists():
        raise InputError(f"{out}: already exists; allowed is a new file")
    with source.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise InputError(
                f"{source}: does not begin as MCAP does; allowed is an MCAP file, cut or not"
            )
    schemas, channels, count, damage = {0: 0}, {}, 0, list[str]()
    with writable(out).open("wb") as copy:
        writer = Writer(copy, compression=CompressionType.NONE)
        writer.start("ros2", "vibrissa")
        for one in takewhile(lambda _: not damage, mcap_records(source, damage)):
            match one:
                case records.Schema() if one.id not in schemas:
                    schemas[one.id] = writer.register_schema(one.name, one.encoding, one.data)
                case records.Channel() if one.id not in channels and one.schema_id in schemas:
                    channels[one.id] = writer.register_channel(
                        one.topic, one.message_encoding, schemas[one.schema_id], one.metadata
                    )
                case records.Message() if one.channel_id in channels:
                    channel = channels[one.channel_id]
                    writer.add_message(
                        channel, one.log_time, one.data, one.publish_time, one.sequence
                    )
                    count += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return count
