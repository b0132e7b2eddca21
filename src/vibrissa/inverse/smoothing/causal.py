"""Causal smoothing for live sensing: a filter of fixed cost per sample.

Three hypotheses run side by side: no contact, tip contact, tangential contact. Each is the forward
pass of the fixed-interval smoother, and they mix by their probabilities (interacting multiple
models: Blom & Bar-Shalom, *IEEE Trans. Automatic Control* 33, 1988).
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from jax.scipy.special import log_ndtr
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from scipy.special import chdtri

from vibrissa.contacts import Status
from vibrissa.geometry.checks import not_negative, positive, positive_array, share
from vibrissa.inverse.parameters import COUNT, Changes, Rig, changes, prepared, velocities_of
from vibrissa.inverse.shared import in_clamp_axes, with_shared
from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.estimate import located
from vibrissa.inverse.smoothing.fit import OUTLIER
from vibrissa.inverse.smoothing.kalman import (
    DRIFT,
    INTENSITIES,
    PLACE,
    RATE,
    ROWS,
    SIZE,
    WRENCH,
    Gaussian,
    Step,
)
from vibrissa.inverse.smoothing.manifold import (
    ARC_LENGTH,
    AT_REST,
    LOADS,
    Linear,
    Pose,
    chosen,
    finite,
    linear_at,
    poses_of,
    smoothed_model,
)
from vibrissa.inverse.smoothing.model import (
    FREE,
    TANGENTIAL,
    TARED,
    TILT_SPREAD,
    TINY,
    TIP,
    Labels,
    entries,
    incidence_spread_of,
    observed,
    whitening_of,
)
from vibrissa.inverse.smoothing.phases import DETECTION_SAMPLES, load_chi_square
from vibrissa.inverse.smoothing.result import LiveContact
from vibrissa.mechanics.model import RodModel
from vibrissa.numerics.compiled import compiled
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.tolerances import SetupErrors
from vibrissa.trail import Trail

_BATCH = 64
"""Samples per call: they take far longer than the call itself."""
_SPEED = 0.2
"""Rod lengths per second, for a clamp of unknown speed."""
_RATES = np.array([30.0, 30.0, 30.0, 3.0, TILT_SPREAD])
"""Standard deviations of unknown rates, at a speed of one rod length per second: ten times those of
a sweep.
"""
_BEND = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
"""Factors on them at a change of phase: only the rate of s₁ is new."""
_ARC_LENGTH_VARIANCE = 0.1
"""Of a contact that begins on the flank: that of a uniform s₁ about 1."""
_JUMP = 2.0
"""Standard deviation of unknown loads: those of a strongly bent rod."""
_SWITCH = 1e-2
"""Probability per sample of a switch to each other hypothesis: contacts last hundreds of samples,
and a wrong hypothesis is left within a few.
"""
_PATIENCE = 4
"""Consecutive outliers that count as a jump of the contact."""


class _Settings(NamedTuple):
    """What does not change."""

    whitening: Float[Any, "wrench wrench"]
    intensities: Float[Any, "intensities"]
    entries: tuple[Any, ...]
    """How the state of each kind (rows) enters each other (columns)."""
    jump: Float[Any, "state"]
    """Variances added to the state if the contact jumps."""
    incidence_variance: Float[Any, ""]
    """Of k² about ½ in tangential contact; infinite if friction may change it."""
    rig: Rig
    rod: RodModel


class _Hypotheses(NamedTuple):
    """What the filter carries from sample to sample."""

    state: Gaussian
    """Of each `ContactKind`. Further columns of the means are their derivatives with respect to the
    setup's parameters for given readings: the same filter, with the change of the wrench in place
    of the readings.
    """
    probability: Float[Any, "kinds"]
    strange: Float[Any, ""]
    """Consecutive outliers."""
    recent: Float[Any, "samples wrench"]
    """Latest wrenches, whitened; NaN where there was none."""


class CausalSmoother:
    """Filters one sweep sample by sample.

    Parameters
    ----------
    rod
        Any whose tip is ahead of its clamp.
    covariance
        Of a sample's (force, moment) on the rod about the clamp, **clamp axes** (6, 6), units of
        the rod.
    position_covariance
        Of the clamp point (3, 3), or None.
    speed
        Of the clamp along the object, in units of the rod per second: how quickly contacts are
        expected to change. Default: a fifth of the length per second.
    intensities
        (5,) as `Smoothing.intensities`, instead of those that follow from the speed.
    friction
        Coulomb friction coefficient between rod and object: 0 for none, None if unknown. If it is
        0, tangential contacts are perpendicular to their force.
    false_alarm
        Fraction of samples without contact that may be mistaken for contact: the mean of five
        samples has to exceed the chi-square limit at that level, allowing for the drift of the zero
        and its error.
    model_error
        As for `smooth`.
    setup_errors
        Errors that all samples share, as for `Reactions`; None for none.

    Raises
    ------
    ValueError
        If a value is not allowed, or the covariance is not positive definite; if the unloaded rod
        does not lead away from the clamp.

    Notes
    -----
    Each call costs the same, whatever came before. `reset` forgets everything.
    """

    def __init__(
        self,
        rod: Rod,
        covariance: ArrayLike,
        *,
        position_covariance: ArrayLike | None = None,
        speed: float | None = None,
        intensities: ArrayLike | None = None,
        friction: float | None = None,
        false_alarm: float = 1e-3,
        model_error: float = 2e-4,
        setup_errors: SetupErrors | None = None,
    ) -> None:
        share(false_alarm, "false_alarm")
        still = np.zeros((1, 3))
        given = Reactions(
            Trail(still),
            still,
            still,
            covariance=covariance,
            position_covariance=position_covariance,
            setup_errors=setup_errors,
        )
        self._rod, self._threshold = rod, float(chdtri(WRENCH, false_alarm))
        pace = _SPEED if speed is None else positive(speed, "speed") / rod.length
        # Of a sweep: accelerations are of the order of the speed squared, and last for its inverse.
        expected = np.array([100.0, 100.0, 1.0, 1e-4, 0.0]) * pace**3 + [0, 0, 0, 0, 1e-4]
        if intensities is not None:
            expected = positive_array(intensities, "intensities", last=INTENSITIES)
        if friction is not None:
            friction = not_negative(friction, "friction")
        spread, rates = incidence_spread_of(friction, setup_errors), _RATES * pace
        before, kind = np.divmod(np.arange(3 * 3), 3)
        x = np.tile(AT_REST, (len(kind), 1))
        keep, begin, *entry = entries(
            before, Labels.of(kind), x, rates, _BEND, _ARC_LENGTH_VARIANCE
        )
        entry = [keep, _with_columns(begin), *entry]
        jump = np.zeros(SIZE)
        jump[:LOADS], jump[RATE][:LOADS] = _JUMP**2, rates[:LOADS] ** 2
        rig, _, self._errors = prepared(rod, setup_errors)
        settings = _Settings(
            whitening_of(in_clamp_axes(given, rod)[1])[0],
            expected,
            tuple(part.reshape(3, 3, *part.shape[1:]) for part in entry),
            jump,
            np.asarray(np.inf if spread is None else spread**2),
            rig,
            smoothed_model(rod),
        )
        self._settings = jax.tree.map(jnp.asarray, settings)
        self._given, self._model_error = given, not_negative(model_error, "model_error")
        self.reset()

    def reset(self) -> None:
        """Forget all samples: a new recording begins, free of contact, with a zero as good as a
        tare over 50 samples.
        """
        start = kalman.at_rest(TARED)
        self._state = _Hypotheses(
            Gaussian(
                np.tile(_with_columns(start.mean), (3, 1, 1)), np.tile(start.covariance, (3, 1, 1))
            ),
            np.array([1.0, 0.0, 0.0]),
            np.zeros(()),
            np.full((DETECTION_SAMPLES, WRENCH), np.nan),
        )
        self._time: float | None = None

    def update(
        self,
        time: float,
        position: ArrayLike,
        orientation: ArrayLike,
        force: ArrayLike,
        moment: ArrayLike,
        velocity: ArrayLike = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    ) -> LiveContact:
        """Take one sample: time [s], the clamp's position (3,) and quaternion x, y, z, w (4,),
        force and moment on the rod about the clamp (3,), world axes.

        `velocity` is that of the clamp point and of its rotation (6,), per second; only the effect
        of late poses depends on it.

        Raises
        ------
        ValueError
            If the time does not increase, the pose is not finite, or a shape is wrong.
        """
        f, m, t, v = (np.array([part]) for part in (force, moment, time, velocity))
        trail = Trail(np.array([position]), np.array([orientation]))
        return self.update_all(Reactions(trail, f, m, time=t, velocity=v))[0]

    def update_all(self, reactions: Reactions) -> LiveContact:
        """Take several samples of one trail (n, …) with time, in one call: the same as `update` one
        by one, at a fraction of its cost per sample.

        Raises
        ------
        ValueError
            If the reactions are of several trails or have no time, or the first does not come after
            the previous sample; if a load bends the rod back to the clamp.
        """
        rod, time, trail = self._rod, reactions.time, reactions.trail
        if time is None or time.ndim != 1:
            raise ValueError(
                f"reactions of shape {reactions.force.shape}: allowed is one trail (n, …) with time"
            )
        if self._time is not None and time[0] <= self._time:
            raise ValueError(
                f"time = {time[0]}; allowed are finite increasing times, after the sample before "
                f"at {self._time}"
            )
        wrench, _ = in_clamp_axes(reactions, rod)
        pose = poses_of(self._settings.rod, trail, rod.length)
        wrench = wrench if pose is None else wrench - pose.free
        since = np.diff(time, prepend=time[0] if self._time is None else self._time)
        samples, told = (wrench, since, velocities_of(rod, reactions), pose), []
        for first in range(0, len(time), _BATCH):
            part = jax.tree.map(lambda values, at=first: values[at : at + _BATCH], samples)
            count, part = np.asarray(len(part[0])), kalman.filled(part, _BATCH)
            self._state, report = _advanced(self._settings, self._state, part, count)
            told.append(report)
        self._time = float(time[-1])
        found: _Found = jax.tree.map(lambda *parts: np.concatenate(parts)[: len(time)], *told)
        rows = located(rod, trail, *found[:4], self._given, self._model_error)
        rows = with_shared(rows, rod.length, self._errors)
        touching = (found.probability >= 0.5) & (found.load > self._threshold)
        status = np.where(touching & ~finite(found.linear), Status.NOT_CONVERGED, Status.OK)
        status = np.where(finite(wrench), status, Status.BAD_DATA)
        return LiveContact(
            time,
            np.where(touching, found.kind, FREE).astype(np.int8),
            **chosen(touching, rows, np.nan),
            probability=found.probability,
            status=status.astype(np.int8),
        )


class _Found(NamedTuple):
    """What the contact hypotheses say together, and whether the rod is loaded at all."""

    linear: Linear
    errors: Float[Any, "*n coordinates coordinates"]
    seen: Changes
    moved: Float[Any, "*n coordinates setup"]
    """Derivatives of the coordinates with respect to the setup's parameters."""
    kind: Int[Any, "*n"]
    probability: Float[Any, "*n"]
    """Of contact."""
    load: Float[Any, "*n"]
    """Chi-square of the last wrenches' mean."""


def _with_columns(mean: Float[np.ndarray, "*n state"]) -> Float[np.ndarray, "*n state columns"]:
    """With zero derivatives with respect to the setup's parameters."""
    return mean[..., None] * np.eye(1, 1 + COUNT)[0]


@compiled
def _advanced(settings: _Settings, state: _Hypotheses, samples: Any, count: Int[Any, ""]) -> Any:
    """The first `count` samples, taken one by one: wrenches in clamp axes and model units, times
    since the previous one, velocities of the clamp, and its poses if the rod is loaded.
    """
    return kalman.scanned(partial(_one, settings), state, samples, count)


def _one(
    settings: _Settings, hypotheses: _Hypotheses, sample: tuple[Array, Array, Array, Pose | None]
) -> tuple[_Hypotheses, _Found]:
    wrench, duration, velocity, pose = sample
    sound = jnp.all(jnp.isfinite(wrench))
    recent = jnp.vstack([hypotheses.recent[1:], settings.whitening @ wrench])
    wrench = jnp.where(sound, wrench, 0.0)
    switch = jnp.full((3, 3), _SWITCH) + (1 - 3 * _SWITCH) * jnp.eye(3)
    arrival = hypotheses.probability @ switch
    jumped = hypotheses.strange >= _PATIENCE

    def one(kind: Array) -> tuple[Gaussian, Array, Array]:
        entry = [part[:, kind] for part in settings.entries]
        shares = hypotheses.probability * switch[:, kind] / jnp.maximum(arrival[kind], TINY)
        state = _mixture(shares, jax.vmap(kalman.entered)(hypotheses.state, *entry[:3]))
        jump = jnp.diag(settings.jump) * (jumped & (kind != FREE))
        step = Step(*[part[kind] for part in entry] + [duration, 1.0, None, None, None])
        mean, covariance = kalman.predicted(
            state._replace(covariance=state.covariance + jump), step, settings.intensities
        )
        mean = mean.at[ARC_LENGTH, 0].set(jnp.clip(mean[ARC_LENGTH, 0], 0.05, 1.0))
        # The sample linearised about the prediction, its squared distance from it, and its setup
        # errors.
        linear = linear_at(mean[PLACE, 0], settings.rod, pose)
        # Where no rod has these coordinates the hypothesis is wrong, and begins anew from others.
        exists = jnp.all(jnp.isfinite(ravel_pytree(linear)[0]))
        linear = jax.tree.map(lambda part: jnp.where(exists, part, 0.0), linear)
        target, slope = observed(linear, wrench, settings.whitening, jnp)
        value, slope = linear.value, slope * (kind != FREE)
        by_setup = changes(settings.rig, value.wrench, value.reach, value.direction, velocity)
        seen = settings.whitening @ by_setup.wrench * (kind != FREE)
        columns = jnp.zeros((ROWS, COUNT)).at[:WRENCH].set(-seen)
        target = jnp.column_stack([target, columns])
        step = step._replace(target=target, slope=slope)
        design = kalman.design(step)[:WRENCH]
        away = target[:WRENCH, 0] - design @ mean[:, 0]
        spread = design @ covariance @ design.T + jnp.eye(WRENCH)
        distance = away @ jnp.linalg.solve(spread, away)
        noise = jnp.where(sound & exists, jnp.maximum(1.0, distance / OUTLIER), jnp.inf)
        square = jnp.where(kind == TANGENTIAL, settings.incidence_variance, jnp.inf)
        variance = jnp.append(jnp.full(ROWS - 1, noise), square).at[WRENCH].set(jnp.inf)
        step = step._replace(variance=variance)
        state, told = kalman.updated(Gaussian(mean, covariance), step)
        # The probability that noise alone puts a contact so far beyond the tip, or as far short.
        beyond = (state.mean[ARC_LENGTH, 0] - 1) / jnp.sqrt(
            jnp.maximum(state.covariance[ARC_LENGTH, ARC_LENGTH], TINY)
        )
        on_rod = jnp.minimum(math.log(2) + log_ndtr(-beyond), 0.0) * (kind == TANGENTIAL)
        likelihood = kalman.log_likelihood(step, told)[0] + on_rod
        likelihood = jnp.where(exists | ~sound, likelihood, -jnp.inf)
        return state, likelihood, jnp.where(sound, jnp.where(exists, distance, jnp.inf), 0.0)

    states, likelihoods, excess = jax.vmap(one)(jnp.arange(3))
    weight = arrival * jnp.exp(likelihoods - jnp.max(likelihoods))
    probability = jnp.where(sound, weight / jnp.sum(weight), arrival)
    strange = jnp.where(jumped, 0.0, hypotheses.strange + 1) * (jnp.min(excess) > OUTLIER)
    shares = probability.at[FREE].set(0.0) / jnp.maximum(jnp.sum(probability[1:]), TINY)
    mean, covariance = _mixture(shares, states)
    linear = linear_at(mean[PLACE, 0], settings.rod, pose)
    value = linear.value
    zero = Gaussian(probability @ states.mean[:, DRIFT, 0], states.covariance[FREE, DRIFT, DRIFT])
    seen = jnp.isfinite(recent).all(axis=1)
    count = jnp.maximum(jnp.sum(seen), 1.0)
    load = jnp.sum(jnp.where(seen[:, None], recent - zero.mean, 0.0), axis=0) / count
    return _Hypotheses(states, probability, strange, recent), _Found(
        linear,
        covariance[PLACE, PLACE],
        changes(settings.rig, value.wrench, value.reach, value.direction, velocity),
        mean[PLACE, 1:],
        jnp.where(probability[TANGENTIAL] > probability[TIP], TANGENTIAL, TIP),
        1 - probability[FREE],
        load_chi_square(load, count, zero, jnp),
    )


def _mixture(shares: Float[Array, "k"], states: Gaussian) -> Gaussian:
    """Mean and covariance of a mixture."""
    mean = jnp.tensordot(shares, states.mean, 1)
    away = (states.mean - mean)[..., 0]
    within = jnp.einsum("k,kij->ij", shares, states.covariance)
    return Gaussian(mean, within + jnp.einsum("k,ki,kj->ij", shares, away, away))
