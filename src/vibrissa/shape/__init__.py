"""From contacts to the surface, with its uncertainty."""

from vibrissa.shape.compare import Comparison, compare
from vibrissa.shape.coverage import coverage
from vibrissa.shape.fit import fit_shape
from vibrissa.shape.follow import Followed, follow
from vibrissa.shape.identify import Candidate, Identification, identify
from vibrissa.shape.locate import Location, Pose, locate
from vibrissa.shape.mesh import ShapeMesh
from vibrissa.shape.metrics import Errors, ShapeErrors, shape_errors
from vibrissa.shape.occupancy import Occupancy
from vibrissa.shape.plan import NextSweep, next_sweep
from vibrissa.shape.primitive import Parameter, PrimitiveFit, fit_primitive
from vibrissa.shape.shape import Shape
from vibrissa.shape.simulated import SimulatedArm

__all__ = [
    "Candidate",
    "Comparison",
    "Errors",
    "Followed",
    "Identification",
    "Location",
    "NextSweep",
    "Occupancy",
    "Parameter",
    "Pose",
    "PrimitiveFit",
    "Shape",
    "ShapeErrors",
    "ShapeMesh",
    "SimulatedArm",
    "compare",
    "coverage",
    "fit_primitive",
    "fit_shape",
    "follow",
    "identify",
    "locate",
    "next_sweep",
    "shape_errors",
]
