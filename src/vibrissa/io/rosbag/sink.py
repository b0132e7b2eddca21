"""A stream to an MCAP file."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from vibrissa.io.rosbag.growing import FileDisk, GrowingFile, Messages
from vibrissa.io.rosbag.messages import QOS, MessageWriter
from vibrissa.reconstruct import Reconstruction
from vibrissa.sensor import RawRecording

_MOST_HELD = 1 << 20


class McapSink:
    """Raw wrenches, poses and contacts as ROS 2 messages in an MCAP file that opens whenever the process is killed.

    Log times never fall: that of a pose or a contact is the stamp of the last sample that had come by then. Their own stamps are in their headers.

    Parameters
    ----------
    path
        Of the file, which is there, whole and empty, once this is built.
    wrench_frame, world_frame
        Names of the frames: of the raw wrench, and of poses and contacts.

    Raises
    ------
    ImportError
        If the libraries for MCAP are missing.
    OSError
        If the file cannot be written.
    """

    def __init__(self, path: Path, *, wrench_frame: str = "sensor", world_frame: str = "world") -> None:
        self._writer = MessageWriter(wrench_frame, world_frame)
        part = path.with_name(f".{path.name}.part")
        self._disk = FileDisk(part)
        self.file = GrowingFile(self._disk, self._writer.channels(), QOS)
        part.replace(path)
        self._held: list[Messages] = []
        self._bytes = 0
        self._log_time = 0

    def wrench(
        self, stamp: Int[np.ndarray, "n"], sequence: Int[np.ndarray, "n"], force: Float[np.ndarray, "n 3"], torque: Float[np.ndarray, "n 3"]
    ) -> None:
        """Keep raw samples for the next chunk."""
        log_time = np.maximum.accumulate(np.maximum(stamp, self._log_time))
        self._log_time = int(log_time[-1])
        self._keep(self._writer.wrenches(stamp, sequence, force, torque, log_time))

    def contacts(self, stamp: Int[np.ndarray, "n"], raw: RawRecording, found: Reconstruction) -> None:
        """Keep poses and contacts for the next chunk."""
        known = np.isfinite(raw.position[:, 0])
        log_time = np.full(int(np.count_nonzero(known)), self._log_time)
        self._keep(self._writer.poses(stamp[known], raw.position[known], raw.orientation[known], log_time))
        self._keep(self._writer.cloud(stamp, found, self._log_time))

    def _keep(self, messages: Messages) -> None:
        self._held.append(messages)
        self._bytes += len(messages.data)
        if self._bytes > _MOST_HELD:
            self.flush()

    def flush(self) -> None:
        """Write a chunk of what is held."""
        held, self._held, self._bytes = self._held, [], 0
        self.file.append(held)

    def close(self) -> None:
        """Write the rest and the index."""
        try:
            self.flush()
            self.file.close()
        finally:
            self._disk.close()
