"""The data and unknowns of the fit, and the problem linearised about a point.

The unknowns are the parameters, the tare of each recording and, if free, its drift, the object's
unevenness and, with friction, the tangential force of each row. Only a standard deviation of that
force is known, the friction coefficient: it adds to the row's covariance, and the force's estimate
follows from the row's residual (a Gaussian unknown, marginalised).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Shaped
from scipy.stats import chi2

from vibrissa.calibration.arrays import Chosen, Information, Numbers, Unknowns, Wrenches
from vibrissa.calibration.bench import Bench, moved_at_once
from vibrissa.calibration.equilibrium import Reading, State, free_readings, readings
from vibrissa.calibration.parameters import Parameter, stepped
from vibrissa.calibration.rows import Rows
from vibrissa.numerics.progress import Guess
from vibrissa.surfaces import Surface

WRENCH = 6
PLACES = 24
"""Places along a contact between which the surface's unevenness is interpolated."""
OUTLYING = 1e-3
"""Probability that noise alone lies beyond the distance from which rows weigh less."""
FAR_OUT = 3.0
"""Multiple of that distance beyond which rows have no weight."""
_MOST_LEANING = 3.0
"""Largest tangential force over normal force: no pair of materials has more."""


@dataclass(frozen=True, eq=False)
class Problem:
    """The data and unknowns of the fit.

    Attributes
    ----------
    surface
        The object at its given pose.
    rows
        The data.
    start
        The bench that all steps start from.
    free
        Parameters of the bench.
    prior
        (parameters,) prior standard deviations of their steps.
    drift
        Whether drift is free; its prior standard deviation over a recording is that of one sample.
    friction
        Coulomb's coefficient: the standard deviation given to each tangential force, in units of
        the normal force. Each row has its own.
    disturbed
        (n,) rows left out because they lie in a stretch that no equilibrium explains.
    unevenness
        Standard deviation assumed for the gap at which the rod touches the object as given, along
        the normal and varying along the sweep; 0 for none.
    steps
        Counts the linearisations, and the score tests.
    """

    surface: Surface
    rows: Rows
    start: Bench
    free: list[Parameter]
    prior: Float[np.ndarray, "parameters"]
    drift: bool
    friction: float
    disturbed: Chosen
    unevenness: float = 0.0
    steps: Guess = field(default_factory=lambda: Guess(None, 0))

    @property
    def freedom(self) -> int:
        """Degrees of freedom of a row in contact: six, less two for a tangential force."""
        return WRENCH - 2 if self.friction > 0 else WRENCH

    @property
    def outlying(self) -> float:
        """Residual length from which a row weighs less."""
        return float(np.sqrt(chi2.isf(OUTLYING, self.freedom)))

    @property
    def scales(self) -> Float[np.ndarray, "parameters"]:
        """Gross changes of the parameters."""
        return np.array([one.scale for one in self.free])

    @cached_property
    def trends(self) -> Float[np.ndarray, "n trends"]:
        """Share of tare and drift in each row."""
        return np.vander(self.rows.time, 1 + self.drift, increasing=True)

    @cached_property
    def hats(self) -> Float[np.ndarray, "n places"]:
        """Weight of each place in the unevenness at a row: piecewise linear in time, from the first
        to the last row in contact; 0 at rest.
        """
        places = np.arange(PLACES if self.unevenness > 0 else 0)
        hats = np.zeros((len(self.rows.time), len(places)))
        for own in self.rows.contacts:
            time = self.rows.time[own]
            along = np.interp(time, time[[0, -1]], [0, PLACES - 1])
            hats[own] = np.maximum(0.0, 1 - np.abs(along[:, None] - places))
        return hats

    @cached_property
    def known(self) -> Unknowns:
        """Inverse prior standard deviations of all unknowns."""
        rows = self.rows
        variances = np.diagonal(rows.covariance, axis1=1, axis2=2) * rows.samples[:, None]
        of_sample = [
            np.median(variances[rows.recording == one], axis=0) for one in range(rows.recordings)
        ]
        offsets = np.zeros((rows.recordings, self.trends.shape[1], WRENCH))
        offsets[:, 1:] = 1 / np.sqrt(of_sample)[:, None]
        uneven = np.full(self.hats.shape[1] * rows.recordings, 1 / (self.unevenness or 1.0))
        return np.concatenate([1 / self.prior, offsets.ravel(), uneven])

    def bench(self, values: Unknowns) -> Bench:
        """The bench after steps of the parameters, the first of the unknowns."""
        step = stepped(self.free, values[: len(self.free)], self.start)
        return jax.tree.map(np.asarray, moved_at_once(self.start, step))

    def offsets(self, values: Unknowns) -> Float[np.ndarray, "recordings trends 6"]:
        """Tare and drift among the unknowns, or among numbers in the same order."""
        shape = (self.rows.recordings, self.trends.shape[1], WRENCH)
        return values[len(self.free) :][: np.prod(shape)].reshape(shape)


class Point(NamedTuple):
    """Where the iteration is."""

    values: Unknowns
    """Steps of the parameters since the start, tare and drift, and the gaps at which the rod
    touches the object as given, at places along each contact.
    """
    states: State
    """States of the rows in contact."""


@dataclass(frozen=True, eq=False)
class Linear:
    """The problem linearised about a point.

    Attributes
    ----------
    problem, point, bench
        The problem, the point, and the bench there.
    reading
        Of all rows; 0 for those without equilibrium, and at rest but for what loads along the rod
        do.
    sound
        (n,) rows at rest or with an equilibrium.
    predicted
        (n, 6) readings.
    left
        (n, 6) readings less those predicted without tangential force.
    design
        (n, 6, unknowns) derivatives of the readings.
    weighing
        (n, 6, 6) whitens readings to independent noise of deviation 1, tangential forces counting
        as noise; 0 for rows that are not sound.
    channels
        (n, 6, 6) the same for what is left once the tangential force is estimated.
    leaning
        (n, 3, 6) maps what is left to tangential forces.
    """

    problem: Problem
    point: Point
    bench: Bench
    reading: Reading
    sound: Chosen
    predicted: Wrenches
    left: Wrenches
    design: Float[np.ndarray, "n 6 unknowns"]
    weighing: Float[np.ndarray, "n 6 6"]
    channels: Float[np.ndarray, "n 6 6"]
    leaning: Float[np.ndarray, "n 3 6"]

    @cached_property
    def residual(self) -> Wrenches:
        """What is `left`, in standard deviations."""
        return by_rows(self.weighing, self.left)

    @cached_property
    def jacobian(self) -> Float[np.ndarray, "n 6 unknowns"]:
        """Derivatives of the readings, in standard deviations."""
        return self.weighing @ self.design

    @cached_property
    def whitened(self) -> Wrenches:
        """What no tangential force explains, in the channels' standard deviations."""
        return by_rows(self.channels, self.left)

    @cached_property
    def length(self) -> Numbers:
        """Length of each row's residual."""
        return np.linalg.norm(self.residual, axis=1)

    @property
    def chi_square(self) -> Numbers:
        """Squared length of each row's whitened channels; NaN where there is no equilibrium."""
        return np.where(self.sound, np.sum(self.whitened**2, axis=1), np.nan)

    @cached_property
    def spread(self) -> float:
        """Median length of the residuals of rows in contact over that of noise alone, at least
        1.
        """
        median = np.nanmedian(self.chi_square[self.problem.rows.contact])
        return max(1.0, float(np.sqrt(median / chi2.median(self.problem.freedom))))

    def weights(self, scale: float) -> Numbers:
        """Weights (n,): 1 for 999 of 1000 rows with noise of this scale, Huber's weight beyond, and
        0 far out, without equilibrium or in a disturbed stretch.
        """
        limit = scale * self.problem.outlying
        counts = self.sound & (self.length < FAR_OUT * limit) & ~self.problem.disturbed
        return np.where(counts, limit / np.maximum(self.length, limit), 0.0)

    def information(self, weight: Numbers) -> Information:
        """Σ JᵀWJ with the priors."""
        flat = self.jacobian * np.sqrt(weight)[:, None, None]
        flat = flat.reshape(-1, flat.shape[2])
        return flat.T @ flat + np.diag(self.problem.known**2)

    def downhill(self, weight: Numbers) -> Unknowns:
        """Σ JᵀWr with the priors: the negative gradient of the cost."""
        pull = np.einsum("n,nku,nk->u", weight, self.jacobian, self.residual, optimize=True)
        return pull - self.problem.known**2 * self.point.values

    def nearby(self, values: Unknowns) -> Point:
        """A point with other values of the unknowns: the rows' states follow in the next
        linearisation, tangential forces at once. Rows without equilibrium start from the state of
        their nearest neighbour that has one.
        """
        left = self.left - self.design @ (values - self.point.values)
        forces = np.clip(by_rows(self.leaning, left), -_MOST_LEANING, _MOST_LEANING)
        contact = np.flatnonzero(self.problem.rows.contact)
        good = np.flatnonzero(self.reading.sound[contact])
        if not good.size:
            return Point(values, self.point.states)
        nearest = np.interp(np.arange(len(contact)), good, np.arange(len(good)))
        own = contact[good[np.round(nearest).astype(int)]]
        state = self.reading.state._replace(leaning=forces)
        return Point(values, jax.tree.map(lambda part: part[own], state))

    def without(self, names: "dict[str, tuple[str, ...]]") -> tuple[Problem, Point]:
        """The problem with some parameters held and an even object, and where to continue from."""
        problem, (values, states) = self.problem, self.point
        keep = [one.name not in names for one in problem.free]
        left = replace(
            problem,
            free=list(compress(problem.free, keep)),
            prior=problem.prior[keep],
            unevenness=0.0,
        )
        steps, others = np.split(values, [len(keep)])
        return left, Point(np.append(steps[keep], others), states)


def _weigh(reading: Reading, bench: Bench, rows: Rows) -> None:
    """Add what loads along the rod make the sensor read at rest."""
    rest = np.flatnonzero(~rows.contact)
    free = free_readings((bench, np.ones(1)), jax.tree.map(lambda part: part[rest], rows.pose))
    reading.wrench[rest] = free.wrench
    for whole, part in zip(reading.by_step, free.by_step, strict=True):
        whole[rest] = part


def by_rows(matrix: Float[np.ndarray, "n i j"], vector: Float[np.ndarray, "n j"]) -> np.ndarray:
    """Each row's matrix times its vector (n, i)."""
    return np.einsum("nij,nj->ni", matrix, vector)


def linearised(problem: Problem, point: Point) -> Linear:
    """Readings, residuals and derivatives about a point."""
    rows, count = problem.rows, len(problem.free)
    bench = problem.bench(point.values)
    poses = jax.tree.map(lambda part: part[rows.contact], rows.pose)
    found = readings((problem.surface, bench), point.states, poses)
    place = np.flatnonzero(rows.contact)[found.sound]

    def everywhere(part: Shaped[np.ndarray, "contacts *k"]) -> Shaped[np.ndarray, "n *k"]:
        whole = np.zeros((len(rows.time), *part.shape[1:]), part.dtype)
        whole[place] = part[found.sound]
        return whole

    reading: Reading = jax.tree.map(everywhere, found)
    if bench.loaded:
        _weigh(reading, bench, rows)
    step, ours = reading.by_step, np.eye(rows.recordings)[rows.recording]
    parameters = np.stack([one.column(step) for one in problem.free], axis=2)
    offsets = np.einsum("nr,nt,ij->nirtj", ours, problem.trends, np.eye(WRENCH))
    uneven = np.einsum("nr,ni,np->nirp", ours, step.standoff[..., 0], problem.hats)
    shape = (len(rows.time), WRENCH, -1)
    design = np.concatenate([parameters, offsets.reshape(shape), uneven.reshape(shape)], axis=2)
    predicted = reading.wrench + design[..., count:] @ point.values[count:]
    # Noise of wrench and pose, in the readings.
    noise = rows.noise
    turn = reading.by_turn(bench.center - noise.center)
    covariance = (
        rows.covariance
        + step.shift @ noise.position @ step.shift.swapaxes(1, 2)
        + turn @ noise.rotation @ turn.swapaxes(1, 2)
    )
    rubbing = problem.friction * reading.by_leaning
    whole = covariance + rubbing @ rubbing.swapaxes(1, 2)
    explained = covariance @ np.linalg.inv(whole)
    root, white = (np.linalg.inv(np.linalg.cholesky(part)) for part in (whole, covariance))
    sound = reading.sound | ~rows.contact
    problem.steps.step()
    return Linear(
        problem=problem,
        point=Point(point.values, found.state),
        bench=bench,
        reading=reading,
        sound=sound,
        predicted=predicted,
        left=rows.wrench - predicted + by_rows(reading.by_leaning, reading.state.leaning),
        design=design,
        weighing=np.where(sound[:, None, None], root, 0.0),
        channels=np.where(sound[:, None, None], white @ explained, 0.0),
        leaning=problem.friction * np.linalg.solve(whole, rubbing).swapaxes(1, 2),
    )
