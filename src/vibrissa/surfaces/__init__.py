"""Objects as level functions g(p), positive outside. The normal follows by differentiation."""

from vibrissa.surfaces.base import ExactSurface, Placed, Surface
from vibrissa.surfaces.derived import Offset, Union
from vibrissa.surfaces.functions import HeightField, Implicit
from vibrissa.surfaces.lattice import Lattice
from vibrissa.surfaces.mesh import Mesh
from vibrissa.surfaces.primitives import Box, Capsule, Cone, Cylinder, Plane, Sphere, Torus
from vibrissa.surfaces.quadrics import (
    Ellipsoid,
    EllipticCylinder,
    EllipticParaboloid,
    Superquadric,
)

__all__ = [
    "Box",
    "Capsule",
    "Cone",
    "Cylinder",
    "Ellipsoid",
    "EllipticCylinder",
    "EllipticParaboloid",
    "ExactSurface",
    "HeightField",
    "Implicit",
    "Lattice",
    "Mesh",
    "Offset",
    "Placed",
    "Plane",
    "Sphere",
    "Superquadric",
    "Surface",
    "Torus",
    "Union",
]
