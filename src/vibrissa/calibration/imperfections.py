"""How a taper and a rest curvature of the rod would change the readings.

For a rod that is taken to be straight and uniform. To first order, each moves the contact under a
given force; the readings change as if the clamp were moved by as much.
"""

import numpy as np
from jaxtyping import Float

from vibrissa.calibration.arrays import Wrenches
from vibrissa.inverse.checks.constraints import TANGENT, TIP, Stated, constraints_of, holding
from vibrissa.mechanics.imperfect import Imperfect


def imperfect_moves(wrench: Wrenches) -> Float[np.ndarray, "n 3 3"]:
    """Derivatives of the contact, at constant force, by a taper (the share of the radius lost at
    the tip) and by rest curvatures towards the clamp's x and y axes: from base wrenches (n, 6) of
    the ideal rod, in clamp axes and model units.
    """
    count = len(wrench)
    ideal = Imperfect(wrench, np.zeros(count), np.zeros((count, 2)), np.zeros((count, 3)))
    here = constraints_of(Stated(np.ones(())), ideal)
    tip = here.value[:, TIP] < -here.value[:, TANGENT]
    constraints, point = here.by_rod
    slopes = constraints[holding(tip)].reshape(count, 3, -1)
    # The base moment follows, so that the constraints of the contact hold.
    moment, imperfect = np.s_[..., 3:6], np.s_[..., 6:9]
    follows = -np.linalg.solve(slopes[moment], slopes[imperfect])
    return np.asarray(point[imperfect] + point[moment] @ follows)
