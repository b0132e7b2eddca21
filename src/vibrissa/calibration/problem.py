"""What is fitted to what, and the problem linearised about a point.

Unknown are the parameters, of each recording the tare and, if it is free, the drift, how uneven the
object is, and with friction of each row the tangential force. Of this only a standard deviation is
known, the coefficient of friction: it adds to the row's covariance, and its estimate follows from
what the row leaves (a Gaussian unknown, marginalised).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from vibrissa.calibration.arrays import Chosen, Information, Numbers, Unknowns, Vectors, Wrenches
from vibrissa.calibration.bench import Bench, Step, moved_at_once
from vibrissa.calibration.equilibrium import Reading, State, readings
from vibrissa.calibration.parameters import Parameter, stepped
from vibrissa.calibration.rows import Rows
from vibrissa.geometry.rotation import cross_matrices
from vibrissa.surfaces import Surface

WRENCH = 6
PLACES = 24
"""Places along a contact between which the surface's unevenness is interpolated."""
OUTLYING = 1e-3
"""How seldom noise alone is farther out than where rows begin to weigh less."""
FAR_OUT = 3.0
"""Of that distance: rows farther out say nothing."""
_MOST_LEANING = 3.0
"""Tangential force over the normal one: no pair of materials has more."""


@dataclass(frozen=True, eq=False)
class Problem:
    """What is fitted to what.

    Attributes
    ----------
    surface
        The object where it was given.
    rows
        The data.
    start
        The bench that all steps start from.
    free
        Parameters of the bench.
    prior
        (parameters,) standard deviations of their steps before the data.
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
    start: Bench
    free: list[Parameter]
    prior: Float[np.ndarray, "parameters"]
    drift: float
    friction: float
    disturbed: Chosen
    unevenness: float = 0.0

    @property
    def freedom(self) -> int:
        """Independent numbers of a row in contact: six, less the two of the tangential force."""
        return WRENCH - 2 if self.friction > 0 else WRENCH

    @property
    def scales(self) -> Float[np.ndarray, "parameters"]:
        """Gross changes of the parameters."""
        return np.array([one.scale for one in self.free])

    @cached_property
    def trends(self) -> Float[np.ndarray, "n trends"]:
        """Share of tare and drift in each row."""
        time = self.rows.time
        return np.stack([np.ones_like(time), time], axis=1)[:, : 2 if self.drift > 0 else 1]

    @cached_property
    def hats(self) -> Float[np.ndarray, "n places"]:
        """Share of each place in the unevenness at a row: piecewise linear in time, from the first
        to the last row in contact; 0 at rest.
        """
        rows, places = self.rows, PLACES if self.unevenness > 0 else 0
        hats = np.zeros((len(rows.time), places))
        for recording in range(rows.recordings if places else 0):
            own = rows.contact & (rows.recording == recording)
            along = np.interp(rows.time[own], rows.time[own][[0, -1]], [0, places - 1])
            hats[own] = np.maximum(0.0, 1 - np.abs(along[:, None] - np.arange(places)))
        return hats

    @cached_property
    def known(self) -> Unknowns:
        """Inverse standard deviations of all unknowns before the data."""
        rows = self.rows
        offsets = np.zeros((rows.recordings, self.trends.shape[1], WRENCH))
        for recording in range(rows.recordings if self.drift > 0 else 0):
            own = rows.recording == recording
            variances = np.diagonal(rows.covariance[own], axis1=1, axis2=2)
            one = np.median(variances * rows.samples[own, None], axis=0)
            offsets[recording, 1] = 1 / (self.drift * np.sqrt(one))
        uneven = np.full(self.hats.shape[1] * rows.recordings, 1 / (self.unevenness or 1.0))
        return np.concatenate([1 / self.prior, offsets.ravel(), uneven])

    def bench(self, values: Unknowns) -> Bench:
        """After steps of the parameters, the first of the unknowns."""
        step = stepped(self.free, values[: len(self.free)])
        return jax.tree.map(np.asarray, moved_at_once(self.start, step))

    def offsets(self, values: Unknowns) -> Float[np.ndarray, "recordings trends 6"]:
        """Tare and drift among the unknowns, or among numbers that belong to them."""
        shape = (self.rows.recordings, self.trends.shape[1], WRENCH)
        return values[len(self.free) :][: int(np.prod(shape))].reshape(shape)

    def without(self, names: "dict[str, tuple[str, ...]]") -> "Problem":
        """With some parameters held, and an even object."""
        keep = [index for index, one in enumerate(self.free) if one.name not in names]
        free = [self.free[index] for index in keep]
        return replace(self, free=free, prior=self.prior[keep], unevenness=0.0)


class Point(NamedTuple):
    """Where the iteration is."""

    values: Unknowns
    """Steps of the parameters since the start, tare and drift, and how far off the object as given
    the rod touches at places along each contact.
    """
    states: State


@dataclass(frozen=True, eq=False)
class Linear:
    """The problem about a point.

    Attributes
    ----------
    point, bench, reading
        Where it is, and what rows in contact read there.
    by_step
        Derivatives of all rows by small steps of the bench, 0 without contact or equilibrium.
    contact, sound
        (n,) rows in contact, and those that rest or have an equilibrium.
    predicted
        (n, 6) readings.
    left
        (n, 6) readings less those predicted without tangential force.
    design
        (n, 6, unknowns) derivatives of the readings.
    weighing
        (n, 6, 6) what takes readings to independent noise of deviation 1, tangential forces being
        noise; 0 for rows that are not sound.
    channels
        (n, 6, 6) the same for what is left when the tangential force is estimated.
    leaning
        (contacts, 3, 6) from what is left to tangential forces.
    """

    point: Point
    bench: Bench
    reading: Reading
    by_step: Step
    contact: Chosen
    sound: Chosen
    predicted: Wrenches
    left: Wrenches
    design: Float[np.ndarray, "n 6 unknowns"]
    weighing: Float[np.ndarray, "n 6 6"]
    channels: Float[np.ndarray, "n 6 6"]
    leaning: Float[np.ndarray, "contacts 3 6"]

    @cached_property
    def residual(self) -> Wrenches:
        """What is left, in standard deviations."""
        return _by(self.weighing, self.left)

    @cached_property
    def jacobian(self) -> Float[np.ndarray, "n 6 unknowns"]:
        """Derivatives of the readings, in standard deviations."""
        return self.weighing @ self.design

    @cached_property
    def whitened(self) -> Wrenches:
        """What no tangential force explains, in the channels' standard deviations."""
        return _by(self.channels, self.left)

    @cached_property
    def length(self) -> Numbers:
        """Of the residuals."""
        return np.linalg.norm(self.residual, axis=1)

    @property
    def chi_square(self) -> Numbers:
        """Squared length of each row's whitened channels; NaN where there is no equilibrium."""
        return np.where(self.sound, np.sum(self.whitened**2, axis=1), np.nan)


def _by(matrix: Float[np.ndarray, "n i j"], vector: Float[np.ndarray, "n j"]) -> np.ndarray:
    return np.einsum("nij,nj->ni", matrix, vector)


def linearised(problem: Problem, point: Point) -> Linear:
    """Readings, residuals and derivatives about a point."""
    rows, contact = problem.rows, problem.rows.contact
    bench, count = problem.bench(point.values), len(problem.free)
    found = readings(
        problem.surface, bench, point.states, jax.tree.map(lambda part: part[contact], rows.pose)
    )
    sound = np.ones(len(contact), dtype=bool)
    sound[contact] = found.sound

    def everywhere(part: Float[np.ndarray, "contacts *k"]) -> Float[np.ndarray, "n *k"]:
        whole = np.zeros((len(contact), *part.shape[1:]))
        whole[contact & sound] = part[found.sound]
        return whole

    by_step: Step = jax.tree.map(everywhere, found.by_step)
    by_leaning, leaning = everywhere(found.by_leaning), everywhere(found.state.leaning)
    parameters = np.stack([one.column(by_step) for one in problem.free], axis=2)
    ours = np.eye(rows.recordings)[rows.recording]
    offsets = np.einsum("nr,nt,ij->nirtj", ours, problem.trends, np.eye(WRENCH))
    uneven = np.einsum("nr,ni,np->nirp", ours, by_step.standoff[..., 0], problem.hats)
    shape = (len(contact), WRENCH, -1)
    linear = np.concatenate([offsets.reshape(shape), uneven.reshape(shape)], axis=2)
    predicted = everywhere(found.wrench) + linear @ point.values[count:]
    # The torque's and the pose's noise, in what the sensor reads.
    shift, turn = by_step.shift, by_turn(by_step, bench.center - rows.noise.center)
    covariance = (
        rows.covariance
        + shift @ rows.noise.position @ np.swapaxes(shift, 1, 2)
        + turn @ rows.noise.rotation @ np.swapaxes(turn, 1, 2)
    )
    rubbing = problem.friction * by_leaning
    whole = covariance + rubbing @ np.swapaxes(rubbing, 1, 2)
    explained = covariance @ np.linalg.inv(whole)
    root, white = (np.linalg.inv(np.linalg.cholesky(part)) for part in (whole, covariance))
    return Linear(
        point=Point(point.values, found.state),
        bench=bench,
        reading=found,
        by_step=by_step,
        contact=contact,
        sound=sound,
        predicted=predicted,
        left=rows.wrench - predicted + _by(by_leaning, leaning),
        design=np.concatenate([parameters, linear], axis=2),
        weighing=np.where(sound[:, None, None], root, 0.0),
        channels=np.where(sound[:, None, None], white @ explained, 0.0),
        leaning=problem.friction * np.linalg.solve(whole, rubbing)[contact].swapaxes(1, 2),
    )


def by_turn(by_step: Step, arm: Vectors) -> Float[np.ndarray, "n 6 3"]:
    """Derivatives of readings by a turn of the object about points from which its pivot is `arm`
    away; those by a turn of sensor and rod about them are the opposite.
    """
    return by_step.turn - by_step.shift @ cross_matrices(arm)


def nearby(linear: Linear, values: Unknowns) -> Point:
    """Other values of the unknowns: the rows' states follow in the next linearisation, tangential
    forces at once. Rows without equilibrium start from their nearest neighbour's.
    """
    left = linear.left - linear.design @ (values - linear.point.values)
    state, sound = linear.reading.state, linear.reading.sound
    forces = _by(linear.leaning, left[linear.contact])
    state = state._replace(
        leaning=np.where(
            sound[:, None], np.clip(forces, -_MOST_LEANING, _MOST_LEANING), state.leaning
        )
    )
    good = np.flatnonzero(sound)
    if good.size:
        nearest = np.interp(np.arange(len(sound)), good, np.arange(len(good)))
        own = good[np.round(nearest).astype(int)]
        state = jax.tree.map(lambda part: part[own], state)
    return Point(values, state)


def spread(problem: Problem, linear: Linear) -> float:
    """Median length of the residuals of rows in contact over that of noise alone, at least 1."""
    found = linear.chi_square[problem.rows.contact & linear.sound]
    return max(1.0, float(np.sqrt(np.median(found) / chi2.median(problem.freedom))))


def outlying(problem: Problem) -> float:
    """Length of a residual from which a row weighs less."""
    return float(np.sqrt(chi2.isf(OUTLYING, problem.freedom)))


def weights(problem: Problem, linear: Linear, scale: float) -> Numbers:
    """Weights (n,): 1 for 999 of 1000 rows of noise of this scale, less as Huber's beyond, and 0
    far out, without equilibrium or in a disturbed stretch.
    """
    limit = scale * outlying(problem)
    return np.where(
        linear.sound & (linear.length < FAR_OUT * limit) & ~problem.disturbed,
        limit / np.maximum(linear.length, limit),
        0.0,
    )


def information(problem: Problem, linear: Linear, weight: Numbers) -> Information:
    """Σ JᵀWJ with the priors."""
    flat = linear.jacobian * np.sqrt(weight)[:, None, None]
    flat = flat.reshape(-1, flat.shape[2])
    return flat.T @ flat + np.diag(problem.known**2)


def downhill(problem: Problem, linear: Linear, weight: Numbers) -> Unknowns:
    """Σ JᵀWr with the priors: the gradient of half the cost, with the opposite sign."""
    pull = np.einsum("n,nku,nk->u", weight, linear.jacobian, linear.residual, optimize=True)
    return pull - problem.known**2 * linear.point.values
