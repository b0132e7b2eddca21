"""Whisker-like tactile sensing: large-deflection contact mechanics of a swept elastic rod, forward and inverse.

Names are loaded when first used, so that `import vibrissa` and the command line's help stay quick.
"""

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:
    from vibrissa import surfaces
    from vibrissa.calibrate import Calibration, CalibrationError, calibrate
    from vibrissa.contacts import ContactKind, Motion, RecordingWarning, Status
    from vibrissa.design import ExpectedError, expected_error
    from vibrissa.io import Case, Setup, load_case, load_setup, read_recording, write_contacts
    from vibrissa.reactions import Reactions
    from vibrissa.reconstruct import (
        CausalSmoother,
        ContactErrors,
        FrictionEstimate,
        LiveContact,
        Reconstruction,
        Smoothing,
        Touch,
        contact_errors,
        estimate_friction,
        reconstruct,
        smooth,
    )
    from vibrissa.rod import Rod
    from vibrissa.scan import Equilibrium, Event, EventKind, Scan, equilibria, scan
    from vibrissa.sensor import Sensor
    from vibrissa.tolerances import Tolerances
    from vibrissa.trail import Trail

_HOMES = {
    "Calibration": "calibrate",
    "CalibrationError": "calibrate",
    "calibrate": "calibrate",
    "Case": "io",
    "CausalSmoother": "reconstruct",
    "contact_errors": "reconstruct",
    "ContactErrors": "reconstruct",
    "Sensor": "sensor",
    "Setup": "io",
    "load_case": "io",
    "load_setup": "io",
    "read_recording": "io",
    "write_contacts": "io",
    "ContactKind": "contacts",
    "Equilibrium": "scan",
    "equilibria": "scan",
    "ExpectedError": "design",
    "expected_error": "design",
    "Event": "scan",
    "EventKind": "scan",
    "FrictionEstimate": "reconstruct",
    "estimate_friction": "reconstruct",
    "LiveContact": "reconstruct",
    "Motion": "contacts",
    "Reactions": "reactions",
    "RecordingWarning": "contacts",
    "Reconstruction": "reconstruct",
    "reconstruct": "reconstruct",
    "Rod": "rod",
    "Scan": "scan",
    "Smoothing": "reconstruct",
    "smooth": "reconstruct",
    "Status": "contacts",
    "Tolerances": "tolerances",
    "Touch": "reconstruct",
    "Trail": "trail",
    "scan": "scan",
    "surfaces": "surfaces",
}

__all__ = [
    "Calibration",
    "CalibrationError",
    "Case",
    "CausalSmoother",
    "ContactErrors",
    "ContactKind",
    "Equilibrium",
    "Event",
    "EventKind",
    "ExpectedError",
    "FrictionEstimate",
    "LiveContact",
    "Motion",
    "Reactions",
    "Reconstruction",
    "RecordingWarning",
    "Rod",
    "Scan",
    "Sensor",
    "Setup",
    "Smoothing",
    "Status",
    "Tolerances",
    "Touch",
    "Trail",
    "__version__",
    "calibrate",
    "contact_errors",
    "equilibria",
    "estimate_friction",
    "expected_error",
    "load_case",
    "load_setup",
    "read_recording",
    "reconstruct",
    "scan",
    "smooth",
    "surfaces",
    "write_contacts",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'vibrissa' has no attribute {name!r}")
    home = importlib.import_module(f"vibrissa.{_HOMES[name]}")
    value = home if name == _HOMES[name] == "surfaces" else getattr(home, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)


class _Face(ModuleType):
    """Keeps `vibrissa.scan` the function, though a room has the same name: importing the room would put the module in its place."""

    def __setattr__(self, name: str, value: object) -> None:
        if isinstance(value, ModuleType) and name in _HOMES and name != "surfaces":
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Face
