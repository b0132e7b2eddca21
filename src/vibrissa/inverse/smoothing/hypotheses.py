"""The causal smoother's compiled step: three hypotheses, mixed, predicted and updated."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.inverse.parameters import COUNT, Rig, changes
from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.kalman import ROWS, SIZE, WRENCH, Step
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, COORDINATES, TILT, Bent, bent
from vibrissa.inverse.smoothing.series import FREE, TANGENTIAL, TILT_SPREAD, TIP
from vibrissa.numerics.blocks import AnyArray
from vibrissa.numerics.compiled import compiled
from vibrissa.numerics.rotation import rotation_matrix

_SWITCH = 1e-2
"""Probability a sample that the hypothesis changes, to each of the others."""
_OUTLIER = 28.0
_PATIENCE = 4
"""Consecutive outliers that are taken for a jump of the contact."""
_JUMP = 2.0
_ENTRIES = np.arange(SIZE)
_STATE_REPORT = 29
REPORT = _STATE_REPORT + 2 * 9 + 6 * COUNT
SAMPLE = 20


class Hypotheses(NamedTuple):
    """What the filter carries from sample to sample."""

    mean: Float[Array, "3 16"]
    covariance: Float[Array, "3 16 16"]
    probability: Float[Array, "3"]
    recent: Float[Array, "5 6"]
    """The last whitened wrenches, the newest first; NaN where there was none."""
    strange: Float[Array, ""]
    """Consecutive outliers."""
    columns: Float[Array, "3 16 15"]
    """Derivatives of `mean` by the setup's numbers, for given readings: the same filter, with what
    they change in the wrench in the place of the readings.
    """


class Settings(NamedTuple):
    """What does not change."""

    units: Float[Array, "7"]
    """Of length, of force and of moment, by axis."""
    whitening: Float[Array, "6 6"]
    intensities: Float[Array, "5"]
    rates: Float[Array, "5"]
    modulus_variance: Float[Array, ""]
    """Of k² about ½ in tangential contact; infinite where friction may make it another one."""
    rig: Rig
    errors: Float[Array, "15 15"]
    """Covariance of the errors of the setup, model units."""


@compiled
def advanced(
    state: Hypotheses, settings: Settings, sample: Float[AnyArray, "20"]
) -> tuple[Hypotheses, Float[Array, "137"]]:
    """Take position (3), orientation (4), force and moment (3 each), the time since the sample
    before, and the clamp's velocity (6), world axes.
    """
    return _advanced(state, settings, sample)


def _advanced(
    state: Hypotheses, settings: Settings, sample: Float[AnyArray, "20"]
) -> tuple[Hypotheses, Float[Array, "137"]]:
    duration, turn = sample[13], rotation_matrix(jnp.asarray(sample[3:7]))
    wrench = jnp.concatenate([sample[7:10] @ turn, sample[10:13] @ turn]) / settings.units[1:]
    sound = jnp.all(jnp.isfinite(wrench))
    whitened = settings.whitening @ jnp.where(jnp.isfinite(wrench), wrench, 0.0)
    velocity = jnp.concatenate([sample[14:17] @ turn / settings.units[0], sample[17:20] @ turn])
    arrival = state.probability @ _transition_probabilities()
    jumped = (state.strange >= _PATIENCE).astype(float)

    def one(kind: Array) -> tuple[Array, Array, Array, Array, Array]:
        mean, covariance, columns = _mixed(state, kind, arrival[kind], settings, jumped)
        step = _prediction(kind, duration)
        mean, covariance = kalman.predicted(mean, covariance, step, settings.intensities)
        mean = mean.at[ARC_LENGTH].set(jnp.clip(mean[ARC_LENGTH], 0.05, 1.0))
        step, excess, value = _observed(step, kind, mean, covariance, whitened, settings, sound)
        mean, covariance, trace, likelihood = kalman.updated(mean, covariance, step)
        changed = changes(value.wrench, value.reach, value.direction, velocity, settings.rig).wrench
        targets = -(settings.whitening @ changed) * (kind != FREE)
        columns = kalman.columns_updated(
            kalman.moved(step, columns),
            step,
            trace,
            jnp.concatenate([targets, jnp.zeros((2, COUNT))]),
        )[0]
        return mean, covariance, columns, likelihood, excess

    means, covariances, columns, likelihoods, excess = jax.vmap(one)(jnp.arange(3))
    weight = arrival * jnp.exp(likelihoods - jnp.max(likelihoods))
    probability = jnp.where(sound, weight / jnp.sum(weight), arrival)
    strange = jnp.where(
        jnp.min(excess) > _OUTLIER, jnp.where(jumped > 0, 0.0, state.strange + 1), 0.0
    )
    newest = jnp.where(sound, whitened, jnp.nan)
    recent = jnp.concatenate([newest[None], state.recent[:-1]])
    after = Hypotheses(means, covariances, probability, recent, strange, columns)
    return after, _report(after, settings, sample[:3] / settings.units[0], turn, velocity, sound)


@compiled
def advanced_through(
    state: Hypotheses,
    settings: Settings,
    samples: Float[AnyArray, "batch 20"],
    count: Int[AnyArray, ""],
) -> tuple[Hypotheses, Float[Array, "batch 137"]]:
    """The same for the first `count` of several samples, one after the other."""
    samples = jnp.asarray(samples)

    def one(index: Array, carried: tuple[Hypotheses, Array]) -> tuple[Hypotheses, Array]:
        after, report = _advanced(carried[0], settings, samples[index])
        return after, carried[1].at[index].set(report)

    through: tuple[Hypotheses, Array] = lax.fori_loop(
        0, count, one, (state, jnp.full((samples.shape[0], REPORT), jnp.nan))
    )
    return through


def _transition_probabilities() -> Float[Array, "3 3"]:
    return jnp.full((3, 3), _SWITCH) + (1 - 3 * _SWITCH) * jnp.eye(3)


def _mixed(
    state: Hypotheses, kind: Array, arrival: Array, settings: Settings, jumped: Array
) -> tuple[Float[Array, "16"], Float[Array, "16 16"], Float[Array, "16 15"]]:
    """State under a hypothesis from those under all, each as it would enter this one."""
    shares = state.probability * _transition_probabilities()[:, kind] / jnp.maximum(arrival, 1e-300)
    means, covariances, keep = jax.vmap(
        lambda other: _entered(state.mean[other], state.covariance[other], other, kind, settings)
    )(jnp.arange(3))
    mean = shares @ means
    away = means - mean
    covariance = jnp.einsum("k,kij->ij", shares, covariances) + jnp.einsum(
        "k,ki,kj->ij", shares, away, away
    )
    spread = (
        jnp.zeros(SIZE)
        .at[:ARC_LENGTH]
        .set(_JUMP**2)
        .at[COORDINATES : COORDINATES + ARC_LENGTH]
        .set(settings.rates[:3] ** 2)
    )
    columns = jnp.einsum("k,ki,kij->ij", shares, keep, state.columns)
    return mean, covariance + jnp.diag(spread) * jumped * (kind != FREE), columns


def _entered(
    mean: Float[Array, "16"],
    covariance: Float[Array, "16 16"],
    before: Array,
    kind: Array,
    settings: Settings,
) -> tuple[Float[Array, "16"], Float[Array, "16 16"], Float[Array, "16"]]:
    """As a fixed-interval smoother's sample begins: at rest where a contact begins, at the tip in
    tip contact, with a new rate of s₁ in tangential contact.
    """
    free, tip, onset = kind == FREE, kind == TIP, (before == FREE) & (kind != FREE)
    rate_of_arc_length = COORDINATES + ARC_LENGTH
    anew = (free | onset) & (_ENTRIES < 2 * COORDINATES)
    anew = anew | (tip & ((_ENTRIES == ARC_LENGTH) | (rate_of_arc_length == _ENTRIES)))
    anew = anew | ((kind == TANGENTIAL) & (before == TIP) & (rate_of_arc_length == _ENTRIES))
    keep = jnp.where(anew, 0.0, 1.0)
    begin = jnp.where(anew & (_ENTRIES == ARC_LENGTH), 1.0, 0.0)
    rates = jnp.concatenate([jnp.zeros(COORDINATES), settings.rates**2, jnp.zeros(WRENCH)])
    spread = jnp.where(anew & ~free & ~(tip & (rate_of_arc_length == _ENTRIES)), rates, 0.0)
    spread = spread + jnp.where(onset & (_ENTRIES == TILT), TILT_SPREAD**2, 0.0)
    spread = spread + jnp.where(onset & (kind == TANGENTIAL) & (_ENTRIES == ARC_LENGTH), 0.1, 0.0)
    return keep * mean + begin, keep[:, None] * covariance * keep + jnp.diag(spread), keep


def _prediction(kind: Array, duration: Array) -> Step:
    active = (
        jnp.where(kind == FREE, 0.0, jnp.ones(COORDINATES))
        .at[ARC_LENGTH]
        .set((kind == TANGENTIAL).astype(float))
    )
    nothing = jnp.zeros(SIZE)
    return Step(
        duration,
        nothing + 1,
        nothing,
        nothing,
        active,
        jnp.ones(()),
        jnp.zeros(ROWS),
        jnp.zeros((ROWS, SIZE)),
        jnp.full(ROWS, jnp.inf),
    )


def _observed(
    step: Step,
    kind: Array,
    mean: Array,
    covariance: Array,
    whitened: Array,
    settings: Settings,
    sound: Array,
) -> tuple[Step, Float[Array, ""], Bent]:
    """The sample linearised about the prediction, its squared distance from it, and what is
    predicted.
    """

    def both(x: Array) -> tuple[Array, tuple[Array, Bent]]:
        value = bent(x)
        seen = jnp.concatenate([settings.whitening @ value.wrench, value.modulus[None]])
        return seen, (seen, value)

    touching = (kind != FREE).astype(float)
    slope, (seen, value) = jax.jacfwd(both, has_aux=True)(mean[:COORDINATES])
    design = jnp.zeros((ROWS, SIZE)).at[:WRENCH, :COORDINATES].set(touching * slope[:WRENCH])
    design = (
        design.at[:WRENCH, 2 * COORDINATES :]
        .set(jnp.eye(WRENCH))
        .at[WRENCH + 1, :COORDINATES]
        .set(slope[WRENCH])
    )
    offset = design @ mean
    residual = whitened - touching * seen[:WRENCH] - mean[2 * COORDINATES :]
    target = (
        jnp.zeros(ROWS)
        .at[:WRENCH]
        .set(residual + offset[:WRENCH])
        .at[WRENCH + 1]
        .set(0.5 - seen[WRENCH] + offset[WRENCH + 1])
    )
    expected = design[:WRENCH] @ covariance @ design[:WRENCH].T + jnp.eye(WRENCH)
    distance = residual @ jnp.linalg.solve(expected, residual)
    variance = jnp.where(sound, jnp.maximum(1.0, distance / _OUTLIER), jnp.inf)
    square = jnp.where(kind == TANGENTIAL, settings.modulus_variance, jnp.inf)
    variances = jnp.full(ROWS, jnp.inf).at[:WRENCH].set(variance).at[WRENCH + 1].set(square)
    return (
        step._replace(target=target, design=design, variance=variances),
        jnp.where(sound, distance, 0.0),
        value,
    )


def _report(
    state: Hypotheses,
    settings: Settings,
    clamp: AnyArray,
    turn: Array,
    velocity: Array,
    sound: Array,
) -> Float[Array, "137"]:
    """What `update` reports.

    Point (3), direction (3), s₁, k², covariances of point and direction (9 each), probability of
    contact, its test's figure, and the kind, negative after a bad sample; what errors of the setup
    add to the covariances (9 each), and the derivatives of point and direction by its numbers (6,
    15).
    """
    shares = state.probability[1:] / jnp.maximum(jnp.sum(state.probability[1:]), 1e-300)
    mean = shares @ state.mean[1:]
    away = state.mean[1:] - mean
    covariance = jnp.einsum("k,kij->ij", shares, state.covariance[1:]) + jnp.einsum(
        "k,ki,kj->ij", shares, away, away
    )

    def contact(x: Array) -> tuple[Array, tuple[Array, Bent]]:
        value = bent(x)
        packed = jnp.concatenate(
            [
                clamp + turn @ value.reach,
                turn @ value.direction,
                x[ARC_LENGTH, None],
                value.modulus[None],
            ]
        )
        return packed, (packed, value)

    slope, (values, value) = jax.jacfwd(contact, has_aux=True)(mean[:COORDINATES])
    errors = slope @ covariance[:COORDINATES, :COORDINATES] @ slope.T
    seen = changes(value.wrench, value.reach, value.direction, velocity, settings.rig)
    moved = slope[:6] @ jnp.einsum("k,kij->ij", shares, state.columns[1:, :COORDINATES])
    sensitivity = moved + jnp.concatenate([turn @ seen.reach, turn @ seen.direction])
    shared = sensitivity @ settings.errors @ sensitivity.T
    drift, spread = (
        state.probability @ state.mean[:, 2 * COORDINATES :],
        state.covariance[0, 2 * COORDINATES :, 2 * COORDINATES :],
    )
    present = jnp.all(jnp.isfinite(state.recent), axis=1)
    count = jnp.sum(present)
    average = jnp.sum(jnp.where(present[:, None], state.recent - drift, 0.0), axis=0) / jnp.maximum(
        count, 1
    )
    distance = average @ jnp.linalg.solve(jnp.eye(WRENCH) / jnp.maximum(count, 1) + spread, average)
    kind = jnp.where(
        state.probability[TANGENTIAL] > state.probability[TIP], TANGENTIAL, TIP
    ) * jnp.where(sound, 1.0, -1.0)
    told = jnp.stack([1 - state.probability[FREE], distance, kind])
    blocks = [
        square[part, part].ravel()
        for square in (errors, shared)
        for part in (slice(0, 3), slice(3, 6))
    ]
    return jnp.concatenate([values, *blocks[:2], told, *blocks[2:], sensitivity.ravel()])
