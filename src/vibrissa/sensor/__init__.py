"""Between reactions and recordings: mount, tare, sign of the wrench, noise."""

from vibrissa.sensor.lowpass import LowPass
from vibrissa.sensor.mount import Mount
from vibrissa.sensor.raw import RawRecording
from vibrissa.sensor.sensor import Sensor
from vibrissa.sensor.tare import Tare

__all__ = ["LowPass", "Mount", "RawRecording", "Sensor", "Tare"]
