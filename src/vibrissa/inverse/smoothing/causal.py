"""Smoothing as the samples come: a filter of fixed cost a sample, for live sensing.

Three hypotheses run side by side: no contact, tip contact, tangential contact. Each is the same
filter as the fixed-interval smoother's way forward, and they mix by their probabilities
(interacting multiple models: Blom & Bar-Shalom, *IEEE Trans. Automatic Control* 33, 1988).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from scipy.special import chdtri

from vibrissa.contacts import Status
from vibrissa.geometry.checks import finite_array, not_negative, positive
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse.parameters import COUNT, Rig, changes, prepared, velocities_of
from vibrissa.inverse.shared import in_clamp_axes
from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.fit import OUTLIER
from vibrissa.inverse.smoothing.kalman import (
    DRIFT,
    INTENSITIES,
    PLACE,
    RATE,
    ROWS,
    SIZE,
    WRENCH,
    Step,
)
from vibrissa.inverse.smoothing.manifold import (
    ARC_LENGTH,
    AT_REST,
    LOADS,
    chosen,
    linear_at,
)
from vibrissa.inverse.smoothing.model import (
    FREE,
    GO_ON,
    KINK,
    TANGENTIAL,
    TARED,
    TILT_SPREAD,
    TINY,
    TIP,
    Labels,
    entries,
    incidence_spread_of,
    observed,
    series_of,
)
from vibrissa.inverse.smoothing.result import LiveContact
from vibrissa.numerics.compiled import compiled
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.tolerances import SetupErrors
from vibrissa.trail import Trail

_MEAN_SAMPLES = 5
"""Averaged before a load is tested, as offline."""
_BATCH = 64
"""Samples of a call: they take far longer than the call itself."""
_SPEED = 0.2
"""Rod lengths a second, of a clamp of unknown speed."""
_RATES = np.array([30.0, 30.0, 30.0, 3.0, TILT_SPREAD])
"""Standard deviations of unknown rates, at a speed of a rod length a second: ten times those of a
sweep."""
_BEND = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
"""Of them where a phase changes: the rate of s₁ is then another one."""
_ARC_LENGTH_VARIANCE = 0.1
"""Of a contact that begins with the flank: that of a uniform s₁ about 1."""
_JUMP = 2.0
"""Standard deviation of unknown loads: those of a strongly bent rod."""
_SWITCH = 1e-2
"""Probability a sample that the hypothesis changes, to each of the others: contacts last hundreds
of samples, and a wrong hypothesis is left within some."""
_PATIENCE = 4
"""Consecutive outliers that are taken for a jump of the contact."""


class _Settings(NamedTuple):
    """What does not change."""

    whitening: Float[Any, "wrench wrench"]
    intensities: Float[Any, "intensities"]
    entries: tuple[Any, ...]
    """How the state of each kind (rows) enters each other (columns)."""
    jump: Float[Any, "state"]
    """Variances of the state added where the contact jumps."""
    incidence_variance: Float[Any, ""]
    """Of k² about ½ in tangential contact; infinite where friction may make it another one."""
    rig: Rig


class _Hypotheses(NamedTuple):
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


class CausalSmoother:
    """Filters one sweep sample by sample.

    Parameters
    ----------
    rod
        Uniform straight rod.
    covariance
        Of a sample's (force, moment) on the rod about the clamp, **clamp axes** (6, 6), units of
        the rod.
    position_covariance
        Of the clamp point (3, 3), or None.
    speed
        Of the clamp along the object, in units of the rod a second: how quickly contacts are
        expected to change. Default: a fifth of the length a second.
    intensities
        (5,) as `Smoothing.intensities`, in place of those that follow from the speed.
    friction
        Coulomb's coefficient between rod and object: 0 for none, None where it is not known.
        Where it is 0, tangential contacts are square to their force.
    false_alarm
        Share of samples without contact that may be taken for contact: the mean of five samples has
        to pass the chi-square test at that level, the drift of the zero and its error taken into
        account.
    model_error
        As for `smooth`.
    setup_errors
        What all samples share, as for `Reactions`; None for nothing.

    Raises
    ------
    ValueError
        If a figure is not allowed, or the covariance is not positive definite.

    Notes
    -----
    One call costs the same whatever came before. `reset` forgets all.
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
        if not 0 < false_alarm < 1:
            raise ValueError(f"false_alarm = {false_alarm!r}; allowed is a number between 0 and 1")
        still = np.zeros((1, 3))
        given = Reactions(
            Trail(still),
            still,
            still,
            covariance=np.asarray(covariance, dtype=float),
            position_covariance=(
                None
                if position_covariance is None
                else np.asarray(position_covariance, dtype=float)
            ),
            setup_errors=setup_errors,
        )
        self._rod, self._threshold = rod, float(chdtri(WRENCH, false_alarm))
        pace = _SPEED if speed is None else positive(speed, "speed") / rod.length
        # Of a sweep: accelerations are of the order of the speed squared, and last for its inverse.
        expected = np.array([100.0, 100.0, 1.0, 1e-4, 0.0]) * pace**3 + [0, 0, 0, 0, 1e-4]
        if intensities is not None:
            expected = finite_array(intensities, "intensities", last=INTENSITIES, ndim=1)
            if not np.all(expected > 0):
                raise ValueError(
                    f"intensities = {expected.tolist()}; allowed are numbers greater than 0"
                )
        if friction is not None:
            friction = not_negative(friction, "friction")
        spread, rates = incidence_spread_of(friction, setup_errors), _RATES * pace
        before, kind = np.divmod(np.arange(3 * 3), 3)
        link, one = np.where((before != kind) & (before != FREE), KINK, GO_ON), np.ones(len(kind))
        x, labels = np.tile(AT_REST, (len(kind), 1)), Labels(kind, link, one, one)
        entry = entries(before, labels, x, rates, _BEND, _ARC_LENGTH_VARIANCE)
        jump = np.zeros(SIZE)
        jump[:LOADS], jump[RATE][:LOADS] = _JUMP**2, rates[:LOADS] ** 2
        rig, _, self._errors = prepared(rod, setup_errors)
        settings = _Settings(
            series_of(rod, given, np.zeros(1, dtype=bool)).whitening[0],
            expected,
            tuple(part.reshape(3, 3, -1) for part in entry),
            jump,
            np.asarray(np.inf if spread is None else spread**2),
            rig,
        )
        self._settings = jax.tree.map(jnp.asarray, settings)
        floor = np.eye(3) * (not_negative(model_error, "model_error") * rod.length) ** 2
        clamp = given.position_covariance
        self._floor = floor if clamp is None else floor + clamp
        self.reset()

    def reset(self) -> None:
        """Forget all samples: a new recording begins, free of contact, with its zero as good as a
        tare over 50 samples.
        """
        start = kalman.at_rest(TARED)
        self._state = _Hypotheses(
            np.tile(start.mean, (3, 1)),
            np.tile(start.covariance, (3, 1, 1)),
            np.array([1.0, 0.0, 0.0]),
            np.full((_MEAN_SAMPLES, WRENCH), np.nan),
            np.zeros(()),
            np.zeros((3, SIZE, COUNT)),
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

        `velocity` is that of the clamp point and of its rotation (6,), a second; only what poses
        that come late do depends on it.

        Raises
        ------
        ValueError
            If the time does not increase, the pose is not finite, or a shape is another one.
        """
        trail = Trail(np.array([position]), np.array([orientation]))
        row = {"force": force, "moment": moment, "time": time, "velocity": velocity}
        given: dict[str, Any] = {name: np.array([value]) for name, value in row.items()}
        return self.update_all(Reactions(trail, **given))[0]

    def update_all(self, reactions: Reactions) -> LiveContact:
        """Take several samples of one trail (n, …) with time, in one call: as `update` does one by
        one, at a fraction of its cost for each.

        Raises
        ------
        ValueError
            If the reactions are of several trails or have no time, or the first is not after the
            last sample before.
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
        since = np.diff(time, prepend=time[0] if self._time is None else self._time)
        samples, told = (wrench, since, velocities_of(rod, reactions)), []
        for first in range(0, len(time), _BATCH):
            part = [values[first : first + _BATCH] for values in samples]
            count = np.asarray(len(part[0]))
            filled = kalman.filled(part, _BATCH)
            self._state, report = _advanced(self._state, self._settings, filled, count)
            told.append(
                jax.tree.map(lambda values, count=count: np.asarray(values)[:count], report)
            )
        self._time = float(time[-1])
        found = jax.tree.map(lambda *parts: np.concatenate(parts), *told)
        turn = rotation_matrices(trail.orientation)
        both = np.kron(np.eye(2), turn)
        sensitivity = both @ found["sensitivity"]
        shared = sensitivity @ self._errors @ np.swapaxes(sensitivity, 1, 2)
        noise = both @ found["noise"] @ np.swapaxes(both, 1, 2)
        (of_point, of_normal), (point_noise, normal_noise) = (
            (part[:, :3, :3] * rod.length**2 + self._floor, part[:, 3:, 3:])
            for part in (noise + shared, noise)
        )
        reach, direction = (turn @ found[name][..., None] for name in ("reach", "direction"))
        located = {
            "point": trail.position + rod.length * reach[..., 0],
            "force_direction": direction[..., 0],
            "arc_length": rod.length * found["arc_length"],
            "modulus": found["incidence"],
            "covariance": of_point,
            "normal_covariance": of_normal,
            "covariance_noise": point_noise,
            "normal_covariance_noise": normal_noise,
            "sensitivity": sensitivity,
        }
        touching = (found["probability"] >= 0.5) & (found["load"] > self._threshold)
        sound = np.isfinite(wrench).all(axis=1)
        return LiveContact(
            time,
            np.where(touching, found["kind"], FREE).astype(np.int8),
            **chosen(touching, located, np.nan),
            probability=found["probability"],
            status=np.where(sound, Status.OK, Status.BAD_DATA).astype(np.int8),
        )


@compiled
def _advanced(
    state: _Hypotheses, settings: _Settings, samples: Any, count: Int[Any, ""]
) -> tuple[_Hypotheses, dict[str, Array]]:
    """The first `count` samples taken, one after the other: wrenches in clamp axes and model units,
    times since the one before, velocities of the clamp.
    """
    found: tuple[_Hypotheses, dict[str, Array]] = kalman.scanned(
        lambda state, sample: _one(state, settings, *sample), state, samples, count
    )
    return found


def _one(
    state: _Hypotheses, settings: _Settings, wrench: Array, duration: Array, velocity: Array
) -> tuple[_Hypotheses, dict[str, Array]]:
    sound = jnp.all(jnp.isfinite(wrench))
    wrench = jnp.where(jnp.isfinite(wrench), wrench, 0.0)
    switch = jnp.full((3, 3), _SWITCH) + (1 - 3 * _SWITCH) * jnp.eye(3)
    arrival = state.probability @ switch
    jumped = state.strange >= _PATIENCE

    def one(kind: Array) -> tuple[Array, ...]:
        entry = [part[:, kind] for part in settings.entries]
        shares = state.probability * switch[:, kind] / jnp.maximum(arrival[kind], TINY)
        entered = jax.vmap(kalman.entered)(state.mean, state.covariance, *entry[:3])
        mean, covariance = _mixture(shares, *entered)
        covariance += jnp.diag(settings.jump) * (jumped & (kind != FREE))
        columns = jnp.einsum("k,ki,kij->ij", shares, entry[0], state.columns)
        step = Step(*[part[kind] for part in entry] + [duration, 1.0, None, None, None])
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
        value = linear.value
        by_setup = changes(settings.rig, value.wrench, value.reach, value.direction, velocity)
        seen = settings.whitening @ by_setup.wrench * (kind != FREE)
        variance = jnp.full(ROWS, jnp.inf).at[:WRENCH].set(jnp.maximum(1.0, distance / OUTLIER))
        variance = variance.at[-1].set(
            jnp.where(kind == TANGENTIAL, settings.incidence_variance, jnp.inf)
        )
        step = step._replace(
            target=jnp.column_stack(
                [residual + slope @ linear.x, jnp.zeros((ROWS, COUNT)).at[:WRENCH].set(-seen)]
            ),
            slope=slope,
            variance=jnp.where(sound | (jnp.arange(ROWS) >= WRENCH), variance, jnp.inf),
        )
        both = jnp.column_stack([mean, kalman.moved(step, columns)])
        both, covariance, told = kalman.updated(both, covariance, step)
        likelihood = kalman.log_likelihood(step, told)[0]
        return both[:, 0], covariance, both[:, 1:], likelihood, jnp.where(sound, distance, 0.0)

    means, covariances, columns, likelihoods, excess = jax.vmap(one)(jnp.arange(3))
    weight = arrival * jnp.exp(likelihoods - jnp.max(likelihoods))
    probability = jnp.where(sound, weight / jnp.sum(weight), arrival)
    newest = jnp.where(sound, settings.whitening @ wrench, jnp.nan)
    recent = jnp.concatenate([newest[None], state.recent[:-1]])
    strange = jnp.where(jumped, 0.0, state.strange + 1) * (jnp.min(excess) > OUTLIER)
    after = _Hypotheses(means, covariances, probability, recent, strange, columns)
    shares = probability[1:] / jnp.maximum(jnp.sum(probability[1:]), TINY)
    mean, covariance = _mixture(shares, means[1:], covariances[1:])
    linear = linear_at(mean[PLACE])
    slope = jnp.concatenate([linear.slope.reach, linear.slope.direction])
    value = linear.value
    seen = changes(settings.rig, value.wrench, value.reach, value.direction, velocity)
    moved = slope @ jnp.einsum("k,kij->ij", shares, columns[1:, PLACE])
    return after, {
        "reach": value.reach,
        "direction": value.direction,
        "arc_length": mean[ARC_LENGTH],
        "incidence": value.incidence,
        "noise": slope @ covariance[PLACE, PLACE] @ slope.T,
        "sensitivity": moved + jnp.concatenate([seen.reach, seen.direction]),
        "kind": jnp.where(probability[TANGENTIAL] > probability[TIP], TANGENTIAL, TIP),
        "probability": 1 - probability[FREE],
        "load": _load(after),
    }


def _mixture(
    shares: Float[Array, "k"], means: Float[Array, "k state"], covariances: Array
) -> tuple[Float[Array, "state"], Float[Array, "state state"]]:
    """Mean and covariance of a mixture."""
    mean = shares @ means
    away = means - mean
    within = jnp.einsum("k,kij->ij", shares, covariances)
    return mean, within + jnp.einsum("k,ki,kj->ij", shares, away, away)


def _load(state: _Hypotheses) -> Float[Array, ""]:
    """Of the mean of the last wrenches being noise and drift: chi-square with six degrees of
    freedom.
    """
    present = jnp.all(jnp.isfinite(state.recent), axis=1)
    count = jnp.maximum(jnp.sum(present), 1)
    drift = state.probability @ state.mean[:, DRIFT]
    average = jnp.sum(jnp.where(present[:, None], state.recent - drift, 0.0), axis=0) / count
    spread = jnp.eye(WRENCH) / count + state.covariance[FREE, DRIFT, DRIFT]
    return average @ jnp.linalg.solve(spread, average)
