"""From contacts of one or many sweeps to a surface.

1. Contacts are raised above the object, where its edges are round, and pooled along their sweeps
   (`sites`).
2. A first surface, from a part of them, gives curvatures, directions and outliers, and where along
   it contacts are.
3. The surface itself: its covariance tells the two sides of an edge apart by the first surface's
   directions (`prior.Folds`), its scales come from the contacts, outliers lose their weight, and
   errors are correlated along a sweep as much as residuals are (`noise`).
4. Two surfaces, each through half of the sweeps, and how far the mean is drawn towards what is
   assumed, tell how far deviations can be believed (`halves`).
5. Rods that passed through empty space push it back to where they were not (`swept`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtri

from vibrissa.contacts import Contacts
from vibrissa.geometry.checks import positive
from vibrissa.shape.departures import Departures
from vibrissa.shape.halves import agreement, told_by_half
from vibrissa.shape.kernel import JET, Coordinates
from vibrissa.shape.level import Level, places_of
from vibrissa.shape.noise import Noise, lifted, reach_of, squared
from vibrissa.shape.outliers import (
    agree_with_neighbours,
    doubtful,
    findings_of,
    inside_out,
    mostly_outliers,
    outliers_of,
    unused,
)
from vibrissa.shape.posterior import Basis, Data, LeftOut, information, left_out
from vibrissa.shape.prior import Ball, Expected, Folds, Scales, most_likely
from vibrissa.shape.shape import Shape
from vibrissa.shape.sites import (
    LEAST,
    Gathered,
    Sites,
    gathered,
    pooled,
    room,
    several,
    single,
    spread_out,
)
from vibrissa.shape.swept import emptied, swept_points

_FIRST, _CARRIERS, _TRIED = 300, 400, 200
"""Sites of the first surface, sites that carry unknowns of the second, and those of which the
evidence is taken. Twice as many carriers change distances by 0.03 to 0.15 of their deviations
(median; torus, blob, block). Evidence of 120 contacts gave directions on a block a weight of 3.5
mm, that of 160 to 300 one of 12 to 15 mm, whose surface is a quarter better.
"""
_LEFT_OUT = 0.5
"""Share of the evidence that how probable each sweep is given all others replaces, once directions
count: evidence takes the first surface's directions for exact, and makes them count too little. A
block with edges of 5 mm came out 11 % less far off, with intervals that held 97, not 84 % of what
is beyond 3 mm; other blocks, cones, tori and blobs 1 to 6 % less far, a sharp cylinder 4 % farther,
and with left-out sweeps alone 22 %.
"""
_MOSTLY = 0.5
"""Share of contacts that a first surface must explain to be trusted with telling outliers."""
_ABOVE = 0.025
"""Height above the surface at which contacts are used, relative to the extent. There edges are
round. With 0, 0.012, 0.018 and 0.025 a cylinder with sharp ends is off by 0.18, 0.09, 0.06 and 0.04
mm, a block with edges of 1 mm through 600 contacts by 0.09, 0.05, 0.04 and 0.02 mm. Concave parts
get tighter: a blob is off by 0.008, 0.009, 0.0095 and 0.010 mm.
"""
_ROUND, _EDGES = 0.045, 0.95
"""Radius of edges, relative to the extent, up to which contacts are raised, and the share of places
that are less convex than edges: rounder objects are better known at their own height. A block with
edges of 3 mm is off by 0.019, 0.016 and 0.015 mm with 0.025, this, and no height, its normals by
3.4, 3.0 and 2.7 degrees (95th percentile); a cylinder with such rims by 0.018, 0.021 and 0.024 mm.
"""
_FAR_OFF = 10.0
"""The least such radius in errors of contacts along the surface, over which normals turn in
proportion: with less height than 1.6 mm, where contacts are off by 0.8 mm along an edge of 6 mm, 95
% intervals held 76 to 85 %.
"""
_ROOM = 0.15
"""Largest height, relative to the room in front of the contacts. With 0.5, 0.25 and 0.15, walls
that face one another across 8 mm are off by 0.07, 0.04 and 0.01 mm; without a limit, those across 3
mm by 0.9 mm.
"""
_STUDENT = 4.0
"""Degrees of freedom of the contacts' errors: a few in a hundred are far off, at starts and ends of
contacts and where the rod snaps over an edge.
"""
_EXPECTED = Scales(0.3, 1.0, 0.05, 0.9)
"""Medians, lengths relative to the extent of the contacts: what spheres, ellipsoids, a torus, blobs
and a rounded block had. Smoothed contacts state 10 % more than their errors. The deviation is
fixed: contacts on one side determine only its ratio to a power of the length.
"""
_SPREAD = Scales(0.0, 0.8, 0.3, 0.0)
"""Of their logarithms."""
_SHORTEST = 1e-3
"""Of lengths that are given, relative to the extent: with twice as much, deviations of an ellipsoid
were as large as itself, and with a fifty-millionth the covariance had no factor.
"""
_UNKNOWN_NOISE = 2.0
"""Spread of the noise's factor where contacts come without covariances."""


def fit_shape(
    contacts: Contacts | Sequence[Contacts],
    *,
    swept: np.ndarray | Sequence[np.ndarray] | None = None,
    length_scale: float | None = None,
) -> Shape:
    """Surface through the contacts of one or many sweeps, with its uncertainty.

    Parameters
    ----------
    contacts
        Of one sweep or several, as one object whose `sweep` tells them apart, or one for each;
        best `vibrissa.smooth(found).contacts`. Only rows with a contact, with status OK where a
        status is given, and a normal known to 1 rad are used. Sensors may differ: each contact
        counts by its covariance.
    swept
        Elastic lines (k, m, 3), or several such arrays: rods whose every point was outside the
        object, as `Reconstruction.elastic_lines` gives them for rows without contact.
    length_scale
        Length over which the surface changes; by default what the contacts say.

    Returns
    -------
    Shape
        Signed distance, its standard deviation, gradient, mesh, outliers and warnings, in the
        contacts' unit of length.

    Raises
    ------
    ValueError
        If fewer than three contacts can be used, all lie in one place, a covariance has a negative
        eigenvalue, `swept` has no shape (k, m, 3), or `length_scale` is not positive or less than a
        thousandth of the contacts' extent.

    Notes
    -----
    A Gaussian process of the level given values and gradients at the contacts (Williams &
    Fitzgibbon, *Gaussian process implicit surfaces*, 2006, with Matérn covariance). Time hardly
    depends on the number of contacts beyond some thousand, as neighbours of a sweep are pooled; of
    more than 200 000, one in two, three, … is used.
    Without covariances, errors are estimated with the rest.
    """
    parts, lines = several(contacts), swept_points(swept)
    given = gathered(parts)
    inwards = inside_out(given)
    length = None if length_scale is None else positive(length_scale, "length_scale")
    if length is not None and length < _SHORTEST * given.extent:
        raise ValueError(
            f"length_scale = {length:.3g}, with contacts that extend over {given.extent:.3g}; "
            f"allowed is at least {_SHORTEST} of that, in their unit of length"
        )
    highest = min(_ABOVE * given.extent, _ROOM * room(given))
    expected = _expected(given, length)
    given, first, part = _first(given.raised(highest), expected)
    # Before neighbours are pooled, as one outlier spoils its pool.
    judged = doubtful(given, first, first.curvature)
    sound = ~outliers_of(given, judged, first, first.curvature)
    sites = pooled(given.part(sound) if sound.sum() > _MOSTLY * len(sound) else given)
    level, data, fit = _second(_carried(part, first, sites), first, expected)
    if not given.known:
        fit = _rescaled(level, data, fit)
    noise = fit.noise()
    halves, basis = told_by_half(data, noise, sites), level.found.basis
    level = level.knowing(halves[0].and_that(halves[1]).posterior(basis))
    others = left_out(level.found, data, noise)
    findings = findings_of(others, noise, sites, given.extent)
    jets = level.jets(sites.point) - np.array([level.above, 0, 0, 0])
    departures = Departures.of(sites.touched, jets, fit.curvature, given.extent)
    level = level._replace(
        doubt=_excess(others, 0.95),
        agreement=agreement(level.found, data, halves, len(np.unique(given.sweep))),
        departures=departures,
    )
    if lines is not None:
        level, refuted = emptied(level, sites, fit.place, data.target, noise, lines, given.extent)
        findings = findings + refuted
    outlier = outliers_of(given, judged, level, first.curvature)
    findings = unused(given) + inwards + mostly_outliers(given, outlier) + findings
    return Shape(
        level,
        given.extent,
        sites,
        given.outliers(outlier),
        findings,
        parts,
        given.rows,
        lines,
        length,
    )


def _expected(given: Gathered, length: float | None) -> Expected:
    """Priors of the scales for these contacts."""
    lengths = np.array([given.extent] * 3 + [1.0])
    median, spread = Scales(*(lengths * _EXPECTED).tolist()), _SPREAD
    if length is not None:
        median, spread = median._replace(length=length), spread._replace(length=0.0)
    if not given.known:
        median, spread = median._replace(noise=1.0), spread._replace(noise=_UNKNOWN_NOISE)
    return Expected(median, spread)


@dataclass(frozen=True)
class Fitting:
    """Sites with what is known of them so far."""

    sites: Sites
    place: Float[np.ndarray, "n 3"]
    """Where their values and gradients are told: their points, less what is known of how far these
    are off along the surface.
    """
    left: Float[np.ndarray, "n 3 3"]
    """Covariance of what is not known of it."""
    extent: float
    curvature: Float[np.ndarray, "n 3 3"]
    weight: Float[np.ndarray, "n"]
    reach: float
    scales: Scales

    def noise(self, *, scale: float | None = None, weight: np.ndarray | None = None) -> Noise:
        """Errors of the sites, with another factor or other weights if asked."""
        scale = self.scales.noise if scale is None else scale
        weight = (self.weight if weight is None else weight) / scale**2
        of = self.sites, self.curvature, weight, self.reach, self.extent
        return Noise.of(*of, left=self.left)

    def part(self, rows: Int[np.ndarray, "rows"]) -> "Fitting":
        """Some of the sites."""
        return replace(
            self,
            sites=self.sites.part(rows),
            place=self.place[rows],
            left=self.left[rows],
            curvature=self.curvature[rows],
            weight=self.weight[rows],
        )

    def target(self, ball: Ball) -> Float[np.ndarray, "n 4"]:
        """What the level's value and gradient should be, less the mean's."""
        moved = self.sites.point - self.place
        turned = np.einsum("nij,nj->ni", self.curvature, moved)
        lift = lifted(self.left, self.curvature)
        wanted = np.column_stack([lift, self.sites.normal - turned])
        return wanted - ball.at(self.place)

    def residual(self, level: Level) -> Float[np.ndarray, "n 4"]:
        """What it is, off that."""
        return self.target(level.ball) - np.column_stack(level.total.at(level.places(self.place)))

    def placed(self, level: Level, open_: Float[np.ndarray, "n 4 4"]) -> "Fitting":
        """With places: a normal tells where along a curved surface a contact was. Told at their
        points, normals turn too slowly along the surface, as in any regression on a variable with
        errors (Fuller, *Measurement Error Models*, 1987), and edges of what was touched came out up
        to 0.1 mm too far out.
        """
        error, left = self.noise().of_points(self.residual(level), open_)
        # Outliers tell less.
        error *= self.weight[:, None]
        normal = self.sites.normal
        error -= np.sum(error * normal, axis=1)[:, None] * normal
        return replace(self, place=self.sites.point - error, left=left)

    def judged(self, level: Level, open_: Float[np.ndarray, "n 4 4"], *, alike: bool) -> "Fitting":
        """With weights by the residuals (Student's t, as iteratively reweighted least squares),
        and, if asked, how far errors are alike.
        """
        residual, own = self.residual(level), self.noise(weight=np.ones_like(self.weight)).own
        own = own + open_
        weight = np.minimum((_STUDENT + JET) / (_STUDENT + squared(residual, own)), 1.0)
        reach = reach_of(self.sites, residual, own) if alike else self.reach
        return replace(self, weight=weight, reach=reach)


def _start(sites: Sites, extent: float, scales: Scales) -> Fitting:
    count = len(sites.point)
    flat, all_ = np.zeros((count, 3, 3)), np.ones(count)
    reach = 3 * float(sites.size.mean())
    left = sites.covariance[:, :3, :3]
    return Fitting(sites, sites.point, left, extent, flat, all_, reach, scales)


def _first(given: Gathered, expected: Expected) -> tuple[Gathered, Level, Fitting]:
    """A surface through a part of the contacts, and the contacts at the height that its edges call
    for: one round without curvatures, which tells that, one with them and new scales, one more with
    new weights.
    """
    agreeing = np.flatnonzero(agree_with_neighbours(given))
    if len(agreeing) < LEAST:
        agreeing = np.arange(len(given.point))
    rows = agreeing[_every(len(agreeing), _FIRST)]
    part = _start(single(given.part(rows)), given.extent, expected.median)
    expected = expected._replace(spread=expected.spread._replace(fold=0.0))
    _, part = _round(part, expected)
    given = given.raised(_height(part, given.above) - given.above)
    sites = single(given.part(rows))
    part = replace(part, sites=sites, place=sites.point, left=sites.covariance[:, :3, :3])
    _, part = _round(part, expected)
    return given, *_round(part, None)


def _height(part: Fitting, highest: float) -> float:
    """The height at which edges are round enough, by their radius at the highest."""
    bent = float(np.quantile(np.linalg.eigvalsh(part.curvature)[:, -1], _EDGES))
    radius = 1 / max(bent, 1 / part.extent) - highest
    off = np.sqrt(np.linalg.eigvalsh(part.sites.covariance[:, :3, :3])[:, -1])
    enough = max(_ROUND * part.extent, _FAR_OFF * float(np.median(off)))
    return float(np.clip(enough - radius, 0.0, highest))


def _round(part: Fitting, expected: Expected | None) -> tuple[Level, Fitting]:
    """A surface through sites, with new scales if their priors are given, and what it says of
    them.
    """
    ball = Ball.of(part.sites)
    if expected is not None:
        part = replace(part, scales=_likely(part, ball, None, expected))
    level, data = _surface(part, ball, None, len(part.weight))
    part = part.judged(level, data.open, alike=True)
    return level, replace(part, curvature=level.curvature(part.place))


def _carried(part: Fitting, first: Level, sites: Sites) -> Fitting:
    """What the first surface says of all sites."""
    point = sites.point
    fit = replace(
        part,
        sites=sites,
        place=point,
        left=sites.covariance[:, :3, :3],
        curvature=first.curvature(point),
        weight=np.ones(len(point)),
    )
    open_ = np.zeros((len(point), JET, JET))
    open_[:, 0, 0] = first.variance(point)
    return fit.judged(first, open_, alike=False).placed(first, open_)


def _second(fit: Fitting, first: Level, expected: Expected) -> tuple[Level, Data, Fitting]:
    """The surface whose coordinates know directions."""
    ball = first.ball
    folds = Folds(ball, first.total, 1.0)
    fit = replace(fit, scales=_likely(fit, ball, folds, expected))
    folds = folds._replace(fold=fit.scales.fold)
    level, data = _surface(fit, ball, folds, _CARRIERS)
    fit = fit.judged(level, data.open, alike=True)
    fit = replace(fit, curvature=level.curvature(fit.place))
    return level, data._replace(target=fit.target(ball)), fit


def _rescaled(level: Level, data: Data, fit: Fitting) -> Fitting:
    """With errors as large as each sweep's distance from the others says, where they were not
    given: the evidence alone takes what neighbours share for the surface's own.
    """
    noise = fit.noise()
    found = information(data, noise).posterior(level.found.basis)
    factor = _excess(left_out(found, data, noise), 0.5)
    return replace(fit, scales=fit.scales._replace(noise=fit.scales.noise * factor))


def _excess(others: list[LeftOut], share: float) -> float:
    """By how much such a share of contacts is further from the surface through all other sweeps
    than of a normal distribution, at least 1: at 95 %, up to 2 with a few sweeps, and 1 with all
    (block, torus, blob).
    """
    apart = [
        np.abs(missed) / np.sqrt(np.diag(predicted + errors))
        for missed, predicted, errors in others
    ]
    normal = ndtri(0.5 + 0.5 * share)
    return max(float(np.quantile(np.concatenate(apart), share) / normal), 1.0)


def _likely(fit: Fitting, ball: Ball, folds: Folds | None, expected: Expected) -> Scales:
    """The most likely scales, from a part of the sites."""
    part = fit.part(_every(len(fit.weight), _TRIED))
    places = places_of(folds, part.place)

    def coordinates(fold: float) -> Coordinates:
        return places if folds is None else places.scaled(fold)

    noise, target = part.noise(scale=1.0), part.target(ball)
    share = 0.0 if folds is None else _LEFT_OUT
    return most_likely(expected, fit.scales, coordinates, noise, target, fit.extent, share)


def _surface(fit: Fitting, ball: Ball, folds: Folds | None, carriers: int) -> tuple[Level, Data]:
    """The random surface for given scales."""
    places = places_of(folds, fit.place)
    basis = Basis.of(fit.scales.kernel(fit.extent), places.part(spread_out(places.value, carriers)))
    data = Data.of(basis, places, fit.target(ball))
    found = information(data, fit.noise()).posterior(basis)
    return Level.of(ball, folds, found, float(fit.sites.above[0])), data


def _every(count: int, most: int) -> Int[np.ndarray, "rows"]:
    """Every so manieth row, so that there are no more than that."""
    return np.arange(count)[:: -(-count // most)]
