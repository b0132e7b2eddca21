"""Smoothing as the samples come: a filter of fixed cost a sample, for live sensing.

Three hypotheses run side by side: no contact, tip contact, tangential contact. Each is the same
filter as the fixed-interval smoother's way forward, and they mix by their probabilities
(interacting multiple models: Blom & Bar-Shalom, *IEEE Trans. Automatic Control* 33, 1988).
"""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.stats import chi2

from vibrissa.contacts import ContactKind, Status
from vibrissa.geometry.checks import finite_array, not_negative, positive
from vibrissa.inverse.parameters import COUNT, prepared
from vibrissa.inverse.smoothing.hypotheses import (
    SAMPLE,
    Hypotheses,
    Settings,
    advanced,
    advanced_through,
)
from vibrissa.inverse.smoothing.kalman import INTENSITIES, SIZE, WRENCH
from vibrissa.inverse.smoothing.manifold import COORDINATES
from vibrissa.inverse.smoothing.series import AT_REST, TILT_SPREAD, modulus_spread_of
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.tolerances import SetupErrors

_MEAN_SAMPLES = 5
_TARE_VARIANCE = 0.02
_BATCH = 64


@dataclass(frozen=True, eq=False)
class LiveContact:
    """One sample's contact, given the samples so far. World axes, units of the rod.

    Attributes
    ----------
    time
        [s].
    kind
        `ContactKind.NONE` without contact.
    point, normal
        (3,); NaN without contact.
    arc_length, modulus
        s₁ and k².
    covariance, normal_covariance
        (3, 3): from sample to sample, and of what the whole sweep shares.
    covariance_noise, normal_covariance_noise
        (3, 3): from sample to sample alone.
    sensitivity
        (6, 15): as that of `Reconstruction`.
    probability
        Of contact, among the hypotheses.
    status
        BAD_DATA where the sample holds numbers that are not finite: the contact is then that
        predicted from the samples before.
    """

    time: float
    kind: ContactKind
    point: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    arc_length: float
    modulus: float
    covariance: Float[np.ndarray, "3 3"]
    normal_covariance: Float[np.ndarray, "3 3"]
    covariance_noise: Float[np.ndarray, "3 3"]
    normal_covariance_noise: Float[np.ndarray, "3 3"]
    sensitivity: Float[np.ndarray, "6 15"]
    probability: float
    status: Status


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
        0 where there is known to be none: k² = ½ is then used in tangential contact.
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
        self._rod = rod
        units = np.repeat([rod.force_scale, rod.moment_scale], 3)
        pace = (positive(speed, "speed") / rod.length) if speed is not None else 0.2
        spread = modulus_spread_of(
            None if friction is None else not_negative(friction, "friction"), setup_errors
        )
        self._settings = Settings(
            jnp.asarray(np.concatenate([[rod.length], units])),
            jnp.asarray(_whitening(covariance, units)),
            jnp.asarray(_intensities(intensities, pace)),
            jnp.asarray(np.array([30.0, 30.0, 30.0, 3.0, TILT_SPREAD]) * pace),
            jnp.asarray(np.inf if spread is None else spread**2),
            *jax.tree.map(jnp.asarray, prepared(rod, setup_errors)[::2]),
        )
        clamp = (
            np.zeros((3, 3))
            if position_covariance is None
            else finite_array(position_covariance, "position_covariance", last=3, ndim=2)
        )
        self._floor = (
            clamp + np.eye(3) * (not_negative(model_error, "model_error") * rod.length) ** 2
        )
        self._threshold = float(chi2.isf(false_alarm, WRENCH))
        self.reset()

    def reset(self) -> None:
        """Forget all samples: a new recording begins, free of contact, with its zero as good as a
        tare over 50 samples.
        """
        covariance = np.zeros((3, SIZE, SIZE))
        covariance[:, 2 * COORDINATES :, 2 * COORDINATES :] = _TARE_VARIANCE * np.eye(WRENCH)
        mean = np.zeros((3, SIZE))
        mean[:, :COORDINATES] = AT_REST
        recent = np.full((_MEAN_SAMPLES, WRENCH), np.nan)
        self._state = Hypotheses(
            *map(
                jnp.asarray,
                (
                    mean,
                    covariance,
                    np.array([1.0, 0.0, 0.0]),
                    recent,
                    0.0,
                    np.zeros((3, SIZE, COUNT)),
                ),
            )
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
            If the time does not increase, or the pose is not finite.
        """
        if not math.isfinite(time) or (self._time is not None and time <= self._time):
            before = "" if self._time is None else f", after the sample before at {self._time}"
            raise ValueError(f"time = {time!r}; allowed are finite increasing times{before}")
        sample = np.concatenate(
            [
                position,
                orientation,
                force,
                moment,
                [0.0 if self._time is None else time - self._time],
                velocity,
            ]
        ).astype(float)
        if sample.shape != (SAMPLE,) or not np.isfinite(sample[:7]).all() or not sample[3:7].any():
            raise ValueError(
                f"position, orientation, force, moment = {sample[:13].tolist()}; allowed are 3, 4, 3 and 3 numbers, a finite position and a quaternion"
            )
        self._time = float(time)
        self._state, packed = advanced(self._state, self._settings, sample)
        return self._contact(np.asarray(packed), self._time)

    def update_all(self, reactions: Reactions) -> list[LiveContact]:
        """Take several samples of one trail (n, …) with time, in one call: as `update` does one by
        one, at a fraction of its cost for each.

        Raises
        ------
        ValueError
            If the reactions are of several trails or have no time, or the first is not after the
            last sample before.
        """
        time, trail = reactions.time, reactions.trail
        if time is None or time.ndim != 1:
            raise ValueError(
                f"reactions of shape {reactions.force.shape}: allowed is one trail (n, …) with time"
            )
        if self._time is not None and len(time) and time[0] <= self._time:
            raise ValueError(
                f"time[0] = {time[0]}; allowed is after the sample before at {self._time}"
            )
        steps = np.diff(time, prepend=time[0] if self._time is None else self._time)
        samples = np.column_stack(
            [
                trail.position,
                trail.orientation,
                reactions.force,
                reactions.moment,
                steps,
                reactions.clamp_velocity(),
            ]
        )
        found: list[LiveContact] = []
        for first in range(0, len(samples), _BATCH):
            part = samples[first : first + _BATCH]
            filled = np.concatenate([part, np.zeros((_BATCH - len(part), SAMPLE))])
            self._state, packed = advanced_through(
                self._state, self._settings, filled, np.array(len(part))
            )
            rows = np.asarray(packed)[: len(part)]
            found += [
                self._contact(row, float(at))
                for row, at in zip(rows, time[first : first + _BATCH], strict=True)
            ]
        self._time = float(time[-1]) if len(time) else self._time
        return found

    def _contact(self, packed: Float[np.ndarray, "137"], time: float) -> LiveContact:
        probability, distance, sound = float(packed[26]), packed[27], packed[28] >= 0
        status = Status.OK if sound else Status.BAD_DATA
        if probability < 0.5 or not distance > self._threshold:
            nothing, square = np.full(3, np.nan), np.full((3, 3), np.nan)
            no_slope = np.full((6, COUNT), np.nan)
            return LiveContact(
                time,
                ContactKind.NONE,
                nothing,
                nothing,
                np.nan,
                np.nan,
                square,
                square,
                square,
                square,
                no_slope,
                probability,
                status,
            )
        length = self._rod.length
        noise, of_normal, shared, shared_normal = (
            packed[first : first + 9].reshape(3, 3) for first in (8, 17, 29, 38)
        )
        return LiveContact(
            time,
            ContactKind(int(abs(packed[28]))),
            length * packed[:3],
            packed[3:6],
            float(length * packed[6]),
            float(packed[7]),
            length**2 * (noise + shared) + self._floor,
            of_normal + shared_normal,
            length**2 * noise + self._floor,
            of_normal,
            packed[47:].reshape(6, COUNT),
            probability,
            status,
        )


def _whitening(covariance: ArrayLike, units: np.ndarray) -> Float[np.ndarray, "6 6"]:
    square = finite_array(covariance, "covariance", last=WRENCH, ndim=2) / np.outer(units, units)
    if square.shape != (WRENCH, WRENCH) or np.linalg.eigvalsh((square + square.T) / 2)[0] <= 0:
        raise ValueError(
            f"covariance of shape {square.shape}; allowed is a positive definite (6, 6)"
        )
    return np.linalg.inv(np.linalg.cholesky(square))


def _intensities(given: ArrayLike | None, pace: float) -> Float[np.ndarray, "5"]:
    """Those of a sweep at a speed (rod lengths a second): accelerations are of the order of its
    square, and last for its inverse.
    """
    if given is None:
        return np.array([100.0, 100.0, 1.0, 1e-4, 0.0]) * pace**3 + np.array([0, 0, 0, 0, 1e-4])
    values = finite_array(given, "intensities", last=INTENSITIES, ndim=1)
    if not np.all(values > 0):
        raise ValueError(f"intensities = {values.tolist()}; allowed are numbers greater than 0")
    return values
