"""Which stretches touch with the tip, and how well each cause of error explains what the
constraints leave.

A contact obeys min(1 − s₁, −t·n) = 0 with the object's normal n (mechanics.md): whatever is wrong,
the smaller of the two in its own scale tells the phase once that is taken off. So phases and one
cause of error are found in turn, for each cause and from several starts; what explains most tells
the phases. With these, causes are weighed by generalised least squares, one at a time.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import solve_triangular

from vibrissa.inverse.checks.constraints import COUPLE, TANGENT, TIP, TORSION, Constraints, Slopes
from vibrissa.inverse.checks.stretches import Stretches

MODEL_ERROR = 2e-4
"""What statics of an ideal rod leaves out, in rod lengths: 10 µm on 50 mm, as smoothing states."""
_TANGENT_ERROR = 1e-3
"""The same of t·n: what a grid of 32 links leaves of a right angle, and a rod's tip of 10 µm."""
_CORRELATED = 1 / 6
"""Share of a contact over which the model's error stays alike."""
_FRICTION_UNEVEN = 0.2
"""Share of the coefficient of friction by which it changes on the way."""
_SCALES = ((0.01, 0.03), (0.005, 0.01), (0.002, 0.004), (0.002, 0.004))
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


class Rows(NamedTuple):
    """Constraints of all stretches, linear in what is unknown."""

    value: Float[np.ndarray, "k 4"]
    deviation: Float[np.ndarray, "k 4"]
    steepness: Float[np.ndarray, "k"]


class Guess(NamedTuple):
    """A cause, as slopes of the constraints by its numbers and their standard deviations before the
    data.
    """

    slope: Float[np.ndarray, "k 4 p"]
    spread: Float[np.ndarray, "p"]


def _applying(tip: Phases) -> Int[np.ndarray, "k 3"]:
    """The three constraints that hold in each phase."""
    rows = np.tile([COUPLE, TORSION, TANGENT], (len(tip), 1))
    rows[tip, 2] = TIP
    return rows


def picked(
    values: Float[np.ndarray, "k 4 *p"], rows: Int[np.ndarray, "k 3"]
) -> Float[np.ndarray, "k 3 *p"]:
    """Of all constraints those that hold."""
    return np.take_along_axis(values, rows.reshape(*rows.shape, *[1] * (values.ndim - 2)), axis=1)


def in_tip_contact(rows: Rows, guesses: Iterable[Guess], *, started: bool = True) -> Phases:
    """Whether each stretch touches with the tip, for the cause that then explains most; from none
    of it, and if `started` from gross sizes as well.
    """
    found = []
    for guess in guesses:
        unit = np.eye(len(guess.spread))
        starts = [0 * unit[:1], unit, -unit] if started else [0 * unit[:1]]
        found += [_settled(rows, guess, start) for start in np.concatenate(starts) * guess.spread]
    return min(found, key=lambda pair: pair[0])[1]


def rubs(rows: Rows, friction: Guess, causes: Iterable[Guess]) -> bool:
    """Whether friction alone explains at least half of what the best cause without it explains, and
    something at all.
    """

    def score(guess: Guess, *starts: float) -> float:
        return min(_settled(rows, guess, start * guess.spread)[0] for start in starts)

    nothing = score(friction._replace(spread=_NONE * friction.spread), 0.0)
    by_friction = score(friction, 0.0, 0.3, 1.0)
    by_cause = min(score(cause, 0.0, -0.3, 0.3) for cause in causes)
    return nothing - by_friction > max(_SOME, _HALF * (nothing - by_cause))


def _settled(rows: Rows, guess: Guess, unknown: Float[np.ndarray, "p"]) -> tuple[float, Phases]:
    count = len(unknown)
    for of_length, of_tangent in (*_SCALES, _SCALES[-1]):
        size = rows.deviation.copy()
        size[:, TIP] = np.hypot(size[:, TIP], of_length * rows.steepness)
        size[:, TANGENT] = np.hypot(size[:, TANGENT], of_tangent)
        left = (rows.value + guess.slope @ unknown) / size
        tip = left[:, TIP] < -left[:, TANGENT]
        pick = _applying(tip)
        shown, last = picked(left, pick), unknown
        weight = np.sqrt(_BELIEVED / np.maximum(np.abs(shown), _BELIEVED))
        design = picked(guess.slope / size[:, :, None], pick) * weight[:, :, None] * guess.spread
        target = (picked(rows.value / size, pick) * weight).ravel()
        whole = np.concatenate([design.reshape(target.size, count), np.eye(count)])
        solved = np.linalg.lstsq(whole, np.append(target, np.zeros(count)), rcond=None)
        unknown = -guess.spread * solved[0]
    score = np.sum(np.log1p(shown**2)) + np.sum((last / guess.spread) ** 2) + _PRICE * count
    return float(score), tip


class Misfit(NamedTuple):
    """Constraints that apply, three a stretch, whitened."""

    value: Float[np.ndarray, "rows"]
    root: Float[np.ndarray, "rows rows"]
    """Cholesky factor of the covariance."""
    pick: Int[np.ndarray, "k 3"]
    told: Bool[np.ndarray, "k 3"]
    """Constraints that say something."""
    alone: Float[np.ndarray, "k 3"]
    """Each constraint in its own standard deviations."""

    def whitened(self, slope: Float[np.ndarray, "k 4 p"]) -> Float[np.ndarray, "rows p"]:
        """Derivatives of the constraints in the same rows."""
        rows = np.where(self.told[:, :, None], picked(slope, self.pick), 0.0)
        return np.asarray(
            solve_triangular(self.root, rows.reshape(rows.shape[0] * 3, slope.shape[2]), lower=True)
        )

    @property
    def square(self) -> float:
        """χ²."""
        return float(self.value @ self.value)


class Fitted(NamedTuple):
    """One cause."""

    size: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]
    explained: float
    """By how much it lessens χ²."""


def misfit_of(
    stretches: Stretches,
    here: Constraints,
    tip: Phases,
    silent: Bool[np.ndarray, "k"],
    *,
    friction: float = 0.0,
    tolerated: Float[np.ndarray, "k 4 p"] | None = None,
    inflation: float = 1.0,
) -> Misfit:
    """Of stretches in these phases, under noise, errors of the zero and of the model, friction's
    unevenness, and errors that are tolerated (columns).

    Silent stretches, and those next to a change of phase, tell nothing of s₁ and t·n̂.
    """
    count, pick = len(tip), _applying(tip)
    told = np.ones((count, 3), dtype=bool)
    # A stretch next to a change of phase may hold some of both.
    change = tip[1:] != tip[:-1]
    told[:, 2] = ~(silent | np.append(change, False) | np.append(False, change))
    slope = np.where(told[:, :, None], picked(np.asarray(here.by_wrench.constraints), pick), 0.0)
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
    lasting = [slope @ stretches.zero]
    if tolerated is not None:
        lasting.append(np.where(told[:, :, None], picked(tolerated, pick), 0.0))
    for columns in lasting:
        flat = columns.reshape(3 * count, columns.shape[2])
        whole = whole + flat @ flat.T
    root = np.linalg.cholesky(whole)
    value = np.where(told, picked(np.asarray(here.value), pick), 0.0)
    alone = value / np.sqrt(np.diag(whole)).reshape(value.shape)
    return Misfit(solve_triangular(root, value.ravel(), lower=True), root, pick, told, alone)


def fitted(
    misfit: Misfit, design: Float[np.ndarray, "rows p"], spread: Float[np.ndarray, "p"]
) -> Fitted:
    """A cause whose numbers have these standard deviations before the data; design as from
    `Misfit.whitened`.
    """
    right = design.T @ misfit.value
    covariance = np.linalg.inv(design.T @ design + np.diag(spread**-2.0))
    return Fitted(-covariance @ right, covariance, float(right @ covariance @ right))


def shifts(
    slopes: Slopes, noise: Float[np.ndarray, "k 6 6"], here: Constraints, tip: Phases
) -> Float[np.ndarray, "k 3 p"]:
    """Derivatives of contacts that are taken to a single contact, and in tip contact to the rod's
    length, by the least change of the wrench.
    """
    rows = [COUPLE, TIP]
    given, back = here.by_wrench.constraints[:, rows], slopes.constraints[:, rows]
    spread = noise @ np.swapaxes(given, 1, 2)
    square = given @ spread
    # Where the flank touches, the second row says nothing.
    square[~tip, 1, 1] += _SILENCED * square[~tip, 1, 1]
    return np.asarray(slopes.point - here.by_wrench.point @ spread @ np.linalg.solve(square, back))
