"""The rod: geometry, stiffness and the scales that make the model dimensionless."""

import vibrissa.numerics  # noqa: F401, 64-bit floats, also for derivatives with respect to a rod
from vibrissa.rod.rod import Rod

__all__ = ["Rod"]
