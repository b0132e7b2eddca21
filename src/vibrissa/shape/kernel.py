"""Covariances of a random surface: of its level, and of the level's gradient.

The level f is a Gaussian process with Matérn covariances of smoothness 5/2, so that it is twice
differentiable: k(r) = σ² (1 + t + t²/3) exp(−t), t = √5 r/ℓ (Rasmussen & Williams, *Gaussian
Processes for Machine Learning*, 2006, eq. 4.17). Distances r are taken between coordinates z(x):
the places themselves, or places together with the direction of the surface there, so that the two
faces of an edge are far apart while places along the edge stay near. Derivatives follow by the
chain rule with the slope J = ∂z/∂x:

∂k/∂x = −b Jᵀd, ∂²k/∂x∂y = b JᵀJ' − c (Jᵀd)(J'ᵀd)ᵀ, d = z − z', b = −k'/r, c = −b'/r.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

Points = Float[np.ndarray, "n 3"]
Values = Float[np.ndarray, "n"]
_ROOT = np.sqrt(5.0)
_BLOCK = 2**21
"""Pairs of places evaluated at a time: some tens of MB."""
JET = 4
"""Value and gradient."""
_TINY = 1e-30
"""Least squared distance that is divided by; what it divides vanishes there."""


class Matern(NamedTuple):
    """Standard deviation σ of the level, and the length ℓ over which it changes."""

    deviation: float
    length: float

    def slopes(self, squared: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """k, b and c at squared distances."""
        rate = _ROOT / self.length
        t = rate * np.sqrt(squared)
        fade = self.deviation**2 * np.exp(-t)
        return (1 + t + t * t / 3) * fade, rate**2 / 3 * (1 + t) * fade, rate**4 / 3 * fade


class Kernel(NamedTuple):
    """Sum of two such covariances, of independent parts of the level."""

    smooth: Matern
    rough: Matern

    @property
    def variance(self) -> float:
        """Of the level."""
        return self.smooth.deviation**2 + self.rough.deviation**2

    def slopes(self, squared: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """k, b and c at squared distances."""
        one, other = self.smooth.slopes(squared), self.rough.slopes(squared)
        return one[0] + other[0], one[1] + other[1], one[2] + other[2]

    def third(self, squared: np.ndarray) -> np.ndarray:
        """−c'/r = √5 c/(ℓ r)."""
        far = np.sqrt(np.maximum(squared, _TINY))
        parts = [_ROOT / part.length * part.slopes(squared)[2] / far for part in self]
        return np.sum(parts, axis=0)


class Coordinates(NamedTuple):
    """z (n, k) at places, and its slopes ∂z/∂x (n, k, 3)."""

    value: Float[np.ndarray, "n k"]
    slope: Float[np.ndarray, "n k 3"]

    @classmethod
    def of(cls, points: Points) -> "Coordinates":
        """The places themselves."""
        return cls(points, np.broadcast_to(np.eye(3), (len(points), 3, 3)))

    def folded(
        self, direction: Points, turning: Float[np.ndarray, "n 3 3"], fold: float
    ) -> "Coordinates":
        """Places with the surface's direction there, weighted by a length; `turning` is the
        direction's derivative.
        """
        return Coordinates(
            np.concatenate([self.value, fold * direction], axis=1),
            np.concatenate([self.slope, fold * turning], axis=1),
        )

    def scaled(self, fold: float) -> "Coordinates":
        """The same with directions that count for another length, where it was 1."""
        factor = np.repeat([1.0, fold], 3)
        return Coordinates(self.value * factor, self.slope * factor[:, None])

    def part(self, rows: Any) -> "Coordinates":
        """Some of the places."""
        return Coordinates(self.value[rows], self.slope[rows])


def differences(left: Coordinates, right: Coordinates) -> tuple[np.ndarray, np.ndarray]:
    """Differences z − z' (n, m, k) of coordinates, and their squares (n, m)."""
    apart = left.value[:, None] - right.value[None]
    return apart, np.einsum("nmk,nmk->nm", apart, apart)


def covariance(
    kernel: Kernel, left: Coordinates, right: Coordinates
) -> Float[np.ndarray, "left right"]:
    """Of values and gradients at the one places with those at the other (4 n, 4 m)."""
    apart, squared = differences(left, right)
    k, b, c = kernel.slopes(squared)
    here = np.einsum("nmk,nki->nmi", apart, left.slope)
    there = np.einsum("nmk,mki->nmi", apart, right.slope)
    whole = np.empty((len(left.value), JET, len(right.value), JET))
    whole[:, 0, :, 0] = k
    for i in range(3):
        whole[:, 0, :, 1 + i] = b * there[..., i]
        whole[:, 1 + i, :, 0] = -b * here[..., i]
    met = left.slope.reshape(len(left.value), -1, 3)
    for i in range(3):
        for j in range(3):
            metric = met[:, :, i] @ right.slope[:, :, j].T
            whole[:, 1 + i, :, 1 + j] = b * metric - c * here[..., i] * there[..., j]
    return whole.reshape(JET * len(left.value), -1)


def covariance_of_values(
    kernel: Kernel, left: Coordinates, right: Coordinates
) -> Float[np.ndarray, "left right"]:
    """Of values at the one places with values and gradients at the other (n, 4 m)."""
    apart, squared = differences(left, right)
    k, b, _ = kernel.slopes(squared)
    whole = np.empty((len(left.value), len(right.value), JET))
    whole[..., 0] = k
    whole[..., 1:] = b[..., None] * np.einsum("nmk,mki->nmi", apart, right.slope)
    return whole.reshape(len(left.value), -1)


def variances(kernel: Kernel, places: Coordinates) -> Float[np.ndarray, "n 4 4"]:
    """Of value and gradient at each place."""
    own = np.zeros((len(places.value), JET, JET))
    own[:, 0, 0] = kernel.variance
    _, b, _ = kernel.slopes(np.zeros(1))
    own[:, 1:, 1:] = b[0] * np.swapaxes(places.slope, 1, 2) @ places.slope
    return own


class Sum(NamedTuple):
    """A level Σ k(z, zⱼ) w₀ⱼ + ∂k/∂xⱼ · wⱼ, by the weights (m, 4) of its sites."""

    kernel: Kernel
    sites: Coordinates
    weights: Float[np.ndarray, "m 4"]

    def at(self, places: Coordinates) -> tuple[Values, Points]:
        """Values and gradients at places."""
        first, second = (
            self.weights[:, 0],
            np.einsum("mki,mi->mk", self.sites.slope, self.weights[:, 1:]),
        )
        values, slopes = np.empty(len(places.value)), np.empty(places.value.shape)
        step = max(_BLOCK // len(first), 1)
        for start in range(0, len(values), step):
            rows = slice(start, start + step)
            apart, squared = differences(places.part(rows), self.sites)
            k, b, c = self.kernel.slopes(squared)
            along = np.einsum("nmk,mk->nm", apart, second)
            values[rows] = k @ first + np.einsum("nm,nm->n", b, along)
            pull = b * first + c * along
            slopes[rows] = b @ second - (pull[:, None] @ apart)[:, 0]
        return values, np.einsum("nki,nk->ni", places.slope, slopes)

    def curvature(self, points: Points) -> Float[np.ndarray, "n 3 3"]:
        """Second derivatives at places that are their own coordinates."""
        return self.derivatives(points)[1]

    def derivatives(self, points: Points) -> tuple[Points, Float[np.ndarray, "n 3 3"]]:
        """First and second derivatives at places that are their own coordinates."""
        first, second = self.weights[:, 0], self.weights[:, 1:]
        slopes, curvatures = np.empty((len(points), 3)), np.empty((len(points), 3, 3))
        step = max(_BLOCK // len(first), 1)
        for start in range(0, len(points), step):
            rows = slice(start, start + step)
            apart, squared = differences(Coordinates.of(points[rows]), self.sites)
            _, b, c = self.kernel.slopes(squared)
            along = np.einsum("nmk,mk->nm", apart, second)
            pull = b * first + c * along
            slopes[rows] = b @ second - (pull[:, None] @ apart)[:, 0]
            bend = (c * first + self.kernel.third(squared) * along)[:, None]
            weighted = (np.swapaxes(apart, 1, 2) * bend) @ apart
            mixed = -(np.swapaxes(apart, 1, 2) * c[:, None]) @ second
            curvatures[rows] = weighted + mixed + np.swapaxes(mixed, 1, 2)
            curvatures[rows] -= pull.sum(axis=1)[:, None, None] * np.eye(3)
        return slopes, curvatures
