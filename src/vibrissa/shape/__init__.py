"""From contacts to the surface, with its uncertainty."""

from vibrissa.shape.coverage import coverage
from vibrissa.shape.fit import fit_shape
from vibrissa.shape.identify import Candidate, Identification, identify
from vibrissa.shape.locate import Location, Pose, locate
from vibrissa.shape.mesh import ShapeMesh
from vibrissa.shape.primitive import Parameter, PrimitiveFit, fit_primitive
from vibrissa.shape.shape import Shape

__all__ = [
    "Candidate",
    "Identification",
    "Location",
    "Parameter",
    "Pose",
    "PrimitiveFit",
    "Shape",
    "ShapeMesh",
    "coverage",
    "fit_primitive",
    "fit_shape",
    "identify",
    "locate",
]
