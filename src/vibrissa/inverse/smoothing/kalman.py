"""Fixed-interval smoothing of a linear Gaussian model, one scalar observation at a time.

Durbin & Koopman, *Time Series Analysis by State Space Methods*, 2nd ed., sections 4.4 and 6.4. No
matrix is inverted, so states may be known exactly: a rod in tip contact, or without contact.

The state holds the contact's coordinates x, their rates v and the drift d of the sensor's zero.
Between samples x is driven by white acceleration of spectral density q (an integrated Wiener
process) and d by white noise:

    x' = v,    v' = √q ẇ,    d' = √q_d ẇ.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.inverse.smoothing.manifold import AT_REST, COORDINATES
from vibrissa.numerics.compiled import compiled
from vibrissa.numerics.lanes import lanes
from vibrissa.numerics.rows import row_of, with_row

WRENCH = 6
ROWS = WRENCH + 2
"""Observations of a sample: the whitened wrench, then the constraints: s₁ where it is the rod's
length, and k² where the contact is tangential.
"""
PLACE, RATE, DRIFT = (
    slice(0, COORDINATES),
    slice(COORDINATES, 2 * COORDINATES),
    slice(2 * COORDINATES, 2 * COORDINATES + WRENCH),
)
"""Entries of the state: x, v, d."""
SIZE = DRIFT.stop
INTENSITIES = 5
"""Spectral densities per second: of the accelerations of the moment, the axial force, the arc
length and the tilt, and of the drift in standard deviations of a sample."""

_SOFT = 1e-9
"""Variance of k² above which it is a soft constraint: far above that of an exact one, 1e-12, and
far below any from friction or from a setup's tolerances.
"""
_BUCKET = 512
"""Rows are padded to multiples of it: each length is compiled anew, and a recording has several."""

Tree = TypeVar("Tree")
Intensities = Float[Any, "intensities"]
Vector = Float[Array, "state"]
State = Float[Array, "state *k"]
Square = Float[Array, "state state"]
Seen = tuple[Array, ...]
"""Outcome of a sample's observations, one per row: innovation (observed, *k) and its variance
(observed), infinite where nothing was observed.
"""


class Gaussian(NamedTuple):
    """Mean and covariance."""

    mean: Float[Any, "*n state"]
    covariance: Float[Any, "*n state state"]


class Step(NamedTuple):
    """How the state enters a sample and moves to it, and what the sample shows; for a series, one
    row per sample.
    """

    keep: Float[Any, "*n state"]
    """1 for entries that continue, 0 for entries that start anew."""
    begin: Float[Any, "*n state"]
    """Values of those that start anew."""
    spread: Float[Any, "*n state"]
    """Variances added."""
    active: Float[Any, "*n coordinates"]
    """Fraction of the time since the previous sample in which each coordinate moves; 0 for known
    ones.
    """
    duration: Float[Any, "*n"]
    """Since the previous sample [s]."""
    pace: Float[Any, "*n"]
    """Factor on the intensities of moment and axial force."""
    target: Float[Any, "*n observed"]
    """Observed values; with a further axis, those of several series that differ only in them."""
    slope: Float[Any, "*n observed coordinates"]
    """Their derivatives with respect to the coordinates; the wrench also shows the drift."""
    variance: Float[Any, "*n observed"]
    """Of the observations; infinite where there is none."""


class States(NamedTuple):
    """States given all samples, and how the samples from each one on contradict its prediction
    (Durbin & Koopman, eq. 4.44).
    """

    mean: Float[Any, "n state *k"]
    covariance: Float[Any, "n state state"]
    pull: Float[Any, "n state *k"]
    """r: zero on average, with covariance `information`. Large where the state jumps on the way to
    the sample (section 7.5).
    """
    information: Float[Any, "n state state"]
    score: Float[Any, "n intensities"]
    """Of the log-likelihood: each step's share of its derivative with respect to the logarithms of
    the intensities, half the trace of (r rᵀ − N) ∂Q (Koopman & Shephard, *Biometrika* 79, 1992).
    """
    log_likelihood: Float[Any, "n *k"]
    """Of each sample, given the previous ones."""
    expected_zero: Gaussian
    """Drift of the sensor's zero given the previous samples only."""

    @property
    def zero(self) -> Gaussian:
        """Drift of the sensor's zero given all samples."""
        return Gaussian(self.mean[:, DRIFT], self.covariance[:, DRIFT, DRIFT])


def at_rest(zero: Gaussian) -> Gaussian:
    """State of a rod free of contact, given what is known about the drift."""
    covariance = np.zeros((SIZE, SIZE))
    covariance[DRIFT, DRIFT] = zero.covariance
    return Gaussian(np.concatenate([AT_REST, np.zeros(COORDINATES), zero.mean]), covariance)


def entered(
    state: Gaussian, keep: Vector, begin: Float[Array, "state *columns"], spread: Vector
) -> Gaussian:
    """State as it enters a sample; several columns if they start anew with different values."""
    mean, covariance = state
    covariance = keep[:, None] * covariance * keep + jnp.diag(spread)
    return Gaussian((keep * mean.T + begin.T).T, covariance)


def predicted(state: Gaussian, step: Step, intensities: Intensities) -> Gaussian:
    """State before the sample is seen, from the state that entered it."""
    spread = moved(step, moved(step, state.covariance).T)
    return Gaussian(moved(step, state.mean), spread + _process_noise(step, intensities))


def arriving(state: Gaussian, step: Step, intensities: Intensities) -> Gaussian:
    """State before the sample is seen, from that after the previous sample."""
    return predicted(entered(state, *step[:3]), step, intensities)


def moved(step: Step, rows: State) -> State:
    """From the previous sample to this one: x + v dt, for each column."""
    return rows.at[PLACE].add((step.active * step.duration * rows[RATE].T).T)


def updated(state: Gaussian, step: Step) -> tuple[Gaussian, Seen]:
    """State after the sample is seen, and the outcome of its observations, one after the other."""
    (mean, covariance), told = state, []
    for z, target, variance in zip(design(step), step.target, step.variance, strict=True):
        known, direction = jnp.isfinite(variance), covariance @ z
        spread = z @ direction + jnp.where(known, variance, 1.0)
        innovation = jnp.where(known, target - z @ mean, 0.0)
        gain = jnp.where(known, direction / spread, 0.0)
        mean = mean + jnp.tensordot(gain, innovation, 0)
        covariance = covariance - jnp.outer(gain, direction)
        told.append((innovation, jnp.where(known, spread, jnp.inf)))
    seen = tuple(map(jnp.stack, zip(*told, strict=True)))
    return Gaussian(mean, (covariance + covariance.T) / 2), seen


def design(step: Step) -> Float[Array, "observed state"]:
    """Observation matrix: what the observations show of the state."""
    drift = jnp.eye(ROWS, WRENCH)
    return jnp.concatenate([step.slope, jnp.zeros((ROWS, COORDINATES)), drift], axis=1)


def log_likelihood(step: Step, seen: Seen) -> Float[Array, "*k"]:
    """Of a sample, given those before. A soft constraint is not a datum: it weights the states, and
    one that does not restrict them costs nothing.
    """
    soft = jnp.asarray(step.variance) > jnp.full(ROWS, jnp.inf).at[-1].set(_SOFT)
    return _log_density(seen, jnp.where(soft, seen[1] / step.variance, 2 * jnp.pi * seen[1]))


def _log_density(seen: Seen, size: Float[Array, "observed"]) -> Float[Array, "*k"]:
    innovation, spread = seen
    size, spread = (jnp.where(jnp.isfinite(spread), part, 1.0) for part in (size, spread))
    return -0.5 * jnp.sum(jnp.log(size) + innovation.T**2 / spread, axis=-1)


def filled(rows: Tree, size: int = _BUCKET) -> Tree:
    """Padded to a multiple of a size with rows that loops skip."""
    whole = -(-len(jax.tree.leaves(rows)[0]) // size) * size
    return jax.tree.map(lambda part: np.resize(part, (whole, *part.shape[1:])), rows)


def scanned(
    one: Callable[..., Any], carry: Any, rows: Any, count: Any, *, back: bool = False
) -> Any:
    """`lax.scan` over the first `count` rows, in reverse if `back`: compiled once for any number of
    rows up to those present.
    """

    def step(number: Array, state: Any) -> Any:
        index = count - 1 - number if back else number
        after, told = one(state[0], row_of(rows, index))
        return after, with_row(state[1], told, index)

    _, told = jax.eval_shape(jax.vmap(one, (None, 0)), carry, rows)
    return lax.fori_loop(0, count, step, (carry, jax.tree.map(jnp.zeros_like, told)))


@compiled
def _smoothed(
    steps: Step, count: Int[Any, ""], intensities: Intensities, start: Gaussian
) -> States:
    def seeing(state: Gaussian, step: Step) -> tuple[Gaussian, Array]:
        after, seen = updated(state, step)
        return after, log_likelihood(step, seen)

    def forward(state: Gaussian, step: Step) -> tuple[Gaussian, Any]:
        before = arriving(state, step, intensities)
        after, likelihood = seeing(before, step)
        return after, (before, likelihood)

    def backward(slope: Gaussian, row: Any) -> tuple[Gaussian, States]:
        step, (before, likelihood) = row
        mean, covariance = before
        # Derivatives of the log-likelihood with respect to the prediction: r, and half of r rᵀ − N.
        _, to_prediction = jax.vjp(lambda state: seeing(state, step), before)
        (slope,) = to_prediction((slope, jnp.ones_like(likelihood)))
        pulls = slope.mean.reshape(SIZE, -1)
        surprise = slope.covariance + slope.covariance.T
        information = (pulls @ pulls.T - surprise) / pulls.shape[1]
        spread = covariance - covariance @ information @ covariance
        _, to_sample_before = jax.vjp(lambda state, q: arriving(state, step, q), start, intensities)
        earlier, of_intensities = to_sample_before(slope)
        told = States(
            mean + covariance @ slope.mean,
            (spread + spread.T) / 2,
            slope.mean,
            information,
            intensities * of_intensities,
            likelihood,
            Gaussian(mean[DRIFT], covariance[DRIFT, DRIFT]),
        )
        return earlier, told

    there = scanned(forward, start, steps, count)[1]
    nothing = jax.tree.map(jnp.zeros_like, start)
    states: States = scanned(backward, nothing, (steps, there), count, back=True)[1]
    return states


def smoothed(steps: Step, intensities: Intensities, start: Gaussian) -> States:
    """States at the samples of a series, given all of them."""
    count = len(steps.duration)
    states = _smoothed(filled(steps), np.asarray(count), intensities, start)
    return jax.tree.map(lambda part: np.asarray(part)[:count], states)


def log_likelihoods(
    series: list[Step], intensities: Intensities, start: Gaussian
) -> Float[np.ndarray, "series"]:
    """Log marginal likelihoods of several time series of equal length: of the wrenches, given the
    constraints.

    Different labels have different constraints, whose densities are no evidence: that of k² = ½
    would be counted again for each further sample, and tangential phases would come out too long.
    """
    rows = jax.tree.map(lambda *parts: np.stack(parts), *map(filled, series))
    count = np.asarray(len(series[0].duration))
    return np.asarray(_log_likelihoods((count, intensities, start), rows))


@lanes(width=8, blocks=1)
def _log_likelihoods(
    shared: tuple[Int[Any, ""], Float[Any, "intensities"], Gaussian], steps: Step
) -> Float[Array, ""]:
    count, intensities, start = shared

    def one(carry: tuple[Gaussian, Array], step: Step) -> tuple[Any, None]:
        state, total = carry
        state, seen = updated(arriving(state, step, intensities), step)
        # s₁ and k² lie between 0 and 1: however vague, their densities are at least 1.
        size = (2 * jnp.pi * seen[1]).at[WRENCH:].min(1.0)
        return (state, total + _log_density(seen, size)), None

    def joint(variance: Float[Array, "n observed"]) -> Float[Array, ""]:
        rows = steps._replace(variance=variance)
        return scanned(one, (start, jnp.zeros(())), rows, count)[0][1]

    unseen = steps.variance.at[:, :WRENCH].set(jnp.inf)
    wrenches, constraints = jax.vmap(joint)(jnp.stack([steps.variance, unseen]))
    return wrenches - constraints


def _process_noise(step: Step, intensities: Intensities) -> Square:
    """Covariance that motion and drift add; linear in the intensities."""
    moment, axial, arc_length, tilt, drift = intensities
    loads = jnp.stack([moment, moment, axial]) * step.pace
    q = step.active * jnp.append(loads, jnp.stack([arc_length, tilt]))
    dt = step.duration
    of_time = jnp.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    of_drift = jnp.eye(WRENCH) * drift * dt
    return jax.scipy.linalg.block_diag(jnp.kron(of_time, jnp.diag(q)), of_drift)
