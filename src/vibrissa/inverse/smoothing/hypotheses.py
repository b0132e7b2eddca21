"""The causal smoother's compiled step: three hypotheses, mixed, predicted and updated."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from vibrissa.inverse.parameters import COUNT, Changes, Rig, changes
from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.fit import OUTLIER
from vibrissa.inverse.smoothing.kalman import DRIFT, PLACE, ROWS, WRENCH, Entry, Step
from vibrissa.inverse.smoothing.loops import scanned
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, Linear, linear_at
from vibrissa.inverse.smoothing.model import observed
from vibrissa.inverse.smoothing.series import FREE, TANGENTIAL, TIP
from vibrissa.numerics.compiled import compiled
from vibrissa.numerics.rotation import rotation_matrix

_SWITCH = 1e-2
"""Probability a sample that the hypothesis changes, to each of the others: contacts last hundreds
of samples, and a wrong hypothesis is left within some."""
_PATIENCE = 4
"""Consecutive outliers that are taken for a jump of the contact."""
_TINY = 1e-300
"""In place of a divisor of zero."""


class Hypotheses(NamedTuple):
    """What the filter carries from sample to sample: a state for each `ContactKind`."""

    mean: Float[Any, "kinds state"]
    covariance: Float[Any, "kinds state state"]
    probability: Float[Any, "kinds"]
    recent: Float[Any, "samples wrench"]
    """The last whitened wrenches, the newest first; NaN where there was none."""
    strange: Float[Any, ""]
    """Consecutive outliers."""
    columns: Float[Any, "kinds state parameters"]
    """Derivatives of `mean` by the setup's numbers, for given readings: the same filter, with what
    they change in the wrench in the place of the readings.
    """


class Settings(NamedTuple):
    """What does not change."""

    length: Float[Any, ""]
    units: Float[Any, "wrench"]
    whitening: Float[Any, "wrench wrench"]
    intensities: Float[Any, "intensities"]
    entries: Entry
    """How the state of each kind (rows) enters each other (columns)."""
    jump: Float[Any, "state"]
    """Variances of the state added where the contact jumps."""
    incidence_variance: Float[Any, ""]
    """Of k² about ½ in tangential contact; infinite where friction may make it another one."""
    rig: Rig
    errors: Float[Any, "parameters parameters"]
    """Covariance of the errors of the setup, model units."""


class Sample(NamedTuple):
    """World axes, units of the rod."""

    position: Float[Any, "*n 3"]
    orientation: Float[Any, "*n 4"]
    wrench: Float[Any, "*n wrench"]
    duration: Float[Any, "*n"]
    """Since the sample before [s]."""
    velocity: Float[Any, "*n wrench"]
    """Of the clamp point and of its rotation, a second."""


class Located(NamedTuple):
    """A contact, world axes and model units."""

    point: Float[Any, "*n 3"]
    direction: Float[Any, "*n 3"]
    arc_length: Float[Any, "*n"]
    incidence: Float[Any, "*n"]
    noise: Float[Any, "*n 6 6"]
    """Covariance of point and direction from sample to sample."""
    shared: Float[Any, "*n 6 6"]
    """What errors of the setup add to it."""
    sensitivity: Float[Any, "*n 6 parameters"]
    """Derivatives of point and direction by the setup's numbers."""


class Report(NamedTuple):
    """What one sample says, given those before."""

    located: Located
    kind: Int[Any, "*n"]
    """Tip or tangential, whichever is more probable."""
    probability: Float[Any, "*n"]
    """Of contact."""
    load: Float[Any, "*n"]
    """Mean of the last wrenches being noise and drift: chi-square with six degrees of freedom."""
    sound: Bool[Any, "*n"]


@compiled
def advanced(
    state: Hypotheses, settings: Settings, samples: Sample, count: Int[Any, ""]
) -> tuple[Hypotheses, Report]:
    """The first `count` samples taken, one after the other."""
    return scanned(lambda state, sample: _one(state, settings, sample), state, samples, count)


def _one(state: Hypotheses, settings: Settings, sample: Sample) -> tuple[Hypotheses, Report]:
    turn = rotation_matrix(sample.orientation)
    units = jnp.ones(WRENCH).at[:3].set(settings.length)
    velocity = _turned_back(sample.velocity / units, turn)
    wrench = _turned_back(sample.wrench, turn) / settings.units
    sound = jnp.all(jnp.isfinite(wrench))
    wrench = jnp.where(jnp.isfinite(wrench), wrench, 0.0)
    switch = jnp.full((3, 3), _SWITCH) + (1 - 3 * _SWITCH) * jnp.eye(3)
    arrival = state.probability @ switch
    jumped = state.strange >= _PATIENCE

    def one(kind: Array) -> tuple[Array, Array, Array, Array, Array]:
        shares = state.probability * switch[:, kind] / jnp.maximum(arrival[kind], _TINY)
        entry = jax.tree.map(lambda part: part[:, kind], settings.entries)
        entered = jax.vmap(kalman.entered)(state.mean, state.covariance, entry)
        mean, covariance = _mixture(shares, *entered)
        covariance += jnp.diag(settings.jump) * (jumped & (kind != FREE))
        columns = jnp.einsum("k,ki,kij->ij", shares, entry.keep, state.columns)
        step = Step(
            jax.tree.map(lambda part: part[kind], entry),
            sample.duration,
            jnp.ones(()),
            jnp.zeros(ROWS),
            jnp.zeros(()),
            jnp.full(ROWS, jnp.inf),
        )
        mean, covariance = kalman.predicted(mean, covariance, step, settings.intensities)
        mean = mean.at[ARC_LENGTH].set(jnp.clip(mean[ARC_LENGTH], 0.05, 1.0))
        # The sample about the prediction, its squared distance from it, and its errors by setup.
        linear = linear_at(mean[PLACE])
        residual, slope = observed(linear, wrench, settings.whitening, jnp)
        slope = slope * (kind != FREE)
        of_wrench = slope[:WRENCH]
        spread = of_wrench @ covariance[PLACE, PLACE] @ of_wrench.T
        across = of_wrench @ covariance[PLACE, DRIFT]
        spread += across + across.T + covariance[DRIFT, DRIFT] + jnp.eye(WRENCH)
        away = residual[:WRENCH] - mean[DRIFT]
        distance = away @ jnp.linalg.solve(spread, away)
        variance = jnp.full(ROWS, jnp.inf)
        variance = variance.at[:WRENCH].set(
            jnp.where(sound, jnp.maximum(1.0, distance / OUTLIER), jnp.inf)
        )
        variance = variance.at[-1].set(
            jnp.where(kind == TANGENTIAL, settings.incidence_variance, jnp.inf)
        )
        seen = settings.whitening @ _changes(linear, velocity, settings).wrench
        target = jnp.column_stack(
            [
                residual + slope @ linear.x,
                jnp.zeros((ROWS, COUNT)).at[:WRENCH].set(-seen * (kind != FREE)),
            ]
        )
        step = step._replace(target=target, slope=slope, variance=variance)
        both = jnp.column_stack([mean, kalman.moved(step, columns)])
        both, covariance, told = kalman.updated(both, covariance, step)
        likelihood = kalman.log_likelihood(step, told)[0]
        return both[:, 0], covariance, both[:, 1:], likelihood, jnp.where(sound, distance, 0.0)

    means, covariances, columns, likelihoods, excess = jax.vmap(one)(jnp.arange(3))
    weight = arrival * jnp.exp(likelihoods - jnp.max(likelihoods))
    strange = jnp.where(jumped, 0.0, state.strange + 1) * (jnp.min(excess) > OUTLIER)
    newest = jnp.where(sound, settings.whitening @ wrench, jnp.nan)
    after = Hypotheses(
        means,
        covariances,
        jnp.where(sound, weight / jnp.sum(weight), arrival),
        jnp.concatenate([newest[None], state.recent[:-1]]),
        strange,
        columns,
    )
    located = _located(after, settings, sample.position / settings.length, turn, velocity)
    return after, Report(
        located,
        jnp.where(after.probability[TANGENTIAL] > after.probability[TIP], TANGENTIAL, TIP),
        1 - after.probability[FREE],
        _load(after),
        sound,
    )


def _turned_back(pair: Array, turn: Array) -> Float[Array, "wrench"]:
    """Two vectors in clamp axes."""
    return (pair.reshape(2, 3) @ turn).ravel()


def _mixture(
    shares: Float[Array, "k"], means: Float[Array, "k state"], covariances: Array
) -> tuple[Float[Array, "state"], Float[Array, "state state"]]:
    """Mean and covariance of a mixture."""
    mean = shares @ means
    away = means - mean
    within = jnp.einsum("k,kij->ij", shares, covariances)
    return mean, within + jnp.einsum("k,ki,kj->ij", shares, away, away)


def _changes(linear: Linear, velocity: Array, settings: Settings) -> Changes:
    value = linear.value
    return changes(settings.rig, value.wrench, value.reach, value.direction, velocity)


def _located(
    state: Hypotheses, settings: Settings, clamp: Array, turn: Array, velocity: Array
) -> Located:
    touching = state.probability[1:]
    shares = touching / jnp.maximum(jnp.sum(touching), _TINY)
    mean, covariance = _mixture(shares, state.mean[1:], state.covariance[1:])
    linear = linear_at(mean[PLACE])
    slope = jnp.concatenate([turn @ linear.slope.reach, turn @ linear.slope.direction])
    seen = _changes(linear, velocity, settings)
    moved = slope @ jnp.einsum("k,kij->ij", shares, state.columns[1:, PLACE])
    sensitivity = moved + jnp.concatenate([turn @ seen.reach, turn @ seen.direction])
    return Located(
        clamp + turn @ linear.value.reach,
        turn @ linear.value.direction,
        mean[ARC_LENGTH],
        linear.value.incidence,
        slope @ covariance[PLACE, PLACE] @ slope.T,
        sensitivity @ settings.errors @ sensitivity.T,
        sensitivity,
    )


def _load(state: Hypotheses) -> Float[Array, ""]:
    present = jnp.all(jnp.isfinite(state.recent), axis=1)
    count = jnp.maximum(jnp.sum(present), 1)
    drift = state.probability @ state.mean[:, DRIFT]
    average = jnp.sum(jnp.where(present[:, None], state.recent - drift, 0.0), axis=0) / count
    spread = jnp.eye(WRENCH) / count + state.covariance[FREE, DRIFT, DRIFT]
    return average @ jnp.linalg.solve(spread, average)
