"""Objects as level functions g(p), positive outside. The normal follows by differentiation."""

from vibrissa.surfaces.base import Placed, Surface
from vibrissa.surfaces.functions import HeightField, Implicit
from vibrissa.surfaces.mesh import Mesh
from vibrissa.surfaces.quadrics import Ellipsoid, EllipticCylinder, EllipticParaboloid, Plane, Sphere

__all__ = ["Ellipsoid", "EllipticCylinder", "EllipticParaboloid", "HeightField", "Implicit", "Mesh", "Placed", "Plane", "Sphere", "Surface"]
