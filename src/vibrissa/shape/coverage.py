"""How much of a surface the contacts reach."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from vibrissa.geometry.checks import finite_array, positive


def coverage(
    contacts: Float[np.ndarray, "k 3"], samples: Float[np.ndarray, "n 3"], distance: float
) -> tuple[float, Bool[np.ndarray, "n"]]:
    """Fraction of surface samples that lie within a distance of a contact, and which ones.

    Parameters
    ----------
    contacts
        Contact points (k, 3); rows that are not finite are ignored.
    samples
        Points of the surface region, evenly spread over its area (n, 3).
    distance
        Largest distance at which a sample counts as covered.

    Raises
    ------
    ValueError
        If the distance is not positive, or a sample is not finite.
    """
    positive(distance, "distance")
    points = finite_array(samples, "samples", last=3, ndim=2)
    touched = contacts[np.all(np.isfinite(contacts), axis=-1)]
    if not len(touched) or not len(points):
        return 0.0, np.zeros(len(points), dtype=bool)
    near = np.asarray(KDTree(touched).query(points)[0] <= distance)
    return float(near.mean()), near
