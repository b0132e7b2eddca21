"""Score tests: how much better the readings would be explained if something that is held were other
than stated (C. R. Rao 1948).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from vibrissa.calibration.fit import Linear, Problem, prior_system, thinned, whitened
from vibrissa.calibration.suspects import Suspect, suspects
from vibrissa.rod import Rod

_ROWS = 1200
_ROUNDS = 8
_OUTLYING = 1e-3


class Score(NamedTuple):
    """Of one suspect."""

    suspect: Suspect
    value: Float[np.ndarray, "m"]
    """Its numbers, from stated to what the data want."""
    deviation: Float[np.ndarray, "m"]
    significance: float
    """In standard deviations: √ of the cost that it takes off, where what is then left is taken as
    noise.
    """


class System(NamedTuple):
    """The linearised problem on a share of the rows, for all unknowns and further columns."""

    residual: Float[np.ndarray, "n k"]
    jacobian: Float[np.ndarray, "n k unknowns"]
    prior: Float[np.ndarray, "unknowns"]
    pull: Float[np.ndarray, "unknowns"]
    limit: float


def scores(problem: Problem, linear: Linear, rod: Rod, inflation: float) -> list[Score]:
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
    problem, linear = thinned(problem, linear, every)
    rows = linear.sound & ~problem.disturbed if problem.rubs else linear.sound
    prior, pull = (part / every for part in prior_system(problem, linear.point))
    limit = float(np.sqrt(chi2.isf(_OUTLYING, problem.freedom)))
    system = System(linear.residual[rows], linear.jacobian[rows], prior, pull, limit)
    base, _, _ = _settled(system, np.zeros((*system.residual.shape, 0)))
    expected = float(np.count_nonzero(rows)) * problem.freedom
    found = []
    for suspect in suspects(problem, linear, rod):
        cost, value, information = _settled(
            system, whitened(problem, linear, suspect.columns)[rows]
        )
        # A cause is judged by what it leaves: of the inflation as large a share as of the cost.
        noise = max(1.0, inflation * cost / base if cost > expected else 1.0, cost / expected)
        gained = max(0.0, base - cost)
        deviation = np.sqrt(
            np.maximum(np.diag(np.linalg.pinv(information, hermitian=True)), 0.0) * noise / every
        )
        found.append(Score(suspect, value, deviation, float(np.sqrt(gained * every / noise))))
    return sorted(found, key=lambda score: -score.significance)


def _settled(
    system: System, columns: Float[np.ndarray, "n k m"]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Huber's cost after the best steps, those of the further columns, and the information on them."""
    size, more = system.jacobian.shape[2], columns.shape[2]
    unit = np.maximum(np.sqrt(np.sum(columns**2, axis=(0, 1))), np.finfo(float).tiny)
    design = np.concatenate([system.jacobian, columns / unit], axis=2)
    prior = np.concatenate([system.prior, np.zeros(more)])
    pull = np.concatenate([system.pull, np.zeros(more)])
    step, left = np.zeros(size + more), system.residual
    for _ in range(_ROUNDS):
        length = np.sqrt(np.sum(left**2, axis=1))
        weight = np.minimum(1.0, system.limit / np.maximum(length, system.limit))
        flat = (design * np.sqrt(weight)[:, None, None]).reshape(-1, size + more)
        matrix = flat.T @ flat + np.diag(prior + 1e-12)
        slope = flat.T @ (system.residual * np.sqrt(weight)[:, None]).ravel() - pull
        root = 1 / np.sqrt(np.diag(matrix))
        step = root * np.linalg.solve(
            matrix * np.outer(root, root) + 1e-12 * np.eye(len(root)), root * slope
        )
        left = system.residual - design @ step
    length = np.sqrt(np.sum(left**2, axis=1))
    robust = np.where(length <= system.limit, length**2, system.limit * (2 * length - system.limit))
    own = slice(size, size + more)
    information = (
        matrix[own, own]
        - matrix[own, :size]
        @ np.linalg.lstsq(matrix[:size, :size], matrix[:size, own], rcond=None)[0]
    )
    cost = float(np.sum(robust) + np.sum(prior * step**2) + 2 * pull @ step)
    return cost, step[own] / unit, information * np.outer(unit, unit)
