"""Fixed-interval smoothing of a linear Gaussian model, one scalar observation after the other.

Durbin & Koopman, *Time Series Analysis by State Space Methods*, 2nd ed., sections 4.4 and 6.4. No
matrix is inverted, so states may be known exactly: a rod in tip contact, or without contact.

The state holds the contact's coordinates x, their rates v and the drift d of the sensor's zero.
Between samples x is driven by white acceleration of spectral density q (an integrated Wiener
process) and d by white noise:

    x' = v,    v' = √q ẇ,    d' = √q_d ẇ.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from vibrissa.inverse.smoothing.loops import filled, scanned
from vibrissa.inverse.smoothing.manifold import AT_REST, COORDINATES
from vibrissa.numerics.compiled import compiled

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
"""Variance of k² above which it is a soft constraint: far above that of one that holds exactly,
1e-12, far below any of friction or of a setup's tolerances."""
_AT_ONCE = 8
"""Series whose likelihoods one call computes."""

State = Float[Array, "state *k"]
Square = Float[Array, "state state"]


class Gaussian(NamedTuple):
    """Mean and covariance."""

    mean: Float[Any, "*n state"]
    covariance: Float[Any, "*n state state"]


class Entry(NamedTuple):
    """How the state enters a sample, before it moves."""

    keep: Float[Any, "*n state"]
    """1 for entries that go on, 0 for entries that begin anew."""
    begin: Float[Any, "*n state"]
    """Values of those that begin anew."""
    spread: Float[Any, "*n state"]
    """Variances added."""
    active: Float[Any, "*n coordinates"]
    """Share of the time since the sample before in which each coordinate moves; 0 for known ones.
    """


class Step(NamedTuple):
    """How the state comes to a sample, and what the sample shows; of a series, one row a sample."""

    entry: Entry
    duration: Float[Any, "*n"]
    """Since the sample before [s]."""
    pace: Float[Any, "*n"]
    """Factor of the intensities of moment and axial force."""
    target: Float[Any, "*n observed"]
    """Observed values; with a further axis, those of several series that differ in them alone."""
    slope: Float[Any, "*n observed coordinates"]
    """Their derivatives by the coordinates; the wrench shows the drift, too."""
    variance: Float[Any, "*n observed"]
    """Of the observations; infinite where there is none."""


class Seen(NamedTuple):
    """What one sample's observations did, one after the other."""

    innovation: Float[Array, "observed *k"]
    spread: Float[Array, "observed"]
    """Variance of the innovation; infinite where nothing was observed."""
    gain: Float[Array, "observed state"]


class States(NamedTuple):
    """States given all samples, and what the samples from each one on say against its prediction
    (Durbin & Koopman, eq. 4.44).
    """

    mean: Float[Any, "n state *k"]
    covariance: Float[Any, "n state state"]
    pull: Float[Any, "n state *k"]
    """r: zero on average, with the covariance `information`. Large where the state jumps on the way
    to the sample (section 7.5).
    """
    information: Float[Any, "n state state"]
    score: Float[Any, "n intensities"]
    """Of the log-likelihood: what each step adds to its derivative by the logarithms of the
    intensities, half the trace of (r rᵀ − N) ∂Q (Koopman & Shephard, *Biometrika* 79, 1992)."""
    log_likelihood: Float[Any, "n *k"]
    """Of each sample, given those before."""
    expected: Float[Any, "n state *k"]
    """Means given the samples before alone."""
    uncertainty: Float[Any, "n state state"]
    """Their covariances."""

    @property
    def zero(self) -> Gaussian:
        """Drift of the sensor's zero given all samples."""
        return Gaussian(self.mean[:, DRIFT], self.covariance[:, DRIFT, DRIFT])

    @property
    def expected_zero(self) -> Gaussian:
        """Drift given the samples before."""
        return Gaussian(self.expected[:, DRIFT], self.uncertainty[:, DRIFT, DRIFT])


def at_rest(zero: Gaussian) -> Gaussian:
    """State of a rod free of contact, for what is known of the drift."""
    covariance = np.zeros((SIZE, SIZE))
    covariance[DRIFT, DRIFT] = zero.covariance
    return Gaussian(np.concatenate([AT_REST, np.zeros(COORDINATES), zero.mean]), covariance)


def entered(mean: State, covariance: Square, entry: Entry) -> tuple[State, Square]:
    """State as it enters a sample."""
    keep = jnp.asarray(entry.keep)
    return (
        (keep * mean.T + entry.begin).T,
        keep[:, None] * covariance * keep + jnp.diag(entry.spread),
    )


def predicted(
    mean: State, covariance: Square, step: Step, intensities: Float[Array, "intensities"]
) -> tuple[State, Square]:
    """State before the sample is seen, from that which entered it."""
    spread = moved(step, moved(step, covariance).T)
    return moved(step, mean), spread + _process_noise(step, intensities)


def moved(step: Step, rows: Float[Array, "state *k"]) -> Float[Array, "state *k"]:
    """From the sample before to this one: x + v dt, for each column."""
    return rows.at[PLACE].add((step.entry.active * step.duration * rows[RATE].T).T)


def moved_back(step: Step, rows: Float[Array, "state *k"]) -> Float[Array, "state *k"]:
    """The transpose of entering and moving."""
    rows = rows.at[RATE].add((step.entry.active * step.duration * rows[PLACE].T).T)
    return (step.entry.keep * rows.T).T


def updated(mean: State, covariance: Square, step: Step) -> tuple[State, Square, Seen]:
    """State after the sample is seen."""
    told = []
    for z, target, variance in zip(_design(step), step.target, step.variance, strict=True):
        seen, direction = jnp.isfinite(variance), covariance @ z
        spread = z @ direction + jnp.where(seen, variance, 1.0)
        innovation = jnp.where(seen, target - z @ mean, 0.0)
        gain = jnp.where(seen, direction / spread, 0.0)
        mean = mean + _outer(gain, innovation)
        covariance = covariance - jnp.outer(gain, direction)
        told.append(Seen(innovation, jnp.where(seen, spread, jnp.inf), gain))
    return mean, (covariance + covariance.T) / 2, jax.tree.map(lambda *rows: jnp.stack(rows), *told)


def _design(step: Step) -> Float[Array, "observed state"]:
    drift = jnp.eye(ROWS, WRENCH)
    return jnp.concatenate([step.slope, jnp.zeros((ROWS, COORDINATES)), drift], axis=1)


def _outer(one: Float[Array, "state"], other: Float[Array, "*k"]) -> Float[Array, "state *k"]:
    return jnp.tensordot(one, other, 0)


def log_likelihood(step: Step, seen: Seen) -> Float[Array, "*k"]:
    """Of a sample, given those before. A soft constraint is no datum: it weighs the states, and one
    that does not restrict them costs nothing.
    """
    soft = jnp.asarray(step.variance) > jnp.full(ROWS, jnp.inf).at[-1].set(_SOFT)
    return _log_density(
        seen, jnp.where(soft, seen.spread / step.variance, 2 * jnp.pi * seen.spread)
    )


def _log_density(seen: Seen, size: Float[Array, "observed"]) -> Float[Array, "*k"]:
    there = jnp.isfinite(seen.spread)
    size, spread = (jnp.where(there, part, 1.0) for part in (size, seen.spread))
    return -0.5 * jnp.sum(jnp.log(size) + seen.innovation.T**2 / spread, axis=-1)


@compiled
def _smoothed(
    steps: Step, count: Int[Any, ""], intensities: Float[Any, "intensities"], start: Gaussian
) -> States:
    def forward(
        carry: tuple[State, Square], step: Step
    ) -> tuple[tuple[State, Square], tuple[Gaussian, Seen, Array]]:
        before = Gaussian(*predicted(*entered(*carry, step.entry), step, intensities))
        mean, covariance, seen = updated(*before, step)
        return (mean, covariance), (before, seen, log_likelihood(step, seen))

    def backward(
        carry: tuple[State, Square], row: tuple[Step, tuple[Gaussian, Seen, Array]]
    ) -> tuple[tuple[State, Square], States]:
        step, ((mean, covariance), seen, likelihood) = row
        pull, information = _pulled(*carry, step, seen)
        spread = covariance - covariance @ information @ covariance
        pulls = pull.reshape(SIZE, -1)
        surprise = pulls @ pulls.T - information
        slope = jax.grad(lambda q: jnp.sum(surprise * _process_noise(step, q)) / 2)
        told = States(
            mean + covariance @ pull,
            (spread + spread.T) / 2,
            pull,
            information,
            intensities * slope(intensities),
            likelihood,
            mean,
            covariance,
        )
        return (moved_back(step, pull), moved_back(step, moved_back(step, information).T)), told

    _, there = scanned(forward, tuple(start), steps, count)
    nothing = jnp.zeros_like(start.mean), jnp.zeros((SIZE, SIZE))
    return scanned(backward, nothing, (steps, there), count, back=True)[1]


def _pulled(r: State, information: Square, step: Step, seen: Seen) -> tuple[State, Square]:
    """What a sample and those after it say against the prediction of it."""
    design = _design(step)
    for j in reversed(range(ROWS)):
        z, gain, spread = design[j], seen.gain[j], seen.spread[j]
        along = information @ gain
        r = r + _outer(z, seen.innovation[j] / spread - gain @ r)
        information = (
            information
            - jnp.outer(z, along)
            - jnp.outer(along, z)
            + jnp.outer(z, z) * (1 / spread + gain @ along)
        )
    return r, information


def smoothed(steps: Step, intensities: Float[np.ndarray, "intensities"], start: Gaussian) -> States:
    """States at the samples of a series, given all of them."""
    count = len(steps.duration)
    states = _smoothed(filled(steps), np.asarray(count), intensities, start)
    return jax.tree.map(lambda part: np.asarray(part)[:count], states)


def log_likelihoods(
    series: list[Step], intensities: Float[np.ndarray, "intensities"], start: Gaussian
) -> Float[np.ndarray, "series"]:
    """Logarithms of the marginal likelihoods of several time series of one length: of the wrenches,
    given the constraints.

    Other labels have other constraints, whose densities are no evidence: of k² = ½ each further
    sample would add its own, and tangential phases would come out too long.
    """
    count, wanted = np.asarray(len(series[0].duration)), len(series)
    series = [filled(steps) for steps in series]
    series += series[-1:] * (-wanted % _AT_ONCE)
    values = [
        _log_likelihoods(
            jax.tree.map(lambda *parts: np.stack(parts), *series[first : first + _AT_ONCE]),
            count,
            intensities,
            start,
        )
        for first in range(0, len(series), _AT_ONCE)
    ]
    return np.concatenate(values)[:wanted]


@compiled
def _log_likelihoods(
    series: Step, count: Int[Any, ""], intensities: Float[Any, "intensities"], start: Gaussian
) -> Float[Array, "series"]:
    def joint(steps: Step) -> Float[Array, ""]:
        def one(
            carry: tuple[State, Square, Array], step: Step
        ) -> tuple[tuple[State, Square, Array], None]:
            mean, covariance, total = carry
            before = predicted(*entered(mean, covariance, step.entry), step, intensities)
            mean, covariance, seen = updated(*before, step)
            # s₁ and k² lie between 0 and 1: however vague, their densities are not below 1.
            size = (2 * jnp.pi * seen.spread).at[WRENCH:].min(1.0)
            return (mean, covariance, total + _log_density(seen, size)), None

        return scanned(one, (*start, jnp.zeros(())), steps, count)[0][2]

    def given_constraints(steps: Step) -> Float[Array, ""]:
        unseen = steps.variance.at[:, :WRENCH].set(jnp.inf)
        both = jnp.stack([steps.variance, unseen])
        wrenches, constraints = jax.vmap(lambda variance: joint(steps._replace(variance=variance)))(
            both
        )
        return wrenches - constraints

    return jax.vmap(given_constraints)(series)


def _process_noise(step: Step, intensities: Float[Array, "intensities"]) -> Square:
    """Covariance that motion and drift add; linear in the intensities."""
    moment, axial, arc_length, tilt, drift = intensities
    loads = jnp.stack([moment, moment, axial]) * step.pace
    q = step.entry.active * jnp.append(loads, jnp.stack([arc_length, tilt]))
    dt = step.duration
    of_time = jnp.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    of_drift = jnp.eye(WRENCH) * drift * dt
    return jax.scipy.linalg.block_diag(jnp.kron(of_time, jnp.diag(q)), of_drift)
