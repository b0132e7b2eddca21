"""Weighted least squares on the readings, by Gauss–Newton steps with Levenberg's and Marquardt's
damping.

Unknown are the parameters φ, of each recording the tare and, if it is free, the drift, and with
friction of each row the tangential force, which is eliminated row by row. Rows that do not fit
weigh less (Huber), as where the rod swings. Where the data leave a combination of parameters open,
the damping keeps it.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter1d
from scipy.stats import chi2

from vibrissa.calibration.equilibrium import CORE, SHIFT_AT, STANDOFF_AT, Bench, Readings, readings
from vibrissa.calibration.parameters import Parameter, moved
from vibrissa.calibration.rows import CalibrationError, Rows
from vibrissa.surfaces import Surface

WRENCH = 6
_MOST_STEPS = 60
_MOST_TRIALS = 12
_DAMPING = 1e-3
_LONGEST_STEP = 0.25
_DONE = 1e-3
_OUTLYING = 1e-3
_MOST_LOST = 0.05
_FAR_OUT = 3.0
# Information added to each step, in the parameters' scales: what the data leave open stays where it
# is.
_FLOOR = 1.0
_LITTLE = 1e-9
_HELD = 1e-12
_MOST_LEANING = 3.0
_LEAST_SHARE = 0.5
# Rows whose residuals are judged together, a fortieth of those of a contact within these bounds,
# how seldom noise alone does the same, and which share of the rows may be left out.
_SHORTEST, _LONGEST, _OF_A_CONTACT = 9, 25, 40
_CHANCE = 1e-6
_MOST_DISTURBED = 0.3
# Places along a contact between which the surface's unevenness is interpolated, its sizes that are
# tried, in rod lengths, and by how much −2 ln(likelihood) has to be better than without.
_PLACES = 24
_UNEVEN = np.geomspace(1e-5, 1e-3, 13)
_BETTER = 4.0


@dataclass(frozen=True, eq=False)
class Problem:
    """What is fitted to what.

    Attributes
    ----------
    surface
        The object where it was given.
    rows
        The data.
    free
        Parameters of the bench.
    prior
        (parameters,) their standard deviations before the data, infinite for none.
    drift
        Standard deviation of the drift over a recording, in those of one sample; 0 for none.
    friction
        Coulomb's coefficient: the standard deviation given to each tangential force, in units of
        the normal one. Each row shows its own.
    disturbed
        (n,) rows that are left out, since they lie in a stretch that no equilibrium explains.
    unevenness
        Standard deviation by which the rod is taken to touch off the object as given, along its
        normal, changing along the sweep; 0 for none.
    """

    surface: Surface
    rows: Rows
    free: list[Parameter]
    prior: Float[np.ndarray, "parameters"]
    drift: float
    friction: float
    disturbed: Bool[np.ndarray, "n"]
    unevenness: float = 0.0

    @property
    def rubs(self) -> bool:
        """Whether there is friction."""
        return self.friction > 0

    @property
    def freedom(self) -> int:
        """Independent numbers of a row in contact: six, less the two of the tangential force."""
        return WRENCH - 2 if self.rubs else WRENCH

    @property
    def places(self) -> int:
        """Unknowns of the unevenness in each recording."""
        return _PLACES if self.unevenness > 0 else 0

    def without(self, index: int) -> "Problem":
        """The same with one parameter held."""
        free = [parameter for place, parameter in enumerate(self.free) if place != index]
        return replace(self, free=free, prior=np.delete(self.prior, index))


class Point(NamedTuple):
    """Where the iteration is: everything that is fitted, and the states of the rows in contact."""

    bench: Bench
    offsets: Float[np.ndarray, "recordings 12"]
    """Tare and drift."""
    states: Float[np.ndarray, "contacts 7"]
    step: Float[np.ndarray, "parameters"]
    """Steps of the parameters since the start, added up."""
    uneven: Float[np.ndarray, "recordings places"]
    """How far off the object as given the rod touches, at places along each contact."""


class Rubbing(NamedTuple):
    """Steps of the tangential forces: `still` less `slope` times the step of the unknowns."""

    still: Float[np.ndarray, "contacts 3"]
    slope: Float[np.ndarray, "contacts 3 unknowns"]


class Linear(NamedTuple):
    """The problem about a point, each row in its own standard deviations. Unknown are the
    parameters, all offsets, and the unevenness at all places.
    """

    point: Point
    readings: Readings
    sound: Bool[np.ndarray, "n"]
    residual: Float[np.ndarray, "n k"]
    """Reading less prediction. With friction three more rows hold the bound on the tangential
    force.
    """
    jacobian: Float[np.ndarray, "n k unknowns"]
    rubbing: "Rubbing | None"
    whitened: Float[np.ndarray, "n 6"]
    """Residual of the six channels before the tangential force is eliminated, by Cholesky's factor
    of the covariance.
    """
    predicted: Float[np.ndarray, "n 6"]

    @property
    def chi_square(self) -> Float[np.ndarray, "n"]:
        """Squared length of each row's residual in the six channels; NaN where there is no
        equilibrium.
        """
        return np.where(self.sound, np.sum(self.residual[:, :WRENCH] ** 2, axis=1), np.nan)


def linearised(problem: Problem, point: Point) -> Linear:
    """Readings, residuals and Jacobian about a point."""
    rows = problem.rows
    contact = rows.contact
    found = readings(
        problem.surface, point.bench, point.states, rows.pose[contact], rubs=problem.rubs
    )
    n = len(contact)
    offset_design = _offset_design(rows)
    predicted = np.einsum("nij,nj->ni", offset_design, point.offsets[rows.recording])
    predicted[contact] += found.wrench
    hats = _hats(problem)
    uneven = np.sum(hats * point.uneven[rows.recording], axis=1)
    predicted[contact] += np.where(
        found.sound[:, None], found.jacobian[:, :, STANDOFF_AT] * uneven[contact, None], 0.0
    )
    sound = np.ones(n, dtype=bool)
    sound[contact] = found.sound
    factor = _whitening(rows, found)
    core = np.zeros((n, WRENCH, CORE))
    core[contact] = found.jacobian
    directions = np.stack([parameter.direction for parameter in problem.free], axis=1)
    design = np.zeros(
        (n, WRENCH, len(problem.free) + (2 * WRENCH + problem.places) * rows.recordings)
    )
    design[:, :, : len(problem.free)] = core @ directions
    for recording in range(rows.recordings):
        own = rows.recording == recording
        first = len(problem.free) + 2 * WRENCH * recording
        design[own, :, first : first + 2 * WRENCH] = offset_design[own]
        first = len(problem.free) + 2 * WRENCH * rows.recordings + problem.places * recording
        design[own, :, first : first + problem.places] = (
            core[own, :, STANDOFF_AT, None] * hats[own, None, :]
        )
    whitened = np.einsum("nij,nj->ni", factor, rows.wrench - predicted)
    jacobian = factor @ design
    whitened[~sound], jacobian[~sound] = 0.0, 0.0
    if not problem.rubs:
        return Linear(point, found, sound, whitened, jacobian, None, whitened, predicted)
    residual, jacobian, rubbing = _without_rubbing(
        problem, point, found, factor, whitened, jacobian
    )
    return Linear(point, found, sound, residual, jacobian, rubbing, whitened, predicted)


def _whitening(rows: Rows, found: Readings) -> Float[np.ndarray, "n 6 6"]:
    """What takes each row's noise, with that of its position, to independent noise of deviation 1."""
    covariance = rows.covariance.copy()
    shift = found.jacobian[:, :, SHIFT_AT]
    covariance[rows.contact] += np.where(
        found.sound[:, None, None],
        shift @ rows.position_covariance[rows.contact] @ np.swapaxes(shift, 1, 2),
        0.0,
    )
    return np.linalg.inv(np.linalg.cholesky(covariance))


def whitened(
    problem: Problem, linear: Linear, columns: Float[np.ndarray, "contacts 6 m"]
) -> Float[np.ndarray, "n k m"]:
    """Changes of the readings in contact as further columns of the Jacobian."""
    contact, found = problem.rows.contact, linear.readings
    factor = _whitening(problem.rows, found)[contact]
    flat = np.where(found.sound[:, None, None], factor @ columns, 0.0)
    design = np.zeros((len(contact), linear.residual.shape[1], columns.shape[2]))
    if problem.rubs:
        flat = np.concatenate([flat, np.zeros((len(flat), 3, columns.shape[2]))], axis=1)
        flat = _projection(problem, found, factor)[1] @ flat
    design[contact] = flat
    return design


def thinned(problem: Problem, linear: Linear, every: int) -> tuple[Problem, Linear]:
    """Every so many rows of a problem and of its linearisation."""
    chosen = slice(None, None, every)
    rows = Rows(*(getattr(problem.rows, name)[chosen] for name in Rows.__dataclass_fields__))
    own = np.flatnonzero(np.arange(len(problem.rows.time))[problem.rows.contact] % every == 0)
    found = Readings(*(part[own] for part in linear.readings))
    fewer = {
        name: getattr(linear, name)[chosen]
        for name in ("sound", "residual", "jacobian", "whitened", "predicted")
    }
    point = linear.point._replace(states=linear.point.states[own])
    return replace(problem, rows=rows, disturbed=problem.disturbed[chosen]), linear._replace(
        point=point, readings=found, rubbing=None, **fewer
    )


def _offset_design(rows: Rows) -> Float[np.ndarray, "n 6 12"]:
    eye = np.broadcast_to(np.eye(WRENCH), (len(rows.time), WRENCH, WRENCH))
    return np.concatenate([eye, eye * rows.time[:, None, None]], axis=2)


def _hats(problem: Problem) -> Float[np.ndarray, "n places"]:
    """Share of each place in the unevenness at a row: piecewise linear in time, from the first to
    the last row in contact; 0 at rest.
    """
    rows = problem.rows
    hats = np.zeros((len(rows.time), problem.places))
    for recording in range(rows.recordings if problem.places else 0):
        own = rows.contact & (rows.recording == recording)
        time = rows.time[own]
        along = (time - time.min()) / max(float(np.ptp(time)), _LITTLE) * (problem.places - 1)
        hats[own] = np.maximum(0.0, 1 - np.abs(along[:, None] - np.arange(problem.places)))
    return hats


def _without_rubbing(
    problem: Problem,
    point: Point,
    found: Readings,
    factor: Float[np.ndarray, "n 6 6"],
    whitened: Float[np.ndarray, "n 6"],
    jacobian: Float[np.ndarray, "n 6 unknowns"],
) -> tuple[Float[np.ndarray, "n 9"], Float[np.ndarray, "n 9 unknowns"], Rubbing]:
    """Eliminate the tangential forces: residual and Jacobian on what they cannot explain (variable
    projection, Golub and Pereyra 1973).
    """
    contact = problem.rows.contact
    n, unknowns = len(contact), jacobian.shape[2]
    residual, design = np.zeros((n, WRENCH + 3)), np.zeros((n, WRENCH + 3, unknowns))
    residual[:, :WRENCH], design[:, :WRENCH] = whitened, jacobian
    residual[contact, WRENCH:] = -point.states[:, 4:] / problem.friction
    solve, project = _projection(problem, found, factor[contact])
    rubbing = Rubbing(np.einsum("nij,nj->ni", solve, residual[contact]), solve @ design[contact])
    residual[contact] = np.einsum("nij,nj->ni", project, residual[contact])
    design[contact] = project @ design[contact]
    return residual, design, rubbing


def _projection(
    problem: Problem, found: Readings, factor: Float[np.ndarray, "contacts 6 6"]
) -> tuple[Float[np.ndarray, "contacts 3 9"], Float[np.ndarray, "contacts 9 9"]]:
    """Tangential forces from residuals, and what of these they cannot explain."""
    slope = np.where(found.sound[:, None, None], factor @ found.rubbing, 0.0)
    slope = np.concatenate(
        [slope, np.broadcast_to(np.eye(3) / problem.friction, (len(slope), 3, 3))], axis=1
    )
    solve = np.linalg.solve(np.swapaxes(slope, 1, 2) @ slope, np.swapaxes(slope, 1, 2))
    return solve, np.eye(WRENCH + 3) - slope @ solve


def spread(problem: Problem, linear: Linear) -> float:
    """Median length of the residuals of rows in contact over that of noise alone, at least 1."""
    found = linear.chi_square[problem.rows.contact & linear.sound]
    return max(1.0, float(np.sqrt(np.median(found) / chi2.median(problem.freedom))))


def weights(problem: Problem, linear: Linear, scale: float) -> Float[np.ndarray, "n"]:
    """Weights (n,): 1 for 999 of 1000 rows of noise of this scale, less as Huber's beyond, and 0
    far out, without equilibrium or in a disturbed stretch.
    """
    limit = scale * np.sqrt(chi2.isf(_OUTLYING, problem.freedom))
    length = np.sqrt(np.sum(linear.residual**2, axis=1))
    return np.where(
        linear.sound & (length < _FAR_OUT * limit) & ~problem.disturbed,
        limit / np.maximum(length, limit),
        0.0,
    )


def disturbed(problem: Problem, linear: Linear) -> Bool[np.ndarray, "n"]:
    """Rows in contact (n,) where many in a row do not fit, with as many before and behind: there
    the rod swings, or sticks and slips.

    None where that would be more than three rows in ten: then it is not the rod that is disturbed,
    but rod or object are others.
    """
    scale = spread(problem, linear)
    cap = scale**2 * chi2.isf(_OUTLYING, problem.freedom)
    found = problem.disturbed.copy()
    for recording in range(problem.rows.recordings):
        own = np.flatnonzero(problem.rows.contact & (problem.rows.recording == recording))
        stretch = int(np.clip(len(own) // _OF_A_CONTACT, _SHORTEST, _LONGEST))
        if len(own) < stretch:
            continue
        allowed = scale**2 * chi2.isf(_CHANCE, stretch * problem.freedom) / stretch
        length = np.where(
            linear.sound[own], np.minimum(np.sum(linear.residual[own] ** 2, axis=1), cap), cap
        )
        too_long = uniform_filter1d(length, stretch) > allowed
        found[own] |= (
            uniform_filter1d(too_long.astype(float), 4 * stretch + 1, mode="constant") > _LITTLE
        )
    share = int(np.count_nonzero(found)) / max(1, int(np.count_nonzero(problem.rows.contact)))
    return found if share <= _MOST_DISTURBED else problem.disturbed


def with_unevenness(problem: Problem, point: Point, unevenness: float) -> tuple[Problem, Point]:
    """Another size of the unevenness, which is zero at first."""
    changed = replace(problem, unevenness=unevenness)
    return changed, point._replace(uneven=np.zeros((problem.rows.recordings, changed.places)))


def unevenness(problem: Problem, linear: Linear) -> float:
    """Size [units of the rod] of the unevenness that makes the data most likely, all else unknown;
    0 if that is no better than none.

    Restricted maximum likelihood of the problem linearised about the point, over all other unknowns
    (Patterson and Thompson 1971).
    """
    scale = spread(problem, linear)
    changed, point = with_unevenness(problem, linear.point, 1.0)
    flat = linearised(changed, point)
    weight = weights(changed, flat, scale) / scale**2
    matrix = information(changed, flat, weight)
    slope = np.einsum("n,nku,nk->u", weight, flat.jacobian, flat.residual)
    slope -= prior_system(changed, point)[1]
    uneven = np.arange(len(slope)) >= len(slope) - point.uneven.size
    matrix[uneven, uneven] -= 1.0
    # What the data leave open, as the roll, has no information, here as little for each size.
    known = np.sqrt(np.where(uneven | (np.diag(matrix) == 0), 1.0, np.diag(matrix)))
    length = float(point.bench.length)

    def badness(size: float) -> float:
        unit = np.where(uneven, size * length, 1 / known)
        scaled = matrix * np.outer(unit, unit) + np.diag(np.where(uneven, 1.0, _LITTLE))
        return float(
            np.linalg.slogdet(scaled)[1] - (slope * unit) @ np.linalg.solve(scaled, slope * unit)
        )

    found = [badness(size) for size in (0.0, *_UNEVEN)]
    best = int(np.argmin(found))
    return float(_UNEVEN[best - 1]) * length if best and found[best] < found[0] - _BETTER else 0.0


def _costs(problem: Problem, linear: Linear, trial: Linear, scale: float) -> tuple[float, float]:
    """Cost of two points, on the rows that have an equilibrium at both and are not far out at the
    first.
    """
    rows = trial.sound & (weights(problem, linear, scale) > 0)
    return _cost(problem, linear, scale, rows), _cost(problem, trial, scale, rows)


def _cost(problem: Problem, linear: Linear, scale: float, rows: Bool[np.ndarray, "n"]) -> float:
    limit = scale * np.sqrt(chi2.isf(_OUTLYING, problem.freedom))
    length = np.minimum(np.sqrt(np.sum(linear.residual[rows] ** 2, axis=1)), _FAR_OUT * limit)
    robust = np.where(length <= limit, length**2, limit * (2 * length - limit))
    return float(np.sum(robust) + np.sum(_prior_terms(problem, linear.point) ** 2))


def _prior_deviations(problem: Problem) -> Float[np.ndarray, "unknowns"]:
    """Of all unknowns; infinite where there is none."""
    rows = problem.rows
    offsets = np.full((rows.recordings, 2 * WRENCH), np.inf)
    for recording in range(rows.recordings):
        own = rows.recording == recording
        one = np.sqrt(
            np.median(
                np.diagonal(rows.covariance[own], axis1=1, axis2=2) * rows.count[own, None], axis=0
            )
        )
        offsets[recording, WRENCH:] = problem.drift * one
    return np.concatenate(
        [
            problem.prior,
            offsets.ravel(),
            np.full(rows.recordings * problem.places, problem.unevenness),
        ]
    )


def _prior_terms(problem: Problem, point: Point) -> Float[np.ndarray, "unknowns"]:
    values = np.concatenate([point.step, point.offsets.ravel(), point.uneven.ravel()])
    deviations = _prior_deviations(problem)
    return np.divide(values, deviations, out=np.zeros_like(values), where=deviations > 0)


def prior_system(
    problem: Problem, point: Point
) -> tuple[Float[np.ndarray, "unknowns"], Float[np.ndarray, "unknowns"]]:
    """Information of the priors on each unknown, and their gradient at a point."""
    deviations = _prior_deviations(problem)
    known = np.where(deviations > 0, 1 / np.maximum(deviations, _HELD) ** 2, 1 / _HELD**2)
    terms = _prior_terms(problem, point)
    return known, np.divide(terms, deviations, out=np.zeros_like(terms), where=deviations > 0)


def information(
    problem: Problem, linear: Linear, weight: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "unknowns unknowns"]:
    """Σ JᵀWJ with the priors; what is held, a drift of no deviation, is known for sure."""
    flat = linear.jacobian * np.sqrt(weight)[:, None, None]
    flat = flat.reshape(-1, flat.shape[2])
    return flat.T @ flat + np.diag(prior_system(problem, linear.point)[0])


def fitted(problem: Problem, start: Point) -> Linear:
    """Least-squares solution from a start.

    Raises
    ------
    CalibrationError
        If for less than half of the rows an equilibrium is found near the start.
    """
    linear = linearised(problem, start)
    _check_start(linear)
    damping = _DAMPING
    for _ in range(_MOST_STEPS):
        scale = spread(problem, linear)
        weight = weights(problem, linear, scale)
        matrix = information(problem, linear, weight)
        gradient = np.einsum("n,nku,nk->u", weight, linear.jacobian, linear.residual)
        gradient -= prior_system(problem, linear.point)[1]
        linear, damping, length = _improved(problem, linear, (matrix, gradient), scale, damping)
        if length < _DONE:
            break
    return linear


def _improved(
    problem: Problem,
    linear: Linear,
    system: tuple[np.ndarray, np.ndarray],
    scale: float,
    damping: float,
) -> tuple[Linear, float, float]:
    """Damped step that lowers the cost, the next damping, and the step's length in standard
    deviations; length 0 where no step does.
    """
    matrix, gradient = system
    units = np.concatenate(
        [
            [parameter.scale for parameter in problem.free],
            1 / np.sqrt(np.diag(matrix)[len(problem.free) :]),
        ]
    )
    scaled, slope = matrix * np.outer(units, units), gradient * units
    floor = np.diag(np.where(np.arange(len(units)) < len(problem.free), _FLOOR, _LITTLE))
    for _ in range(_MOST_TRIALS):
        damped = scaled + damping * np.diag(np.diag(scaled)) + floor
        step = np.linalg.solve(damped, slope)
        own = step[: len(problem.free)]
        step = step * min(1.0, _LONGEST_STEP / max(np.abs(own).max(), _LONGEST_STEP))
        trial = linearised(problem, _moved(problem, linear, step * units))
        before, after = _costs(problem, linear, trial, scale)
        if after <= before and np.mean(trial.sound) > np.mean(linear.sound) - _MOST_LOST:
            return trial, damping / 10, float(np.sqrt(step @ scaled @ step))
        damping = max(damping, _DAMPING) * 10
    return linear, damping, 0.0


def _moved(problem: Problem, linear: Linear, step: Float[np.ndarray, "unknowns"]) -> Point:
    count = len(problem.free)
    core = sum(
        (
            value * parameter.direction
            for value, parameter in zip(step[:count], problem.free, strict=True)
        ),
        start=np.zeros(CORE),
    )
    states = _mended(linear)
    if linear.rubbing is not None:
        turned = states[:, 4:] + np.where(
            linear.readings.sound[:, None], linear.rubbing.still - linear.rubbing.slope @ step, 0.0
        )
        states = np.concatenate(
            [states[:, :4], np.clip(turned, -_MOST_LEANING, _MOST_LEANING)], axis=1
        )
    point = linear.point
    offsets, uneven = np.split(step[count:], [point.offsets.size])
    return Point(
        moved(point.bench, core),
        point.offsets + offsets.reshape(point.offsets.shape),
        states,
        point.step + step[:count],
        point.uneven + uneven.reshape(point.uneven.shape),
    )


def _mended(linear: Linear) -> Float[np.ndarray, "contacts 7"]:
    """States to start from: where no equilibrium was found, that of the nearest row which has one."""
    sound = linear.readings.sound
    if sound.all():
        return linear.readings.state
    good = np.flatnonzero(sound)
    place = np.searchsorted(good, np.arange(len(sound))).clip(1, max(1, len(good) - 1))
    before, after = good[place - 1], good[np.minimum(place, len(good) - 1)]
    index = np.arange(len(sound))
    return linear.readings.state[np.where(index - before <= after - index, before, after)]


def _check_start(linear: Linear) -> None:
    share = float(np.mean(linear.readings.sound))
    if share < _LEAST_SHARE:
        raise CalibrationError(
            f"for {share:.0%} of the samples in contact the rod as given can touch the object as given; needed are at least {_LEAST_SHARE:.0%}: "
            "check the object's pose, the clamp's, and the rod's length"
        )
