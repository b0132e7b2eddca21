"""Fixed-interval smoothing of a linear Gaussian model, one scalar observation after the other.

Durbin & Koopman, *Time Series Analysis by State Space Methods*, 2nd ed., sections 4.4 and 6.4. No
matrix is inverted, so states may be known exactly: a rod in tip contact, or without contact.

The state holds the contact's coordinates x, their rates v and the drift d of the sensor's zero.
Between samples x is driven by white acceleration of spectral density q (an integrated Wiener
process) and d by white noise:

    x' = v,    v' = √q ẇ,    d' = √q_d ẇ.
"""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.inverse.smoothing.manifold import COORDINATES
from vibrissa.numerics.blocks import AnyArray
from vibrissa.numerics.compiled import compiled

WRENCH = 6
ROWS = WRENCH + 2
"""Observations of a sample: the whitened wrench, the arc length where it is that of the rod, and
k², ½ where the contact is tangential, exactly or within friction.
"""
SIZE = 2 * COORDINATES + WRENCH
"""x, v, d."""
INTENSITIES = 5
"""Spectral densities per second: of the accelerations of the moment, the axial force, the arc
length and the tilt, and of the drift in standard deviations of a sample."""

_SOFT = 1e-9
"""Variance of k² above which it is a soft constraint."""

Parts = TypeVar("Parts")
State = Float[Array, "16"]
Square = Float[Array, "16 16"]


class Step(NamedTuple):
    """How the state comes to a sample, and what the sample shows. A time series holds one in each
    row.
    """

    duration: Float[AnyArray, "*n"]
    """Since the sample before [s]."""
    keep: Float[AnyArray, "*n 16"]
    """1 for states that go on, 0 for states that begin anew."""
    begin: Float[AnyArray, "*n 16"]
    """Values of those that begin anew."""
    spread: Float[AnyArray, "*n 16"]
    """Their variances."""
    active: Float[AnyArray, "*n 5"]
    """1 for coordinates that move, 0 for known ones."""
    pace: Float[AnyArray, "*n"]
    """Factor of the intensities of moment and axial force."""
    target: Float[AnyArray, "*n 8"]
    """Observed values."""
    design: Float[AnyArray, "*n 8 16"]
    """What they observe."""
    variance: Float[AnyArray, "*n 8"]
    """Of the observations; infinite where there is none."""


class Trace(NamedTuple):
    """What the way back needs of the way there."""

    mean: State
    covariance: Square
    innovation: Float[Array, "8"]
    spread: Float[Array, "8"]
    gain: Float[Array, "8 16"]


def predicted(
    mean: State, covariance: Square, step: Step, intensities: Float[Array, "5"]
) -> tuple[State, Square]:
    """State before the sample is seen."""
    keep = jnp.asarray(step.keep)
    covariance = keep[:, None] * covariance * keep + jnp.diag(step.spread)
    spread = moved(step, moved(step, covariance).T)
    return moved(step, keep * mean + step.begin), spread + _process_noise(step, intensities)


def moved(step: Step, rows: Float[Array, "16 *k"]) -> Float[Array, "16 *k"]:
    """From the sample before to this one: x + v dt, for each column."""
    distance = (step.active * step.duration).reshape(-1, *[1] * (rows.ndim - 1)) * rows[
        COORDINATES : 2 * COORDINATES
    ]
    return jnp.concatenate([rows[:COORDINATES] + distance, rows[COORDINATES:]])


def moved_back(step: Step, rows: Float[Array, "16 *k"]) -> Float[Array, "16 *k"]:
    """The transpose of the whole transition, to states that begin anew too."""
    shape = (-1, *[1] * (rows.ndim - 1))
    distance = (step.active * step.duration).reshape(shape) * rows[:COORDINATES]
    rates = rows[COORDINATES : 2 * COORDINATES] + distance
    return jnp.asarray(step.keep).reshape(shape) * jnp.concatenate(
        [rows[:COORDINATES], rates, rows[2 * COORDINATES :]]
    )


def updated(
    mean: State, covariance: Square, step: Step
) -> tuple[State, Square, Trace, Float[Array, ""]]:
    """State after the sample is seen, and the logarithm of the sample's likelihood."""
    innovations, spreads, gains = [], [], []
    before, log_likelihood = (mean, covariance), jnp.zeros(())
    for row in range(ROWS):
        z = step.design[row]
        seen = jnp.isfinite(step.variance[row])
        direction = covariance @ z
        spread = z @ direction + jnp.where(seen, step.variance[row], 1.0)
        innovation = jnp.where(seen, step.target[row] - z @ mean, 0.0)
        gain = jnp.where(seen, direction / spread, 0.0)
        mean, covariance = mean + gain * innovation, covariance - jnp.outer(gain, direction)
        # A soft constraint is no datum: it weighs the states, and one that it does not restrict
        # costs nothing.
        soft = (row == ROWS - 1) & (step.variance[row] > _SOFT)
        size = jnp.where(
            soft, spread / jnp.where(seen, step.variance[row], 1.0), 2 * jnp.pi * spread
        )
        log_likelihood += jnp.where(seen, -0.5 * (jnp.log(size) + innovation**2 / spread), 0.0)
        innovations.append(innovation)
        spreads.append(jnp.where(seen, spread, jnp.inf))
        gains.append(gain)
    trace = Trace(*before, jnp.stack(innovations), jnp.stack(spreads), jnp.stack(gains))
    return mean, (covariance + covariance.T) / 2, trace, log_likelihood


def columns_updated(
    columns: Float[Array, "16 k"], step: Step, trace: Trace, targets: Float[Array, "8 k"]
) -> tuple[Float[Array, "16 k"], Float[Array, "8 k"]]:
    """Columns of states after a sample with these targets is seen, by the gains of `updated`, and
    their innovations.
    """
    innovations = []
    for row in range(ROWS):
        innovations.append(targets[row] - step.design[row] @ columns)
        columns = columns + jnp.outer(trace.gain[row], innovations[row])
    return columns, jnp.stack(innovations)


def row_of(parts: Parts, row: Array) -> Parts:
    """One row of each part."""
    return jax.tree.map(lambda part: lax.dynamic_index_in_dim(part, row, keepdims=False), parts)


def with_row(parts: Parts, row: Array, values: Parts) -> Parts:
    """Parts with one row of each replaced."""
    return jax.tree.map(
        lambda part, value: lax.dynamic_update_index_in_dim(part, value, row, 0), parts, values
    )


def _empty(rows: int, *shapes: tuple[int, ...]) -> list[Array]:
    return [jnp.zeros((rows, *shape)) for shape in shapes]


@compiled
def log_likelihoods(
    steps: Step,
    count: Int[AnyArray, ""],
    intensities: Float[AnyArray, "5"],
    mean: Float[AnyArray, "16"],
    covariance: Float[AnyArray, "16 16"],
) -> Float[Array, "series"]:
    """Logarithms of the marginal likelihoods of the first `count` samples of several time series:
    of the wrenches, given the constraints.

    Other labels have other constraints, whose densities are no evidence: of k² = ½ each further
    sample would add its own, and tangential phases would come out too long.
    """

    def one_series(steps: Step) -> Float[Array, ""]:
        unseen = jnp.asarray(steps.variance).at[:, :WRENCH].set(jnp.inf)
        variances = jnp.stack([jnp.asarray(steps.variance), unseen])
        joint, constraints = jax.vmap(
            lambda variance: joint_density(steps._replace(variance=variance))
        )(variances)
        return joint - constraints

    def joint_density(steps: Step) -> Float[Array, ""]:
        def one(row: Array, carry: tuple[State, Square, Array]) -> tuple[State, Square, Array]:
            step = row_of(steps, row)
            after, left, trace, _ = updated(
                *predicted(*carry[:2], step, jnp.asarray(intensities)), step
            )
            return after, left, carry[2] + _log_density(trace)

        through: tuple[State, Square, Array] = lax.fori_loop(
            0, count, one, (jnp.asarray(mean), jnp.asarray(covariance), jnp.zeros(()))
        )
        return through[2]

    return jax.vmap(one_series)(Step(*map(jnp.asarray, steps)))


def _log_density(trace: Trace) -> Float[Array, ""]:
    """Of what a sample shows; s₁ and k² lie between 0 and 1, so that, however vague, their
    densities are not below 1.
    """
    seen = jnp.isfinite(trace.spread)
    size = 2 * jnp.pi * jnp.where(seen, trace.spread, 1.0)
    size = size.at[WRENCH:].min(1.0)
    return -0.5 * jnp.sum(
        jnp.where(
            seen, jnp.log(size) + trace.innovation**2 / jnp.where(seen, trace.spread, 1.0), 0.0
        )
    )


class Smoothed(NamedTuple):
    """States given all samples, and what the samples from each one on say against its prediction
    (Durbin & Koopman, eq. 4.44).
    """

    mean: Float[Array, "n 16"]
    covariance: Float[Array, "n 16 16"]
    pull: Float[Array, "n 16"]
    """r: zero on average, with the covariance `information`. Large where the state jumps on the way
    to the sample (section 7.5).
    """
    information: Float[Array, "n 16 16"]
    log_likelihood: Float[Array, "n"]
    """Of each sample, given those before."""
    expected: Float[Array, "n 16"]
    """Means given the samples before alone."""
    uncertainty: Float[Array, "n 16 16"]
    """Their covariances."""


class States(NamedTuple):
    """`Smoothed`, fetched: the rows of a series without those that fill it up."""

    mean: Float[np.ndarray, "n 16"]
    covariance: Float[np.ndarray, "n 16 16"]
    pull: Float[np.ndarray, "n 16"]
    information: Float[np.ndarray, "n 16 16"]
    log_likelihood: Float[np.ndarray, "n"]
    expected: Float[np.ndarray, "n 16"]
    uncertainty: Float[np.ndarray, "n 16 16"]


def fetched(states: Smoothed, count: int) -> States:
    """Return the first rows as NumPy arrays."""
    return States(*(np.asarray(part)[:count] for part in states))


@compiled
def smoothed(
    steps: Step,
    count: Int[AnyArray, ""],
    intensities: Float[AnyArray, "5"],
    mean: Float[AnyArray, "16"],
    covariance: Float[AnyArray, "16 16"],
) -> Smoothed:
    """Means and covariances of the states at the first `count` samples, given these; the rows
    beyond them are zero.
    """
    steps, rows, last_row = (
        Step(*map(jnp.asarray, steps)),
        steps.duration.shape[0],
        jnp.asarray(count) - 1,
    )

    def forward(
        row: Array, carry: tuple[State, Square, tuple[Trace, Array]]
    ) -> tuple[State, Square, tuple[Trace, Array]]:
        step = row_of(steps, row)
        after, left, trace, likelihood = updated(
            *predicted(*carry[:2], step, jnp.asarray(intensities)), step
        )
        return after, left, with_row(carry[2], row, (trace, likelihood))

    nothing = (
        Trace(*_empty(rows, (SIZE,), (SIZE, SIZE), (ROWS,), (ROWS,), (ROWS, SIZE))),
        jnp.zeros(rows),
    )
    first = jnp.asarray(mean), jnp.asarray(covariance), nothing
    traces: Trace
    _, _, (traces, likelihoods) = lax.fori_loop(0, count, forward, first)

    def backward(
        number: Array, carry: tuple[State, Square, list[Array]]
    ) -> tuple[State, Square, list[Array]]:
        row = last_row - number
        trace, step = row_of(traces, row), row_of(steps, row)
        r, information = _told(*carry[:2], trace, step)
        spread = trace.covariance - trace.covariance @ information @ trace.covariance
        told = [trace.mean + trace.covariance @ r, (spread + spread.T) / 2, r, information]
        return (
            moved_back(step, r),
            moved_back(step, moved_back(step, information).T),
            with_row(carry[2], row, told),
        )

    last = (
        jnp.zeros(SIZE),
        jnp.zeros((SIZE, SIZE)),
        _empty(rows, (SIZE,), (SIZE, SIZE), (SIZE,), (SIZE, SIZE)),
    )
    means, covariances, pulls, informations = lax.fori_loop(0, count, backward, last)[2]
    return Smoothed(
        means, covariances, pulls, informations, likelihoods, traces.mean, traces.covariance
    )


def _told(r: State, information: Square, trace: Trace, step: Step) -> tuple[State, Square]:
    """What a sample and those after it say against the prediction of it."""
    for j in reversed(range(ROWS)):
        z, gain = step.design[j], trace.gain[j]
        along = information @ gain
        r = r + z * (trace.innovation[j] / trace.spread[j] - gain @ r)
        information = (
            information
            - jnp.outer(z, along)
            - jnp.outer(along, z)
            + jnp.outer(z, z) * (1 / trace.spread[j] + gain @ along)
        )
    return r, information


def score(
    steps: Step, states: States, intensities: Float[np.ndarray, "5"]
) -> Float[np.ndarray, "n 5"]:
    """What each step adds to the derivative of the log-likelihood by the logarithms of the
    intensities.

    Half the trace of (r rᵀ − N) ∂Q (Koopman & Shephard, *Biometrika* 79, 1992).
    """

    def diagonal(first: int, second: int, size: int) -> Float[np.ndarray, "n k"]:
        one, other = slice(first, first + size), slice(second, second + size)
        return states.pull[:, one] * states.pull[:, other] - np.einsum(
            "nii->ni", states.information[:, one, other]
        )

    dt, pace = np.asarray(steps.duration)[:, None], np.asarray(steps.pace)[:, None]
    place, both, rate = (
        diagonal(*pair, COORDINATES)
        for pair in ((0, 0), (0, COORDINATES), (COORDINATES, COORDINATES))
    )
    local = np.concatenate(
        [intensities[[0, 0, 1]] * pace, np.broadcast_to(intensities[2:4], (len(pace), 2))], axis=1
    )
    of_coordinates = (
        np.asarray(steps.active) * (dt**3 / 3 * place + dt**2 * both + dt * rate) * local
    )
    of_drift = intensities[-1] * np.sum(
        dt * diagonal(2 * COORDINATES, 2 * COORDINATES, WRENCH), axis=1
    )
    return (
        np.column_stack(
            [of_coordinates[:, 0] + of_coordinates[:, 1], of_coordinates[:, 2:], of_drift]
        )
        / 2
    )


def _local(intensities: Float[Array, "5"], pace: Float[Array, ""]) -> Float[Array, "5"]:
    """Of the five coordinates at a sample."""
    return jnp.concatenate([intensities[:1] * pace, intensities[:2] * pace, intensities[2:4]])


def _process_noise(step: Step, intensities: Float[Array, "5"]) -> Square:
    dt = step.duration
    q = step.active * _local(intensities, jnp.asarray(step.pace))
    place, rate = slice(0, COORDINATES), slice(COORDINATES, 2 * COORDINATES)
    noise = (
        jnp.zeros((SIZE, SIZE))
        .at[2 * COORDINATES :, 2 * COORDINATES :]
        .set(jnp.eye(WRENCH) * intensities[4] * dt)
    )
    noise = noise.at[place, place].set(jnp.diag(q * dt**3 / 3)).at[rate, rate].set(jnp.diag(q * dt))
    return (
        noise.at[place, rate]
        .set(jnp.diag(q * dt**2 / 2))
        .at[rate, place]
        .set(jnp.diag(q * dt**2 / 2))
    )
