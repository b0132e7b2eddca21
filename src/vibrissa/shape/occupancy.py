"""Voxels that an object fills, as planners want them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtr, ndtri


@dataclass(frozen=True, eq=False)
class Occupancy:
    """Probability that an object fills the voxels of a lattice, along x, y and z.

    Attributes
    ----------
    origin
        (3,) middle of the first voxel, in the contacts' unit of length.
    spacing
        Edge length of a voxel.
    values
        (x, y, z) probability that the middle of a voxel is inside the object; NaN where the
        contacts do not say.
    """

    origin: Float[np.ndarray, "3"]
    spacing: float
    values: Float[np.ndarray, "x y z"]

    def __repr__(self) -> str:
        """Return one line."""
        known = np.isfinite(self.values)
        size = " × ".join(map(str, self.values.shape))
        return (
            f"Occupancy: {size} voxels of {self.spacing:.3g}, {np.sum(self.values > 0.5)} filled, "
            f"{np.sum(~known)} unknown"
        )

    @property
    def volume(self) -> float:
        """Expected volume of the object, where it is known."""
        return float(np.nansum(self.values) * self.spacing**3)

    def points(self, least: float = 0.5) -> Float[np.ndarray, "n 3"]:
        """Middles (n, 3) of the voxels whose probability is at least this."""
        return self.origin + self.spacing * np.argwhere(self.values >= least)


def lattice_points(
    origin: Float[np.ndarray, "3"], spacing: float, counts: Int[np.ndarray, "3"]
) -> Float[np.ndarray, "n 3"]:
    """Nodes of a lattice, the last axis fastest."""
    nodes = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
    return origin + spacing * nodes.reshape(-1, 3)


def probability_inside(
    distance: Float[np.ndarray, "n"], deviation: Float[np.ndarray, "n"], known: float
) -> Float[np.ndarray, "n"]:
    """Probability that places at some distance from a surface, positive outside, are inside; NaN
    where its deviation exceeds `known` and its 95 % interval holds the place.
    """
    apart = distance / deviation
    unknown = (deviation > known) & (np.abs(apart) < ndtri(0.975))
    return np.where(unknown, np.nan, ndtr(-apart))
