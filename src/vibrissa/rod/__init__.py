"""The rod: geometry, stiffness and the scales that make the model dimensionless."""

from vibrissa.rod.rod import Rod

__all__ = ["Rod"]
