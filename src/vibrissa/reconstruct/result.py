"""What a reconstruction returns."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.contacts import ContactKind
from vibrissa.mechanics.elastic_line import sampled_line
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod

if TYPE_CHECKING:
    import xarray

    from vibrissa.reconstruct.smoothing.result import Smoothing


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Contacts found from support reactions alone, one row a sample (…), in units of the rod, world axes.

    Attributes
    ----------
    rod, reactions
        What was given.
    kind
        (…) values of `ContactKind`; TIP where the arc length is that of the rod, within two of its standard deviations or, where
        the noise is not known, within 1e-6 L.
    point
        (…, 3); NaN without contact.
    normal
        (…, 3) unit vector of the contact force on the rod: the outward normal of the object where there is no friction, else within atan μ of it.
    arc_length
        s₁ (…).
    energy
        Bending energy (…).
    modulus
        k² (…) of the elliptic integrals; ½ where the rod is tangent to the object and there is no friction.
    covariance, normal_covariance
        (…, 3, 3) of point and normal, carried linearly from the wrench's and the clamp point's; None where the noise is not known.
    arc_length_deviation
        Standard deviation (…) of s₁, or None.
    chi_square
        (…) of the wrench being noise alone, with six degrees of freedom, or None.
    single_contact_residual
        (…): violation of m0·f0 = 0, in standard deviations where the noise is known, else relative to ‖m0‖ ‖f0‖; also on rows
        without contact.
    status
        (…) values of `Status`.
    friction
        Coulomb's coefficient that was given, or None.
    smoothing
        What `smooth` says beside the contacts, one entry a trail; None for samples taken one by one.
    """

    rod: Rod
    reactions: Reactions
    kind: Int[np.ndarray, "*trail n"]
    point: Float[np.ndarray, "*trail n 3"]
    normal: Float[np.ndarray, "*trail n 3"]
    arc_length: Float[np.ndarray, "*trail n"]
    energy: Float[np.ndarray, "*trail n"]
    modulus: Float[np.ndarray, "*trail n"]
    covariance: Float[np.ndarray, "*trail n 3 3"] | None
    normal_covariance: Float[np.ndarray, "*trail n 3 3"] | None
    arc_length_deviation: Float[np.ndarray, "*trail n"] | None
    chi_square: Float[np.ndarray, "*trail n"] | None
    single_contact_residual: Float[np.ndarray, "*trail n"]
    status: Int[np.ndarray, "*trail n"]
    friction: float | None = None
    smoothing: "tuple[Smoothing, ...] | None" = None

    @property
    def normal_half_angle(self) -> float:
        """Half-angle atan μ [rad] of the cone around `normal` in which the object's normal lies; 0 without friction.

        Raises
        ------
        ValueError
            If the coefficient of friction is not known.
        """
        if self.friction is None:
            raise ValueError(
                "friction = None: a bound on the object's normal needs the coefficient of friction; give it to `reconstruct`, or estimate it"
            )
        return math.atan(self.friction)

    @property
    def in_contact(self) -> Bool[np.ndarray, "*trail n"]:
        """Whether a contact was found (…)."""
        return self.kind != ContactKind.NONE

    def elastic_line(self, index: "int | tuple[int, int]", count: int = 200) -> Float[np.ndarray, "count 3"]:
        """The rod's shape at a sample: `count` points equally spaced in arc length from clamp to tip; straight without contact.

        Raises
        ------
        ValueError
            If `count` is less than 2, or `index` does not name one sample.
        """
        if count < 2:
            raise ValueError(f"count = {count}; allowed is at least 2")
        trail, length = self.reactions.trail, self.rod.length
        clamp, axis = trail.position[index], trail.axis[index]
        if clamp.ndim != 1:
            raise ValueError(f"index = {index}; allowed is (trail, i), as the reactions hold several trails")
        if self.kind[index] == ContactKind.NONE:
            return sampled_line(clamp, axis, length, length * axis, axis, 0.0, 1.0, count)
        # The force that goes with the point and the arc length, which noise and the limit at the tip may have moved from the measured one.
        reach, n = (self.point[index] - clamp) / length, self.normal[index]
        lever_arm = np.linalg.norm(reach - (reach @ n) * n)
        force = 4 * (self.modulus[index] - (1 + n @ axis) / 2) / lever_arm**2
        return sampled_line(clamp, axis, length, reach, n, float(force), float(self.arc_length[index]) / length, count)

    def to_dataset(self) -> "xarray.Dataset":
        """All fields as an `xarray.Dataset` with CF-style units and flag meanings."""
        from vibrissa.reconstruct.dataset import reconstruction_dataset  # noqa: PLC0415

        return reconstruction_dataset(self)
