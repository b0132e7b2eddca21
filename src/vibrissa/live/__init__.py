"""Streams: samples of sensors in as they come, contacts out."""

from vibrissa.live.address import Address, parse_address
from vibrissa.live.lines import LineSource
from vibrissa.live.loop import stream
from vibrissa.live.netft import NetFtSource
from vibrissa.live.poses import ConstantPose, Poses, StreamedPoses, TimedPoses
from vibrissa.live.process import Processor, Stage
from vibrissa.live.replay import ReplaySource
from vibrissa.live.report import Report
from vibrissa.live.samples import Counts, EndOfStreamError, Samples, Source
from vibrissa.live.simulator import Flaws, SensorSimulator
from vibrissa.live.sinks import Callback, Sink
from vibrissa.live.smoothing import SmoothingStage

__all__ = [
    "Address",
    "Callback",
    "ConstantPose",
    "Counts",
    "EndOfStreamError",
    "Flaws",
    "LineSource",
    "NetFtSource",
    "Poses",
    "Processor",
    "ReplaySource",
    "Report",
    "Samples",
    "SensorSimulator",
    "Sink",
    "SmoothingStage",
    "Source",
    "Stage",
    "StreamedPoses",
    "TimedPoses",
    "parse_address",
    "stream",
]
