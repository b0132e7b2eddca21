"""One sweep about a bench with given errors: its constraints, which stretches touch with the tip, how
well causes of error explain what the constraints leave, and the nonlinear fit of some of the errors
to one sweep or several.

A contact obeys min(1 − s₁, −t·n) = 0 with the object's normal n (mechanics.md): whatever is wrong,
the smaller of the two in its own scale tells the phase once that is taken off. So phases and one
cause of error are found in turn, for each cause and from several starts; what explains most tells
the phases. With these, causes are weighed by generalised least squares, one at a time.
"""

from collections.abc import Iterable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import solve_triangular
from scipy.ndimage import uniform_filter1d

from vibrissa.inverse.checks.constraints import COUPLE, TANGENT, TIP, TORSION, Constraints, Slopes
from vibrissa.inverse.checks.rig import (
    ERRORS,
    GAIN,
    LENGTH,
    POSITION,
    SUSPECTS,
    TELLING,
    Bench,
    BenchErrors,
    Directions,
    Frame,
    spreads_of,
)
from vibrissa.inverse.checks.stretches import Stretches
from vibrissa.reactions import Reactions

_FEWEST = 12
"""Stretches in contact below which a sweep is not judged."""
_VAGUE = 0.06
"""Standard deviation of s₁ [L] above which a stretch is too weak to tell, and its errors are no
longer linear.
"""
_FARTHEST = 5.0
"""s₁ [L] beyond which it says no more than that the contact is not on the rod: a stiffness a tenth
of the true one triples it.
"""
GROSS = 3.0
"""Standard deviations before the data up to which causes are looked for."""
_UNKNOWN_FRICTION = 0.3
_KNOWN_FRICTION = 0.2
"""Standard deviations of the coefficient: where none is stated, and of one that is, relative."""
_SMOOTH = 7
"""Stretches over which the way of the contact is averaged, to see its direction."""
_STEPS, _DONE = 8, 0.03
"""Gauss-Newton steps, and their size in standard deviations that ends them."""
MODEL_ERROR = 2e-4
"""What statics of an ideal rod leaves out, in rod lengths: 10 µm on 50 mm, as smoothing states."""
_TANGENT_ERROR = 1e-3
"""The same of t·n: what a grid of 32 links leaves of a right angle, and a rod's tip of 10 µm."""
_CORRELATED = 1 / 6
"""Share of a contact over which the model's error stays alike."""
_FRICTION_UNEVEN = 0.2
"""Share of the coefficient of friction by which it changes on the way."""
_SCALES = ((0.01, 0.03), (0.005, 0.01), (0.002, 0.004), (0.002, 0.004), (0.002, 0.004))
"""Of 1 − s₁ and t·n besides the noise, round by round: a few per cent of EI at first, what an
engine's grid leaves at last.
"""
_PRICE = 3.0
"""Of a number that is free, in the score's units: about half of BIC's for a hundred stretches."""
_NONE = 1e-6
"""A spread that leaves nothing free."""
_SOME, _HALF = 15.0, 0.5
"""By what score friction shows, and by what share of the best cause's."""
_BELIEVED = 3.0
"""Deviations up to which a row counts in full."""
_SILENCED = 1e6
"""Of its variance: what the tip's row is widened by where the flank touches."""


Phases = Bool[np.ndarray, "k"]
"""Whether each stretch touches with the tip."""


Numbers = Float[np.ndarray, "p"]
"""Of a cause."""
Square = Float[np.ndarray, "p p"]
Values = Float[np.ndarray, "k 4"]
Slope = Float[np.ndarray, "k 4 p"]
"""Of the constraints, by the numbers of a cause."""
Picked = Int[np.ndarray, "k 3"]
"""Which constraints hold."""


class Guess(NamedTuple):
    """A cause, as slopes of the constraints by its numbers and their standard deviations before the
    data.
    """

    slope: Slope
    spread: Numbers


class Fitted(NamedTuple):
    """One cause."""

    size: Numbers
    covariance: Square
    explained: float
    """By how much it lessens χ²."""


class Misfit(NamedTuple):
    """Constraints that apply, three a stretch, whitened."""

    value: Float[np.ndarray, "rows"]
    root: Float[np.ndarray, "rows rows"]
    """Cholesky factor of the covariance."""
    pick: Picked
    told: Bool[np.ndarray, "k 3"]
    """Constraints that say something."""
    alone: Float[np.ndarray, "k 3"]
    """Each constraint in its own standard deviations."""

    def whitened(self, slope: Slope) -> Float[np.ndarray, "rows p"]:
        """Derivatives of the constraints in the same rows."""
        rows = np.where(self.told[:, :, None], picked(slope, self.pick), 0.0)
        return np.asarray(solve_triangular(self.root, _flat(rows), lower=True))

    @property
    def square(self) -> float:
        """χ²."""
        return float(self.value @ self.value)

    def fitted(self, cause: Guess) -> Fitted:
        """A cause as large as explains most."""
        design = self.whitened(cause.slope)
        right = design.T @ self.value
        covariance = np.linalg.inv(design.T @ design + np.diag(cause.spread**-2.0))
        return Fitted(-covariance @ right, covariance, float(right @ covariance @ right))


class Tried(NamedTuple):
    """One cause of `SUSPECTS`, as large as explains most."""

    score: float
    """What it explains of χ², less a price for its numbers."""
    name: str
    size: Numbers
    deviation: Numbers
    explained: float
    moved: Float[np.ndarray, "k 3"]
    """Shift of the contacts that it implies, clamp axes [L]."""

    @property
    def shift(self) -> float:
        """In the median."""
        return float(np.median(np.linalg.norm(self.moved, axis=1)))

    @property
    def largest(self) -> float:
        """Where it is largest, in a fifth of the sweep: a length shows, and matters, in tip contact
        alone.
        """
        return float(np.quantile(np.linalg.norm(self.moved, axis=1), 0.8))


class Case(NamedTuple):
    """Stretches of one sweep, and what the constraints say of them with some errors taken off."""

    bench: Bench
    """Stretches that are strong enough, and how they were measured."""
    errors: BenchErrors
    """That are taken off."""
    here: Constraints
    slopes: Slopes
    friction: Float[np.ndarray, "k 4 f"]
    """Slope of the constraints by Coulomb's coefficient; f is 0 where it is known to be 0."""
    friction_spread: Float[np.ndarray, "f"]
    """Standard deviation of the coefficient before the data."""
    spread: BenchErrors
    """Standard deviations of errors before the data."""
    silent: Bool[np.ndarray, "k"]
    """Stretches whose s₁ and t·n̂ tell nothing: all of them where there is friction, which leaves
    open what they should be.
    """

    @property
    def stretches(self) -> Stretches:
        """With the noise that is left when the errors are taken off."""
        own, taken = self.bench.stretches, self.bench.taken(self.errors)
        return own._replace(noise=taken @ own.noise @ taken.T, zero=taken @ own.zero)

    @property
    def deviations(self) -> Values:
        """Of the constraints, by noise."""
        return _deviations(self.stretches, self.here)

    def about(self, errors: BenchErrors, stated: float | None) -> "Case":
        """With other errors taken off; stretches that then have no contact keep what they said
        before.
        """
        here = self.bench.constraints(errors)
        slopes = self.bench.slopes(here, errors)
        both = np.concatenate([here.value[:, :, None], slopes.constraints], axis=2)
        lost = ~np.isfinite(both).all(axis=(1, 2))
        here = jax.tree.map(
            lambda new, old: np.where(lost.reshape(-1, *[1] * (new.ndim - 1)), old, new),
            here,
            self.here,
        )
        slopes.constraints[lost] = 0.0
        if stated:
            rubbing = np.where(lost[:, None], 0.0, stated * self.friction[:, :, 0])
            here = here._replace(value=here.value + rubbing)
        return self._replace(errors=errors, here=here, slopes=slopes)

    def along(self, directions: Directions) -> Guess:
        """A cause: steps along directions, and their standard deviations before the data."""
        square = (directions**2).T @ self.spread**2 / np.sum(directions**2, axis=0)
        return Guess(self.slopes.constraints @ directions, np.sqrt(square))

    def rubbing(self, cause: Guess) -> Guess:
        """A cause together with friction."""
        return Guess(
            np.concatenate([cause.slope, self.friction], axis=2),
            np.concatenate([cause.spread, self.friction_spread]),
        )

    def phases(self, causes: Iterable[Directions] | None = None, *, started: bool = True) -> Phases:
        """Whether each stretch touches with the tip, for the cause that explains most, of `causes`
        or of all that change all stretches: from none of it, and if `started` from gross sizes as
        well.
        """
        given = [SUSPECTS[name] for name in TELLING] if causes is None else causes
        found, deviations = [], self.deviations
        for directions in given:
            guess = self.rubbing(self.along(directions))
            unit = np.eye(len(guess.spread))
            starts = np.concatenate([0 * unit[:1], unit, -unit] if started else [0 * unit[:1]])
            found += [self._settled(deviations, guess, start) for start in starts * guess.spread]
        return min(found, key=lambda pair: pair[0])[1]

    def rubs(self) -> bool:
        """Whether friction alone explains at least half of what the best cause without it explains,
        and something at all.
        """
        deviations = self.deviations

        def score(guess: Guess, *starts: float) -> float:
            return min(
                self._settled(deviations, guess, start * guess.spread)[0] for start in starts
            )

        nothing = score(Guess(self.friction, _NONE * self.friction_spread), 0.0)
        by_friction = score(Guess(self.friction, self.friction_spread), 0.0, 0.3, 1.0)
        by_cause = min(score(self.along(SUSPECTS[name]), 0.0, -0.3, 0.3) for name in TELLING)
        return nothing - by_friction > max(_SOME, _HALF * (nothing - by_cause))

    def _settled(
        self,
        deviations: Values,
        guess: Guess,
        unknown: Numbers,
    ) -> tuple[float, Phases]:
        """Phases and a cause in turn, from a start; and a score, the less the better."""
        count = len(unknown)
        for of_length, of_tangent in _SCALES:
            size = deviations.copy()
            size[:, TIP] = np.hypot(size[:, TIP], of_length * self.here.steepness)
            size[:, TANGENT] = np.hypot(size[:, TANGENT], of_tangent)
            left = (self.here.value + guess.slope @ unknown) / size
            tip = left[:, TIP] < -left[:, TANGENT]
            pick, last = _applying(tip), unknown
            shown = picked(left, pick)
            weight = np.sqrt(_BELIEVED / np.maximum(np.abs(shown), _BELIEVED))
            design = picked(guess.slope / size[:, :, None], pick) * weight[:, :, None]
            target = (picked(self.here.value / size, pick) * weight).ravel()
            whole = np.concatenate([_flat(design) * guess.spread, np.eye(count)])
            solved = np.linalg.lstsq(whole, np.append(target, np.zeros(count)), rcond=None)
            unknown = -guess.spread * solved[0]
        score = np.sum(np.log1p(shown**2)) + np.sum((last / guess.spread) ** 2) + _PRICE * count
        return float(score), tip

    def misfit(
        self,
        tip: Phases,
        *,
        friction: float = 0.0,
        tolerated: Slope | None = None,
        inflation: float = 1.0,
    ) -> Misfit:
        """Of stretches in these phases, under noise, errors of the zero and of the model,
        friction's unevenness, and errors that are tolerated (columns).

        Silent stretches, and those next to a change of phase, tell nothing of s₁ and t·n̂.
        """
        stretches, here = self.stretches, self.here
        count, pick = len(tip), _applying(tip)
        told = np.ones((count, 3), dtype=bool)
        # A stretch next to a change of phase may hold some of both.
        change = tip[1:] != tip[:-1]
        told[:, 2] = ~(self.silent | np.append(change, False) | np.append(False, change))

        def seen(values: Slope) -> Float[np.ndarray, "k 3 p"]:
            return np.where(told[:, :, None], picked(values, pick), 0.0)

        slope = seen(here.by_wrench.constraints)
        of_force = MODEL_ERROR * np.linalg.norm(here.force, axis=1)
        of_tangent = np.hypot(_TANGENT_ERROR, _FRICTION_UNEVEN * friction)
        floors = (of_force, of_force, np.where(tip, MODEL_ERROR * here.steepness, of_tangent))
        elapsed = np.abs(stretches.time[:, None] - stretches.time)
        alike = np.exp(-elapsed / (_CORRELATED * np.ptp(stretches.time)))
        covariance = np.zeros((count, 3, count, 3))
        own = np.arange(count)
        covariance[own, :, own, :] = inflation * slope @ stretches.noise @ np.swapaxes(slope, 1, 2)
        for row, floor in enumerate(floors):
            same = pick[:, row][:, None] == pick[:, row]
            covariance[:, row, :, row] += np.outer(floor, floor) * alike * same
        whole = covariance.reshape(3 * count, 3 * count)
        for columns in (slope @ stretches.zero, None if tolerated is None else seen(tolerated)):
            if columns is not None:
                whole = whole + _flat(columns) @ _flat(columns).T
        root = np.linalg.cholesky(whole)
        value = seen(here.value[:, :, None])[:, :, 0]
        alone = value / np.sqrt(np.diag(whole)).reshape(value.shape)
        return Misfit(solve_triangular(root, value.ravel(), lower=True), root, pick, told, alone)

    def weighed(self, tip: Phases, reactions: Reactions, length: float) -> tuple[Misfit, float]:
        """Misfit under as much noise as it shows, and under as uneven a friction; the friction."""
        friction, inflation = 0.0, 1.0
        tolerated = self.slopes.constraints @ self.tolerances(reactions, length)
        everything = self.rubbing(Guess(self.slopes.constraints, self.spread))
        for _ in range(2):
            current = self.misfit(tip, friction=friction, tolerated=tolerated, inflation=inflation)
            best = current.fitted(everything)
            left = current.square - best.explained
            inflation = max(1.0, inflation * left / max(len(current.value) - ERRORS, 1))
            if self.friction.shape[2]:
                deviation = float(np.sqrt(best.covariance[-1, -1]))
                friction = max(0.0, abs(float(best.size[-1])) - 2 * deviation)
        misfit = self.misfit(tip, friction=friction, tolerated=tolerated, inflation=inflation)
        return misfit, friction

    def tolerances(self, reactions: Reactions, length: float) -> Directions:
        """Errors of the bench that the setup states, a standard deviation each, independent of each
        other.
        """
        errors = reactions.setup_errors
        if errors is None:
            return np.zeros((ERRORS, 0))
        # From `vibrissa.tolerances.PARAMETERS`: stiffness, length, the clamp's place in sensor
        # axes, its turn in its own, gains; the last is the clocks'.
        carry = np.zeros((ERRORS, len(errors.factor)))
        carry[: GAIN.stop, : GAIN.stop] = np.eye(GAIN.stop)
        carry[LENGTH, LENGTH] = 1 / length
        carry[POSITION, POSITION] = self.bench.frame.turn.T / length
        return np.asarray(carry @ errors.factor)

    def shifts(self, tip: Phases) -> Float[np.ndarray, "k 3 errors"]:
        """Derivatives of contacts by the errors, taken to a single contact, and in tip contact to
        the rod's length, by the least change of the wrench.
        """
        rows, (given, point) = [COUPLE, TIP], self.here.by_wrench
        spread = self.stretches.noise @ np.swapaxes(given[:, rows], 1, 2)
        square = given[:, rows] @ spread
        # Where the flank touches, the second row says nothing.
        square[~tip, 1, 1] += _SILENCED * square[~tip, 1, 1]
        back = np.linalg.solve(square, self.slopes.constraints[:, rows])
        return np.asarray(self.slopes.point - point @ spread @ back)


def _applying(tip: Phases) -> Picked:
    """The three constraints that hold in each phase."""
    rows = np.tile([COUPLE, TORSION, TANGENT], (len(tip), 1))
    rows[tip, 2] = TIP
    return rows


def picked(values: Float[np.ndarray, "k 4 *p"], rows: Picked) -> Float[np.ndarray, "k 3 *p"]:
    """Of all constraints those that hold."""
    return np.take_along_axis(values, rows.reshape(*rows.shape, *[1] * (values.ndim - 2)), axis=1)


def _flat(rows: Float[np.ndarray, "k 3 p"]) -> Float[np.ndarray, "rows p"]:
    return rows.reshape(rows.shape[0] * 3, rows.shape[2])


def _deviations(stretches: Stretches, here: Constraints) -> Values:
    slope = here.by_wrench.constraints
    return np.sqrt(np.einsum("kip,kpq,kiq->ki", slope, stretches.noise, slope))


def case_of(averaged: Stretches, frame: Frame, stated: float | None) -> Case | None:
    """With no errors, for a coefficient of friction as stated, if any; None with too few
    stretches.
    """
    contact, rest = averaged.chosen(averaged.contact), averaged.chosen(~averaged.contact)
    if len(contact.time) < _FEWEST:
        return None
    before = rest.chosen(rest.time < contact.time[0])
    at_rest = before if len(before.time) else contact.chosen(slice(1))
    bench, none = (
        Bench(contact, frame, float(at_rest.time.mean()), at_rest.turn[0]),
        np.zeros(ERRORS),
    )
    here = bench.constraints(none)
    with np.errstate(invalid="ignore", divide="ignore"):
        vague = _deviations(contact, here)[:, TIP] / here.steepness
    usable = np.isfinite(here.value).all(axis=1) & (vague < _VAGUE)
    usable &= np.abs(here.arc_length) < _FARTHEST
    if np.count_nonzero(usable) < _FEWEST:
        return None
    bench = bench._replace(stretches=contact.chosen(usable))
    here = bench.constraints(none)
    sizes = np.einsum("kii,k->ki", contact.noise, contact.last - contact.first)
    columns = np.zeros((len(here.value), 4, 1))
    columns[:, TANGENT, 0] = -_rubbing(bench.stretches, here)
    spread = np.array([_UNKNOWN_FRICTION if stated is None else _KNOWN_FRICTION * stated])
    if stated == 0:
        columns, spread = columns[:, :, :0], spread[:0]
    spreads = spreads_of(np.sqrt(sizes.mean(axis=0)), float(np.ptp(contact.time)))
    silent = np.zeros(len(here.value), dtype=bool)
    slopes = bench.slopes(here, none)
    case = Case(bench, none, here, slopes, columns, spread, spreads, silent).about(none, stated)
    rough = case.rubs() if stated is None else stated > 0
    return case._replace(silent=~silent) if rough else case


def _rubbing(stretches: Stretches, here: Constraints) -> Float[np.ndarray, "k"]:
    """t·n̂ for a unit tangential force on the rod against its slip: −(w·t)/‖w‖, w = dp − t ds₁ the
    way of its material point over the object.
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
    tips: list[np.ndarray]
    misfits: list[Misfit]
    size: Numbers
    covariance: Square


def solved(
    cases: list[Case],
    directions: Directions,
    spread: Numbers,
    stated: float | None,
    start: Numbers,
) -> Solution:
    """Gauss-Newton for errors along directions that all sweeps share, from a start, phases anew at
    each step; friction is free in each sweep that states none.
    """
    size, count = start.copy(), len(spread)
    # What is known well may still be misstated.
    wide = np.maximum(spread, cases[0].along(directions).spread)
    for _ in range(_STEPS):
        cases = [case.about(directions @ size, stated) for case in cases]
        tips = [case.phases([directions]) for case in cases]
        misfits = [case.misfit(tip) for case, tip in zip(cases, tips, strict=True)]
        information, right = np.diag(spread**-2.0), spread**-2.0 * size
        for case, misfit in zip(cases, misfits, strict=True):
            design = misfit.whitened(case.rubbing(case.along(directions)).slope)
            matrix, vector = design.T @ design, design.T @ misfit.value
            matrix[count:, count:] += np.diag(case.friction_spread**-2.0)
            # Friction is the sweep's own: Schur's complement.
            gain = np.linalg.solve(matrix[count:, count:], matrix[count:, :count]).T
            information = information + matrix[:count, :count] - gain @ matrix[count:, :count]
            right = right + vector[:count] - gain @ vector[count:]
        covariance = np.linalg.inv(information)
        change = -covariance @ right
        longest = float(np.max(np.abs(change) / wide))
        size = np.clip(size + change / max(1.0, longest), -GROSS * wide, GROSS * wide)
        if longest <= 1 and np.max(np.abs(change) / np.sqrt(np.diag(covariance))) < _DONE:
            break
    return Solution(cases, tips, misfits, size, covariance)
