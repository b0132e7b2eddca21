"""Writing a stream to an MCAP file, alone or in a rosbag2 folder."""

import json
import time
from pathlib import Path

import numpy as np

from vibrissa.inverse import Reconstruction
from vibrissa.io.disk import whole_file
from vibrissa.io.rosbag.growing import GrowingFile, Messages, Stamps
from vibrissa.io.rosbag.messages import POSE, QOS, WRENCH, MessageWriter
from vibrissa.sensor.raw import Quaternions, RawRecording, Vectors

_MOST_HELD = 1 << 20  # bytes buffered: what a file grows by
_VERSION = 5  # of the metadata, as in ROS 2 Humble
_EVERY = 1.0  # seconds between metadata updates


class McapSink:
    """Raw wrenches, poses and contacts as ROS 2 messages in an MCAP file that can be opened even if
    the process is killed.

    Log times never decrease: that of a pose or contact is the stamp of the latest sample received
    by then. Their own stamps are in their headers.

    Parameters
    ----------
    path
        The file, which exists, valid and empty, as soon as this is constructed.
    wrench_frame, world_frame
        Frame names: of the raw wrench, and of poses and contacts.

    Raises
    ------
    OSError
        If the file cannot be written.
    """

    def __init__(
        self, path: Path, *, wrench_frame: str = "sensor", world_frame: str = "world"
    ) -> None:
        self._writer = MessageWriter(wrench_frame, world_frame)
        with whole_file(path) as self._disk:
            self.file = GrowingFile(self._disk, self._writer.channels(), QOS)
        self._held: list[Messages] = []
        self._bytes = 0
        self._log_time = 0

    def wrench(
        self,
        stamp: Stamps,
        sequence: Stamps,
        force: Vectors,
        torque: Vectors,
    ) -> None:
        """Buffer raw samples for the next chunk."""
        log_time = np.maximum.accumulate(np.maximum(stamp, self._log_time))
        self._log_time = int(log_time[-1])
        wrench = np.hstack([force, torque])
        self._keep(self._writer.stamped(WRENCH, stamp, log_time, wrench, sequence))

    def contacts(self, stamp: Stamps, raw: RawRecording, found: Reconstruction) -> None:
        """Buffer poses and contacts for the next chunk."""
        self.poses(stamp, raw.position, raw.orientation)
        self._keep(self._writer.cloud(stamp, found, self._log_time))

    def poses(self, stamp: Stamps, position: Vectors, orientation: Quaternions) -> None:
        """Buffer known poses for the next chunk."""
        known = np.isfinite(position[:, 0])
        log_time = np.full(int(np.count_nonzero(known)), self._log_time)
        pose = np.hstack([position, orientation])[known]
        self._keep(self._writer.stamped(POSE, stamp[known], log_time, pose))

    def _keep(self, messages: Messages) -> None:
        self._held.append(messages)
        self._bytes += len(messages.data)
        if self._bytes > _MOST_HELD:
            self.flush()

    def flush(self) -> None:
        """Write what is buffered as a chunk."""
        held, self._held, self._bytes = self._held, [], 0
        self.file.append(held)

    def close(self) -> None:
        """Write what is buffered and the index."""
        try:
            self.flush()
            self.file.close()
        finally:
            self._disk.close()


class Rosbag2Sink(McapSink):
    """Raw wrenches, poses and contacts as a rosbag2 folder: `NAME_0.mcap` as `McapSink` writes it,
    and `metadata.yaml`.

    Both stay valid if the process is killed; the metadata, replaced atomically every second, then
    lag by up to a second. They are of version 5, as in ROS 2 Humble, which all later releases read.

    Parameters
    ----------
    folder
        Created if needed; its parent must exist.
    frames
        As for `McapSink`.

    Raises
    ------
    OSError
        If the folder cannot be written to.
    """

    def __init__(self, folder: Path, **frames: str) -> None:
        folder.mkdir(exist_ok=True)
        self._metadata = folder / "metadata.yaml"
        self._name = f"{folder.resolve().name}_0.mcap"
        super().__init__(folder / self._name, **frames)
        self._described()

    def _described(self) -> None:
        """Replace the metadata."""
        file = self.file
        first, last = file.time_range
        size = {
            "starting_time": {"nanoseconds_since_epoch": first},
            "duration": {"nanoseconds": last - first},
            "message_count": sum(file.message_counts),
        }
        topics = [
            {
                "topic_metadata": {
                    "name": channel.topic,
                    "type": channel.message_type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": QOS,
                },
                "message_count": number,
            }
            for channel, number in zip(file.channels, file.message_counts, strict=True)
        ]
        content = {
            "version": _VERSION,
            "storage_identifier": "mcap",
            **size,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._name],
            "files": [{"path": self._name, **size}],
        }
        # JSON is valid YAML.
        text = json.dumps({"rosbag2_bagfile_information": content}, indent=1)
        with whole_file(self._metadata) as disk:
            disk.write(text.encode(), 0)
        disk.close()
        self._when = time.monotonic()

    def flush(self) -> None:
        """Write what is buffered as a chunk and, at most once a second, the metadata."""
        super().flush()
        if time.monotonic() - self._when >= _EVERY:
            self._described()

    def close(self) -> None:
        """Write what is buffered, the index and the metadata."""
        super().close()
        self._described()
