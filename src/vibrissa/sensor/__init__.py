"""Between reactions and recordings: mount, tare, sign of the wrench, noise."""

from vibrissa.sensor.sensor import RawRecording, Sensor

__all__ = ["RawRecording", "Sensor"]
