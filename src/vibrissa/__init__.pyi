from . import io, live, plot, rods, shape, surfaces
from .calibration import Calibration, CalibrationError, calibrate
from .contacts import ContactKind, Contacts, Motion, RecordingWarning, Status
from .design import ExpectedError, expected_error
from .forward import Equilibrium, Event, EventKind, Scan, equilibria, scan
from .inverse import (
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
from .io import (
    Case,
    Setup,
    load_case,
    load_setup,
    read_contacts,
    read_recording,
    write_contacts,
)
from .reactions import Reactions
from .rod import Loads, RestShape, Rod, Section, Support, Thermal
from .sensor import Sensor
from .shape import (
    Candidate,
    Identification,
    Location,
    Pose,
    Shape,
    ShapeMesh,
    fit_shape,
    identify,
    locate,
)
from .tolerances import Tolerances
from .trail import Trail
from .viewer import view

__all__ = [
    "Calibration",
    "CalibrationError",
    "Candidate",
    "Case",
    "CausalSmoother",
    "ContactErrors",
    "ContactKind",
    "Contacts",
    "Equilibrium",
    "Event",
    "EventKind",
    "ExpectedError",
    "FrictionEstimate",
    "Identification",
    "LiveContact",
    "Loads",
    "Location",
    "Motion",
    "Pose",
    "Reactions",
    "Reconstruction",
    "RecordingWarning",
    "RestShape",
    "Rod",
    "Scan",
    "Section",
    "Sensor",
    "Setup",
    "Shape",
    "ShapeMesh",
    "Smoothing",
    "Status",
    "Support",
    "Thermal",
    "Tolerances",
    "Touch",
    "Trail",
    "__version__",
    "calibrate",
    "contact_errors",
    "equilibria",
    "estimate_friction",
    "expected_error",
    "fit_shape",
    "identify",
    "io",
    "live",
    "load_case",
    "load_setup",
    "locate",
    "plot",
    "read_contacts",
    "read_recording",
    "reconstruct",
    "rods",
    "scan",
    "shape",
    "smooth",
    "surfaces",
    "view",
    "write_contacts",
]

__version__: str
