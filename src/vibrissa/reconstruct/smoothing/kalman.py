"""Fixed-interval smoothing of a linear Gaussian model, one scalar observation after the other.

Durbin & Koopman, *Time Series Analysis by State Space Methods*, 2nd ed., sections 4.4 and 6.4. No matrix is inverted, so states may be known exactly: a rod in tip
contact, or without contact.

The state holds the contact's coordinates x, their rates v and the drift d of the sensor's zero. Between samples x is driven by white acceleration of spectral density q
(an integrated Wiener process) and d by white noise:

    x' = v,    v' = √q ẇ,    d' = √q_d ẇ.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float

from vibrissa.reconstruct.smoothing.manifold import COORDINATES

WRENCH = 6
ROWS = WRENCH + 2
"""Observations of a sample: the whitened wrench, the arc length where it is that of the rod, and k² where the contact is tangential without friction."""
SIZE = 2 * COORDINATES + WRENCH
"""x, v, d."""
INTENSITIES = 5
"""Spectral densities per second: of the accelerations of the moment, the axial force, the arc length and the tilt, and of the drift in standard deviations of a
sample."""

State = Float[Array, "16"]
Square = Float[Array, "16 16"]


class Step(NamedTuple):
    """How the state comes to a sample, and what the sample shows. A time series holds one in each row."""

    duration: Float[Array, "*n"]
    """Since the sample before [s]."""
    keep: Float[Array, "*n 16"]
    """1 for states that go on, 0 for states that begin anew."""
    begin: Float[Array, "*n 16"]
    """Values of those that begin anew."""
    spread: Float[Array, "*n 16"]
    """Their variances."""
    active: Float[Array, "*n 5"]
    """1 for coordinates that move, 0 for known ones."""
    pace: Float[Array, "*n"]
    """Factor of the intensities of moment and axial force."""
    target: Float[Array, "*n 8"]
    """Observed values."""
    design: Float[Array, "*n 8 16"]
    """What they observe."""
    variance: Float[Array, "*n 8"]
    """Of the observations; infinite where there is none."""


class Trace(NamedTuple):
    """What the way back needs of the way there."""

    mean: State
    covariance: Square
    innovation: Float[Array, "8"]
    spread: Float[Array, "8"]
    gain: Float[Array, "8 16"]


def predicted(mean: State, covariance: Square, step: Step, intensities: Float[Array, "5"]) -> tuple[State, Square, Square]:
    """State before the sample is seen, and the transition to it."""
    kept = jnp.diag(step.keep)
    transition = _transition(step) @ kept
    noise = _process_noise(step, intensities)
    start = _transition(step)
    mean = start @ (step.keep * mean + step.begin)
    return mean, transition @ covariance @ transition.T + (start * step.spread) @ start.T + noise, transition


def updated(mean: State, covariance: Square, step: Step) -> tuple[State, Square, Trace, Float[Array, ""]]:
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
        log_likelihood += jnp.where(seen, -0.5 * (jnp.log(2 * jnp.pi * spread) + innovation**2 / spread), 0.0)
        innovations.append(innovation)
        spreads.append(jnp.where(seen, spread, jnp.inf))
        gains.append(gain)
    trace = Trace(*before, jnp.stack(innovations), jnp.stack(spreads), jnp.stack(gains))
    return mean, (covariance + covariance.T) / 2, trace, log_likelihood


def _forward(
    steps: Step, intensities: Float[Array, "5"], mean: State, covariance: Square
) -> tuple[tuple[Trace, Float[Array, "n 16 16"]], Float[Array, "n"]]:
    def one(carry: tuple[State, Square], step: Step) -> tuple[tuple[State, Square], tuple[tuple[Trace, Square], Float[Array, ""]]]:
        ahead, spread, transition = predicted(*carry, step, intensities)
        after, left, trace, log_likelihood = updated(ahead, spread, step)
        return (after, left), ((trace, transition), log_likelihood)

    _, (traces, log_likelihood) = lax.scan(one, (mean, covariance), steps)
    return traces, log_likelihood


@jax.jit
def log_likelihood(steps: Step, intensities: Float[Array, "5"], mean: State, covariance: Square) -> Float[Array, ""]:
    """Logarithm of the marginal likelihood of a time series."""
    return jnp.sum(_forward(steps, intensities, mean, covariance)[1])


class Smoothed(NamedTuple):
    """States given all samples, and what the samples from each one on say against its prediction (Durbin & Koopman, eq. 4.44)."""

    mean: Float[Array, "n 16"]
    covariance: Float[Array, "n 16 16"]
    pull: Float[Array, "n 16"]
    """r: zero on average, with the covariance `information`. Large where the state jumps on the way to the sample (section 7.5)."""
    information: Float[Array, "n 16 16"]
    log_likelihood: Float[Array, "n"]
    """Of each sample, given those before."""


class States(NamedTuple):
    """`Smoothed`, fetched: the rows of a series without those that fill it up."""

    mean: Float[np.ndarray, "n 16"]
    covariance: Float[np.ndarray, "n 16 16"]
    pull: Float[np.ndarray, "n 16"]
    information: Float[np.ndarray, "n 16 16"]
    log_likelihood: Float[np.ndarray, "n"]


def fetched(states: Smoothed, count: int) -> States:
    """Return the first rows as NumPy arrays."""
    return States(*(np.asarray(part)[:count] for part in states))


@jax.jit
def smoothed(steps: Step, intensities: Float[Array, "5"], mean: State, covariance: Square) -> Smoothed:
    """Means and covariances of the states given all samples."""
    (traces, transitions), likelihoods = _forward(steps, intensities, mean, covariance)

    def one(
        carry: tuple[State, Square], row: tuple[Trace, Square, Array]
    ) -> tuple[tuple[State, Square], tuple[State, Square, State, Square]]:
        r, information = carry
        trace, transition, design = row
        for j in reversed(range(ROWS)):
            z, gain = design[j], trace.gain[j]
            along = information @ gain
            r = r + z * (trace.innovation[j] / trace.spread[j] - gain @ r)
            information = information - jnp.outer(z, along) - jnp.outer(along, z) + jnp.outer(z, z) * (1 / trace.spread[j] + gain @ along)
        mean = trace.mean + trace.covariance @ r
        spread = trace.covariance - trace.covariance @ information @ trace.covariance
        return (transition.T @ r, transition.T @ information @ transition), (mean, (spread + spread.T) / 2, r, information)

    nothing = (jnp.zeros(SIZE), jnp.zeros((SIZE, SIZE)))
    _, rows = lax.scan(one, nothing, (traces, transitions, steps.design), reverse=True)
    return Smoothed(*rows, likelihoods)


@jax.jit
def score(steps: Step, states: Smoothed, intensities: Float[Array, "5"]) -> Float[Array, "n 5"]:
    """What each step adds to the derivative of the log-likelihood by the logarithms of the intensities.

    Half the trace of (r rᵀ − N) ∂Q (Koopman & Shephard, *Biometrika* 79, 1992).
    """

    def diagonal(first: int, second: int, size: int) -> Float[Array, "n k"]:
        parts = [states.pull[:, first + k] * states.pull[:, second + k] - states.information[:, first + k, second + k] for k in range(size)]
        return jnp.stack(parts, axis=1)

    dt = steps.duration[:, None]
    place, both, rate = (diagonal(*pair, COORDINATES) for pair in ((0, 0), (0, COORDINATES), (COORDINATES, COORDINATES)))
    of_coordinates = steps.active * (dt**3 / 3 * place + dt**2 * both + dt * rate) * jax.vmap(_local, (None, 0))(intensities, steps.pace)
    of_drift = intensities[-1] * jnp.sum(dt * diagonal(2 * COORDINATES, 2 * COORDINATES, WRENCH), axis=1)
    return jnp.column_stack([of_coordinates[:, 0] + of_coordinates[:, 1], of_coordinates[:, 2:], of_drift]) / 2


def _local(intensities: Float[Array, "5"], pace: Float[Array, ""]) -> Float[Array, "5"]:
    """Of the five coordinates at a sample."""
    return jnp.concatenate([intensities[:1] * pace, intensities[:2] * pace, intensities[2:4]])


def _transition(step: Step) -> Square:
    moving = jnp.diag(step.active * step.duration)
    return jnp.eye(SIZE).at[:COORDINATES, COORDINATES : 2 * COORDINATES].set(moving)


def _process_noise(step: Step, intensities: Float[Array, "5"]) -> Square:
    dt = step.duration
    q = step.active * _local(intensities, step.pace)
    place, rate = slice(0, COORDINATES), slice(COORDINATES, 2 * COORDINATES)
    noise = jnp.zeros((SIZE, SIZE)).at[2 * COORDINATES :, 2 * COORDINATES :].set(jnp.eye(WRENCH) * intensities[4] * dt)
    noise = noise.at[place, place].set(jnp.diag(q * dt**3 / 3)).at[rate, rate].set(jnp.diag(q * dt))
    return noise.at[place, rate].set(jnp.diag(q * dt**2 / 2)).at[rate, place].set(jnp.diag(q * dt**2 / 2))
