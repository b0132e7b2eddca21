"""Space that is known to be empty, as a rod passed through it without touching.

The level is positive at every point of such a rod. Each of these inequalities makes the random
surface's distribution a truncated one, which expectation propagation approximates by a Gaussian of
the same moments (Rasmussen & Williams, section 3.6; Riihimäki & Vehtari, AISTATS 2010, for
inequalities).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.linalg import cholesky, solve_triangular
from scipy.spatial import KDTree
from scipy.special import log_ndtr

from vibrissa.shape.kernel import Coordinates
from vibrissa.shape.level import Level
from vibrissa.shape.noise import Noise
from vibrissa.shape.posterior import Basis, Data, Information, information
from vibrissa.shape.prior import Ball
from vibrissa.shape.sites import Sites, spread_out
from vibrissa.shape.stated import Stated

_APART = 0.03
"""Distance between points of rods that are used, relative to the extent: a rod says as much about
its neighbourhood.
"""
_CLOSE = 0.02
"""Distance from contacts within which rods say nothing new."""
_SURE = 3.0
"""Deviations from zero beyond which the contacts alone say on which side a point is."""
_BEYOND = 0.3
"""Distance from the box around all contacts and the ball that fits them, relative to the extent,
beyond which nothing is expected anyway.
"""
_AT_ONCE, _TIMES = 60, 4
"""Points of rods added at once, and how often."""
_ROUNDS, _DAMPING = 8, 0.8
"""Of expectation propagation: distances settle to 0.02 of their deviations."""


def swept_points(
    swept: np.ndarray | Sequence[np.ndarray] | None,
) -> Float[np.ndarray, "n 3"] | None:
    """Points of all rods that were found whole.

    Raises
    ------
    ValueError
        If an array has no shape (k, m, 3), or all rods have points that are not finite.
    """
    if swept is None:
        return None
    single = isinstance(swept, np.ndarray)
    parts = [swept] if single else list(swept)
    points, given = [], 0
    for number, part in enumerate(parts):
        lines = np.asarray(part, dtype=np.float64)
        if lines.ndim != 3 or lines.shape[-1] != 3:
            name = "swept" if single else f"swept[{number}]"
            if lines.size:
                raise ValueError(f"{name} has shape {lines.shape}; allowed is (k, m, 3)")
            continue
        given += len(lines)
        points.append(lines[np.isfinite(lines).all(axis=(1, 2))].reshape(-1, 3))
    if given and not any(map(len, points)):
        raise ValueError("swept: each rod has points that are not finite; allowed are whole rods")
    return np.concatenate(points) if points else None


def emptied(
    level: Level,
    sites: Sites,
    place: Float[np.ndarray, "n 3"],
    target: Float[np.ndarray, "n 4"],
    noise: Noise,
    points: Float[np.ndarray, "k 3"],
    extent: float,
) -> tuple[Level, list[str]]:
    """The random surface given, besides these contacts as they are told at their places, that these
    points are outside; and a line if contacts alone surely put some of them inside.

    Points are added where the surface so far leaves them open, as long as there are any.
    """
    contacts, places = sites.touched, level.places(place)
    carriers = len(level.found.basis.sites.value)
    points = _thinned(points, contacts, level.ball, extent)
    deepest = _contradicted(level, points, contacts, extent)
    said = (
        f"rods that missed are up to {deepest:.2g} inside the object, by its contacts; check that "
        "no rod touched, and whether the object moved"
    )
    chosen = np.zeros((0, 3))
    for _ in range(_TIMES):
        deviation = np.sqrt(level.variance(points)) if len(points) else np.zeros(0)
        open_ = points[level.values(points) < _SURE * deviation] if len(points) else points
        added = open_[spread_out(open_, _AT_ONCE)]
        if not len(added):
            break
        chosen = np.unique(np.concatenate([chosen, added]), axis=0)
        level = _given_outside(level, places, target, noise, chosen, carriers)
        points = points[KDTree(chosen).query(points)[0] > 0]
    return level, [said] if deepest > 0 else []


def _contradicted(
    level: Level,
    points: Float[np.ndarray, "n 3"],
    contacts: Float[np.ndarray, "m 3"],
    extent: float,
) -> float:
    """How deep inside the deepest of the points is that contacts alone surely put there, or 0."""
    depth = -level.values(points) if len(points) else np.zeros(0)
    points, depth = points[depth > 0], depth[depth > 0]
    if not len(points):
        return 0.0
    stated = Stated.at(level, points, contacts, extent)
    deviation = stated.deviations(level.variance(stated.feet.raised))
    return float(depth[depth > _SURE * deviation].max(initial=0.0))


def _thinned(
    points: Float[np.ndarray, "n 3"], contacts: Float[np.ndarray, "m 3"], ball: Ball, extent: float
) -> Float[np.ndarray, "thinned 3"]:
    """One of the points in each cell of a lattice, near the contacts' or the ball's box but not
    close to a contact.
    """
    low = np.minimum(contacts.min(axis=0), ball.center - ball.radius)
    high = np.maximum(contacts.max(axis=0), ball.center + ball.radius)
    beyond = np.maximum(np.maximum(low - points, points - high), 0.0)
    points = points[np.linalg.norm(beyond, axis=1) < _BEYOND * extent]
    _, first = np.unique(np.floor(points / (_APART * extent)), axis=0, return_index=True)
    points = points[np.sort(first)]
    if not len(points):
        return points
    return points[KDTree(contacts).query(points)[0] > _CLOSE * extent]


def _given_outside(
    level: Level,
    places: Coordinates,
    target: Float[np.ndarray, "n 4"],
    noise: Noise,
    points: Float[np.ndarray, "k 3"],
    carriers: int,
) -> Level:
    """Expectation propagation: each inequality is replaced by a Gaussian that leaves the same mean
    and variance.
    """
    before, own = level.found.basis, level.places(points)
    sites = Coordinates(
        np.concatenate([before.sites.value[:carriers], own.value]),
        np.concatenate([before.sites.slope[:carriers], own.slope]),
    )
    basis = Basis.of(before.kernel, sites)
    touched = information(Data.of(basis, places, target), noise)
    rows, offset = basis.values(own), level.above + level.ball.at(points)[:, 0]
    alone = touched.posterior(basis)
    left = solve_triangular(alone.root, rows, lower=True, check_finite=False)
    # By the contacts alone: the rounds go on in the space of the points.
    known, expected = left.T @ left, alone.mean @ rows
    weight, push = np.zeros(len(points)), np.zeros(len(points))
    for _ in range(_ROUNDS):
        half = np.sqrt(np.maximum(weight, 0.0))
        inner = cholesky(np.eye(len(half)) + half[:, None] * known * half, lower=True)
        told = solve_triangular(inner, half[:, None] * known, lower=True, check_finite=False)
        variance = np.diag(known) - np.sum(told**2, axis=0)
        drawn = solve_triangular(inner, half * expected, lower=True, check_finite=False)
        mean = expected - told.T @ drawn + known @ push - told.T @ (told @ push)
        # Without the inequality's own part.
        open_ = 1 / (1 / variance - weight)
        center = open_ * (mean / variance - push)
        scale = np.sqrt(open_)
        z = (center + offset) / scale
        ratio = np.exp(-0.5 * z**2 - 0.5 * np.log(2 * np.pi) - log_ndtr(z))
        narrowed = open_ * (1 - ratio * (z + ratio))
        moved = center + scale * ratio
        weight += _DAMPING * (1 / narrowed - 1 / open_ - weight)
        push += _DAMPING * (moved / narrowed - center / open_ - push)
    missed = Information((rows * weight) @ rows.T, rows @ push)
    return level.knowing(touched.and_that(missed).posterior(basis))
