"""The weighted least-squares fit: SciPy's trust-region method with Huber's loss on whole rows.

The six channels of a row are weighted as one, and a hundred unknowns are found from 10⁵ residuals
by normal equations: hence `scipy.optimize.minimize` with the Gauss–Newton matrix, not
`least_squares`. Rows that do not fit, as where the rod swings, weigh less; the median row sets the
scale of a row's noise. Where the data leave a combination of parameters open, the priors hold it.
"""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.optimize import minimize
from scipy.special import huber
from scipy.stats import chi2

from vibrissa.calibration.arrays import Chosen, Information, Unknowns
from vibrissa.calibration.problem import FAR_OUT, OUTLYING, Linear, Point, Problem, linearised
from vibrissa.calibration.rows import CalibrationError

_LONGEST_STEP = 0.25
"""First step, in the parameters' scales: a start is off by less."""
_MANY = 1e3
"""Standard deviations of the offsets that equal such a step: offsets follow the parameters."""
_MOST_STEPS, _MOST_SCALES = 60, 8
_DONE = 0.03
"""Step to the minimum, in standard deviations of it, that is not worth taking; a failed step this
short also ends the search: the cost jumps where a row changes its phase.
"""
_SETTLED = 0.02
"""Relative change of the rows' scale that is too small to change the fit."""
_LEAST_SHARE = 0.5
_SHORTEST, _LONGEST, _OF_A_CONTACT = 9, 25, 40
"""Rows whose residuals are judged together: a fortieth of those of a contact, within bounds."""
_CHANCE = 1e-6
"""Probability that noise alone makes such a stretch look disturbed."""
_MOST_DISTURBED = 0.3
"""Largest share of rows left out: with more, rod or object are not as stated."""
_UNEVEN = np.geomspace(1e-5, 1e-3, 13)
"""Sizes of the unevenness to try, in rod lengths: for 50 mm, half a micrometre to 50 µm."""
_BETTER = 4.0
"""How much better −2 ln(likelihood) must be than without: two standard deviations."""
_LITTLE = 1e-9
"""Information that stands for none, on a diagonal scaled to 1."""


def fitted(problem: Problem, start: Point) -> Linear:
    """Least-squares solution from a start, whose values may be for fewer unknowns.

    Raises
    ------
    CalibrationError
        If fewer than half of the rows have an equilibrium near the start.
    """
    values = np.zeros(len(problem.known))
    values[: len(start.values)] = start.values[: len(values)]
    linear = linearised(problem, start._replace(values=values))
    check_equilibria(linear)
    scale = math.inf
    for _ in range(_MOST_SCALES):
        before, scale = scale, linear.spread
        if math.isclose(before, scale, rel_tol=_SETTLED):
            break
        linear = _descended(linear, scale)
    return linear


def check_equilibria(linear: Linear) -> None:
    """Raise CalibrationError if fewer than half of the rows in contact have an equilibrium."""
    share = float(np.mean(linear.sound[linear.problem.rows.contact]))
    if share < _LEAST_SHARE:
        raise CalibrationError(
            f"for only {share:.0%} of the samples in contact the rod has an equilibrium on the "
            f"object as given; at least {_LEAST_SHARE:.0%} are needed: check the object's shape "
            "and pose, the clamp's pose, and the rod's length"
        )


def _descended(start: Linear, scale: float) -> Linear:
    """The cost's minimum for rows of this scale, or a point where they show another scale."""
    problem = start.problem
    limit = scale * problem.outlying
    offsets = np.diag(start.information(start.weights(scale)))[len(problem.free) :]
    units = np.append(_LONGEST_STEP * problem.scales, _MANY / np.sqrt(offsets))
    here = tried = start

    def at(x: Unknowns) -> Linear:
        nonlocal tried
        values = start.point.values + units * x
        for known in (here, tried):
            if np.array_equal(values, known.point.values):
                return known
        tried = linearised(problem, here.nearby(values))
        return tried

    def cost(x: Unknowns) -> float:
        """Huber's loss of each row's length, constant far out and without equilibrium."""
        there = at(x)
        near = np.minimum(np.where(there.sound, there.length, np.inf), FAR_OUT * limit)
        prior = problem.known * there.point.values
        return float(np.sum(huber(limit, near)[~problem.disturbed]) + prior @ prior / 2)

    def slope(x: Unknowns) -> Unknowns:
        nonlocal here
        here = at(x)
        return -units * here.downhill(here.weights(scale))

    @lru_cache(maxsize=1)
    def curved(there: Linear) -> Information:
        return there.information(there.weights(scale)) * np.outer(units, units)

    def stop(x: Unknowns) -> None:
        pull, matrix = slope(x), curved(here)
        failed = (tried.point.values - here.point.values) / units
        lengths = pull @ np.linalg.solve(matrix, pull), failed @ matrix @ failed or math.inf
        if min(lengths) < _DONE**2 or here.spread < scale / 2:
            raise StopIteration

    minimize(
        cost, np.zeros(len(units)), jac=slope, hess=lambda x: curved(at(x)), method="trust-exact",
        callback=stop,
        options={"initial_trust_radius": 1.0, "gtol": 0.0, "maxiter": _MOST_STEPS},
    )  # fmt: skip
    return here


def disturbed(linear: Linear) -> Chosen:
    """Rows in contact (n,) where many in succession do not fit, with two such stretches before and
    after: there the rod swings, or sticks and slips.

    Those found before if that would be more than three rows in ten: then the motion is not
    disturbed, but rod or object are not as stated.
    """
    problem, square = linear.problem, linear.spread**2
    cap = square * chi2.isf(OUTLYING, problem.freedom)
    length = np.where(linear.sound, np.minimum(linear.length**2, cap), cap)
    found = problem.disturbed.copy()
    for own in problem.rows.contacts:
        stretch = int(np.clip(len(own) // _OF_A_CONTACT, _SHORTEST, _LONGEST))
        allowed = square * chi2.isf(_CHANCE, stretch * problem.freedom) / stretch
        too_long = uniform_filter1d(length[own], stretch) > allowed
        found[own] |= maximum_filter1d(too_long, 4 * stretch + 1)
    share = np.mean(found[problem.rows.contact])
    return found if share <= _MOST_DISTURBED else problem.disturbed


def unevenness(linear: Linear) -> float:
    """Size [units of the rod] of the unevenness that makes the data most likely, with all else
    unknown; 0 if that is no better than none.

    Restricted maximum likelihood of the problem linearised about the point, over all other unknowns
    (Patterson and Thompson 1971).
    """
    problem, scale, length = linear.problem, linear.spread, float(linear.bench.length)
    even = len(problem.free) + problem.offsets(problem.known).size
    changed = replace(problem, unevenness=1.0)
    values = np.zeros(len(changed.known))
    values[:even] = linear.point.values[:even]
    flat = linearised(changed, Point(values, linear.point.states))
    weight = flat.weights(scale) / scale**2
    matrix, slope = flat.information(weight), flat.downhill(weight)
    uneven = np.arange(len(slope)) >= even
    matrix[uneven, uneven] -= 1.0
    unit = 1 / np.sqrt(np.where(uneven, 1.0, np.diag(matrix)))

    def badness(size: float) -> float:
        units = np.where(uneven, size * length, unit)
        scaled = matrix * np.outer(units, units) + np.diag(np.where(uneven, 1.0, _LITTLE))
        pull = slope * units
        return float(np.linalg.slogdet(scaled)[1] - pull @ np.linalg.solve(scaled, pull))

    found = [badness(size) for size in (0.0, *_UNEVEN)]
    best = int(np.argmin(found))
    return float(_UNEVEN[best - 1]) * length if found[best] < found[0] - _BETTER else 0.0
