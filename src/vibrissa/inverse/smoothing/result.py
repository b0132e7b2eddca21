"""What smoothing says beside the contacts."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True)
class Touch:
    """One contact of a sweep, from start to end.

    Attributes
    ----------
    first, last
        Samples within the contact, both included.
    start, end
        Time [s] at which it began and ended; None where the recording begins or ends in contact.
    start_deviation, end_deviation
        Their standard deviations [s], from the likelihood.
    start_limit, end_limit
        The least that the noise allows [s] (Cramér-Rao; mechanics.md, "Where a contact begins").
    changes
        Samples at which the phase (tip, tangential) changes: the first of the new phase.
    jumps
        Samples at which the contact jumped, or its motion broke: nothing is smoothed across them.
    change_deviations
        Standard deviations [s] of the places of the changes of phase, from the likelihood. Points
        and covariances near a change are averaged over its places.
    """

    first: int
    last: int
    start: float | None
    end: float | None
    start_deviation: float | None
    end_deviation: float | None
    start_limit: float | None
    end_limit: float | None
    changes: tuple[int, ...] = ()
    jumps: tuple[int, ...] = ()
    change_deviations: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Smoothing:
    """How the contacts of one sweep were smoothed.

    Attributes
    ----------
    touches
        The contacts, in order.
    intensities
        (5,) spectral densities, per second: of the accelerations of base moment, axial force, arc
        length and tilt, in the rod's own units (L = EI = 1), and of the drift of the sensor's zero
        in standard deviations of a sample. Most probable values for the sweep.
    drift
        (n, 6) estimated drift of the zero of (force, moment), clamp axes, units of the reactions.
    weight
        (n,) of each sample: 1, less where it is an outlier.
    tilt
        (n,) angle [rad] by which the base moment leaves the plane square to the rod: 0 for an ideal
        rod and mount.
    model_error
        Standard deviation in rod lengths that was added on each axis.
    log_likelihood
        Logarithm of the marginal likelihood of the recording.
    """

    touches: tuple[Touch, ...]
    intensities: Float[np.ndarray, "5"]
    drift: Float[np.ndarray, "n 6"]
    weight: Float[np.ndarray, "n"]
    tilt: Float[np.ndarray, "n"]
    model_error: float
    log_likelihood: float

    @property
    def outlier(self) -> Bool[np.ndarray, "n"]:
        """(n,) samples that were given less weight."""
        return self.weight < 1
