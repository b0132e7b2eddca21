"""Files: setups, cases, recordings in; contacts and datasets out."""

from vibrissa.io.calibration import write_calibration
from vibrissa.io.case import Case, load_case
from vibrissa.io.contacts import write_contacts, write_dataset
from vibrissa.io.errors import InputError
from vibrissa.io.recording import read_recording, write_recording
from vibrissa.io.setup import Setup, load_setup

__all__ = [
    "Case",
    "InputError",
    "Setup",
    "load_case",
    "load_setup",
    "read_recording",
    "write_calibration",
    "write_contacts",
    "write_dataset",
    "write_recording",
]
