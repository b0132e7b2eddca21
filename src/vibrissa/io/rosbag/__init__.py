"""MCAP files and rosbag2 folders from a stream, valid at any moment while being written.

Importing it raises ImportError, with the install command, if `mcap` or `rosbags` is missing.
"""

from functools import partial

from vibrissa.libraries import extra_library

library = partial(extra_library, extra="live", need="MCAP needs it")
for _name in ("mcap.records", "rosbags.typesys"):
    library(_name)

from vibrissa.io.rosbag.mend import mend  # noqa: E402
from vibrissa.io.rosbag.sink import McapSink, Rosbag2Sink  # noqa: E402

__all__ = ["McapSink", "Rosbag2Sink", "mend"]
