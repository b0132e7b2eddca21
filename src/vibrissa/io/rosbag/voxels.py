"""Voxels that an object fills as `OccupancyGrid` and `PointCloud2` in an MCAP file."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int8
from mcap.records import Message
from rosbags.typesys import Stores, get_typestore

from vibrissa.io.disk import whole_file
from vibrissa.io.rosbag.growing import Channel, GrowingFile, Messages, packed
from vibrissa.io.rosbag.messages import QOS, cloud_message, point_fields
from vibrissa.shape import Occupancy

_TYPES = ("nav_msgs/msg/OccupancyGrid", "sensor_msgs/msg/PointCloud2")
_TOPICS = ("/vibrissa/occupancy", "/vibrissa/voxels")
_FRAME = "world"
_KEPT = QOS.replace("durability: 2", "durability: 1")
"""Maps are sent once and kept for those who come later (transient local)."""
_VOXEL = np.dtype([(name, "<f4") for name in ("x", "y", "z", "probability")])


def write_voxels(file: Path, occupancy: Occupancy, layer: int) -> None:
    """Write one layer as a grid, and the middles of all filled voxels as a cloud, stamped 0."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    channels = [
        Channel(topic, kind, store.generate_msgdef(kind, ros_version=2)[0])
        for topic, kind in zip(_TOPICS, _TYPES, strict=True)
    ]
    contents = _grid(store, occupancy, layer), _cloud(store, occupancy)
    start = np.zeros(1, dtype=np.int64)
    messages = [
        Messages(channel, start, start, packed(Message(channel + 1, 0, bytes(data), 0, 0)))
        for channel, data in enumerate(
            store.serialize_cdr(content, kind)
            for content, kind in zip(contents, _TYPES, strict=True)
        )
    ]
    with whole_file(file) as disk:
        mcap = GrowingFile(disk, channels, _KEPT)
        mcap.append(messages)
        mcap.close()


def percent(occupancy: Occupancy, layer: int) -> Int8[np.ndarray, "y x"]:
    """Probabilities of a layer in percent, -1 where unknown, rows along x."""
    values = occupancy.values[:, :, layer].T
    return np.where(np.isfinite(values), np.round(100 * np.nan_to_num(values)), -1).astype(np.int8)


def _grid(store: Any, occupancy: Occupancy, layer: int) -> Any:
    types, cells = store.types, percent(occupancy, layer)
    moment = types["builtin_interfaces/msg/Time"](0, 0)
    # The grid's origin is the corner of its first cell.
    corner = occupancy.origin + occupancy.spacing * np.array([-0.5, -0.5, layer])
    pose = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](*corner.tolist()),
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    height, width = cells.shape
    about = types["nav_msgs/msg/MapMetaData"](moment, occupancy.spacing, width, height, pose)
    header = types["std_msgs/msg/Header"](moment, _FRAME)
    return types[_TYPES[0]](header, about, cells.ravel())


def _cloud(store: Any, occupancy: Occupancy) -> Any:
    filled = occupancy.values >= 0.5
    voxels = np.zeros(np.count_nonzero(filled), dtype=_VOXEL)
    for name, column in zip("xyz", occupancy.points().T, strict=True):
        voxels[name] = column
    voxels["probability"] = occupancy.values[filled]
    moment = store.types["builtin_interfaces/msg/Time"](0, 0)
    header = store.types["std_msgs/msg/Header"](moment, _FRAME)
    return cloud_message(store, header, voxels, point_fields(store, _VOXEL), is_dense=True)
