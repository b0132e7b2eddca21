"""Calibration of rod, mount, sensor and object pose from sweeps over a known object."""

from vibrissa.calibration.calibrate import calibrate
from vibrissa.calibration.held_out import HeldOut
from vibrissa.calibration.result import Calibration, Estimate, Residuals
from vibrissa.calibration.rows import CalibrationError
from vibrissa.calibration.statistics import Fitness, Identifiability

__all__ = [
    "Calibration",
    "CalibrationError",
    "Estimate",
    "Fitness",
    "HeldOut",
    "Identifiability",
    "Residuals",
    "calibrate",
]
