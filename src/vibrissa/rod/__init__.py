"""The rod: geometry, stiffness, rest shape, loads and support, and the scales that make the model
dimensionless.
"""

import vibrissa.numerics  # noqa: F401, 64-bit floats, also for derivatives with respect to a rod
from vibrissa.rod.loads import Loads
from vibrissa.rod.record import rod_from_json, rod_to_json
from vibrissa.rod.rest_shape import RestShape
from vibrissa.rod.rod import Rod
from vibrissa.rod.section import Section
from vibrissa.rod.support import Support
from vibrissa.rod.thermal import Thermal

__all__ = [
    "Loads",
    "RestShape",
    "Rod",
    "Section",
    "Support",
    "Thermal",
    "rod_from_json",
    "rod_to_json",
]
