"""Specifications of a sensor: its noise, its response to a wrench, what it carries, and how its
zero is found.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrissa.geometry.checks import finite_array, not_negative, positive
from vibrissa.geometry.rotation import cross_matrices
from vibrissa.sensor.lowpass import LowPass
from vibrissa.sensor.noise import NO_STEP, Coloured, Pink, RandomWalk
from vibrissa.sensor.raw import Interval, Times, Wrench

Vector = tuple[float, float, float]
PerAxis = float | Vector

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)
"""Standard acceleration of free fall [m/s²], world axes with z up (ISO 80000-3)."""

# Solving with a matrix of this condition number keeps half of the sixteen digits.
_LARGEST_CONDITION = 1e8
# Decimals are inexact in binary: a range of 20 steps must not end at 19.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Noise:
    """Random errors of readings and poses. Figures for force and torque are one number for all
    axes, or one for each.

    Attributes
    ----------
    force_noise, torque_noise
        Standard deviation of a sample's white noise [N], [N m], greater than 0; None if unknown.
    force_resolution, torque_resolution
        Steps of the numbers [N], [N m].
    force_random_walk, torque_random_walk
        Standard deviation of a random walk after one second [N/√s], [N m/√s]; it grows with the
        square root of time.
    noise_corner
        Corner frequency [Hz], at which pink noise has the power spectral density of the white
        noise; 0 for no pink noise.
    position_noise, orientation_noise
        Standard deviation of the robot's position [m], and of its orientation as a rotation vector
        [rad], on each axis; position noise is used if the wrench's noise is known. Orientation
        noise rotates rod and wrench as one body about the sensor's origin, also if the wrench is in
        world axes, as the logged orientation was used to rotate it: a contact moves by the cross
        product of the rotation with the vector from the origin. The error from subtracting the
        mount's weight in a slightly wrong orientation is not in any covariance.

    Raises
    ------
    ValueError
        If a figure is negative or not finite, only one of force and torque noise is given, or pink
        noise or a random walk is given without white noise.
    """

    force_noise: PerAxis | None = None
    torque_noise: PerAxis | None = None
    force_resolution: PerAxis = 0.0
    torque_resolution: PerAxis = 0.0
    force_random_walk: PerAxis = 0.0
    torque_random_walk: PerAxis = 0.0
    noise_corner: float = 0.0
    position_noise: float = 0.0
    orientation_noise: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            _check_figure(name, value)
        if (self.force_noise is None) != (self.torque_noise is None):
            raise ValueError(
                "force_noise and torque_noise: one is given without the other; "
                "allowed are both or none"
            )
        for name in ("noise_corner", "force_random_walk", "torque_random_walk"):
            if not self.known and np.any(getattr(self, name)):
                raise ValueError(
                    f"{name} = {getattr(self, name)} without force_noise and torque_noise; "
                    "allowed is 0, or both beside it"
                )

    @property
    def known(self) -> bool:
        """Whether the white noise is stated."""
        return self.force_noise is not None

    @property
    def white(self) -> Wrench:
        """Standard deviation (6,) of the channels' white noise [N], [N m].

        Raises
        ------
        ValueError
            If it is unknown.
        """
        if not self.known:
            raise ValueError(
                "force_noise = None: the variance of a reading is not known; "
                "allowed is a sensor with force_noise and torque_noise"
            )
        return _six(self.force_noise, self.torque_noise)

    @property
    def resolution(self) -> Wrench:
        """Resolution (6,) of the channels [N], [N m]; 0 for none."""
        return _six(self.force_resolution, self.torque_resolution)

    @property
    def random_walk(self) -> Wrench:
        """Standard deviation (6,) of the channels' random walk after 1 s [N/√s], [N m/√s]."""
        return _six(self.force_random_walk, self.torque_random_walk)

    @property
    def variance(self) -> Wrench:
        """Variance (6,) of one reading's white noise and rounding [N²], [(N m)²].

        Raises
        ------
        ValueError
            If the noise is unknown.
        """
        return self.white**2 + self.resolution**2 / 12

    @property
    def lasting(self) -> bool:
        """Whether there is noise that does not average out."""
        return self.noise_corner > 0 or bool(np.any(self.random_walk))

    def coloured(self, time: Times) -> list[Coloured]:
        """The sensor's pink noise and random walk over the stamps (n,), each with its scale (6,) on
        the channels.
        """
        interval = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
        return self.coloured_within(float(time[0]), float(time[-1] - time[0]), interval)

    def coloured_within(self, start: float, duration: float, interval: float) -> list[Coloured]:
        """The same for a recording from `start` with this duration and sampling interval [s]; no
        pink noise if the interval is 0.
        """
        processes: list[Coloured] = []
        if self.noise_corner > 0 and interval > 0:
            # The one-sided density of white noise is twice its variance over the sampling rate; at
            # the corner, pink noise has the same density.
            factor = np.sqrt(2 * self.noise_corner * interval)
            processes.append((Pink.within(duration, interval), factor * self.white))
        if np.any(self.random_walk):
            processes.append((RandomWalk(start), self.random_walk))
        return processes

    def wandered(self, time: Times, first: Interval, second: Interval) -> Wrench:
        """Variance (6,) of the change of the mean offset between two intervals due to pink noise
        and random walk over the stamps (n,).
        """
        variance = np.zeros(6)
        for process, scale in self.coloured(time):
            own = process.between_means(first, first) + process.between_means(second, second)
            variance += scale**2 * max(own - 2 * process.between_means(first, second), 0.0)
        return variance


@dataclass(frozen=True, eq=False)
class Response:
    """How the sensor responds to a wrench, apart from noise.

    Attributes
    ----------
    gain
        Ratio of reading to true value for the six channels, force x, y, z and torque x, y, z in
        sensor axes, before cross-talk.
    cross_talk
        Matrix (6, 6) that maps the true wrench (force, torque) in sensor axes to the readings; None
        for the identity.
    force_range, torque_range
        Largest reading on each axis (3,) [N], [N m]; None if unknown.
    low_pass
        Filter and delay of the electronics, or None.

    Raises
    ------
    ValueError
        If a gain or a range is not greater than 0, or the cross-talk has no inverse.
    """

    gain: tuple[float, float, float, float, float, float] = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    cross_talk: Float[np.ndarray, "6 6"] | None = None
    force_range: Vector | None = None
    torque_range: Vector | None = None
    low_pass: LowPass | None = None

    def __post_init__(self) -> None:
        for name, size in (("gain", 6), ("force_range", 3), ("torque_range", 3)):
            value = getattr(self, name)
            if value is not None and np.any(finite_array(value, name, last=size, ndim=1) <= 0):
                raise ValueError(
                    f"{name} = {value!r}; allowed are {size} finite numbers greater than 0"
                )
        if self.cross_talk is not None:
            matrix = finite_array(self.cross_talk, "cross_talk")
            if matrix.shape != (6, 6):
                raise ValueError(f"cross_talk has shape {matrix.shape}; allowed is (6, 6)")
            condition = np.linalg.cond(matrix)
            if not condition < _LARGEST_CONDITION:
                raise ValueError(
                    f"cross_talk has the condition {condition:.3g}; allowed is a matrix with an "
                    f"inverse, of a condition below {_LARGEST_CONDITION:g}"
                )
            object.__setattr__(self, "cross_talk", matrix)

    @property
    def matrix(self) -> Float[np.ndarray, "6 6"]:
        """Map from the true wrench in sensor axes to the readings: gain, then cross-talk."""
        return (np.eye(6) if self.cross_talk is None else self.cross_talk) * np.asarray(self.gain)

    def limits(self, resolution: Wrench) -> Wrench:
        """Largest reading (6,) of each channel [N], [N m]: the last step within its range, infinite
        if the range is unknown.
        """
        ranges = _six(self.force_range or np.inf, self.torque_range or np.inf)
        steps = np.maximum(resolution, NO_STEP)
        return np.floor(ranges / steps + _ROUNDING) * steps


@dataclass(frozen=True)
class TarePolicy:
    """Where the sensor's zero is taken, and what is known about its drift.

    Attributes
    ----------
    tare_seconds
        Contact-free time [s] at the start, whose mean wrench is subtracted; 0 for no tare, None to
        detect the rest at the start.
    rest_intervals
        Contact-free intervals (start, stop) [s] since the recording's start; they replace
        `tare_seconds`.
    estimate_drift
        Whether to estimate a linear drift of the offset from rest at the start and at the end, in
        addition to a known one.
    force_drift, torque_drift
        Known rates of the offset (3,) [N/s], [N m/s], in the axes of the wrench, since the
        recording's start.

    Raises
    ------
    ValueError
        If `tare_seconds` is negative, a figure is not finite, or rest intervals are not in order.
    """

    tare_seconds: float | None = 0.0
    rest_intervals: tuple[Interval, ...] = ()
    estimate_drift: bool = False
    force_drift: Vector = (0.0, 0.0, 0.0)
    torque_drift: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.tare_seconds is not None:
            not_negative(self.tare_seconds, "tare_seconds")
        for name in ("force_drift", "torque_drift"):
            finite_array(getattr(self, name), name, last=3, ndim=1)
        edges = finite_array(self.rest_intervals or (0, 1), "rest_intervals", last=2).ravel()
        if np.any(np.diff(edges, prepend=0.0) < 0) or np.any(edges[1::2] <= edges[::2]):
            raise ValueError(
                f"rest_intervals = {self.rest_intervals}; allowed are pairs (start, stop) of at "
                "least 0, in order, that do not overlap"
            )

    @property
    def drift(self) -> Wrench:
        """Known rates (6,) of the offset [N/s], [N m/s]."""
        return _six(self.force_drift, self.torque_drift)


@dataclass(frozen=True)
class Mount:
    """The parts that the sensor carries: clamp, adapter and rod.

    Attributes
    ----------
    mass
        [kg].
    center
        Centre of mass in the sensor frame (3,) [m].
    gravity
        Gravitational acceleration in world axes (3,) [m/s²].
    estimated
        Whether mass and centre are estimated from the recording's own rest intervals, in at least
        three orientations, instead of those given.

    Raises
    ------
    ValueError
        If the mass is negative, or a figure is not finite.
    """

    mass: float = 0.0
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gravity: tuple[float, float, float] = STANDARD_GRAVITY
    estimated: bool = False

    def __post_init__(self) -> None:
        not_negative(self.mass, "mount.mass")
        for name in ("center", "gravity"):
            finite_array(getattr(self, name), f"mount.{name}", last=3, ndim=1)

    @property
    def moments(self) -> Float[np.ndarray, "4"]:
        """Mass [kg] and first moments of mass [kg m], in which the weight is linear."""
        return np.array([self.mass, *(self.mass * np.asarray(self.center))])

    def weight(
        self, axes: Float[np.ndarray, "n 3 3"], point: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "n 6 4"]:
        """Matrices that map `moments` to the weight's force and torque on the sensor about `point`,
        in sensor axes.

        Parameters
        ----------
        axes
            Rotations (n, 3, 3) from sensor to world axes.
        point
            Reference point in the sensor frame (3,) [m].
        """
        fall = np.asarray(self.gravity) @ axes
        matrix = np.zeros((len(axes), 6, 4))
        matrix[:, :3, 0], matrix[:, 3:, 0] = fall, -np.cross(point, fall)
        matrix[:, 3:, 1:] = -cross_matrices(fall)
        return matrix


def _six(force: Any, torque: Any) -> Wrench:
    """Figures for the six channels, from one number for all axes or one for each."""
    return np.concatenate([np.broadcast_to(part, 3) for part in (force, torque)]).astype(float)


def _check_figure(name: str, value: Any) -> None:
    white, by_axis = name in {"force_noise", "torque_noise"}, name.startswith(("force", "torque"))
    if white and value is None:
        return
    if np.shape(value) not in ((), (3,) if by_axis else ()):
        raise ValueError(f"{name} = {value!r}; allowed is a number, or three, one for each axis")
    for number in np.ravel(value).tolist():
        (positive if white else not_negative)(number, name)
