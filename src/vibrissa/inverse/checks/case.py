"""One sweep about given bench errors: its constraints, which stretches touch with the tip, how well
errors explain the misfit of the constraints, and the nonlinear fit of some errors to one or several
sweeps.

A contact obeys min(1 − s₁, −t·n) = 0 with the object's normal n (mechanics.md): once whatever is
wrong has been removed, the smaller of the two, each in its own scale, tells the phase. So phases
and one cause of error are found alternately, for each cause and from several starts; the best
explanation decides the phases. With these, causes are weighed by generalised least squares, one at
a time.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular
from scipy.ndimage import uniform_filter1d

from vibrissa.inverse.arrays import Flags, Scalars, Spread
from vibrissa.inverse.checks.constraints import COUPLE, TANGENT, TIP, Constraints, Slopes, holding
from vibrissa.inverse.checks.rig import (
    ERRORS,
    FRICTION,
    NOTHING,
    RUBBING,
    SUSPECTS,
    TELLING,
    Bench,
    BenchErrors,
    Directions,
    spreads_of,
)
from vibrissa.inverse.checks.stretches import Stretches
from vibrissa.inverse.shared import leaning_under
from vibrissa.inverse.smoothing.manifold import chosen, finite
from vibrissa.rod import Rod

_FEWEST = 12
"""Stretches in contact below which a sweep is not judged."""
_VAGUE = 0.06
"""Standard deviation of s₁ [L] above which a stretch is too weak to use, and its errors are no
longer linear.
"""
_FARTHEST = 5.0
"""s₁ [L] beyond which it only says that the contact is not on the rod: a stiffness a tenth of the
true one triples it.
"""
GROSS = 3.0
"""Prior standard deviations up to which causes are searched for."""
_SMOOTH = 7
"""Stretches over which the path of the contact is averaged to see its direction."""
_STEPS, _DONE = 8, 0.03
"""Gauss-Newton steps, and the step size in standard deviations that ends them."""
MODEL_ERROR = 2e-4
"""What the statics of an ideal rod leave out, in rod lengths: 10 µm on 50 mm, as in smoothing."""
_TANGENT_ERROR = 1e-3
"""The same for t·n: what a grid of 32 links leaves of a right angle, and a rod's tip of 10 µm."""
_CORRELATED = 1 / 6
"""Fraction of a contact over which the model error stays correlated."""
_FRICTION_UNEVEN = 0.2
"""Relative variation of the friction coefficient along the way."""
_SCALES = ((0.01, 0.03), (0.005, 0.01), (0.002, 0.004), (0.002, 0.004), (0.002, 0.004))
"""Scales of 1 − s₁ and t·n on top of the noise, round by round: a few per cent of EI at first, a
physics engine's grid error at last.
"""
_PRICE = 3.0
"""Penalty for a free number, in units of the score: about half of BIC's for a hundred stretches."""
_SOME, _HALF = 15.0, 0.5
"""Gain in score from which friction shows, and the fraction of the best cause's gain it must reach.
"""
_BELIEVED = 3.0
"""Deviations up to which a row counts in full."""
_SILENCED = 1e6
"""Factor on the variance of the tip's row where the flank touches."""
NO_DIRECTIONS: Directions = np.zeros((ERRORS, 0))


Phases = Flags
"""Whether each stretch touches with the tip."""


Numbers = Float[np.ndarray, "p"]
"""Along directions of error."""
Square = Float[np.ndarray, "p p"]
Slope = Float[np.ndarray, "n 4 p"]
"""Of the constraints, with respect to such numbers."""
Told = Bool[np.ndarray, "n 4"]


class Fitted(NamedTuple):
    """Errors along some directions."""

    size: Numbers
    covariance: Square
    explained: float
    """By how much they reduce χ²."""


class Misfit(NamedTuple):
    """Constraints that apply, three per stretch, whitened."""

    value: Float[np.ndarray, "rows"]
    root: Float[np.ndarray, "rows rows"]
    """Cholesky factor of the covariance."""
    holds: Told
    """Constraints that hold, three per stretch."""
    told: Told
    """Those of them that are informative."""
    alone: Float[np.ndarray, "n 3"]
    """Each constraint in its own standard deviations."""

    def whitened(self, slope: Slope) -> Float[np.ndarray, "rows p"]:
        """Derivatives of the constraints in the same rows."""
        rows = np.where(self.told[:, :, None], slope, 0.0)[self.holds]
        return np.asarray(solve_triangular(self.root, rows, lower=True))

    @property
    def square(self) -> float:
        """χ²."""
        return float(self.value @ self.value)


@dataclass(frozen=True, eq=False)
class Case:
    """Stretches of one sweep, and their constraints with some errors removed."""

    bench: Bench
    """Stretches that are strong enough, and how they were measured."""
    errors: BenchErrors
    """Those that are removed."""
    here: Constraints
    slopes: Slopes
    spread: BenchErrors
    """Prior standard deviations of the errors."""
    tolerated: Directions
    """Stated errors of the setup, one standard deviation each, independent of each other."""
    silent: bool = False
    """Whether s₁ and t·n̂ tell nothing, as under friction, which leaves their values open."""

    @cached_property
    def stretches(self) -> Stretches:
        """With the noise as it is once the errors are removed."""
        own, taken = self.bench.stretches, self.bench.taken(self.errors)
        return own._replace(noise=taken @ own.noise @ taken.T, zero=taken @ own.zero)

    @cached_property
    def deviations(self) -> Float[np.ndarray, "n 4"]:
        """Of the constraints, from noise."""
        slope = self.here.by_wrench.constraints
        return np.sqrt(np.einsum("kip,kpq,kiq->ki", slope, self.stretches.noise, slope))

    def about(self, errors: BenchErrors) -> "Case":
        """With other errors removed; stretches that then have no contact keep their previous
        values.
        """
        here = self.bench.constraints(errors)
        slopes = self.bench.slopes(here, errors)
        lost = ~finite((here.value, slopes.constraints))
        slopes.constraints[lost] = 0.0
        return replace(self, errors=errors, here=chosen(lost, self.here, here), slopes=slopes)

    def spreads(self, directions: Directions) -> Numbers:
        """Prior standard deviations of numbers along directions."""
        return np.sqrt((directions**2).T @ self.spread**2 / np.sum(directions**2, axis=0))

    def fitted(self, misfit: Misfit, directions: Directions) -> Fitted:
        """Errors along directions, sized to explain most."""
        design = misfit.whitened(self.slopes.constraints @ directions)
        right = design.T @ misfit.value
        covariance = np.linalg.inv(design.T @ design + np.diag(self.spreads(directions) ** -2.0))
        return Fitted(-covariance @ right, covariance, float(right @ covariance @ right))

    def phases(self, causes: Iterable[Directions] = (), *, started: bool = True) -> Phases:
        """Whether each stretch touches with the tip, under the cause that, along with friction,
        explains most, of `causes` or of all that affect every stretch: starting from zero, and if
        `started` from gross sizes as well.
        """
        found = []
        for directions in causes or map(SUSPECTS.__getitem__, TELLING):
            both = np.hstack([directions, RUBBING])
            unit = np.eye(both.shape[1])
            starts = np.concatenate([0 * unit[:1], unit, -unit] if started else [0 * unit[:1]])
            found += [self._settled(both, start) for start in starts]
        return min(found, key=itemgetter(0))[1]

    def rubs(self) -> bool:
        """Whether friction alone explains at least half of what the best cause without it explains,
        and enough to show.
        """

        def score(directions: Directions, *starts: float) -> float:
            return min(self._settled(directions, np.array(start))[0] for start in starts)

        nothing = score(NOTHING * RUBBING, 0.0)
        by_friction = score(RUBBING, 0.0, 0.3, 1.0)
        by_cause = min(score(SUSPECTS[name], 0.0, -0.3, 0.3) for name in TELLING)
        return nothing - by_friction > max(_SOME, _HALF * (nothing - by_cause))

    def _settled(
        self, directions: Directions, start: Float[np.ndarray, "..."]
    ) -> tuple[float, Phases]:
        """Phases and errors along directions, found alternately, from a start in standard
        deviations; and a score, the lower the better.
        """
        slope, spread = self.slopes.constraints @ directions, self.spreads(directions)
        unknown, count = start * spread, len(spread)
        for of_length, of_tangent in _SCALES:
            size = self.deviations.copy()
            size[:, TIP] = np.hypot(size[:, TIP], of_length * self.here.steepness)
            size[:, TANGENT] = np.hypot(size[:, TANGENT], of_tangent)
            left, last = (self.here.value + slope @ unknown) / size, unknown
            tip = left[:, TIP] < -left[:, TANGENT]
            holds = holding(tip)
            shown = left[holds]
            weight = np.sqrt(_BELIEVED / np.maximum(np.abs(shown), _BELIEVED))
            design = (slope * spread / size[:, :, None])[holds] * weight[:, None]
            target = (self.here.value / size)[holds] * weight
            normal = design.T @ design + np.eye(count)
            unknown = -spread * np.linalg.solve(normal, design.T @ target)
        score = np.sum(np.log1p(shown**2)) + np.sum((last / spread) ** 2) + _PRICE * count
        return float(score), tip

    def misfit(
        self,
        tip: Phases,
        tolerated: Directions = NO_DIRECTIONS,
        friction: float = 0.0,
        inflation: float = 1.0,
    ) -> Misfit:
        """Of stretches in these phases, under noise, errors of zero and model, uneven friction, and
        tolerated errors.

        Silent stretches, and those next to a change of phase, say nothing about s₁ and t·n̂.
        """
        stretches, here, count = self.stretches, self.here, len(tip)
        holds = holding(tip)
        # A stretch next to a change of phase may contain some of both.
        silent = self.silent | np.diff(tip, append=tip[-1:]) | np.diff(tip, prepend=tip[:1])
        told = holds.copy()
        told[silent, TIP:] = False

        def seen(values: Slope) -> Slope:
            return np.where(told[:, :, None], values, 0.0)

        slope = seen(here.by_wrench.constraints)
        of_force = MODEL_ERROR * np.linalg.norm(here.force, axis=1)
        of_tangent = np.full(count, np.hypot(_TANGENT_ERROR, _FRICTION_UNEVEN * friction))
        floor = np.array([of_force, of_force, MODEL_ERROR * here.steepness, of_tangent])
        elapsed = np.abs(stretches.time[:, None] - stretches.time)
        alike = np.exp(-elapsed / (_CORRELATED * np.ptp(stretches.time)))
        covariance = np.einsum("ik,jl,kl,ij->kilj", floor, floor, alike, np.eye(4))
        own = np.arange(count)
        covariance[own, :, own] += inflation * slope @ stretches.noise @ np.swapaxes(slope, 1, 2)
        lasting = [slope @ stretches.zero, seen(self.slopes.constraints @ tolerated)]
        columns = np.concatenate(lasting, axis=2)[holds]
        whole = covariance[holds][:, holds] + columns @ columns.T
        root = np.linalg.cholesky(whole)
        value = np.where(told, here.value, 0.0)[holds]
        alone = (value / np.sqrt(np.diag(whole))).reshape(count, 3)
        return Misfit(solve_triangular(root, value, lower=True), root, holds, told, alone)

    def shifts(self, tip: Phases) -> Float[np.ndarray, "n 3 errors"]:
        """Derivatives of contacts with respect to the errors, projected onto a single contact, and
        in tip contact onto the rod's length, by the smallest change of the wrench.
        """
        rows, (given, point) = [COUPLE, TIP], self.here.by_wrench
        spread = self.stretches.noise @ np.swapaxes(given[:, rows], 1, 2)
        square = given[:, rows] @ spread
        # Where the flank touches, the second row says nothing.
        square[~tip, 1, 1] += _SILENCED * square[~tip, 1, 1]
        back = np.linalg.solve(square, self.slopes.constraints[:, rows])
        return np.asarray(self.slopes.point - point @ spread @ back)


def case_of(
    averaged: Stretches,
    to_sensor: Spread,
    friction: float | None,
    tolerated: Directions = NO_DIRECTIONS,
    rod: Rod | None = None,
) -> Case | None:
    """Case without errors, for the stated friction coefficient, if any, and a rod other than a
    straight uniform one; None if there are too few stretches.
    """
    contact, rest = averaged.chosen(averaged.contact), averaged.chosen(~averaged.contact)
    if len(contact.time) < _FEWEST:
        return None
    before = rest.chosen(rest.time < contact.time[0])
    at_rest = before if len(before.time) else contact.chosen(slice(1))
    tared, leaning = float(at_rest.time.mean()), leaning_under(friction)
    bench = Bench(contact, to_sensor, tared, at_rest.turn[0], rod=rod, leaning=leaning)
    sample = np.einsum("kii,k->ki", contact.noise, contact.last - contact.first).mean(axis=0)
    spread = spreads_of(np.sqrt(sample), float(np.ptp(contact.time)), friction)
    none = np.zeros(ERRORS)
    here = bench.constraints(none)
    case = Case(bench, none, here, here.by_rod, spread, tolerated)
    with np.errstate(invalid="ignore", divide="ignore"):
        vague = case.deviations[:, TIP] / here.steepness
    usable = finite(here.value) & (vague < _VAGUE) & (np.abs(here.arc_length) < _FARTHEST)
    if np.count_nonzero(usable) < _FEWEST:
        return None
    strong, here = jax.tree.map(lambda part: part[usable], (contact, here))
    bench = bench._replace(stretches=strong, rubbing=_rubbing(strong, here))
    case = replace(case, bench=bench, here=here).about((friction or 0.0) * RUBBING[:, 0])
    return replace(case, silent=case.rubs() if friction is None else friction > 0)


def _rubbing(stretches: Stretches, here: Constraints) -> Scalars:
    """t·n̂ for a unit tangential force that opposes the rod's slip: −(w·t)/‖w‖, with w = dp − t ds₁
    the motion of its material point over the object.
    """
    point, tangent = (np.einsum("kij,kj->ki", stretches.turn, part) for part in here[1:3])
    path = np.column_stack([stretches.position + point, here.arc_length])
    rates = np.gradient(
        uniform_filter1d(path, min(_SMOOTH, len(path)), axis=0, mode="nearest"), axis=0
    )
    way = rates[:, :3] - tangent * rates[:, 3:]
    speed = np.maximum(np.linalg.norm(way, axis=1), 1e-12)
    return np.asarray(-np.sum(way * tangent, axis=1) / speed)


class Solution(NamedTuple):
    """Errors that explain sweeps."""

    cases: list[Case]
    misfits: list[Misfit]
    size: Numbers
    covariance: Square
    left: float
    """χ², including that of the errors under their prior."""


def solved(cases: list[Case], directions: Directions, spread: Numbers, start: Numbers) -> Solution:
    """Gauss-Newton for errors along directions that all sweeps share, from a start, with the phases
    found anew at each step; friction is free in each sweep that states none.
    """
    size = change = start
    # What is thought to be well known may still be misstated.
    wide = np.maximum(spread, cases[0].spreads(directions))
    for _ in range(_STEPS):
        cases = [case.about(case.errors + directions @ change) for case in cases]
        misfits = [case.misfit(case.phases([directions])) for case in cases]
        information, right = np.diag(spread**-2.0), spread**-2.0 * size
        for case, misfit in zip(cases, misfits, strict=True):
            slope = case.slopes.constraints @ np.hstack([directions, RUBBING])
            design = misfit.whitened(slope)
            matrix, vector = design.T @ design, design.T @ misfit.value
            # Each sweep has its own friction: Schur complement.
            own = matrix[-1, -1] + case.spread[FRICTION] ** -2.0
            gain = matrix[:-1, -1] / own
            information = information + matrix[:-1, :-1] - np.outer(gain, matrix[-1, :-1])
            right = right + vector[:-1] - gain * vector[-1]
        covariance = np.linalg.inv(information)
        change = -covariance @ right
        longest = float(np.max(np.abs(change) / wide))
        settled = longest <= 1 and np.max(np.abs(change) / np.sqrt(np.diag(covariance))) < _DONE
        last, size = size, np.clip(size + change / max(1.0, longest), -GROSS * wide, GROSS * wide)
        change = size - last
        if settled:
            break
    left = sum(misfit.square for misfit in misfits) + float(np.sum((size / spread) ** 2))
    return Solution(cases, misfits, size, covariance, left)
