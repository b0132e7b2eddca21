"""Contacts as `PointCloud2` in an MCAP file, and back."""

from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from vibrissa.files import InputError
from vibrissa.forward.result import Scan
from vibrissa.inverse import Reconstruction
from vibrissa.io.clouds import Columns
from vibrissa.io.contacts import columns, known
from vibrissa.io.disk import whole_file
from vibrissa.io.rosbag.growing import GrowingFile
from vibrissa.io.rosbag.messages import (
    CONTACTS,
    DATATYPES,
    POINT,
    QOS,
    TYPES,
    MessageWriter,
)

_SECOND = 1_000_000_000


def write_clouds(file: Path, found: Reconstruction | Scan) -> None:
    """Write one cloud for each trail, stamped with its first contact, or 0 if there is no time."""
    writer, named, there = MessageWriter(), columns(found), known(found).reshape(-1)
    time = np.zeros(there.shape) if found.reactions.time is None else found.reactions.time
    stamp = np.round(time.reshape(-1) * _SECOND).astype(np.int64)
    trail = np.arange(there.size) // found.kind.shape[-1]
    is_dense = getattr(found, "covariance", None) is not None
    clouds = []
    for own in (there & (trail == each) for each in np.unique(trail)):
        rows = {name: part[own] for name, part in named.items()}
        clouds.append(writer.points(stamp[own], rows, is_dense=is_dense))
    with whole_file(file) as disk:
        mcap = GrowingFile(disk, writer.channels(), QOS)
        mcap.append(clouds)
        mcap.close()


def only_clouds(file: Path) -> bool:
    """Whether all messages of an MCAP file are clouds, as `write_clouds` writes them."""
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    if summary is None or summary.statistics is None:
        return False
    counts = summary.statistics.channel_message_counts
    used = [summary.channels[channel].schema_id for channel, count in counts.items() if count]
    return {summary.schemas[schema].name for schema in used} == {TYPES[CONTACTS]}


def read_clouds(file: Path) -> Columns:
    """Columns of all clouds of contacts in an MCAP file, also of one that a stream wrote.

    Raises
    ------
    InputError
        If it holds no topic of clouds.
    """
    types = get_typestore(Stores.ROS2_HUMBLE)
    with file.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        channels = summary.channels.values() if summary else ()
        kinds = {} if summary is None else summary.schemas
        topics = [one.topic for one in channels if kinds[one.schema_id].name == TYPES[CONTACTS]]
        if not topics:
            raise InputError(f"{file}: no topic of {TYPES[CONTACTS]}; allowed is at least one")
        clouds: list[Any] = [
            types.deserialize_cdr(message.data, TYPES[CONTACTS])
            for _, _, message in reader.iter_messages(topics)
        ]
    formats = {code: kind for kind, code in DATATYPES.items()}
    nothing = np.zeros(0, POINT)
    parts = [{name.replace("normal_", "n"): nothing[name] for name in POINT.names or ()}]
    for cloud in clouds:
        layout: Any = {
            "names": [field.name for field in cloud.fields],
            "formats": [formats[field.datatype] for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_step,
        }
        kind = np.dtype(layout)
        points = np.frombuffer(cloud.data, kind)
        stamp = cloud.header.stamp
        part = {name.replace("normal_", "n"): points[name] for name in kind.names or ()}
        parts.append(part | {"time": stamp.sec + 1e-9 * stamp.nanosec + part["time"]})
    named = set.intersection(*(set(part) for part in parts))
    joined = {name: np.concatenate([part[name] for part in parts]) for name in named}
    if not joined["time"].any():
        del joined["time"]
    return joined
