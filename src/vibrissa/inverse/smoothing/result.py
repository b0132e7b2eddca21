"""Results of smoothing: about a sweep, besides its contacts, and for each sample as it comes."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.brief import brief
from vibrissa.contacts import ContactKind, Contacts, Status

Numbers = Float[np.ndarray, "*rows"] | float
Vectors = Float[np.ndarray, "*rows 3"]
Matrices = Float[np.ndarray, "*rows 3 3"]


@dataclass(frozen=True)
class Touch:
    """One contact of a sweep, from start to end.

    Attributes
    ----------
    first, last
        First and last sample of the contact.
    start, end
        Time [s] at which it began and ended; None where the recording begins or ends in contact.
    start_deviation, end_deviation
        Their standard deviations [s], from the likelihood.
    start_limit, end_limit
        The least that the noise allows [s] (Cramér-Rao; mechanics.md, "Where a contact begins").
    changes
        Samples at which the phase (tip, tangential) changes: the first of each new phase.
    jumps
        Samples at which the contact jumped, or its motion broke: nothing is smoothed across them.
    change_deviations
        Standard deviations [s] of the times of the changes of phase, from the likelihood. Points
        and covariances near a change are averaged over where it may be.
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
        (n,) of each sample: 1, or less for outliers.
    tilt
        (n,) angle [rad] by which the base moment leaves the plane perpendicular to the rod: 0 for
        an ideal rod and mounting.
    model_error
        Standard deviation in rod lengths that was added on each axis.
    log_likelihood
        Logarithm of the marginal likelihood of the recording.
    branch_probability
        (n,) that of the contacts which explain a sample's reactions (`Reconstruction.candidates`)
        the one followed is the true one, given the whole touch: 1 where there is no other. Rows
        below 0.95 stay `NOT_UNIQUE`, as those of a touch before the tip do if all its rows have
        several.
    """

    touches: tuple[Touch, ...]
    intensities: Float[np.ndarray, "5"]
    drift: Float[np.ndarray, "n 6"]
    weight: Float[np.ndarray, "n"]
    tilt: Float[np.ndarray, "n"]
    model_error: float
    log_likelihood: float
    branch_probability: Float[np.ndarray, "n"]

    __repr__ = brief

    @property
    def outlier(self) -> Bool[np.ndarray, "n"]:
        """(n,) samples that were down-weighted."""
        return self.weight < 1


@dataclass(frozen=True, eq=False)
class LiveContact:
    """Contacts of one sample, or of several in a row (…), each given the samples so far; several
    can be indexed and iterated over. World axes, units of the rod.

    Attributes
    ----------
    time
        (…) [s].
    kind
        (…) values of `ContactKind`; NONE without contact.
    point, force_direction
        (…, 3) contact point and unit vector of the contact force on the rod; NaN without contact.
    arc_length, modulus
        (…) s₁ and k².
    covariance, normal_covariance
        (…, 3, 3): from sample to sample, plus what the whole sweep shares.
    covariance_noise, normal_covariance_noise
        (…, 3, 3): from sample to sample only.
    cross_covariance
        (…, 3, 3) of point (rows) with force direction (columns).
    sensitivity
        (…, 6, 15): as in `Reconstruction`.
    probability
        (…) of contact, among the hypotheses.
    status
        (…) values of `Status`: BAD_DATA if the sample is not finite; the contact is then predicted
        from the samples before.
    """

    time: Numbers
    kind: Int[np.ndarray, "*rows"] | ContactKind
    point: Vectors
    force_direction: Vectors
    arc_length: Numbers
    modulus: Numbers
    covariance: Matrices
    normal_covariance: Matrices
    covariance_noise: Matrices
    normal_covariance_noise: Matrices
    cross_covariance: Matrices
    sensitivity: Float[np.ndarray, "*rows 6 15"]
    probability: Numbers
    status: Int[np.ndarray, "*rows"] | Status

    __repr__ = brief

    @property
    def normal(self) -> Vectors:
        """(…, 3) outward unit normal of the object as far as it is known: the force direction,
        within atan μ of it where there is friction.
        """
        return self.force_direction

    @property
    def contacts(self) -> Contacts:
        """The same contacts in the form that scans and reconstructions return."""
        return Contacts.of(self, self.time)

    def __getitem__(self, rows: Any) -> "LiveContact":
        """Return one sample's contact, or some."""
        parts = {field.name: getattr(self, field.name)[rows] for field in fields(self)}
        if parts["kind"].ndim == 0:
            parts |= {"kind": ContactKind(parts["kind"]), "status": Status(parts["status"])}
        return LiveContact(**parts)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.point)
