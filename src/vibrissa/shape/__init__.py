"""From contacts to the surface, with its uncertainty."""

from vibrissa.shape.compare import Comparison, compare
from vibrissa.shape.coverage import coverage
from vibrissa.shape.fit import fit_shape
from vibrissa.shape.locate import Location, Pose, locate
from vibrissa.shape.mesh import ShapeMesh
from vibrissa.shape.metrics import Errors, ShapeErrors, shape_errors
from vibrissa.shape.occupancy import Occupancy
from vibrissa.shape.shape import Shape

__all__ = [
    "Comparison",
    "Errors",
    "Location",
    "Occupancy",
    "Pose",
    "Shape",
    "ShapeErrors",
    "ShapeMesh",
    "compare",
    "coverage",
    "fit_shape",
    "locate",
    "shape_errors",
]
