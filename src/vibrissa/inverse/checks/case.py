"""One sweep about a bench with given errors: its constraints, phases and misfit, and the nonlinear
fit of some of the errors to one sweep or several.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter1d

from vibrissa.inverse.checks.constraints import TANGENT, TIP, Constraints, Slopes
from vibrissa.inverse.checks.regression import (
    Guess,
    Misfit,
    Phases,
    Rows,
    fitted,
    in_tip_contact,
    misfit_of,
    rubs,
)
from vibrissa.inverse.checks.rig import (
    ERRORS,
    GAIN,
    LENGTH,
    POSITION,
    ROTATION,
    STIFFNESS,
    Bench,
    BenchErrors,
    Directions,
    Frame,
)
from vibrissa.inverse.checks.stretches import Stretches
from vibrissa.inverse.checks.suspects import SUSPECTS, TELLING, spreads_of
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
_PUSHED, _OFTEN = 0.08, 0.05
"""t·n̂ beyond 0 that friction explains more readily than a setup does (EI 15 % too low makes it
so), and the share of stretches that shows it.
"""
_SMOOTH = 7
"""Stretches over which the way of the contact is averaged, to see its direction."""
_STEPS = 8
_DONE = 0.03
"""Gauss-Newton steps, and their size in standard deviations that ends them."""


@dataclass(frozen=True, eq=False)
class Case:
    """Stretches of one sweep, and what the constraints say of them with some errors taken off.

    Attributes
    ----------
    bench
        Stretches that are strong enough, and how they were measured.
    errors
        (32,) that are taken off.
    here, slopes
        Constraints and derivatives there.
    friction, friction_spread
        (k, 4, f) slope of the constraints by Coulomb's coefficient, and its standard deviation
        before the data; f is 0 where it is known to be 0.
    spread
        (32,) standard deviations of errors before the data.
    silent
        (k,) stretches whose s₁ and t·n̂ tell nothing: all of them where there is friction, which
        leaves open what they should be.
    """

    bench: Bench
    errors: BenchErrors
    here: Constraints
    slopes: Slopes
    friction: Float[np.ndarray, "k 4 f"]
    friction_spread: Float[np.ndarray, "f"]
    spread: BenchErrors
    silent: Bool[np.ndarray, "k"]

    @property
    def stretches(self) -> Stretches:
        """With the noise that is left when the errors are taken off."""
        own, taken = self.bench.stretches, self.bench.taken(self.errors)
        return replace(own, noise=taken @ own.noise @ taken.T, zero=taken @ own.zero)

    @property
    def deviations(self) -> Float[np.ndarray, "k 4"]:
        """Of the constraints, by noise."""
        return _deviations(self.stretches, self.here)

    def about(self, errors: BenchErrors, stated: float | None) -> "Case":
        """With other errors taken off; stretches that then have no contact keep what they said
        before.
        """
        here = self.bench.constraints(errors)
        slopes = self.bench.slopes(here, errors)
        lost = ~(
            np.isfinite(here.value).all(axis=1) & np.isfinite(slopes.constraints).all(axis=(1, 2))
        )
        if lost.any():
            here = jax.tree.map(
                lambda new, old: np.where(lost.reshape(-1, *[1] * (new.ndim - 1)), old, new),
                here,
                self.here,
            )
            slopes.constraints[lost] = 0.0
        if stated:
            rubbing = np.where(lost[:, None], 0.0, stated * self.friction[:, :, 0])
            here = here._replace(value=here.value + rubbing)
        return replace(self, errors=errors, here=here, slopes=slopes)

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

    @property
    def rows(self) -> Rows:
        """For the phases."""
        return Rows(self.here.value, self.deviations, self.here.steepness)

    def rubs(self) -> bool:
        """Whether friction shows."""
        causes = [self.along(suspect.directions) for suspect in SUSPECTS[:TELLING]]
        return rubs(self.rows, Guess(self.friction, self.friction_spread), causes)

    def phases(self, causes: list[Directions] | None = None, *, started: bool = True) -> Phases:
        """Whether each stretch touches with the tip, for the cause that explains most, of `causes`
        as directions, or of all that change all stretches; `started` tries also gross errors.
        """
        given = [one.directions for one in SUSPECTS[:TELLING]] if causes is None else causes
        guesses = [self.rubbing(self.along(directions)) for directions in given]
        return in_tip_contact(self.rows, guesses, started=started)


def case_of(averaged: Stretches, frame: Frame, stated: float | None) -> Case | None:
    """With no errors, for a coefficient of friction as stated, if any; None with too few
    stretches.
    """
    contact, rest = averaged.chosen(averaged.contact), averaged.chosen(~averaged.contact)
    if len(contact.time) < _FEWEST:
        return None
    before = rest.chosen(rest.time < contact.time[0])
    tared, axes = (
        (float(before.time.mean()), before.turn[0])
        if len(before.time)
        else (float(contact.time[0]), contact.turn[0])
    )
    none = np.zeros(ERRORS)
    here = Bench(contact, frame, tared, axes).constraints(none)
    with np.errstate(invalid="ignore", divide="ignore"):
        vague = _deviations(contact, here)[:, TIP] / here.steepness
    usable = (
        np.isfinite(here.value).all(axis=1)
        & (vague < _VAGUE)
        & (np.abs(here.arc_length) < _FARTHEST)
    )
    if np.count_nonzero(usable) < _FEWEST:
        return None
    bench = Bench(contact.chosen(usable), frame, tared, axes)
    here = bench.constraints(none)
    sample = np.sqrt(
        np.einsum("kii,k->ki", contact.noise, contact.last - contact.first).mean(axis=0)
    )
    columns = np.zeros((len(here.value), 4, 1))
    columns[:, TANGENT, 0] = -_rubbing(bench.stretches, here)
    spread = np.array([_UNKNOWN_FRICTION if stated is None else _KNOWN_FRICTION * stated])
    if stated == 0:
        columns, spread = columns[:, :, :0], spread[:0]
    spreads = spreads_of(sample, float(np.ptp(contact.time)))
    silent = np.zeros(len(here.value), dtype=bool)
    case = Case(
        bench, none, here, bench.slopes(here, none), columns, spread, spreads, silent
    ).about(none, stated)
    rough = case.rubs() if stated is None else stated > 0
    return replace(case, silent=~silent) if rough else case


def _deviations(stretches: Stretches, here: Constraints) -> Float[np.ndarray, "k 4"]:
    slope = here.by_wrench.constraints
    return np.sqrt(np.einsum("kip,kpq,kiq->ki", slope, stretches.noise, slope))


def _rubbing(stretches: Stretches, here: Constraints) -> Float[np.ndarray, "k"]:
    """t·n̂ for a unit tangential force on the rod against its slip: −(w·t)/‖w‖, w = dp − t ds₁ the
    way of its material point over the object.
    """
    point = stretches.position + np.einsum("kij,kj->ki", stretches.turn, here.reach)
    tangent = np.einsum("kij,kj->ki", stretches.turn, here.tangent)
    smooth = uniform_filter1d(
        np.column_stack([point, here.arc_length]), min(_SMOOTH, len(point)), axis=0, mode="nearest"
    )
    rates = np.gradient(smooth, axis=0)
    way = rates[:, :3] - tangent * rates[:, 3:]
    return np.asarray(
        -np.sum(way * tangent, axis=1) / np.maximum(np.linalg.norm(way, axis=1), 1e-12)
    )


def tolerances_of(case: Case, reactions: Reactions, length: float) -> Directions:
    """Errors of the bench that the setup states, a standard deviation each, independent of each
    other.
    """
    errors = reactions.setup_errors
    if errors is None:
        return np.zeros((ERRORS, 0))
    # From `vibrissa.tolerances.PARAMETERS`: stiffness, length, the clamp's place in sensor axes,
    # its turn in its own, gains; the last is the clocks'.
    carry = np.zeros((ERRORS, len(errors.factor)))
    carry[STIFFNESS, 0], carry[LENGTH, 1] = 1, 1 / length
    carry[POSITION, 2:5], carry[ROTATION, 5:8], carry[GAIN, 8:14] = (
        case.bench.frame.turn.T / length,
        np.eye(3),
        np.eye(6),
    )
    return np.asarray(carry @ errors.factor)


def weighed(case: Case, tip: Phases, reactions: Reactions, length: float) -> tuple[Misfit, float]:
    """Misfit under as much noise as it shows, and under as uneven a friction; and the friction."""
    friction, inflation = 0.0, 1.0
    tolerated = case.slopes.constraints @ tolerances_of(case, reactions, length)

    def misfit() -> Misfit:
        return misfit_of(
            case.stretches,
            case.here,
            tip,
            case.silent,
            friction=friction,
            tolerated=tolerated,
            inflation=inflation,
        )

    everything = case.rubbing(Guess(case.slopes.constraints, case.spread))
    for _ in range(2):
        current = misfit()
        best = fitted(current, current.whitened(everything.slope), everything.spread)
        left = current.square - best.explained
        inflation = max(1.0, inflation * left / max(len(current.value) - ERRORS, 1))
        if case.friction.shape[2]:
            deviation = float(np.sqrt(best.covariance[-1, -1]))
            friction = max(0.0, abs(float(best.size[-1])) - 2 * deviation)
    return misfit(), friction


class Solution(NamedTuple):
    """Errors that explain sweeps."""

    cases: list[Case]
    tips: list[np.ndarray]
    misfits: list[Misfit]
    size: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]


def solved(
    cases: list[Case],
    directions: Directions,
    spread: Float[np.ndarray, "p"],
    stated: float | None,
    start: Float[np.ndarray, "p"],
) -> Solution:
    """Gauss-Newton for errors along directions that all sweeps share, from a start, phases anew at
    each step; friction is free in each sweep that states none.
    """
    size, count = start.copy(), len(spread)
    # What is known well may still be misstated.
    wide = np.maximum(spread, cases[0].along(directions).spread)
    for _ in range(_STEPS):
        errors = directions @ size
        cases = [case.about(errors, stated) for case in cases]
        tips = [case.phases([directions]) for case in cases]
        misfits = [
            misfit_of(case.stretches, case.here, tip, case.silent)
            for case, tip in zip(cases, tips, strict=True)
        ]
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
