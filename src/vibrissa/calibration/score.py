"""Score tests: how much better the readings would be explained if something that is held were not
as stated (C. R. Rao 1948).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import huber

from vibrissa.calibration.arrays import Columns
from vibrissa.calibration.problem import Linear
from vibrissa.calibration.suspects import Suspect, suspects
from vibrissa.rod import Rod
from vibrissa.tolerances import Tolerances

_ROWS = 1200
"""Rows used for the tests: enough for causes that matter, few enough to be quick."""
_ROUNDS = 8
"""Rounds of reweighting, after which Huber's cost changes by less than a thousandth."""
_LITTLE = 1e-12
"""Information that stands for none, so that equations can be solved."""


class Score(NamedTuple):
    """Score of one suspect."""

    suspect: Suspect
    value: Float[np.ndarray, "m"]
    """Change of its numbers from what is stated to what the data want."""
    significance: float
    """In standard deviations: √ of the cost that it removes, with what is then left taken as
    noise.
    """


def scores(linear: Linear, rod: Rod, tolerances: Tolerances, inflation: float) -> list[Score]:
    """Scores of everything that is held and may not be as stated, most significant first.

    All rows count, even those left out as disturbed: leaving them out may be what hides the cause.
    With friction given those do not count: where the rod sticks, no coefficient explains the
    readings. Each row's cost is Huber's.

    Parameters
    ----------
    inflation
        Factor by which the variance of the residuals is larger than stated.
    """
    problem, every = linear.problem, max(1, len(linear.sound) // _ROWS)
    usable = linear.sound & ~(problem.disturbed & (problem.friction > 0))
    rows = np.flatnonzero(usable[::every]) * every
    base, _ = _settled(linear, rows, every, np.zeros((len(linear.sound), 6, 0)))
    expected = float(len(rows)) * problem.freedom
    found = []
    for suspect in suspects(linear, rod, tolerances):
        cost, value = _settled(linear, rows, every, suspect.columns)
        # A cause is judged by what it leaves: the inflation shrinks with the cost.
        noise = max(1.0, inflation * cost / base if cost > expected else 1.0, cost / expected)
        significance = float(np.sqrt(max(0.0, base - cost) * every / noise))
        found.append(Score(suspect, value, significance))
        problem.steps.step()
    return sorted(found, key=lambda score: -score.significance)


def _settled(
    linear: Linear, rows: Int[np.ndarray, "rows"], every: int, columns: Columns
) -> tuple[float, np.ndarray]:
    """Huber's cost on some of the rows, one in `every`, after the best steps; and the steps of the
    additional columns.
    """
    more, limit, residual = columns.shape[2], linear.problem.outlying, linear.residual[rows]
    design = linear.weighing[rows] @ np.concatenate([linear.design, columns], axis=2)[rows]
    prior, values = (
        np.append(part, np.zeros(more))
        for part in (linear.problem.known**2 / every, linear.point.values)
    )
    length = linear.length[rows]
    for _ in range(_ROUNDS):
        root = np.sqrt(limit / np.maximum(length, limit))[:, None]
        flat = (design * root[..., None]).reshape(-1, len(prior))
        matrix = flat.T @ flat + np.diag(prior)
        unit = 1 / np.sqrt(np.diag(matrix) + _LITTLE)
        slope = flat.T @ (residual * root).ravel() - prior * values
        scaled = matrix * np.outer(unit, unit) + _LITTLE * np.eye(len(unit))
        step = unit * np.linalg.solve(scaled, unit * slope)
        length = np.linalg.norm(residual - design @ step, axis=1)
    cost = 2 * np.sum(huber(limit, length)) + np.sum(prior * step * (step + 2 * values))
    return float(cost), step[len(step) - more :]
