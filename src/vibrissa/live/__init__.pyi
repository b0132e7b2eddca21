from .address import Address, parse_address
from .lines import LineSource
from .loop import SilentSourceError, stream
from .netft import NetFtSource
from .poses import ConstantPose, Poses, PoseSource, StreamedPoses, TimedPoses
from .process import Processor, Stage
from .replay import ReplaySource
from .report import Report
from .samples import Counts, EndOfStreamError, Samples, Source
from .simulator import Flaws, SensorSimulator
from .sinks import Callback, Sink
from .smoothing import SmoothingStage

__all__ = [
    "Address",
    "Callback",
    "ConstantPose",
    "Counts",
    "EndOfStreamError",
    "Flaws",
    "LineSource",
    "NetFtSource",
    "PoseSource",
    "Poses",
    "Processor",
    "ReplaySource",
    "Report",
    "Samples",
    "SensorSimulator",
    "SilentSourceError",
    "Sink",
    "SmoothingStage",
    "Source",
    "Stage",
    "StreamedPoses",
    "TimedPoses",
    "parse_address",
    "stream",
]
