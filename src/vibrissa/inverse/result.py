"""What a reconstruction returns."""

import math
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.contacts import ContactKind
from vibrissa.mechanics.elastic_line import sampled_line
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.trail import Trail

if TYPE_CHECKING:
    import xarray

    from vibrissa.inverse.checks.findings import SetupCheck
    from vibrissa.inverse.smoothing.result import Smoothing


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Contacts found from support reactions alone, one row a sample (…), in units of the rod, world
    axes.

    Attributes
    ----------
    rod, reactions
        What was given.
    kind
        (…) values of `ContactKind`; TIP where the arc length is that of the rod, within two of its
        standard deviations or, where the noise is not known, within 1e-6 L.
    point
        (…, 3); NaN without contact.
    normal
        (…, 3) unit vector of the contact force on the rod: the outward normal of the object where
        there is no friction, else within atan μ of it.
    arc_length
        s₁ (…).
    energy
        Bending energy (…).
    modulus
        k² (…) of the elliptic integrals; ½ where the rod is tangent to the object and there is no
        friction.
    covariance, normal_covariance
        (…, 3, 3) of point and normal: from sample to sample, to first order, and by second moments
        where the force is weak, and of what the whole sweep shares; None where the noise is not
        known.
    covariance_noise, normal_covariance_noise
        (…, 3, 3) of what varies from sample to sample: noise of the wrench and the clamp point's.
    arc_length_deviation
        Standard deviation (…) of s₁, or None.
    chi_square
        (…) of the wrench being noise alone, with six degrees of freedom, or None.
    single_contact_residual
        (…): violation of m0·f0 = 0, in standard deviations where the noise is known, else relative
        to ‖m0‖ ‖f0‖; also on rows without contact.
    status
        (…) values of `Status`.
    friction
        Coulomb's coefficient that was given, or None.
    smoothing
        What `smooth` says beside the contacts, one entry a trail; None for samples taken one by
        one.
    sensitivity
        (…, 6, 15) derivatives of point and normal by `vibrissa.tolerances.PARAMETERS` for given
        readings, lengths in units of the rod's, where not those of single samples; else None.
    warnings
        What in the data contradicts rod, clamp, sensor or clock as stated, one line each, the
        likeliest cause first.
    setup_check
        What the contacts say of the setup, cause by cause; None where they were not asked.
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
    covariance_noise: Float[np.ndarray, "*trail n 3 3"] | None = None
    normal_covariance_noise: Float[np.ndarray, "*trail n 3 3"] | None = None
    sensitivity: Float[np.ndarray, "*trail n 6 15"] | None = None
    warnings: list[str] = field(default_factory=list)
    setup_check: "SetupCheck | None" = None

    def __post_init__(self) -> None:
        for whole, noise in (
            ("covariance", "covariance_noise"),
            ("normal_covariance", "normal_covariance_noise"),
        ):
            if getattr(self, noise) is None:
                object.__setattr__(self, noise, getattr(self, whole))

    @property
    def normal_half_angle(self) -> float:
        """Half-angle atan μ [rad] of the cone around `normal` in which the object's normal lies; 0
        without friction.

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
    def shared_names(self) -> tuple[str, ...]:
        """Parameters (p) to which the columns of `shared` belong: those of
        `vibrissa.tolerances.PARAMETERS` for which the setup states a tolerance.
        """
        errors = self.reactions.setup_errors
        return () if errors is None or self.covariance is None else errors.names

    @property
    def shared(self) -> Float[np.ndarray, "*trail n 3 p"]:
        """Errors of points that a whole sweep shares, in units of the rod: `covariance` =
        `covariance_noise` + `shared` `shared`ᵀ.

        Each column is what one standard deviation of its parameter does to all points together;
        where a calibration found parameters that go with one another, of what those before leave
        open (`vibrissa.tolerances.SetupErrors.names`). NaN without contact; no columns where no
        tolerances are stated.
        """
        return self._shared[..., :3, :] * self.rod.length

    @property
    def shared_normal(self) -> Float[np.ndarray, "*trail n 3 p"]:
        """The same errors of normals."""
        return self._shared[..., 3:, :]

    @cached_property
    def _shared(self) -> Float[np.ndarray, "*trail n 6 p"]:
        from vibrissa.inverse.shared import shared_of  # noqa: PLC0415

        return shared_of(self)

    @property
    def in_contact(self) -> Bool[np.ndarray, "*trail n"]:
        """Whether a contact was found (…)."""
        return self.kind != ContactKind.NONE

    def elastic_line(
        self, index: "int | tuple[int, int]", count: int = 200
    ) -> Float[np.ndarray, "count 3"]:
        """The rod's shape at a sample: `count` points equally spaced in arc length from clamp to
        tip; straight without contact.

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
            raise ValueError(
                f"index = {index}; allowed is (trail, i), as the reactions hold several trails"
            )
        if self.kind[index] == ContactKind.NONE:
            return sampled_line(clamp, axis, length, length * axis, axis, 0.0, 1.0, count)
        # The force that goes with the point and the arc length, which noise and the limit at the
        # tip may have moved from the measured one.
        reach, n = (self.point[index] - clamp) / length, self.normal[index]
        lever_arm = np.linalg.norm(reach - (reach @ n) * n)
        force = 4 * (self.modulus[index] - (1 + n @ axis) / 2) / lever_arm**2
        return sampled_line(
            clamp,
            axis,
            length,
            reach,
            n,
            float(force),
            float(self.arc_length[index]) / length,
            count,
        )

    def to_dataset(self) -> "xarray.Dataset":
        """All fields as an `xarray.Dataset` with CF-style units and flag meanings."""
        from vibrissa.inverse.dataset import reconstruction_dataset  # noqa: PLC0415

        return reconstruction_dataset(self)


def trail_of(found: Reconstruction, j: int) -> Reconstruction:
    """One of several trails (m, n, …): its rows (n, …)."""
    shape, given = found.kind.shape, found.reactions
    rows: dict[str, Any] = {
        field.name: value[j]
        for field in fields(found)
        if isinstance(value := getattr(found, field.name), np.ndarray)
        and value.shape[: len(shape)] == shape
    }
    own: dict[str, Any] = {
        field.name: value[j]
        for field in fields(given)
        if isinstance(value := getattr(given, field.name), np.ndarray)
        and value.shape[: len(shape)] == shape
    }
    trail = Trail(given.trail.position[j], given.trail.orientation[j])
    return replace(found, reactions=replace(given, trail=trail, **own), **rows)
