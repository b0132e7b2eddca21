"""How far contacts are off, as errors of a level function's value and gradient there.

A contact at p = x + e with normal n + η, where x lies on the surface, says f(p) = 0 and
∇f(p) = n + η, with errors −n·e and η − H e: a point off along a curved surface carries the normal
of another place (H is the second derivative of f). It also lies in front of a convex surface: to
second order f(p) has the mean ½ tr(H Σ) and the further variance ½ tr((H Σ)²), Σ the covariance of
e. An edge of 3 mm and an error of 0.5 mm along the rod make 0.04 mm. Where the normal tells e,
value and gradient are told at p less that, and Σ is what is left of it. Errors of neighbours in a
sweep are alike, as a smoother uses the same samples for both: their correlation falls as
exp(−|i − j|/τ), except for a share that belongs to the whole sweep, as errors of the tare do.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import cho_factor, cho_solve

from vibrissa.shape.kernel import JET
from vibrissa.shape.sites import Sites

_SHARED = 0.1
"""Share of the variance that all of a sweep have in common: autocorrelation of smoothed contacts'
errors after 24 to 32 samples, measured on a torus, an ellipsoid and a blob (0 to 0.15).
"""
_ALONE = 0.02
"""Share that no two contacts have in common: rounding, and what the exponential leaves out."""
_UNIT = 0.02
"""Deviation of a gradient's length from 1: the level is a distance only to first order."""
_FLOOR = 1e-7, 1e-3
"""Least deviations of a value, relative to the extent, and of a gradient: kernel matrices of exact
contacts stay invertible.
"""
_DOUBT = 1.5
"""What starts and ends of sweeps add to the factor of deviations, relative to those between. There
the smoother knows least of the phase, and rows whose squared residual is above 16 are six to ten
times as many (block, torus). With 0.5, surfaces of a ball from unsmoothed contacts were up to twice
as far off.
"""
_MOST = 150
"""Contacts of a sweep whose correlation is kept: their matrices have four rows each."""


class Noise(NamedTuple):
    """Errors of sites: factors (n, 4, 7) whose products are the covariances, those of their points
    (n, 3, 7), additional independent ones (n, 4, 4), and correlation from site to site.
    """

    factor: Float[np.ndarray, "n 4 7"]
    point: Float[np.ndarray, "n 3 7"]
    alone: Float[np.ndarray, "n 4 4"]
    order: Float[np.ndarray, "n"]
    groups: list[Int[np.ndarray, "k"]]
    reach: float
    """Contacts over which the correlation falls to 1/e."""

    @classmethod
    def of(
        cls,
        sites: Sites,
        curvature: Float[np.ndarray, "n 3 3"],
        weight: Float[np.ndarray, "n"],
        reach: float,
        extent: float,
        doubt: float = _DOUBT,
        left: Float[np.ndarray, "n 3 3"] | None = None,
    ) -> "Noise":
        """Errors, where surfaces are curved so and single contacts count less than fully; of their
        points, the covariance `left` is not known yet, by default all.
        """
        left = sites.covariance[:, :3, :3] if left is None else left
        scale = _ends(sites, reach, doubt) ** 2 * sites.alike / weight
        root = np.sqrt(scale)[:, None, None]
        factor, point, alone = _errors(sites.normal, sites.covariance, left, curvature, extent)
        groups = _chunks(sites)
        return cls(factor * root, point * root, alone * root**2, sites.order, groups, reach)

    @staticmethod
    def errors(
        normal: Float[np.ndarray, "n 3"],
        covariance: Float[np.ndarray, "n 6 6"],
        curvature: Float[np.ndarray, "n 3 3"],
        extent: float,
    ) -> Float[np.ndarray, "n 4 4"]:
        """Covariance of single contacts, as stated."""
        left = covariance[:, :3, :3]
        factor, _, alone = _errors(normal, covariance, left, curvature, extent)
        return factor @ np.swapaxes(factor, 1, 2) + alone

    @property
    def own(self) -> Float[np.ndarray, "n 4 4"]:
        """Covariance of each site by itself."""
        return self.factor @ np.swapaxes(self.factor, 1, 2) + self.alone

    def of_points(
        self, residual: Float[np.ndarray, "n 4"], open_: Float[np.ndarray, "n 4 4"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
        """Errors of the points that residuals tell, each by itself, and the covariance that is
        left of them; what the surface leaves open is added to each.
        """
        shared = self.point @ np.swapaxes(self.factor, 1, 2)
        told = shared @ np.linalg.inv(self.own + open_)
        left = self.point @ np.swapaxes(self.point, 1, 2) - told @ np.swapaxes(shared, 1, 2)
        return np.einsum("nij,nj->ni", told, residual), left

    def among(
        self, rows: Int[np.ndarray, "k"], added: Float[np.ndarray, "k 4 4"] | None = None
    ) -> Float[np.ndarray, "rows rows"]:
        """Covariance (4 k, 4 k) of some sites of a sweep, with what is added to each alone."""
        apart = np.abs(self.order[rows][:, None] - self.order[rows][None])
        alike = _SHARED + (1 - _SHARED - _ALONE) * np.exp(-apart / self.reach)
        np.fill_diagonal(alike, 1.0)
        flat = self.factor[rows].reshape(JET * len(rows), -1)
        whole = (flat @ flat.T).reshape(len(rows), JET, len(rows), JET) * alike[:, None, :, None]
        each = np.arange(len(rows))
        whole[each, :, each, :] += self.alone[rows] + (0 if added is None else added)
        return whole.reshape(JET * len(rows), -1)


def _errors(
    normal: Float[np.ndarray, "n 3"],
    covariance: Float[np.ndarray, "n 6 6"],
    left: Float[np.ndarray, "n 3 3"],
    curvature: Float[np.ndarray, "n 3 3"],
    extent: float,
) -> tuple[Float[np.ndarray, "n 4 7"], Float[np.ndarray, "n 3 7"], Float[np.ndarray, "n 4 4"]]:
    """Factors of the errors and of the points', and what is added. Joint covariances whose parts
    were approximated separately may be indefinite; the nearest that is not counts.
    """
    rows = np.zeros((len(normal), JET, 6))
    rows[:, 0, :3], rows[:, 1:, :3], rows[:, 1:, 3:] = -normal, -curvature, np.eye(3)
    bent = curvature @ left
    second = np.zeros((len(normal), JET, 1))
    second[:, 0, 0] = np.sqrt(np.maximum(0.5 * np.einsum("nij,nji->n", bent, bent), 0))
    # The symmetric root, so that errors of neighbours go the same way; of points relative to the
    # extent, so that units do not matter.
    unit = np.repeat([extent, 1.0], 3)
    values, axes = np.linalg.eigh(covariance / np.outer(unit, unit))
    root = (axes * np.sqrt(np.maximum(values, 0))[:, None]) @ np.swapaxes(axes, 1, 2)
    alone = np.zeros((len(normal), JET, JET))
    alone[:, 1:, 1:] = _UNIT**2 * normal[:, :, None] * normal[:, None]
    least = np.diag([(_FLOOR[0] * extent) ** 2, *[_FLOOR[1] ** 2] * 3])
    root *= unit[:, None]
    point = np.concatenate([root[:, :3], np.zeros_like(second[:, :3])], axis=2)
    return np.concatenate([rows @ root, second], axis=2), point, alone + least


def lifted(
    covariance: Float[np.ndarray, "n k k"], curvature: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "n"]:
    """How far contacts lie in front of a curved surface on average, as they are off along it, by
    the covariance of their points, or of points and normals.
    """
    return 0.5 * np.einsum("nij,nji->n", curvature, covariance[:, :3, :3])


def _ends(sites: Sites, reach: float, doubt: float) -> Float[np.ndarray, "n"]:
    """Factor of the deviations: larger at starts and ends of sweeps."""
    factor = np.ones(len(sites.order))
    for rows in _sweeps(sites):
        if len(rows) == 1:  # contacts that belong to no sweep, or pools of several
            continue
        order = sites.order[rows]
        factor[rows] += doubt * np.exp(-np.minimum(order - order[0], order[-1] - order) / reach)
    return factor


def _sweeps(sites: Sites) -> list[Int[np.ndarray, "k"]]:
    """Sites of each sweep in order."""
    found = []
    for sweep in np.unique(sites.sweep):
        rows = np.flatnonzero(sites.sweep == sweep)
        found.append(rows[np.argsort(sites.order[rows])])
    return found


def _chunks(sites: Sites) -> list[Int[np.ndarray, "k"]]:
    """Sites of each sweep in order, long sweeps in parts."""
    return [
        part for rows in _sweeps(sites) for part in np.array_split(rows, -(-len(rows) // _MOST))
    ]


def columns_of(rows: Int[np.ndarray, "k"]) -> Int[np.ndarray, "columns"]:
    """Where value and gradient at some sites stand among those at all."""
    return (JET * rows[:, None] + np.arange(JET)).ravel()


def whitened(whole: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """The inverse of a covariance times columns."""
    return cho_solve(cho_factor(whole, lower=True, check_finite=False), columns, check_finite=False)


def squared(
    residual: Float[np.ndarray, "n 4"], own: Float[np.ndarray, "n 4 4"]
) -> Float[np.ndarray, "n"]:
    """Squared residuals in their errors."""
    return np.einsum("ni,ni->n", residual, np.linalg.solve(own, residual[..., None])[..., 0])


def reach_of(
    sites: Sites, residual: Float[np.ndarray, "n 4"], own: Float[np.ndarray, "n 4 4"]
) -> float:
    """Contacts over which errors stay alike: that of the exponential which is closest to the
    autocorrelation of residuals within sweeps.
    """
    order = np.lexsort((sites.order, sites.sweep))
    place, sweep = sites.order[order], sites.sweep[order]
    scaled = np.linalg.solve(np.linalg.cholesky(own), residual[..., None])[order, :, 0]
    scaled = np.clip(scaled, -_CLIPPED, _CLIPPED)
    apart, alike = [], []
    for lag in range(1, _LAGS + 1):
        same = sweep[lag:] == sweep[:-lag]
        if np.any(same):
            after, before = scaled[lag:][same], scaled[:-lag][same]
            apart.append(np.median((place[lag:] - place[:-lag])[same]))
            alike.append(2 * np.sum(after * before) / np.sum(after**2 + before**2))
    if not apart:
        return 1.0
    reaches = np.geomspace(0.2, 20, 60) * apart[0]
    expected = _SHARED + (1 - _SHARED - _ALONE) * np.exp(-np.divide.outer(apart, reaches).T)
    return float(reaches[np.argmin(np.sum((expected - alike) ** 2, axis=1))])


_LAGS = 6
"""Neighbours whose residuals are compared."""
_CLIPPED = 3.0
"""Deviations beyond which a residual counts no more: an outlier is alike to none."""
