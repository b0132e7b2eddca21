"""What a reconstruction returns."""

import math
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.brief import counts
from vibrissa.contacts import ContactKind, Contacts, Status
from vibrissa.inverse.arrays import Codes, Covariances, Flags, Scalars, Vectors
from vibrissa.inverse.checks.findings import SetupCheck
from vibrissa.inverse.parameters import prepared
from vibrissa.mechanics.shape import Held, elastic_lines
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod

if TYPE_CHECKING:
    import xarray

    from vibrissa.inverse.candidates import Candidates
    from vibrissa.inverse.friction import FrictionEstimate
    from vibrissa.inverse.smoothing.result import Smoothing


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction:
    """Contacts found from support reactions alone, one row per sample (…), in units of the rod,
    world axes.

    Attributes
    ----------
    rod, reactions
        What was given.
    kind
        (…) values of `ContactKind`; TIP if the arc length is that of the rod within two standard
        deviations or, if the noise is unknown, within 1e-6 L.
    point
        (…, 3); NaN without contact.
    force_direction
        (…, 3) unit vector of the contact force on the rod.
    arc_length
        s₁ (…).
    energy
        Bending energy (…).
    modulus
        Incidence (…): (1 + t·d)/2 with t the rod's tangent at the contact and d the force
        direction; ½ if the rod is tangent to the object without friction. For the uniform straight
        rod it is k² of the elliptic integrals.
    covariance, normal_covariance
        (…, 3, 3) of point and force direction: sample-to-sample errors, to first order, or by
        second moments if the force is weak or the rod thin there, plus errors shared by the whole
        sweep; None if the noise is unknown.
    covariance_noise, normal_covariance_noise
        (…, 3, 3) of what varies from sample to sample: noise of the wrench and of the pose.
    cross_covariance
        (…, 3, 3) of point (rows) with force direction (columns), once smoothed; else None.
    arc_length_deviation
        Standard deviation (…) of s₁, or None.
    chi_square
        (…) of the wrench as noise alone, with six degrees of freedom, or None.
    single_contact_residual
        (…): violation of m0·f0 = 0, in standard deviations if the noise is known, else relative to
        ‖m0‖ ‖f0‖; also in rows without contact.
    status
        (…) values of `Status`.
    friction
        Coulomb friction coefficient as given, or estimated: 0 for none, None if unknown. Whatever
        uses the contacts, such as `smooth`, relies on it.
    smoothing
        What `smooth` reports besides the contacts, one entry per trail; None for samples solved one
        by one.
    sensitivity
        (…, 6, 15) derivatives of point and normal with respect to `vibrissa.tolerances.PARAMETERS`
        for given readings, lengths in rod lengths, where they differ from those of single samples;
        else None.
    warnings
        What in the data contradicts rod, clamp, sensor or clock as stated, one line each, likeliest
        cause first.
    setup_check
        What the contacts say about the setup, cause by cause; None if not checked.
    estimated_normal
        (…, 3) normals of the object from `estimate_friction`, if `with_friction` was given one.
    """

    rod: Rod
    reactions: Reactions
    kind: Codes
    point: Vectors
    force_direction: Vectors
    arc_length: Scalars
    energy: Scalars
    modulus: Scalars
    covariance: Covariances | None
    normal_covariance: Covariances | None
    arc_length_deviation: Scalars | None
    chi_square: Scalars | None
    single_contact_residual: Scalars
    status: Codes
    friction: float | None = None
    smoothing: "tuple[Smoothing, ...] | None" = None
    covariance_noise: Covariances | None = None
    normal_covariance_noise: Covariances | None = None
    cross_covariance: Covariances | None = None
    sensitivity: Float[np.ndarray, "*trail n 6 setup"] | None = None
    warnings: list[str] = field(default_factory=list)
    setup_check: SetupCheck | None = None
    estimated_normal: Vectors | None = None

    @property
    def contacts(self) -> Contacts:
        """Where the rod touches, one row per sample (…)."""
        return Contacts.of(self, self.reactions.time)

    @property
    def normal(self) -> Vectors:
        """(…, 3) outward unit normal of the object, as far as it is known.

        The force direction, which is the normal without friction and within atan μ of it otherwise,
        or the estimated normal if there is one.
        """
        if self.estimated_normal is None:
            return self.force_direction
        known = np.isfinite(self.estimated_normal)
        return np.where(known, self.estimated_normal, self.force_direction)

    def with_friction(self, estimate: "FrictionEstimate") -> "Reconstruction":
        """Return the same contacts with the friction and the object's normals from an estimate."""
        return replace(self, friction=estimate.friction, estimated_normal=estimate.normal)

    def __getitem__(self, rows: "int | slice | Bool[np.ndarray, 'n']") -> "Reconstruction":
        """Return one trail of several, or some rows of one trail: all fields together."""
        taken = {name: value[rows] for name, value in rows_of(self).items()}
        return replace(self, reactions=self.reactions[rows], **taken)

    @property
    def trails(self) -> list["Reconstruction"]:
        """Contacts (n, …) of each trail; for a single trail, just these."""
        return [self] if self.kind.ndim == 1 else [self[j] for j in range(len(self.kind))]

    def __repr__(self) -> str:
        """Return five lines: rows, kinds, statuses, noise and warnings."""
        return (
            f"Reconstruction of {self.kind.size} samples {self.kind.shape}, "
            f"{'sample by sample' if self.smoothing is None else 'smoothed'}\n"
            f"  kind: {counts(self.kind, ContactKind)}\n"
            f"  status: {counts(self.status, Status)}\n"
            f"  friction: {self.friction}, noise: {'un' * (self.covariance is None)}known\n"
            f"  warnings: {len(self.warnings)}"
        )

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
                "friction = None: a bound on the object's normal needs the coefficient of "
                "friction; give it to `reconstruct`, or estimate it"
            )
        return math.atan(self.friction)

    @property
    def shared_names(self) -> tuple[str, ...]:
        """Names of the parameters (p) in the columns of `shared`: those of
        `vibrissa.tolerances.PARAMETERS` for which the setup states a tolerance.
        """
        errors = self.reactions.setup_errors
        return () if errors is None or self.covariance is None else errors.names

    @property
    def shared(self) -> Float[np.ndarray, "*trail n 3 p"]:
        """Errors of points shared by the whole sweep, in units of the rod: `covariance` =
        `covariance_noise` + `shared` `shared`ᵀ.

        Each column is what one standard deviation of its parameter does to all points together; if
        a calibration found correlated parameters, what those before it leave open
        (`vibrissa.tolerances.SetupErrors.names`). NaN without contact; no columns if no tolerances
        are stated.
        """
        return self._shared[..., :3, :] * self.rod.length

    @property
    def shared_normal(self) -> Float[np.ndarray, "*trail n 3 p"]:
        """The same errors for normals."""
        return self._shared[..., 3:, :]

    @cached_property
    def _shared(self) -> Float[np.ndarray, "*trail n 6 p"]:
        """For points in rod lengths, and for normals."""
        from vibrissa.inverse.shared import sensitivities  # noqa: PLC0415

        if not self.shared_names:
            return np.zeros((*self.kind.shape, 6, 0))
        return sensitivities(self) @ prepared(self.rod, self.reactions.setup_errors).factor

    @cached_property
    def candidates(self) -> "list[Candidates]":
        """All contacts that explain the reactions, of each row that is `NOT_UNIQUE` because the rod
        is curved.
        """
        from vibrissa.inverse.candidates import candidates  # noqa: PLC0415

        return candidates(self)

    @property
    def in_contact(self) -> Flags:
        """Whether a contact was found (…)."""
        return self.kind != ContactKind.NONE

    def elastic_line(
        self, index: "int | tuple[int, int]", count: int = 200
    ) -> Float[np.ndarray, "count 3"]:
        """The rod's shape at a sample: `count` points equally spaced in arc length from clamp to
        tip; the free rod without contact, NaN where the reactions are not those of a bent rod.

        Raises
        ------
        ValueError
            If `count` is less than 2, or `index` does not name one sample.
        """
        if self.reactions.trail.position[index].ndim != 1:
            raise ValueError(
                f"index = {index}; allowed is (trail, i), as the reactions hold several trails"
            )
        return self.elastic_lines(index, count)[0]

    def elastic_lines(self, rows: Any, count: int = 200) -> Float[np.ndarray, "k count 3"]:
        """The rod's shapes at some rows, as `elastic_line`, chosen by index, slice or mask, one
        after another. Many at once take less time.

        Raises
        ------
        ValueError
            If `count` is less than 2.
        """
        contact = self.in_contact, self.point, self.force_direction, self.arc_length
        held = Held(self.reactions, *contact, self.modulus)
        return elastic_lines(self.rod, held, rows, count)

    def to_dataset(self) -> "xarray.Dataset":
        """All fields as an `xarray.Dataset` with CF-style units and flag meanings."""
        from vibrissa.inverse.dataset import reconstruction_dataset  # noqa: PLC0415

        return reconstruction_dataset(self)


def rows_of(found: Reconstruction) -> dict[str, Any]:
    """Fields of a reconstruction that hold one entry per sample."""
    given = {each.name: getattr(found, each.name) for each in fields(found)}
    return {name: value for name, value in given.items() if isinstance(value, np.ndarray)}
