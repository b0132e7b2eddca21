"""How far a pose may move before contacts contradict it.

The inverse of the information bounds a pose where the misfit is a parabola. It is not where no
contact is on the part that tells poses apart: there the misfit stays low, or goes up and down with
the ripple of a mesh, until a contact meets that part. So the misfit is followed along each
principal direction, the other five optimised at each step (profile likelihood), and from each step
the lowest place nearby is sought.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrissa.shape.poses import Likeness, Poses, fitted
from vibrissa.shape.sites import Gathered
from vibrissa.surfaces import Surface

LARGE = 0.5
"""Motion, as an angle or relative to the extent, within which a direction is bounded, or free: an
ellipsoid of linear motions describes no larger ones.
"""
_FREE = 1e-6
"""Information along a direction, relative to the largest, below which nothing determines it."""
_FIRST, _GROWTH = 2.0, 1.6
"""First step along a direction, in its linear deviation, and factor from each to the next."""
_FARTHEST = 2.8
"""Motion at which walks end: short of half a turn, where screws are no longer unique. The farther,
the better known is a free direction.
"""
_CORRECTED, _SUNK = 5, 12
"""Iterations that optimise the other directions at a step, and all from there."""
_RAISED = 9.0
"""Rise of the misfit up to which a place belongs to a pose: three deviations."""
_BARRIER = 400.0
"""Rise of the misfit at which walks stop: ripple of a mesh with an edge of a twentieth of its size
makes 100 for 12 contacts with normals known to 0.3°.
"""


_APART = 0.3
"""Sine of the angle from which two free directions are two."""
_TURNS = 1.0, 2 * np.pi, 4 * np.pi**2, 8 * np.pi**2
"""Measure of all turns about none, one, two and three axes (of SO(3): 8π²)."""


class Bounds(NamedTuple):
    """What is known of a pose: covariance of motions, and directions that are free, both with
    shifts in the extent.
    """

    covariance: Float[np.ndarray, "6 6"]
    free: Float[np.ndarray, "k 6"]

    @property
    def log_volume(self) -> float:
        """Logarithm of the share of all motions that belongs to the pose, a Gaussian along what is
        bounded; shifts in the extent.
        """
        left = _complement(self.free)
        bounded = np.linalg.slogdet(2 * np.pi * left.T @ self.covariance @ left)[1]
        turns = np.linalg.svd(self.free[:, :3], compute_uv=False)
        turns = turns[turns > _APART]
        return float(0.5 * bounded + np.log(_TURNS[len(turns)] / _TURNS[3]) - np.log(turns).sum())


class _Walked(NamedTuple):
    """Places along walks, then the lowest places nearby: screws that lead there, shifts in the
    extent, how much the misfit rises, and the walk of each.
    """

    motion: Float[np.ndarray, "m 6"]
    rise: Float[np.ndarray, "m"]
    begun: Int[np.ndarray, "m"]


def bounds(
    surface: Surface,
    given: Gathered,
    pose: Poses,
    misfit: float,
    alike: Likeness,
    *,
    follow: bool,
) -> Bounds:
    """Of one pose at a minimum; linear ones only, unless the misfit is to be followed."""
    information, factor = alike.information, alike.factor
    values, axes = np.linalg.eigh(information)
    known = values > _FREE * values[-1]
    free, axes = axes[:, ~known].T, axes[:, known]
    deviation = 1 / np.sqrt(values[known])
    if not follow:
        return Bounds((axes * deviation**2) @ axes.T, free)
    steps = _FIRST * np.minimum(deviation, LARGE / 4)[:, None] * axes.T
    walked = _walked(surface, given, pose, misfit, np.concatenate([steps, -steps]), factor)
    motion, rise, begun = walked.motion, walked.rise, walked.begun
    size, exact = np.linalg.norm(motion, axis=1), len(free)
    level = np.maximum(rise / factor, 1.0)
    belongs = (rise < _RAISED * factor) & (size > 0)
    opened = belongs & (size > LARGE)
    if np.any(opened):
        found_free = motion[opened]
        found_free -= found_free @ free.T @ free
        _, sizes, others = np.linalg.svd(found_free, full_matrices=False)
        # Directions whose walks ended alike are one.
        free = np.concatenate([free, others[sizes > _APART * LARGE]])
    left = _complement(free)
    inner = np.linalg.pinv(left.T @ information @ left, rcond=1e-12, hermitian=True)
    for direction in free[exact:]:
        spread = _scatter(surface, given, pose, misfit, direction, free, factor)
        inner += left.T @ spread @ left
    # Each place that belongs to the pose lies as far out as its rise of the misfit says.
    for number in np.unique(begun[belongs & ~opened]):
        rows = belongs & ~opened & (begun == number)
        scaled = (motion[rows] / np.sqrt(level[rows])[:, None]) @ left
        inner = _widened(inner, scaled)
    return Bounds(left @ inner @ left.T, free)


def _widened(
    inner: Float[np.ndarray, "k k"], places: Float[np.ndarray, "m k"]
) -> Float[np.ndarray, "k k"]:
    """Covariance that has places within one deviation: rank one added for the farthest."""
    if not inner.size:
        return inner
    away = np.einsum("mi,mi->m", places, np.linalg.solve(inner, places.T).T)
    worst = int(np.argmax(away))
    if away[worst] <= 1:
        return inner
    place = places[worst]
    return inner + (1 - 1 / away[worst]) * np.outer(place, place)


def _complement(free: Float[np.ndarray, "k 6"]) -> Float[np.ndarray, "6 m"]:
    """Directions across those that are free."""
    if not len(free):
        return np.eye(6)
    return np.linalg.svd(free)[2][len(free) :].T


def _walked(
    surface: Surface,
    given: Gathered,
    pose: Poses,
    misfit: float,
    steps: Float[np.ndarray, "m 6"],
    factor: float,
) -> _Walked:
    """From a pose, each walk with its first step."""
    middle, units = given.middle, np.repeat([1.0, given.extent], 3)
    numbers, motion = np.arange(len(steps)), steps.copy()
    motions, rises, begun, places = [], [], [], []
    while len(numbers):
        begin = np.linalg.norm(motion, axis=1)
        held = motion / begin[:, None]
        start = pose.times(len(motion)).screwed(motion * units, middle)
        there, told = fitted(surface, given, start, held=held, steps=_CORRECTED)
        motion = there.screws(pose.times(len(motion)), middle) / units
        rise = told.misfit - misfit
        motions.append(motion)
        rises.append(rise)
        begun.append(numbers)
        places.append(there)
        size = np.linalg.norm(motion, axis=1)
        # From a place that was drawn back, the walk goes on straight, as far as it was.
        forth = size >= begin
        farther = _GROWTH * np.where(forth, size, begin)
        way = np.where(forth[:, None], motion / np.maximum(size, begin)[:, None], held)
        on = (rise < _BARRIER * factor) & (farther < _FARTHEST)
        numbers, motion = numbers[on], (farther[:, None] * way)[on]
    motion, rise, walk = (np.concatenate(part) for part in (motions, rises, begun))
    poses = Poses(*(np.concatenate(part) for part in zip(*places, strict=True)))
    # Within three deviations nothing else is expected than what the walk has seen.
    outer = (rise > _RAISED * factor) & (rise < _BARRIER * factor)
    if np.any(outer):
        reached, told = fitted(surface, given, poses.part(outer), steps=_SUNK)
        more = reached.screws(pose.times(int(outer.sum())), middle) / units
        motion, rise = np.concatenate([motion, more]), np.concatenate([rise, told.misfit - misfit])
        walk = np.concatenate([walk, walk[outer]])
    return _Walked(motion, rise, walk)


def _scatter(
    surface: Surface,
    given: Gathered,
    pose: Poses,
    misfit: float,
    direction: Float[np.ndarray, "6"],
    free: Float[np.ndarray, "k 6"],
    factor: float,
) -> Float[np.ndarray, "6 6"]:
    """Mean square, by probability, of how far minima along a free direction are off it."""
    middle, units = given.middle, np.repeat([1.0, given.extent], 3)
    motion = np.linspace(-np.pi, np.pi, _ALONG)[:, None] * direction * units
    there, told = fitted(surface, given, pose.times(_ALONG).screwed(motion, middle), steps=_SUNK)
    rise = told.misfit - misfit
    rest = _across(there, pose, free, middle, given.extent)
    other = (rise < _RAISED * factor) & (np.linalg.norm(rest, axis=1) < LARGE)
    if not np.any(other):
        return np.zeros((6, 6))
    weight = np.exp(-0.5 * np.maximum(rise[other], 0) / factor)
    return np.einsum("m,mi,mj->ij", weight / weight.sum(), rest[other], rest[other])


_ALONG = 48
"""Places along a free direction from which minima are sought: some degrees apart, as the ripple of
a mesh is.
"""


def _across(
    here: Poses,
    start: Poses,
    free: Float[np.ndarray, "k 6"],
    middle: Float[np.ndarray, "3"],
    extent: float,
) -> Float[np.ndarray, "m 6"]:
    """Motions to poses from one, apart from the free motion that comes closest."""
    units = np.repeat([1.0, extent], 3)
    begin = start.times(len(here.turn))
    total = np.zeros((len(here.turn), len(free)))
    rest = here.screws(begin, middle) / units
    for _ in range(_CLOSER if len(free) else 0):
        total += rest @ free.T
        rest = here.screws(begin.screwed(total @ free * units, middle), middle) / units
    return rest - rest @ free.T @ free


_CLOSER = 4
"""Steps towards the closest free motion, each of which leaves a small part of the distance."""


def apart(
    here: Poses,
    start: Poses,
    known: Bounds,
    middle: Float[np.ndarray, "3"],
    extent: float,
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """How far poses are from one: their size, and in its deviations, apart from what is free."""
    rest = _across(here, start, known.free, middle, extent)
    left = _complement(known.free)
    inside = left.T @ known.covariance @ left
    across = rest @ left
    away = np.einsum("ki,ki->k", across, np.linalg.solve(inside, across.T).T)
    return np.linalg.norm(rest, axis=1), np.sqrt(away)
