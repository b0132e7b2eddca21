"""Score tests: how much better the readings would be explained if something that is held were other
than stated (C. R. Rao 1948).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.calibration.arrays import Columns, Unknowns, Wrenches
from vibrissa.calibration.problem import Linear, Problem, outlying
from vibrissa.calibration.suspects import Suspect, suspects
from vibrissa.rod import Rod
from vibrissa.tolerances import Tolerances

_ROWS = 1200
"""Of which the tests are made: enough for causes that matter, few enough to be quick."""
_ROUNDS = 8
"""Of reweighting, after which Huber's cost changes by less than a thousandth."""
_LITTLE = 1e-12
"""Information that stands for none, so that equations can be solved."""


class Score(NamedTuple):
    """Of one suspect."""

    suspect: Suspect
    value: Float[np.ndarray, "m"]
    """Its numbers, from stated to what the data want."""
    significance: float
    """In standard deviations: √ of the cost that it takes off, where what is then left is taken as
    noise.
    """


class System(NamedTuple):
    """The linearised problem on a share of the rows."""

    residual: Wrenches
    jacobian: Float[np.ndarray, "n 6 unknowns"]
    prior: Unknowns
    """Information."""
    values: Unknowns
    limit: float
    """Length of a residual beyond which Huber's cost grows linearly."""


def scores(
    problem: Problem, linear: Linear, rod: Rod, tolerances: Tolerances, inflation: float
) -> list[Score]:
    """Scores of all that is held and may be other than stated, most significant first.

    All rows count, those too that were left out as disturbed: leaving them out may be what hides
    the cause. With friction known they do not: where the rod sticks no coefficient explains the
    readings. Each row's cost is at most Huber's.

    Parameters
    ----------
    inflation
        Factor by which the variance of the residuals is larger than stated.
    """
    every = max(1, len(linear.sound) // _ROWS)
    usable = linear.sound & ~problem.disturbed if problem.friction > 0 else linear.sound
    rows = np.flatnonzero(usable[::every]) * every
    system = System(
        linear.residual[rows],
        linear.jacobian[rows],
        problem.known**2 / every,
        linear.point.values,
        outlying(problem),
    )
    base, _ = _settled(system, np.zeros((len(rows), 6, 0)))
    expected = float(len(rows)) * problem.freedom
    found = []
    for suspect in suspects(problem, linear, rod, tolerances):
        cost, value = _settled(system, linear.weighing[rows] @ suspect.columns[rows])
        # A cause is judged by what it leaves: of the inflation as large a share as of the cost.
        noise = max(1.0, inflation * cost / base if cost > expected else 1.0, cost / expected)
        significance = float(np.sqrt(max(0.0, base - cost) * every / noise))
        found.append(Score(suspect, value, significance))
    return sorted(found, key=lambda score: -score.significance)


def _settled(system: System, columns: Columns) -> tuple[float, np.ndarray]:
    """Huber's cost after the best steps, and those of the further columns."""
    more, limit = columns.shape[2], system.limit
    design = np.concatenate([system.jacobian, columns], axis=2)
    prior, values = (np.append(part, np.zeros(more)) for part in (system.prior, system.values))
    left = system.residual
    for _ in range(_ROUNDS):
        length = np.linalg.norm(left, axis=1)
        root = np.sqrt(np.minimum(1.0, limit / np.maximum(length, limit)))[:, None]
        flat = (design * root[..., None]).reshape(-1, len(prior))
        matrix = flat.T @ flat + np.diag(prior)
        unit = 1 / np.sqrt(np.diag(matrix) + _LITTLE)
        slope = flat.T @ (system.residual * root).ravel() - prior * values
        scaled = matrix * np.outer(unit, unit) + _LITTLE * np.eye(len(unit))
        step = unit * np.linalg.solve(scaled, unit * slope)
        left = system.residual - design @ step
    length = np.linalg.norm(left, axis=1)
    robust = np.where(length <= limit, length**2, limit * (2 * length - limit))
    cost = float(np.sum(robust) + np.sum(prior * step * (step + 2 * values)))
    return cost, step[len(step) - more :]
