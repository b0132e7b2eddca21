"""What is assumed of a surface before it is touched, and how far its level may leave that."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import LinAlgError, cho_solve, cholesky
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize

from vibrissa.shape.kernel import JET, Coordinates, Kernel, Matern, Sum, covariance
from vibrissa.shape.noise import Noise, columns_of
from vibrissa.shape.sites import Sites

_BLUNT = 0.3
"""Radius, relative to the ball's, within which the mean level is rounded off, as a distance has a
kink at the centre.
"""
_GROWTH = 2.0
"""How fast the mean level grows beyond all contacts where that is asked for: by this, times the
cube of the distance beyond, over the square of the ball's radius. Flat faces led it 35 mm beyond
the side of a block of 42 mm that was not touched. With 1, levels where clamps could be were still
7 to 16 mm there, with a deviation of 7 mm.
"""
_DIRECTED = 0.1
"""Length of a gradient below which its direction fades out: inside, where faces are equally far."""
_ROUGH = 0.015, 0.3
"""Deviation and length, relative to the extent, of what a surface may do besides: far from contacts
it need not go on as it is where they are. Between neighbouring sweeps it adds a few hundredths of a
millimetre at most, to an object of 80 mm.
"""


class Ball(NamedTuple):
    """The mean level: distance from a ball that fits all contacts. It grows outwards, so that
    nothing is expected far from them; faster than the distance, if asked, beyond all of them.
    """

    center: Float[np.ndarray, "3"]
    radius: float
    held: float = np.inf
    """Distance from the ball beyond which the level grows faster."""

    @classmethod
    def of(cls, sites: Sites) -> "Ball":
        """The ball with pᵢ − c = R nᵢ in the least-squares sense, or around the contacts' middle
        where their normals do not point outwards.
        """
        point, normal = sites.point, sites.normal
        middle, facing = point.mean(axis=0), normal.mean(axis=0)
        spread = np.sum((normal - facing) ** 2)
        radius = float(np.sum((point - middle) * (normal - facing)) / spread) if spread > 0 else 0.0
        center = middle - radius * facing
        reach = float(np.linalg.norm(point - middle, axis=1).mean())
        if not 0.5 * reach < radius < 4 * reach:
            radius = float(np.clip(radius, 0.5 * reach, 4 * reach))
            center = middle - radius * facing
        return cls(center, radius)

    def growing(self, contacts: Float[np.ndarray, "k 3"]) -> "Ball":
        """The same up to the distance of the farthest contact, growing faster beyond."""
        return self._replace(held=max(0.0, float(self.at(contacts)[:, 0].max())))

    def at(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
        """Values and gradients."""
        apart, root, beyond = self._apart(points)
        value = root - np.hypot(self.radius, _BLUNT * self.radius)
        value += _GROWTH * self.radius * beyond**3
        return np.column_stack([value, (1 + 3 * _GROWTH * beyond**2)[:, None] * apart])

    def curvature(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
        """Second derivatives."""
        apart, root, beyond = (each[..., None, None] for each in self._apart(points))
        radial = apart[:, :, 0] * np.swapaxes(apart[:, :, 0], 1, 2)
        across = (1 + 3 * _GROWTH * beyond**2) / root * (np.eye(3) - radial)
        return across + 6 * _GROWTH * beyond / self.radius * radial

    def _apart(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Gradients of the blunted distance from the centre, that distance, and how far beyond all
        contacts it is, relative to the radius.
        """
        apart, blunt = points - self.center, _BLUNT * self.radius
        root = np.sqrt(np.sum(apart**2, axis=1) + blunt**2)
        beyond = root - np.hypot(self.radius, blunt) - self.held
        return apart / root[:, None], root, np.maximum(beyond, 0.0) / self.radius


class Folds(NamedTuple):
    """Directions of a first surface, by which the second tells the two sides of an edge apart."""

    ball: Ball
    first: Sum
    fold: float
    """Length that a full turn of the direction counts for."""

    def at(self, points: Float[np.ndarray, "n 3"]) -> Coordinates:
        """Coordinates of places."""
        places = Coordinates.of(points)
        slope, bend = self.first.derivatives(points)
        gradient = slope + self.ball.at(points)[:, 1:]
        curvature = bend + self.ball.curvature(points)
        length = np.sqrt(np.sum(gradient**2, axis=1) + _DIRECTED**2)[:, None]
        direction = gradient / length
        along = np.einsum("ni,nij->nj", direction, curvature)
        turning = (curvature - direction[:, :, None] * along[:, None]) / length[:, None]
        return places.folded(direction, turning, self.fold)


class Scales(NamedTuple):
    """What contacts determine: σ and ℓ of the level, the weight of directions, and a factor of
    the stated errors' deviations.
    """

    deviation: float
    length: float
    fold: float
    noise: float

    def kernel(self, extent: float) -> Kernel:
        """Covariance function."""
        rough = Matern(_ROUGH[0] * extent, _ROUGH[1] * extent)
        return Kernel(Matern(self.deviation, self.length), rough)


class Expected(NamedTuple):
    """Log-normal prior of the scales: medians, and standard deviations of their logarithms; 0 for
    what is fixed.
    """

    median: Scales
    spread: Scales


def most_likely(
    expected: Expected,
    start: Scales,
    coordinates: Callable[[float], Coordinates],
    noise: Noise,
    target: Float[np.ndarray, "n 4"],
    extent: float,
    left_out: float,
) -> Scales:
    """Scales of greatest evidence times prior, for contacts few enough for their matrix; with the
    share `left_out` of the evidence replaced by how probable each sweep is given all others.

    `coordinates` gives those of the contacts by the fold.
    """
    median, spread = np.log(expected.median), np.asarray(expected.spread)
    free = spread > 0
    errors = _whole(noise)
    columns = [columns_of(np.sort(rows)) for rows in noise.groups]
    sizes = sorted({len(own) for own in columns})
    sweeps = [np.stack([own for own in columns if len(own) == size]) for size in sizes]

    def loss(free_logs: np.ndarray) -> float:
        logs = median.copy()
        logs[free] = free_logs
        scales = Scales(*np.exp(logs))
        places = coordinates(scales.fold)
        whole = covariance(scales.kernel(extent), places, places) + scales.noise**2 * errors
        try:
            root = cholesky(whole, lower=True, check_finite=False)
            pull = cho_solve((root, True), target.ravel(), check_finite=False)
            told = 0.5 * float(target.ravel() @ pull) + float(np.log(np.diag(root)).sum())
            if left_out:
                told += left_out * (_left_out(dpotri(root, lower=1)[0], pull, sweeps) - told)
        except LinAlgError:
            return np.inf
        away = (logs - median)[free] / spread[free]
        return told + 0.5 * float(away @ away)

    first = np.log(start)[free]
    simplex = np.concatenate([first[None], first + 0.5 * np.eye(len(first))])
    # To a twentieth of a scale and a third of a nat: far within what either is uncertain by.
    options = {"initial_simplex": simplex, "maxfev": 40 * len(first), "xatol": 0.05, "fatol": 0.3}
    best = minimize(loss, first, method="Nelder-Mead", options=options)
    logs = median.copy()
    logs[free] = best.x
    return Scales(*np.exp(logs).tolist())


def _left_out(
    inverse: Float[np.ndarray, "rows rows"],
    pull: Float[np.ndarray, "rows"],
    sweeps: list[Int[np.ndarray, "_ _"]],
) -> float:
    """Minus the logarithm of the probability of each sweep given all others, by the lower triangle
    of the inverse covariance K⁻¹ of all data y, and K⁻¹ y: for few data what `posterior.left_out`
    tells of many. `sweeps` holds ascending rows of sweeps, those of as many rows in one array.
    """
    told = 0.0
    for rows in sweeps:
        root = np.linalg.cholesky(inverse[rows[:, :, None], rows[:, None]])
        half = np.linalg.solve(root, pull[rows][..., None])
        told += 0.5 * float(np.sum(half**2))
        told -= float(np.sum(np.log(np.diagonal(root, axis1=1, axis2=2))))
    return told


def _whole(noise: Noise) -> np.ndarray:
    """Covariance of all errors."""
    size = JET * len(noise.order)
    whole = np.zeros((size, size))
    for rows in noise.groups:
        columns = columns_of(rows)
        whole[np.ix_(columns, columns)] = noise.among(rows)
    return whole
