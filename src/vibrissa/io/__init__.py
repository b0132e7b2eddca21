"""Files: setups, cases and recordings in; contacts and datasets out."""

from vibrissa.contacts import RecordingWarning
from vibrissa.files import InputError
from vibrissa.io.calibration import write_calibration
from vibrissa.io.case import Case, load_case
from vibrissa.io.contacts import read_contacts, write_contacts, write_dataset
from vibrissa.io.fitted import read_shape
from vibrissa.io.recordings.align import Recording
from vibrissa.io.recordings.convert import convert_recording
from vibrissa.io.recordings.read import inspect_recording, read_raw, read_recording
from vibrissa.io.recordings.write import write_recording
from vibrissa.io.setup import Setup, load_setup
from vibrissa.io.shapes import write_occupancy, write_shape

__all__ = [
    "Case",
    "InputError",
    "Recording",
    "RecordingWarning",
    "Setup",
    "convert_recording",
    "inspect_recording",
    "load_case",
    "load_setup",
    "read_contacts",
    "read_raw",
    "read_recording",
    "read_shape",
    "write_calibration",
    "write_contacts",
    "write_dataset",
    "write_occupancy",
    "write_recording",
    "write_shape",
]
