"""MCAP files and rosbag2 folders of a stream, whole at any moment of being written."""

from vibrissa.io.rosbag.growing import Channel, GrowingFile, Messages
from vibrissa.io.rosbag.mend import mend
from vibrissa.io.rosbag.sink import McapSink, Rosbag2Sink

__all__ = ["Channel", "GrowingFile", "McapSink", "Messages", "Rosbag2Sink", "mend"]
