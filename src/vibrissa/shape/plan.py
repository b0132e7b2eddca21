"""What to touch next: which of many sweeps takes most of a surface's uncertainty away.

The surface is a Gaussian process, so that what contacts will leave open depends on where they will
be, not on what they will say. Where they will be, the forward model tells on the present surface.
All candidates are compared by a rod that stays straight and touches where it enters the object,
or where it is deepest inside; the best of them by either are scanned. Far from contacts the mean
surface may be off by a fifth of the object, and the sweep that promises most on it alone is often
one that finds little, or nothing. There, what a straight rod promises that touches where it enters
counts, on average over the mean surface and a lower one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, cholesky, solve_triangular
from scipy.ndimage import map_coordinates, zoom
from scipy.spatial import KDTree
from scipy.special import erfc, ndtr

from vibrissa.contacts import Status
from vibrissa.forward import Scan, scan
from vibrissa.geometry.checks import finite_array, not_negative, positive
from vibrissa.mechanics.shape import free_lines
from vibrissa.rod import Rod
from vibrissa.shape.kernel import Coordinates, covariance, covariance_of_values
from vibrissa.shape.level import STEEP, Level
from vibrissa.shape.mesh import box_of
from vibrissa.shape.noise import Noise, columns_of
from vibrissa.shape.shape import Shape
from vibrissa.shape.sites import spread_out
from vibrissa.shape.stated import Stated
from vibrissa.surfaces import Lattice
from vibrissa.trail import Trail, between

_NODES = 20
"""Nodes along each axis of the surface that is scanned: 3 mm on an object of 60 mm."""
_PLACES = 400
"""Places of the surface whose uncertainty counts."""
_POSITIONS, _ALONG = 16, 16
"""Clamp positions of a candidate, and points along a straight rod."""
_MODELLED, _AT_A_TIME = 12, 4
"""Most candidates that are scanned, and how many at a time: all if there are no more, or as long as
straight rods promise more of others than the best of these gives. In 76 choices among some fifty
sweeps over a block and a blob it was 5 on average, and what was chosen took away as much as with
twelve; over the block, 3 % less with the first six alone.
"""
_CONTACTS = 8
"""Contacts of a sweep that are expected to say something: neighbours say the same."""
_LOWER = 0.0, 0.25
"""Deviations by which the surface may be lower where a straight rod enters it. With half a
deviation as well, what was chosen over a block took 0.76, not 0.82 of what the best sweep would
have taken.
"""
_RELIED = 0.06
"""Deviation of the surface where the rod touches it, relative to the extent, at which what the
forward model promises counts for half. Of what the best sweep takes away, on average over 52 states
of a block, the forward model alone chose 0.52 (share within 2 mm) and 0.66 (mean deviation),
straight rods alone 0.75 and 0.81, and the two together 0.72 and 0.80, all with half a deviation
among the lower surfaces; where the surface is known well, as on an ellipsoid, straight rods alone
are wrong.
"""
_KEPT = 300
"""Contacts so far that tell whether a place is between contacts."""
_RISK = 0.05
"""Probability of the clamp being inside the object that is not taken."""
_REACHED = 5
"""Places from the clamp to where its clearance ends that are looked at: beyond the contacts the
level is no distance.
"""


@dataclass(frozen=True, eq=False)
class NextSweep:
    """Candidates by the uncertainty they are expected to take away.

    Attributes
    ----------
    candidates
        The m trails that were given.
    order
        (m,) their numbers, the best first: those that were scanned before those that were only
        compared, and those that must not be driven last.
    gain
        (m,) expected decrease of `unknown`; with a tolerance, of the part of it that sweeps take
        away by their contacts, not by leaving fewer places beyond contacts. 0 for sweeps that touch
        nothing or must not be driven.
    unknown
        Mean standard deviation of the surface, or, with a tolerance, the expected share of it that
        is off by more than that.
    status
        (m,) `CLAMP_INSIDE` where the clamp may come too close, `OVERSTRAINED` where the rod would
        yield, else `OK`.
    scanned
        (m,) which of them the forward model has scanned.
    contacts
        (m,) points (k, 3) where contacts are expected.
    """

    candidates: Trail
    order: Int[np.ndarray, "m"]
    gain: Float[np.ndarray, "m"]
    unknown: float
    status: Int[np.ndarray, "m"]
    scanned: Bool[np.ndarray, "m"]
    contacts: list[Float[np.ndarray, "_ 3"]]

    def __repr__(self) -> str:
        """Return the first five."""
        refused = int((self.status != Status.OK).sum())
        lines = [
            f"NextSweep among {len(self.order)} candidates, {refused} refused; unknown: "
            f"{self.unknown:.3g}"
        ]
        lines += [f"  {row}: gain {self.gain[row]:.3g}" for row in self.order[:5]]
        return "\n".join(lines)

    @property
    def best(self) -> Trail:
        """The trail to drive next.

        Raises
        ------
        ValueError
            If none of them may be driven.
        """
        first = self.order[0]
        if self.status[first] != Status.OK:
            raise ValueError(
                f"candidates: none of {len(self.order)} may be driven, the first because of "
                f"{Status(self.status[first]).name}; allowed is at least one that may"
            )
        return self.candidates[int(first)]


def next_sweep(
    shape: Shape,
    rod: Rod,
    candidates: Trail | Sequence[Trail],
    *,
    tolerance: float | None = None,
    clearance: float = 0.0,
    friction: float = 0.0,
    places: ArrayLike | None = None,
) -> NextSweep:
    """Rank sweeps by how much of a surface's uncertainty they are expected to take away.

    Parameters
    ----------
    shape
        What is known so far.
    rod
        The rod that will be swept, in the shape's units.
    candidates
        Trails that the arm can drive (m, n, …), or a list of single ones of equal length; their
        ends are enough if it drives straight from one to the other.
    tolerance
        Distance within which the surface is to be known. With it, a sweep counts by the share of
        the surface that it makes known to that, otherwise by the mean standard deviation.
    clearance
        Distance that the clamp keeps from the object, such as half the width of its mount.
    friction
        Coulomb friction coefficient between rod and object.
    places
        Points (k, 3) of the surface whose uncertainty counts; by default all of it.

    Raises
    ------
    ValueError
        If there is no candidate, they differ in length, the tolerance is not positive, clearance or
        friction is negative, or there is no place, or one is not finite.
    """
    trails = candidates if isinstance(candidates, Trail) else Trail.stack(list(candidates))
    if len(trails.shape) == 1:
        trails = Trail.stack([trails])
    shape = _ending(shape)
    within = None if tolerance is None else positive(tolerance, "tolerance")
    keep = not_negative(clearance, "clearance")
    where = None if places is None else finite_array(places, "places", last=3, ndim=2)
    if where is not None and not len(where):
        raise ValueError("places is empty; allowed is at least one point")
    planned = _Planned.of(shape, within)
    gains = planned.gains if where is None else _Gains.of(shape, where, within)
    number = np.arange(trails.count, dtype=np.float64)
    rows = np.linspace(0, trails.count - 1, _POSITIONS)
    few = Trail.stack([between(number, trails[each], rows) for each in range(trails.shape[0])])
    status = np.where(planned.inside(shape, few, keep), Status.CLAMP_INSIDE, Status.OK)
    ways = planned.straight(rod, few)
    straight = gains.expected([points for way in ways for points in way])
    deepest, *enters = straight.reshape(len(ways), -1)
    either = np.stack([deepest, np.mean(enters, axis=0)])
    rank = np.min(np.argsort(np.argsort(-either, axis=1, kind="stable"), axis=1), axis=0)
    promised, gain = np.max(either, axis=0), np.where(status == Status.OK, either[1], 0.0)
    contacts, scanned = ways[0], np.zeros(len(gain), dtype=bool)
    while scanned.sum() < _MODELLED or not np.any(scanned & (status == Status.OK)):
        open_ = np.flatnonzero((status == Status.OK) & ~scanned)
        best = np.max(gain[scanned & (status == Status.OK)], initial=-np.inf)
        if len(gain) > _MODELLED:
            open_ = open_[promised[open_] > best]
        chosen = open_[np.argsort(rank[open_], kind="stable")[:_AT_A_TIME]]
        if not len(chosen):
            break
        found = planned.scanned(rod, few, chosen, friction)
        scanned[chosen] = True
        overstrained = np.any(found.status == Status.OVERSTRAINED, axis=1)
        status[chosen[overstrained]] = Status.OVERSTRAINED
        sound = found.in_contact & (found.status == Status.OK)
        touched = [point[rows] for point, rows in zip(found.point, sound, strict=True)]
        modelled = gains.expected(touched)
        relied = planned.relied(touched, shape.extent)
        gain[chosen] += relied * (modelled - gain[chosen])
        gain[chosen[overstrained]] = 0.0
        for row, points in zip(chosen.tolist(), touched, strict=True):
            contacts[row] = points
    order = np.lexsort((-gain, ~scanned, status != Status.OK))
    return NextSweep(trails, order, gain, gains.unknown, status, scanned, contacts)


def _ending(shape: Shape) -> Shape:
    """The surface as planning expects it: it ends beyond the contacts, also where flat faces would
    lead it on to the clamps on a side that was not touched. Of 48 states of two blocks, the best
    sweep was refused there in 15 to 23 % otherwise.
    """
    level = shape.level
    growing = level.ball.growing(shape.sites.touched)
    return replace(shape, level=level._replace(ball=growing))


class _Planned(NamedTuple):
    """The present surface as a lattice, for rods to touch."""

    surface: Lattice
    gains: "_Gains"
    """At points spread evenly over it."""

    @classmethod
    def of(cls, shape: Shape, tolerance: float | None = None) -> "_Planned":
        """Of a surface, closed as its mean is."""
        low, counts = box_of(shape.level, shape.sites.touched, shape.extent / 20, shape.extent)
        spacing = (counts - 1) * shape.extent / 20 / (_NODES - 1)
        values = _levels(shape.level, low, spacing)
        surface = Lattice(low, spacing, values)
        # Nodes in a thin layer are as many as there is area under them.
        thick = np.linalg.norm(spacing) / 2
        near = np.argwhere(np.abs(values) < thick)
        near = near[np.random.default_rng(0).permutation(len(near))[: 3 * _PLACES]]
        points = low + spacing * near
        points = _onto(surface, points)
        points = points[np.abs(_level(surface, points)) < _MISSED * thick]
        return cls(surface, _Gains.of(shape, points[spread_out(points, _PLACES)], tolerance))

    @property
    def places(self) -> Float[np.ndarray, "n 3"]:
        """Those points."""
        return self.gains.stated.points

    def uncertainty(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """What the surface is uncertain by next to points: at the nearest of its places."""
        return self.gains.deviation[KDTree(self.places).query(points)[1]]

    def relied(
        self, contacts: Sequence[Float[np.ndarray, "_ 3"]], extent: float
    ) -> Float[np.ndarray, "sweeps"]:
        """How far sweeps with contacts at such points of the mean surface can be relied on; fully
        where they touch nothing.
        """
        count = [len(points) for points in contacts]
        sweep = np.repeat(np.arange(len(count)), count)
        total = np.bincount(sweep, self.uncertainty(np.concatenate(contacts)), len(count))
        return 1 / (1 + (total / np.maximum(count, 1) / (_RELIED * extent)) ** 2)

    def inside(self, shape: Shape, trails: Trail, clearance: float) -> Bool[np.ndarray, "m"]:
        """Trails whose clamp may come too close to the object."""
        level = _level(self.surface, trails.position)
        row = np.argmin(level, axis=1)
        closest = np.take_along_axis(trails.position, row[:, None, None], axis=1)[:, 0]
        towards = -shape.level.jets(closest)[:, 1:]
        towards *= clearance / np.linalg.norm(towards, axis=1, keepdims=True)
        reached = closest + np.linspace(0, 1, _REACHED)[:, None, None] * towards
        flat = reached.reshape(-1, 3)
        risk = ndtr(-shape.level.values(flat) / np.sqrt(shape.level.variance(flat)))
        return np.asarray(risk.reshape(_REACHED, -1).max(axis=0) > _RISK)

    def straight(self, rod: Rod, trails: Trail) -> list[list[Float[np.ndarray, "_ 3"]]]:
        """For each trail, points of the surface next to where the free rod is deepest inside; then,
        for the surface and each lower one, next to where it enters, as a rod that is driven far
        beyond an end is bent until it touches there.
        """
        lines = free_lines(rod, trails, _ALONG).reshape(*trails.shape, _ALONG, 3)
        level = _level(self.surface, lines)
        deepest = np.minimum(level.min(axis=2, keepdims=True), 0.0)
        inside, deviation = level <= 0, np.zeros_like(level)
        deviation[inside] = self.uncertainty(lines[inside])
        lower = [level <= -lower * deviation for lower in _LOWER]
        return [self._touched(lines, inside) for inside in (level == deepest, *lower)]

    def _touched(
        self, lines: Float[np.ndarray, "m n k 3"], there: Bool[np.ndarray, "m n k"]
    ) -> list[Float[np.ndarray, "_ 3"]]:
        """Places next to the first point of each line that is there, each place once."""
        trail, row = np.nonzero(there.any(axis=2))
        first = lines[trail, row, np.argmax(there[trail, row], axis=1)]
        nearest = KDTree(self.places).query(first)[1]
        each = [dict.fromkeys(nearest[trail == number].tolist()) for number in range(len(lines))]
        return [self.places[list(places)] for places in each]

    def scanned(self, rod: Rod, trails: Trail, rows: Int[np.ndarray, "k"], friction: float) -> Scan:
        """What the forward model finds."""
        chosen = Trail(trails.position[rows], trails.orientation[rows])
        return scan(rod, self.surface, chosen, friction=friction)


def _levels(
    level: Level, low: Float[np.ndarray, "3"], spacing: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "x y z"]:
    """Levels at a lattice's nodes; away from the surface, between those of half as many."""
    half = _NODES // 2
    coarse = spacing * (_NODES - 1) / (half - 1)
    values = zoom(_at_nodes(level, low, coarse, np.indices((half,) * 3)), _NODES / half, order=3)
    near = np.abs(values) < np.linalg.norm(coarse)
    values[near] = _at_nodes(level, low, spacing, np.argwhere(near).T)
    return values


def _at_nodes(
    level: Level, low: Float[np.ndarray, "3"], spacing: np.ndarray, index: Int[np.ndarray, "3 *n"]
) -> Float[np.ndarray, "*n"]:
    places = low + spacing * index.reshape(3, -1).T
    return level.values(places).reshape(index.shape[1:])


def _level(surface: Lattice, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
    """The lattice's level: its nearest place's, plus the distance from there."""
    place = (points - surface.origin) / surface.spacing
    inside = np.clip(place, 0, _NODES - 1)
    coefficients = np.asarray(surface.coefficients)
    found = map_coordinates(coefficients, np.moveaxis(inside, -1, 0) + 1, order=3, prefilter=False)
    return np.asarray(found + np.linalg.norm(surface.spacing * (place - inside), axis=-1))


def _onto(surface: Lattice, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Points of the surface, by Newton's method along its slope."""
    step = _DIFFERENCE * float(np.min(surface.spacing))
    for _ in range(_ROUNDS):
        moved = points[:, None] + step * np.concatenate([np.eye(3), -np.eye(3)])
        told = _level(surface, moved)
        slope = (told[:, :3] - told[:, 3:]) / (2 * step)
        squared = np.maximum(np.sum(slope**2, axis=1), STEEP**2)
        points = points - (_level(surface, points) / squared)[:, None] * slope
    return points


_DIFFERENCE = 0.05
"""Step of numerical slopes, in the lattice's spacing."""
_ROUNDS, _MISSED = 3, 0.1
"""Steps towards the surface, and level of those left out that are not on it then, in the thickness
of the layer they come from.
"""


class _Gains(NamedTuple):
    """What contacts would take from the uncertainty at some places."""

    shape: Shape
    stated: Stated
    contacts: Float[np.ndarray, "k 3"]
    """Some of those so far."""
    places: Coordinates
    known: Float[np.ndarray, "n m"]
    """What the contacts so far take from the places' covariance with the level's unknowns."""
    variance: Float[np.ndarray, "n"]
    tolerance: float | None

    @classmethod
    def of(
        cls, shape: Shape, points: Float[np.ndarray, "n 3"], tolerance: float | None
    ) -> "_Gains":
        """At points of the surface."""
        stated = Stated.at(shape.level, points, shape.sites.touched, shape.extent)
        places, found = shape.level.places(stated.feet.raised), shape.level.found
        rows = found.basis.values(places)
        known = rows - found.solved(rows)
        variance = np.maximum(found.basis.kernel.variance - np.sum(rows * known, axis=0), 0)
        contacts = shape.sites.touched[spread_out(shape.sites.touched, _KEPT)]
        return cls(shape, stated, contacts, places, known.T, variance, tolerance)

    @property
    def unknown(self) -> float:
        """Mean over the places."""
        return self._counted(self.deviation)

    @property
    def deviation(self) -> Float[np.ndarray, "n"]:
        """What the surface is uncertain by at the places."""
        return self.stated.deviations(self.variance)

    def _counted(self, deviation: Float[np.ndarray, "n"]) -> float:
        """The mean, or with a tolerance the share that is off by more."""
        if self.tolerance is None:
            return float(np.mean(deviation))
        return float(np.mean(erfc(self.tolerance / np.maximum(np.sqrt(2) * deviation, 1e-300))))

    def _left(
        self, variance: Float[np.ndarray, "n"], added: Float[np.ndarray, "k 3"] | None = None
    ) -> float:
        """What counts as unknown with such variances, after contacts at some points more.

        Where a tolerance asks for a share, what is added beyond contacts hides what a sweep does:
        without it, 9 sweeps instead of 10.6 made 95 % of a block known within 2 mm.
        """
        if self.tolerance is not None:
            return self._counted(self.stated.by_level(variance))
        stated = self.stated if added is None else self.stated.touched(self.contacts, added)
        return self._counted(stated.deviations(variance))

    def expected(self, contacts: Sequence[Float[np.ndarray, "_ 3"]]) -> Float[np.ndarray, "sweeps"]:
        """Expected decrease by each sweep with contacts at such points."""
        few = [points[:: -(-len(points) // _CONTACTS) or 1] for points in contacts]
        decrease = np.zeros(len(few))
        if not any(map(len, few)):
            return decrease
        points, which = np.unique(np.concatenate(few), axis=0, return_inverse=True)
        level, found = self.shape.level, self.shape.level.found
        normal = self.shape.normal(points)
        raised = points + level.above * normal
        here, kernel = level.places(raised), found.basis.kernel
        rows = found.basis.jets(here)
        left = solve_triangular(found.root, rows, lower=True, check_finite=False)
        cross = covariance_of_values(kernel, self.places, here)
        cross -= self.known @ rows
        among = covariance(kernel, here, here) + left.T @ left - rows.T @ rows
        among += block_diag(*self._errors(raised, normal))
        before, first = self._left(self.variance), 0
        for number, each in enumerate(few):
            if not len(each):
                continue
            columns = columns_of(np.unique(which[first : first + len(each)]))
            first += len(each)
            root = cholesky(among[np.ix_(columns, columns)], lower=True, check_finite=False)
            told = solve_triangular(root, cross[:, columns].T, lower=True, check_finite=False)
            variance = np.maximum(self.variance - np.sum(told**2, axis=0), 0)
            decrease[number] = before - self._left(variance, each)
        return decrease

    def _errors(
        self, points: Float[np.ndarray, "k 3"], normal: Float[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, "k 4 4"]:
        """Of contacts that are as well known as those so far."""
        level, sites = self.shape.level, self.shape.sites
        usual = np.median(sites.covariance, axis=0) * np.eye(6)
        curvature = level.ball.curvature(points)
        many = np.broadcast_to(usual, (len(points), 6, 6))
        return Noise.errors(normal, many, curvature, self.shape.extent)
