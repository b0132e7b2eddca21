"""Contacts that the surface contradicts, and sweeps that contradict one another."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial import KDTree

from vibrissa.numerics.lanes import in_threads
from vibrissa.shape.kernel import parts_of
from vibrissa.shape.level import Level
from vibrissa.shape.noise import Noise, lifted, squared
from vibrissa.shape.posterior import LeftOut
from vibrissa.shape.sites import Gathered, Sites

Curvature = Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n 3 3"]]
_ROWS = 1024
"""Contacts at a time in each thread: some MB."""
_GROSS = 30.0
"""Squared residual, in stated errors, above which a contact is an outlier."""
_OFF, _TILTED = 5e-4, 0.03
"""Errors of value, relative to the extent, and normal that do not make a contact gross, however
precise it claims to be.
"""
_USUAL = 3.4
"""Median of a squared residual: chi-squared with four degrees of freedom."""
_LOOKED = 200
"""Nearest contacts among which those of other sweeps are looked for: at an edge a sweep may leave
80 within half a millimetre.
"""
_NEIGHBOURS, _APART = 8, 3.0
"""Neighbours that a contact is compared with, and deviations by which they may differ."""
_ROUND = 0.05
"""What surfaces that are neither planes nor balls leave of a chord, relative to its length."""
_COMPARED = 2000
"""Contacts that are compared with their neighbours' normals, at most."""
_BESIDE, _CLOSE, _OPPOSITE = 0.2, 0.1, 0.5
"""Sine of the angle to the tangent plane and distance, relative to the extent, up to which another
contact is beside one, and cosine from which its normal is opposite.
"""
_CONTRADICTED = 6.0
"""Deviations by which the contacts of a sweep, taken together, may miss what all others say."""
_MOSTLY = 1 / 3
"""Share of a sweep's contacts: more outliers are no accident."""
_FEW, _SMALL = 5, 0.05
"""Contacts, and share of all, of which a group of their own is worth a word."""
_GAP = 0.35
"""Gap between two groups of contacts, relative to the extent, above which they may be two objects:
sweeps of one object lie closer.
"""


def doubtful(given: Gathered, level: Level, curvature: Curvature) -> Int[np.ndarray, "k"]:
    """Contacts that a surface, taken as sure, does not readily explain: no others need be judged by
    one that is better known.
    """
    every = np.arange(len(given.point))

    def squares(rows: slice) -> np.ndarray:
        return _squares(given, every[rows], level, curvature, sure=True)

    found = np.concatenate(in_threads(squares, parts_of(len(every), _ROWS)))
    return np.flatnonzero(found > _GROSS / 4)


def outliers_of(
    given: Gathered, rows: Int[np.ndarray, "k"], level: Level, curvature: Curvature
) -> Bool[np.ndarray, "n"]:
    """Which of these contacts have a place or normal off the surface by far more than stated, its
    own uncertainty included, and by far more than their neighbours of other sweeps: where these are
    off as well, as at edges sharper than the level can follow, it is the surface that is wrong.
    """
    square, found = np.zeros((2, len(given.point)))
    square[rows] = _squares(given, rows, level, curvature, sure=False)
    off = np.flatnonzero(square > _GROSS)
    feet = level.feet(given.point[off], given.extent).raised
    around = _around(given, square, feet, given.sweep[off])
    found[off] = square[off] > _GROSS * np.maximum(around / _USUAL, 1.0)
    return found > 0


def _around(
    given: Gathered,
    square: Float[np.ndarray, "n"],
    points: Float[np.ndarray, "k 3"],
    sweep: Int[np.ndarray, "k"],
) -> Float[np.ndarray, "k"]:
    """Median squared residual of contacts next to points but of other sweeps; 0 without any."""
    _, near = KDTree(given.point).query(points, min(_LOOKED, len(square)))
    other = given.sweep[near] != sweep[:, None]
    other &= np.cumsum(other, axis=1) <= _NEIGHBOURS
    pairs = zip(near, other, strict=True)
    return np.array([np.median(square[here[use]]) if use.any() else 0.0 for here, use in pairs])


def agree_with_neighbours(given: Gathered) -> Bool[np.ndarray, "n"]:
    """Contacts whose neighbours, of any sweep, put the surface where they do.

    On a plane or a ball the chord between two contacts is perpendicular to the sum of their
    normals; the median over neighbours of what is left is compared with the stated errors.
    """
    count = min(_NEIGHBOURS, len(given.point) - 1)
    _, near = KDTree(given.point).query(given.point, count + 1)
    near = near[:, 1:]
    chord = given.point[:, None] - given.point[near]
    length = np.linalg.norm(chord, axis=2)
    off = 0.5 * np.einsum("nki,nki->nk", chord, given.normal[:, None] + given.normal[near])
    along = np.einsum("ni,nij,nj->n", given.normal, given.covariance[:, :3, :3], given.normal)
    allowed = np.sqrt(along[:, None] + along[near] + (_ROUND * length) ** 2)
    return np.median(np.abs(off) / np.maximum(allowed, 1e-300), axis=1) < _APART


def _squares(
    given: Gathered, rows: Int[np.ndarray, "k"], level: Level, curvature: Curvature, *, sure: bool
) -> Float[np.ndarray, "k"]:
    """Squared residuals of some contacts in their errors, as if the surface were sure or not."""
    point = given.point[rows]
    jets, bent = level.jets(point), curvature(point)
    wanted = level.above + lifted(given.covariance[rows], bent)
    residual = np.column_stack([wanted - jets[:, 0], given.normal[rows] - jets[:, 1:]])
    own = Noise.errors(given.normal[rows], given.covariance[rows], bent, given.extent)
    own += np.diag([(_OFF * given.extent) ** 2, *[_TILTED**2] * 3])
    square = squared(residual, own)
    if not sure:
        # What is explained by a sure surface is also by one that is not.
        off = np.flatnonzero(square > _GROSS)
        variance, length = level.variance(point[off]), level.found.basis.kernel.smooth.length
        own[off, 0, 0] += variance
        own[off, 1:, 1:] += (variance * 5 / length**2)[:, None, None] * np.eye(3)
        square[off] = squared(residual[off], own[off])
    return square


def findings_of(others: list[LeftOut], noise: Noise, sites: Sites, extent: float) -> list[str]:
    """What the contacts say against one another, one line each."""
    return _sweeps(others, noise, sites, extent) + _groups(sites, extent)


def unused(given: Gathered) -> list[str]:
    """Lines if not all contacts are used."""
    lines = list[str]()
    if given.step > 1:
        lines.append(
            f"one contact in {given.step} is used, as {len(given.point)} tell as much as all"
        )
    if given.far.any():
        lines.append(
            f"contacts too far from all others to be of the object, and left out: "
            f"{given.far.sum()}, the first in row {np.argmax(given.far)}"
        )
    return lines


def inside_out(given: Gathered) -> list[str]:
    """Sweeps whose normals point against those of the contacts close beside them, one line each.
    The other face of a wall is not beside a contact but behind it.
    """
    some = slice(None, None, -(-len(given.point) // _COMPARED))
    point, normal, sweep = given.point[some], given.normal[some], given.sweep[some]
    apart, near = KDTree(given.point).query(point, min(_LOOKED, len(given.point)))
    chord = given.point[near] - point[:, None]
    beside = given.sweep[near] != sweep[:, None]
    beside &= np.abs(np.einsum("nki,ni->nk", chord, normal)) < _BESIDE * apart
    beside &= apart < _CLOSE * given.extent
    beside &= np.cumsum(beside, axis=1) <= _NEIGHBOURS
    opposite = np.einsum("nki,ni->nk", given.normal[near], normal) < -_OPPOSITE
    met = np.any(beside, axis=1)
    total = np.bincount(sweep, met)
    share = np.bincount(sweep, met & np.all(opposite | ~beside, axis=1)) / np.maximum(total, _FEW)
    return [
        f"sweep {number}: {100 * share[number]:.0f} % of its normals point against those of other "
        "sweeps beside them; they should point out of the object"
        for number in np.flatnonzero(share > _MOSTLY)
    ]


def mostly_outliers(given: Gathered, outlier: Bool[np.ndarray, "n"]) -> list[str]:
    """Sweeps a large part of whose contacts are outliers, one line each."""
    total, wrong = np.bincount(given.sweep), np.bincount(given.sweep, weights=outlier)
    return [
        f"sweep {sweep} contradicts the others: {wrong[sweep]:.0f} of its {total[sweep]} contacts "
        "are outliers; check its mount and tare, and whether the object moved"
        for sweep in np.flatnonzero(wrong > _MOSTLY * total)
    ]


def _sweeps(others: list[LeftOut], noise: Noise, sites: Sites, extent: float) -> list[str]:
    """Sweeps that fit the surface through all others better when shifted as a whole."""
    found: dict[int, tuple[float, float]] = {}
    for rows, (missed, predicted, errors) in zip(noise.groups, others, strict=True):
        weighted = np.linalg.solve(predicted + errors, sites.normal[rows])
        # A shift is determined only across the surface; any is less than the object's size.
        precision = weighted.T @ sites.normal[rows] + np.eye(3) / extent**2
        shift = np.linalg.solve(precision, weighted.T @ missed)
        evidence = np.sqrt(shift @ precision @ shift)
        size = float(np.linalg.norm(shift))
        if evidence > _CONTRADICTED:
            found[int(sites.sweep[rows[0]])] = size, size / evidence
    return [
        f"sweep {sweep} contradicts the others: they put the surface {size:.2g} away from its "
        f"contacts, expected within {2 * deviation:.1g}; check its mount and tare, and whether the "
        "object moved"
        for sweep, (size, deviation) in found.items()
    ]


def _groups(sites: Sites, extent: float) -> list[str]:
    """Contacts in groups far apart."""
    label = fcluster(linkage(sites.touched), _GAP * extent, "distance") - 1
    count = int(label.max()) + 1
    sizes = np.bincount(label, weights=sites.size)
    if count == 1 or np.sort(sizes)[-2] < max(_FEW, _SMALL * sizes.sum()):
        return []
    return [
        f"contacts lie in {count} groups, more than {_GAP * extent:.3g} apart; if they are "
        "different objects, fit each by itself"
    ]
