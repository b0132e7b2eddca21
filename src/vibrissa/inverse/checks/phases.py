"""Which stretches touch with the tip and which with the flank, when neither rod nor friction is
trusted.

A contact obeys min(1 − s₁, −t·n) = 0 with the object's normal n (mechanics.md): whatever is wrong,
the smaller of the two in its own scale tells the phase once that is taken off. So phases and one
cause of error are found in turn, for each cause and from several starts; what explains most tells
the phases.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.inverse.checks.constraints import COUPLE, TANGENT, TIP, TORSION

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


def in_tip_contact(
    rows: Rows, guesses: Iterable[Guess], *, started: bool = True
) -> Bool[np.ndarray, "k"]:
    """Whether each stretch touches with the tip, for the cause that then explains most; from none
    of it, and if `started` from gross sizes as well.
    """
    found = []
    for guess in guesses:
        starts = [np.zeros(len(guess.spread))]
        if started:
            starts += [
                sign * guess.spread * unit
                for unit in np.eye(len(guess.spread))
                for sign in (-1.0, 1.0)
            ]
        found += [_settled(rows, guess, start) for start in starts]
    return min(found, key=lambda pair: pair[0])[1]


def rubs(rows: Rows, friction: Guess, causes: Iterable[Guess]) -> bool:
    """Whether friction alone explains at least half of what the best cause without it explains, and
    something at all.
    """
    nothing = _score(rows, friction._replace(spread=_NONE * friction.spread), (0.0,))
    by_friction = _score(rows, friction, (0.0, 0.3, 1.0))
    by_cause = min(_score(rows, cause, (0.0, -0.3, 0.3)) for cause in causes)
    return nothing - by_friction > max(_SOME, _HALF * (nothing - by_cause))


def _score(rows: Rows, guess: Guess, starts: tuple[float, ...]) -> float:
    return min(_settled(rows, guess, start * guess.spread)[0] for start in starts)


def _settled(
    rows: Rows, guess: Guess, unknown: Float[np.ndarray, "p"]
) -> tuple[float, Bool[np.ndarray, "k"]]:
    for scales in _SCALES:
        size = rows.deviation.copy()
        size[:, TIP] = np.hypot(size[:, TIP], scales[0] * rows.steepness)
        size[:, TANGENT] = np.hypot(size[:, TANGENT], scales[1])
        left = (rows.value + guess.slope @ unknown) / size
        tip = left[:, TIP] < -left[:, TANGENT]
        pick = np.stack(
            [np.full(len(tip), COUPLE), np.full(len(tip), TORSION), np.where(tip, TIP, TANGENT)],
            axis=1,
        )
        weight = np.sqrt(
            _BELIEVED / np.maximum(np.abs(np.take_along_axis(left, pick, axis=1)), _BELIEVED)
        )
        design = (
            np.take_along_axis(guess.slope / size[:, :, None], pick[:, :, None], axis=1)
            * weight[:, :, None]
        )
        target = np.take_along_axis(rows.value / size, pick, axis=1) * weight
        whole = np.concatenate(
            [design.reshape(-1, len(unknown)) * guess.spread, np.eye(len(unknown))]
        )
        unknown = (
            -guess.spread
            * np.linalg.lstsq(whole, np.append(target.ravel(), np.zeros(len(unknown))), rcond=None)[
                0
            ]
        )
    left = (rows.value + guess.slope @ unknown) / size
    tip = left[:, TIP] < -left[:, TANGENT]
    chosen = np.stack(
        [left[:, COUPLE], left[:, TORSION], np.where(tip, left[:, TIP], left[:, TANGENT])]
    )
    return float(
        np.sum(np.log1p(chosen**2)) + np.sum((unknown / guess.spread) ** 2) + _PRICE * len(unknown)
    ), tip
