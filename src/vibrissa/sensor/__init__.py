"""From reactions to recordings and back: mount, tare, sign of the wrench, noise, faults."""

from vibrissa.sensor.figures import Mount, Noise, Response, TarePolicy
from vibrissa.sensor.inspection import Inspection, inspect_raw
from vibrissa.sensor.lowpass import LowPass
from vibrissa.sensor.presets import PRESETS, preset
from vibrissa.sensor.raw import CHANNEL_UNITS, CHANNELS, Fault, FaultKind, RawRecording
from vibrissa.sensor.rest import Rest
from vibrissa.sensor.sensor import Sensor
from vibrissa.sensor.tare import Tare

__all__ = [
    "CHANNELS",
    "CHANNEL_UNITS",
    "PRESETS",
    "Fault",
    "FaultKind",
    "Inspection",
    "LowPass",
    "Mount",
    "Noise",
    "RawRecording",
    "Response",
    "Rest",
    "Sensor",
    "Tare",
    "TarePolicy",
    "inspect_raw",
    "preset",
]
