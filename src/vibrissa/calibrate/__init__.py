"""Rod, mount, sensor and object's pose from sweeps over a known object."""

from vibrissa.calibrate.calibrate import calibrate
from vibrissa.calibrate.held_out import HeldOut
from vibrissa.calibrate.result import Calibration, Estimate, Residuals
from vibrissa.calibrate.rows import CalibrationError
from vibrissa.calibrate.statistics import Fitness, Identifiability

__all__ = ["Calibration", "CalibrationError", "Estimate", "Fitness", "HeldOut", "Identifiability", "Residuals", "calibrate"]
