"""Smoothing as the samples come: a filter of fixed cost a sample, for live sensing.

Three hypotheses run side by side: no contact, tip contact, tangential contact. Each is the same
filter as the fixed-interval smoother's way forward, and they mix by their probabilities
(interacting multiple models: Blom & Bar-Shalom, *IEEE Trans. Automatic Control* 33, 1988).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.stats import chi2

from vibrissa.contacts import ContactKind, Status
from vibrissa.geometry.checks import finite_array, not_negative, positive
from vibrissa.inverse.parameters import COUNT, prepared
from vibrissa.inverse.smoothing.fit import TARED
from vibrissa.inverse.smoothing.hypotheses import Hypotheses, Report, Sample, Settings, advanced
from vibrissa.inverse.smoothing.kalman import INTENSITIES, SIZE, WRENCH, at_rest
from vibrissa.inverse.smoothing.loops import filled
from vibrissa.inverse.smoothing.manifold import AT_REST, COORDINATES, LOADS
from vibrissa.inverse.smoothing.model import TILT_SPREAD, entries, incidence_spread_of
from vibrissa.inverse.smoothing.series import (
    FREE,
    GO_ON,
    KINK,
    Labels,
)
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.tolerances import SetupErrors

_MEAN_SAMPLES = 5
"""Averaged before a load is tested, as offline."""
_BATCH = 64
_SPEED = 0.2
"""Rod lengths a second, of a clamp of which nothing else is known."""
_RATES = np.array([30.0, 30.0, 30.0, 3.0, TILT_SPREAD])
"""Standard deviations of rates of which nothing is known, at a speed of a rod length a second: ten
times those of a sweep."""
_BEND = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
"""Of them where a phase changes: the rate of s₁ is then another one."""
_ARC_LENGTH_VARIANCE = 0.1
"""Of a contact that begins with the flank: that of a uniform s₁ about 1."""
_JUMP = 2.0
"""Standard deviation of loads of which nothing is known: those of a strongly bent rod."""


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
    point: Float[np.ndarray, 3]
    normal: Float[np.ndarray, 3]
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
        pace = _SPEED if speed is None else positive(speed, "speed") / rod.length
        if friction is not None:
            friction = not_negative(friction, "friction")
        spread, rates = incidence_spread_of(friction, setup_errors), _RATES * pace
        before, kind = np.divmod(np.arange(3 * 3), 3)
        link = np.where((before != kind) & (before != FREE), KINK, GO_ON)
        one = np.ones(len(kind))
        x = np.tile(AT_REST, (len(kind), 1))
        entry = entries(before, Labels(kind, link, one, one), x, rates, _BEND, _ARC_LENGTH_VARIANCE)
        jump = np.zeros((3, COORDINATES))
        jump[0, :LOADS], jump[1, :LOADS] = _JUMP**2, rates[:LOADS] ** 2
        rig, _, errors = prepared(rod, setup_errors)
        self._settings = jax.tree.map(
            jax.numpy.asarray,
            Settings(
                np.asarray(rod.length),
                units,
                _whitening(covariance, units),
                _intensities(intensities, pace),
                jax.tree.map(lambda part: part.reshape(3, 3, -1), entry),
                np.append(jump[:2], np.zeros(WRENCH)),
                np.asarray(np.inf if spread is None else spread**2),
                rig,
                errors,
            ),
        )
        clamp = (
            np.zeros((3, 3))
            if position_covariance is None
            else finite_array(position_covariance, "position_covariance", last=3, ndim=2)
        )
        floor = not_negative(model_error, "model_error") * rod.length
        self._floor = clamp + np.eye(3) * floor**2
        self._threshold = float(chi2.isf(false_alarm, WRENCH))
        self.reset()

    def reset(self) -> None:
        """Forget all samples: a new recording begins, free of contact, with its zero as good as a
        tare over 50 samples.
        """
        start = at_rest(TARED)
        self._state = Hypotheses(
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
            If the time does not increase, or the pose is not finite.
        """
        if not math.isfinite(time) or (self._time is not None and time <= self._time):
            before = "" if self._time is None else f", after the sample before at {self._time}"
            raise ValueError(f"time = {time!r}; allowed are finite increasing times{before}")
        parts = [
            np.asarray(part, dtype=float)
            for part in (position, orientation, force, moment, velocity)
        ]
        shapes = [part.shape for part in parts]
        if (
            shapes != [(3,), (4,), (3,), (3,), (6,)]
            or not np.isfinite([*parts[0], *parts[1]]).all()
            or not parts[1].any()
        ):
            given = [part.tolist() for part in parts[:4]]
            raise ValueError(
                f"position, orientation, force, moment = {given}; allowed are 3, 4, 3 and 3 "
                "numbers, a finite position and a quaternion"
            )
        wrench = np.concatenate(parts[2:4])
        duration = np.asarray(0.0 if self._time is None else time - self._time)
        sample = Sample(parts[0], parts[1], wrench, duration, parts[4])
        (found,) = self._taken(jax.tree.map(lambda part: part[None], sample), np.array([time]))
        return found

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
        samples = Sample(
            trail.position,
            trail.orientation,
            np.concatenate([reactions.force, reactions.moment], axis=1),
            np.diff(time, prepend=time[0] if self._time is None else self._time),
            reactions.clamp_velocity(),
        )
        found: list[LiveContact] = []
        for first in range(0, len(time), _BATCH):
            rows = slice(first, first + _BATCH)
            part = filled(jax.tree.map(lambda values, rows=rows: values[rows], samples), _BATCH)
            found += self._taken(part, time[rows])
        return found

    def _taken(self, samples: Sample, time: Float[np.ndarray, n]) -> list[LiveContact]:
        """The first samples, one for each time."""
        self._state, report = advanced(self._state, self._settings, samples, np.asarray(len(time)))
        self._time = float(time[-1])
        report = jax.tree.map(np.asarray, report)
        return [
            self._contact(jax.tree.map(lambda part, k=k: part[k], report), float(at))
            for k, at in enumerate(time)
        ]

    def _contact(self, report: Report, time: float) -> LiveContact:
        kind, located, length = ContactKind(int(report.kind)), report.located, self._rod.length
        if report.probability < 0.5 or not report.load > self._threshold:
            kind = ContactKind.NONE
            located = jax.tree.map(lambda part: np.full(np.shape(part), np.nan), located)
        point, normal = slice(0, 3), slice(3, 6)
        noise, whole = located.noise, located.noise + located.shared
        return LiveContact(
            time,
            kind,
            length * located.point,
            located.direction,
            float(length * located.arc_length),
            float(located.incidence),
            length**2 * whole[point, point] + self._floor,
            whole[normal, normal],
            length**2 * noise[point, point] + self._floor,
            noise[normal, normal],
            located.sensitivity,
            float(report.probability),
            Status.OK if report.sound else Status.BAD_DATA,
        )


def _whitening(covariance: ArrayLike, units: np.ndarray) -> Float[np.ndarray, "6 6"]:
    square = finite_array(covariance, "covariance", last=WRENCH, ndim=2) / np.outer(units, units)
    if square.shape != (WRENCH, WRENCH) or np.linalg.eigvalsh((square + square.T) / 2)[0] <= 0:
        raise ValueError(
            f"covariance of shape {square.shape}; allowed is a positive definite (6, 6)"
        )
    return np.linalg.inv(np.linalg.cholesky(square))


def _intensities(given: ArrayLike | None, pace: float) -> Float[np.ndarray, 5]:
    """Those of a sweep at a speed (rod lengths a second): accelerations are of the order of its
    square, and last for its inverse.
    """
    if given is None:
        return np.array([100.0, 100.0, 1.0, 1e-4, 0.0]) * pace**3 + np.array([0, 0, 0, 0, 1e-4])
    values = finite_array(given, "intensities", last=INTENSITIES, ndim=1)
    if not np.all(values > 0):
        raise ValueError(f"intensities = {values.tolist()}; allowed are numbers greater than 0")
    return values
