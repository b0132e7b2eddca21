"""The random surface given contacts.

All contacts are used, but only some of them carry the unknowns: at these sites the level's value
and gradient are what the rest is predicted from, and what such a prediction leaves open counts as
noise of its own (the fully independent training conditional: Snelson & Ghahramani, NIPS 2005).
Where every contact carries unknowns, the result is exact.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.linalg.blas import dtrmm
from scipy.linalg.lapack import dpotri, dtrtri

from vibrissa.shape.kernel import (
    JET,
    Coordinates,
    Kernel,
    covariance,
    covariance_of_values,
    variances,
)
from vibrissa.shape.noise import Noise, columns_of, whitened

_JITTER = 1e-9
"""Added to the sites' covariance, relative to its diagonal: below what contacts resolve."""


class Basis(NamedTuple):
    """Sites that carry unknowns, in whitened form."""

    kernel: Kernel
    sites: Coordinates
    inverse: Float[np.ndarray, "m m"]
    """Of the lower Cholesky factor of their covariance: products with it take 0.8 of the time that
    solutions take.
    """

    @classmethod
    def of(cls, kernel: Kernel, sites: Coordinates) -> "Basis":
        """The factor, with enough jitter to exist."""
        whole = covariance(kernel, sites, sites)
        root = _root(whole, _JITTER * np.diag(whole))
        return cls(kernel, sites, dtrtri(root, lower=1, overwrite_c=1)[0])

    def jets(self, places: Coordinates) -> Float[np.ndarray, "m rows"]:
        """How value and gradient at places (4 rows each) depend on the unknowns."""
        return _times(self.inverse, covariance(self.kernel, self.sites, places))

    def values(self, places: Coordinates) -> Float[np.ndarray, "m n"]:
        """How values at places depend on the unknowns."""
        return _times(self.inverse, self.covariances(places))

    def covariances(self, places: Coordinates) -> Float[np.ndarray, "m n"]:
        """Of the sites' values and gradients with values at places."""
        return covariance_of_values(self.kernel, places, self.sites).T


def _times(factor: Float[np.ndarray, "m m"], columns: Float[np.ndarray, "m n"]) -> np.ndarray:
    """A lower triangular factor times columns, which may be overwritten."""
    return np.asarray(dtrmm(1.0, factor, columns, lower=1, overwrite_b=1))


@dataclass(frozen=True)
class Posterior:
    """Unknowns given data: mean, and the Cholesky factor of the precision; unknowns are independent
    and of unit variance before any data.
    """

    basis: Basis
    mean: Float[np.ndarray, "m"]
    root: Float[np.ndarray, "m m"]

    @cached_property
    def weights(self) -> Float[np.ndarray, "sites 4"]:
        """Of the sites in the mean."""
        return (self.mean @ self.basis.inverse).reshape(-1, JET)

    @cached_property
    def drawn(self) -> Float[np.ndarray, "sites 4"]:
        """Of the sites in the mean's derivative by the logarithm of the unknowns' variance before
        any data: how far they draw it towards zero.
        """
        return (self.solved(self.mean) @ self.basis.inverse).reshape(-1, JET)

    def solved(self, columns: Float[np.ndarray, "m *n"]) -> Float[np.ndarray, "m *n"]:
        """The inverse of the precision times columns."""
        return np.asarray(cho_solve((self.root, True), columns, check_finite=False))

    @cached_property
    def taking(self) -> Float[np.ndarray, "m m"]:
        """Lower triangular T: contacts take ‖T c‖² from the variance of a value whose covariances
        with the sites are c. With P the precision and R Rᵀ the sites' covariance, TᵀT is
        R⁻ᵀ (1 − P⁻¹) R⁻¹.
        """
        taken = -dpotri(self.root, lower=1)[0]
        taken[np.diag_indices(len(taken))] += 1
        # A lower factor S with SᵀS, not S Sᵀ: the last unknown comes first.
        turned = _root(taken.T[::-1, ::-1], np.full(len(taken), _LEFT))
        factor = np.asfortranarray(turned[::-1, ::-1].T)
        return np.asarray(dtrmm(1.0, factor, self.basis.inverse, lower=1))

    def variance(self, places: Coordinates) -> Float[np.ndarray, "n"]:
        """Of the level at places."""
        found = np.empty(len(places.value))
        # Forming the factor takes as long as about so many places do without it.
        many = len(found) > len(self.root)
        factor = self.taking if many else self.basis.inverse
        for start in range(0, len(found), _ROWS):
            rows = slice(start, start + _ROWS)
            known = _times(factor, self.basis.covariances(places.part(rows)))
            found[rows] = -np.einsum("mn,mn->n", known, known)
            if not many:
                left = solve_triangular(self.root, known, lower=True, check_finite=False)
                found[rows] += np.einsum("mn,mn->n", left, left)
        return np.maximum(found + self.basis.kernel.variance, 0.0)


_LEFT = 1e-12
"""Share of an unknown's variance that contacts take in any case, so that the factor of what they
take exists where they say nothing: deviations are off by less than a millionth of the level's.
"""


def _root(whole: Float[np.ndarray, "m m"], added: Float[np.ndarray, "m"]) -> np.ndarray:
    """Lower Cholesky factor, with that added to the diagonal, or as much more as it takes to
    exist.
    """
    diagonal = np.diag(whole).copy()
    while True:
        whole[np.diag_indices(len(whole))] = diagonal + added
        try:
            return np.asarray(cholesky(whole, lower=True, check_finite=False))
        except np.linalg.LinAlgError:
            added = 10 * added


_ROWS = 2048
"""Places at a time: some tens of MB."""


class Data(NamedTuple):
    """What contacts say (4 rows each) about the unknowns."""

    rows: Float[np.ndarray, "m rows"]
    """How value and gradient at the contacts depend on the unknowns."""
    open: Float[np.ndarray, "n 4 4"]
    """Covariance of what the unknowns leave open there."""
    target: Float[np.ndarray, "n 4"]
    """Value and gradient, less the mean's."""

    @classmethod
    def of(cls, basis: Basis, places: Coordinates, target: Float[np.ndarray, "n 4"]) -> "Data":
        """Of contacts at these places."""
        rows = basis.jets(places)
        split = rows.reshape(len(rows), -1, JET)
        told = np.einsum("mni,mnj->nij", split, split)
        values, axes = np.linalg.eigh(variances(basis.kernel, places) - told)
        rest = (axes * np.maximum(values, 0.0)[:, None]) @ np.swapaxes(axes, 1, 2)
        return cls(rows, rest, target)


class Information(NamedTuple):
    """Precision that contacts add to the unknowns' own, and its product with their mean."""

    precision: Float[np.ndarray, "m m"]
    pull: Float[np.ndarray, "m"]

    def and_that(self, other: "Information") -> "Information":
        """With that of other contacts, whose errors are independent."""
        return Information(self.precision + other.precision, self.pull + other.pull)

    def posterior(self, basis: Basis) -> Posterior:
        """Unknowns given it."""
        precision = np.eye(len(self.pull)) + self.precision
        root = cholesky(precision, lower=True, overwrite_a=True, check_finite=False)
        half = solve_triangular(root, self.pull, lower=True, check_finite=False)
        return Posterior(basis, solve_triangular(root, half, lower=True, trans=1), root)


def information(data: Data, noise: Noise) -> Information:
    """What the contacts in the noise's groups tell."""
    scaled, wanted = [np.zeros((0, len(data.rows)))], [np.zeros(0)]
    for rows in noise.groups:
        root = cholesky(noise.among(rows, data.open[rows]), lower=True, check_finite=False)
        told = np.column_stack([data.rows[:, columns_of(rows)].T, data.target[rows].ravel()])
        told = solve_triangular(root, told, lower=True, check_finite=False)
        scaled.append(told[:, :-1])
        wanted.append(told[:, -1])
    whole = np.concatenate(scaled)
    return Information(whole.T @ whole, np.concatenate(wanted) @ whole)


LeftOut = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Of a sweep, as `left_out` gives it."""


def left_out(known: Posterior, data: Data, noise: Noise) -> list[LeftOut]:
    """For each sweep, or part of a long one: its values less their prediction from all others, the
    covariance of that prediction, and of the errors.

    With K the covariance of all data, the prediction's error is ([K⁻¹]ₛₛ)⁻¹ [K⁻¹ y]ₛ and its
    covariance ([K⁻¹]ₛₛ)⁻¹ (Rasmussen & Williams, section 5.4.2, for groups).
    """
    told = []
    off = data.target.ravel() - known.mean @ data.rows
    left = solve_triangular(known.root, data.rows, lower=True, check_finite=False)
    for rows in noise.groups:
        columns = columns_of(rows)
        whole = noise.among(rows, data.open[rows])
        residual, here = off[columns], left[:, columns]
        # What these rows themselves told is taken off: (R − V)⁻¹ with V the posterior covariance.
        inside = here.T @ here
        rest = whitened(whole - inside, np.column_stack([residual, inside[:, ::JET]]))
        found = whole[::JET] @ rest
        told.append((found[:, 0], found[:, 1:], whole[::JET, ::JET]))
    return told
