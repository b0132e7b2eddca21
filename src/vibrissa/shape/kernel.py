"""Covariances of a random surface: of its level, and of the level's gradient.

The level f is a Gaussian process with Matérn covariances of smoothness 5/2, so that it is twice
differentiable: k(r) = σ² (1 + t + t²/3) exp(−t), t = √5 r/ℓ (Rasmussen & Williams, *Gaussian
Processes for Machine Learning*, 2006, eq. 4.17). Distances r are taken between coordinates z(x):
the places themselves, or places together with the direction of the surface there, so that the two
faces of an edge are far apart while places along the edge stay near. Derivatives follow by the
chain rule with the slope J = ∂z/∂x:

∂k/∂x = −b Jᵀd, ∂²k/∂x∂y = b JᵀJ' − c (Jᵀd)(J'ᵀd)ᵀ, d = z − z', b = −k'/r, c = −b'/r.

Differences d are never formed: sums over sites split into products of matrices, such as
Σⱼ pⱼ (z − zⱼ) = z Σⱼ pⱼ − Σⱼ pⱼ zⱼ. Places count from the middle of the sites, so that what
cancels is as small as it can be.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.numerics.lanes import in_threads

Points = Float[np.ndarray, "n 3"]
Values = Float[np.ndarray, "n"]
_ROOT = np.sqrt(5.0)
_BLOCK = 2**16
"""Pairs of places evaluated at a time: a few arrays of them fit into a core's cache."""
JET = 4
"""Value and gradient."""
_TINY = 1e-30
"""Least squared distance that is divided by; what it divides vanishes there."""


class Matern(NamedTuple):
    """Standard deviation σ of the level, and the length ℓ over which it changes."""

    deviation: float
    length: float

    @property
    def rate(self) -> float:
        """√5/ℓ."""
        return float(_ROOT / self.length)

    def faded(self, far: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """σ²/3 exp(−t) at distances, and its products with 1 + t and t²."""
        t = -self.rate * far
        fade = np.exp(t)
        fade *= self.deviation**2 / 3
        bent = fade * t
        once = fade - bent
        bent *= t
        return fade, once, bent


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
        far = np.sqrt(squared)
        k, b, c = np.zeros((3, *squared.shape))
        for part in self:
            fade, once, bent = part.faded(far)
            fade *= part.rate**4
            c += fade
            bent += 3 * once
            k += bent
            once *= part.rate**2
            b += once
        return k, b, c

    def bends(self, squared: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """b, c and −c'/r = √5 c/(ℓ r) at squared distances."""
        far = np.sqrt(np.maximum(squared, _TINY))
        b, c, bend = np.zeros((3, *squared.shape))
        for part in self:
            fade, once, _ = part.faded(far)
            once *= part.rate**2
            b += once
            fade *= part.rate**4
            c += fade
            fade *= part.rate
            bend += fade
        bend /= far
        return b, c, bend


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

    def about(self, middle: Float[np.ndarray, "k"]) -> "Coordinates":
        """The same, counted from another place."""
        return self._replace(value=self.value - middle)

    def projections(
        self, other: Float[np.ndarray, "m k"]
    ) -> list[tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n m"]]]:
        """Along each column of the slopes: of the places, and of others (m, k)."""
        columns = np.moveaxis(self.slope, 2, 0)
        return [(np.sum(self.value * own, axis=1), own @ other.T) for own in columns]


def covariance(
    kernel: Kernel, left: Coordinates, right: Coordinates
) -> Float[np.ndarray, "left right"]:
    """Of values and gradients at the one places with those at the other (4 n, 4 m)."""
    middle = right.value.mean(axis=0)
    left, right = left.about(middle), right.about(middle)
    k, b, c = kernel.slopes(squares(left.value, right.value))
    whole = np.empty((len(left.value), JET, len(right.value), JET))
    whole[:, 0, :, 0] = k
    here = [each[:, None] - met for each, met in left.projections(right.value)]
    there = [met.T - each for each, met in right.projections(left.value)]
    for i in range(3):
        whole[:, 0, :, 1 + i] = b * there[i]
        whole[:, 1 + i, :, 0] = -b * here[i]
        for j in range(3):
            metric = left.slope[:, :, i] @ right.slope[:, :, j].T
            whole[:, 1 + i, :, 1 + j] = b * metric - c * here[i] * there[j]
    return whole.reshape(JET * len(left.value), -1)


def covariance_of_values(
    kernel: Kernel, left: Coordinates, right: Coordinates
) -> Float[np.ndarray, "left right"]:
    """Of values at the one places with values and gradients at the other (n, 4 m)."""
    middle = right.value.mean(axis=0)
    left, right = left.about(middle), right.about(middle)
    whole = np.empty((len(left.value), len(right.value), JET))

    def fill(rows: slice) -> None:
        here = left.value[rows]
        k, b, _ = kernel.slopes(squares(here, right.value))
        whole[rows, :, 0] = k
        for i, (each, met) in enumerate(right.projections(here)):
            whole[rows, :, 1 + i] = b * (met.T - each)

    in_threads(fill, blocks(len(whole), len(right.value)))
    return whole.reshape(len(left.value), -1)


def blocks(count: int, others: int) -> list[slice]:
    """Rows, in blocks of as many as suit the cache if each is paired with so many others."""
    return parts_of(count, max(_BLOCK // others, 1))


def parts_of(count: int, most: int) -> list[slice]:
    """Rows, in parts of so many; one part, which is empty, if there are none."""
    return [slice(start, start + most) for start in range(0, max(count, 1), most)]


def squares(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Squared distances (n, m) between places (n, k) and (m, k)."""
    whole = left @ (-2 * right.T)
    whole += np.sum(left**2, axis=1)[:, None]
    whole += np.sum(right**2, axis=1)
    return np.maximum(whole, 0.0, out=whole)


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
        first = self.weights[:, 0]
        second = np.einsum("mki,mi->mk", self.sites.slope, self.weights[:, 1:])
        middle = self.sites.value.mean(axis=0)
        sites = self.sites.value - middle
        own = np.sum(sites * second, axis=1)

        def some(here: np.ndarray) -> np.ndarray:
            k, b, c = self.kernel.slopes(squares(here, sites))
            along = here @ second.T - own
            value = k @ first + np.sum(b * along, axis=1)
            slope = b @ second - _summed(b * first + c * along, here, sites)
            return np.column_stack([value, slope])

        found = self._in_parts(some, places.value - middle)
        return found[:, 0], np.einsum("nki,nk->ni", places.slope, found[:, 1:])

    def curvature(self, points: Points) -> Float[np.ndarray, "n 3 3"]:
        """Second derivatives at places that are their own coordinates."""
        return self.derivatives(points)[1]

    def derivatives(self, points: Points) -> tuple[Points, Float[np.ndarray, "n 3 3"]]:
        """First and second derivatives at places that are their own coordinates."""
        first, second = self.weights[:, 0], self.weights[:, 1:]
        middle = self.sites.value.mean(axis=0)
        sites = self.sites.value - middle
        own = np.sum(sites * second, axis=1)
        outer = _outer(sites, sites).reshape(-1, 9)
        mixed = (_outer(sites, second) + _outer(second, sites)).reshape(-1, 9)

        def some(here: np.ndarray) -> np.ndarray:
            b, c, third = self.kernel.bends(squares(here, sites))
            along = here @ second.T - own
            pull = b * first + c * along
            bend = c * first + third * along
            slope = b @ second - _summed(pull, here, sites)
            # Σ bend d dᵀ − c (d wᵀ + w dᵀ) − pull I
            aside = c @ second + bend @ sites - 0.5 * bend.sum(axis=1)[:, None] * here
            curvature = (bend @ outer + c @ mixed).reshape(-1, 3, 3)
            curvature -= _outer(aside, here) + _outer(here, aside)
            curvature -= pull.sum(axis=1)[:, None, None] * np.eye(3)
            return np.column_stack([slope, curvature.reshape(-1, 9)])

        found = self._in_parts(some, points - middle)
        return found[:, :3], found[:, 3:].reshape(-1, 3, 3)

    def _in_parts(self, function: Any, places: np.ndarray) -> np.ndarray:
        """A function (n, …) of places, as many at a time as suits the cache, on all cores."""
        parts = blocks(len(places), len(self.weights))
        return np.concatenate(in_threads(lambda rows: function(places[rows]), parts))


def _summed(weights: np.ndarray, here: np.ndarray, sites: np.ndarray) -> np.ndarray:
    """Sums (n, k) of differences from places to all sites, with weights (n, m)."""
    return weights.sum(axis=1)[:, None] * here - weights @ sites


def _outer(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Products (n, 3, 3) of vectors."""
    return one[:, :, None] * other[:, None]
