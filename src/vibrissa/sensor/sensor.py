"""A six-axis force/torque sensor that carries the rod's clamp."""

from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array
from vibrissa.geometry.rotation import inverse, multiplied, rotation_matrices, unit_quaternions
from vibrissa.reactions import Reactions
from vibrissa.sensor.lowpass import LowPass
from vibrissa.sensor.maps import to_reactions
from vibrissa.sensor.model import logged
from vibrissa.sensor.mount import Mount
from vibrissa.sensor.noise import Pink, RandomWalk
from vibrissa.sensor.raw import RawRecording
from vibrissa.sensor.rest import rest_for_tare
from vibrissa.sensor.tare import Tare, fitted_tare, no_tare
from vibrissa.tolerances import SetupErrors, Tolerances
from vibrissa.trail import Trail

WrenchSign = Literal["on_sensor", "on_rod"]
WrenchFrame = Literal["sensor", "world"]
Vector = tuple[float, float, float]
Channels = tuple[float, float, float, float, float, float]

_LARGEST_CONDITION = 1e8
_SAME = 1e-9


def _six(force: float | Vector, torque: float | Vector) -> Float[np.ndarray, "6"]:
    """Figures of the six channels, of one number for all axes or one for each."""
    return np.concatenate(
        [np.broadcast_to(np.asarray(part, dtype=float), 3) for part in (force, torque)]
    )


@dataclass(frozen=True, eq=False)
class Sensor:
    """Where the clamp sits on the sensor, what the wrench's numbers mean, and how noisy they are.
    SI units.

    Attributes
    ----------
    clamp_position, clamp_orientation
        Clamp in the sensor frame: (3,) [m], and the quaternion x, y, z, w that maps clamp axes onto
        sensor axes. The rod leaves along clamp +z.
    wrench
        "on_sensor": exerted by the rod on the sensor. "on_rod": the support reaction. A wrench
        message does not say; it must be given.
    wrench_frame
        Axes of the wrench: "sensor" or "world".
    wrench_point
        Reference point of the torque in the sensor frame (3,) [m].
    tare_seconds
        Leading time [s] free of contact, whose mean wrench is taken off; 0 for none, None for the
        rest that is found at the start.
    force_noise, torque_noise
        Standard deviation of a sample's white noise [N], [N m], greater than 0: one for all axes,
        or one each; None where unknown.
    force_resolution, torque_resolution
        Steps of the numbers [N], [N m], likewise.
    position_noise, orientation_noise
        Standard deviation of the robot's position [m] and of its orientation's rotation vector
        [rad] on each axis; the position's is used where the wrench's noise is known. The
        orientation's turns rod and wrench as one body about the sensor's origin, also a wrench in
        world axes, which was turned by the orientation that is logged: it moves a contact by its
        cross product with the vector from there. That the mount's weight is taken off in an
        orientation that is not the true one enters no covariance.
    noise_corner
        Frequency [Hz] at which pink noise has the power spectral density of the white noise; 0 for
        none.
    force_random_walk, torque_random_walk
        Standard deviation of a random walk after one second [N/√s], [N m/√s], likewise; it grows
        with the root of the time.
    force_drift, torque_drift
        Known rates of the offset (3,) [N/s], [N m/s], in the axes of the wrench, since the
        recording's start.
    estimate_drift
        Whether the offset changes linearly, at a rate that is found from rest at the start and at
        the end, on top of a given one.
    rest_intervals
        Pairs (start, stop) [s] since the recording's start that are free of contact; they take the
        place of `tare_seconds`.
    force_range, torque_range
        Largest reading on each axis (3,) [N], [N m]; None where not known.
    cross_talk
        Matrix (6, 6) that takes the true wrench (force, torque) in sensor axes to the readings;
        None for the identity.
    low_pass
        Filter and delay of the electronics, or None.
    mount
        What hangs on the sensor and weighs, or None.
    gain
        Reading over true value of the six channels, force x, y, z and torque x, y, z in the
        sensor's axes, before the cross-talk.

    Raises
    ------
    ValueError
        If a figure is negative or not finite, a quaternion has zero norm, sign or frame are none of
        those named, the cross-talk has no inverse, rest intervals are not in order, or pink noise
        has no white noise to go by.
    """

    clamp_position: Float[np.ndarray, "3"]
    clamp_orientation: Float[np.ndarray, "4"]
    wrench: WrenchSign
    wrench_frame: WrenchFrame = "sensor"
    wrench_point: Vector = (0.0, 0.0, 0.0)
    tare_seconds: float | None = 0.0
    force_noise: float | Vector | None = None
    torque_noise: float | Vector | None = None
    force_resolution: float | Vector = 0.0
    torque_resolution: float | Vector = 0.0
    position_noise: float = 0.0
    orientation_noise: float = 0.0
    noise_corner: float = 0.0
    force_random_walk: float | Vector = 0.0
    torque_random_walk: float | Vector = 0.0
    force_drift: Vector = (0.0, 0.0, 0.0)
    torque_drift: Vector = (0.0, 0.0, 0.0)
    estimate_drift: bool = False
    rest_intervals: tuple[tuple[float, float], ...] = ()
    force_range: Vector | None = None
    torque_range: Vector | None = None
    cross_talk: Float[np.ndarray, "6 6"] | None = None
    low_pass: LowPass | None = None
    mount: Mount | None = None
    gain: Channels = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        object.__setattr__(
            self,
            "clamp_position",
            finite_array(self.clamp_position, "clamp_position", last=3, ndim=1),
        )
        object.__setattr__(
            self, "clamp_orientation", unit_quaternions(self.clamp_orientation, "clamp_orientation")
        )
        if self.clamp_orientation.shape != (4,):
            raise ValueError(
                f"clamp_orientation has shape {self.clamp_orientation.shape}; allowed is (4,)"
            )
        for name in ("wrench_point", "force_drift", "torque_drift"):
            finite_array(getattr(self, name), name, last=3, ndim=1)
        if np.any(finite_array(self.gain, "gain", last=6, ndim=1) <= 0):
            raise ValueError(f"gain = {self.gain!r}; allowed are six numbers greater than 0")
        for name, allowed in (
            ("wrench", ("on_sensor", "on_rod")),
            ("wrench_frame", ("sensor", "world")),
        ):
            if getattr(self, name) not in allowed:
                raise ValueError(
                    f"{name} = {getattr(self, name)!r}; allowed are {' and '.join(allowed)}"
                )
        for name in (
            field.name
            for field in fields(self)
            if field.name.endswith(("seconds", "noise", "resolution", "walk", "corner"))
        ):
            self._check_figure(name)
        self._check_parts()

    def _check_figure(self, name: str) -> None:
        value = getattr(self, name)
        by_axis = name.startswith(("force", "torque"))
        of_wrench = name in {"force_noise", "torque_noise"}
        numbers = np.zeros(0) if value is None else np.asarray(value, dtype=float)
        shaped = value is None or numbers.shape == () or (by_axis and numbers.shape == (3,))
        if not (
            shaped
            and np.isfinite(numbers).all()
            and np.all(numbers > 0 if of_wrench else numbers >= 0)
        ):
            kind = (
                "greater than 0, or none where the noise is not known"
                if of_wrench
                else "of at least 0"
            )
            each = ", or three of them" if by_axis else ""
            raise ValueError(f"{name} = {value!r}; allowed is a finite number {kind}{each}")

    def _check_parts(self) -> None:
        if (self.force_noise is None) != (self.torque_noise is None):
            raise ValueError(
                "force_noise and torque_noise: one is given without the other; allowed are both or none"
            )
        for name in ("noise_corner", "force_random_walk", "torque_random_walk"):
            if self.force_noise is None and np.any(np.asarray(getattr(self, name)) > 0):
                raise ValueError(
                    f"{name} = {getattr(self, name)} without force_noise and torque_noise; allowed is 0, or both beside it"
                )
        for name in ("force_range", "torque_range"):
            value = getattr(self, name)
            if value is not None and np.any(finite_array(value, name, last=3, ndim=1) <= 0):
                raise ValueError(
                    f"{name} = {value}; allowed are three finite numbers greater than 0"
                )
        edges = (
            finite_array(self.rest_intervals, "rest_intervals", last=2, ndim=2).ravel()
            if self.rest_intervals
            else np.zeros(0)
        )
        if np.any(np.diff(edges, prepend=0.0) < 0) or np.any(edges[1::2] <= edges[::2]):
            raise ValueError(
                f"rest_intervals = {self.rest_intervals}; allowed are pairs (start, stop) of at least 0, in order, that do not overlap"
            )
        if self.cross_talk is not None:
            self._check_cross_talk()

    def _check_cross_talk(self) -> None:
        assert self.cross_talk is not None
        matrix = finite_array(self.cross_talk, "cross_talk", last=6, ndim=2)
        if matrix.shape != (6, 6):
            raise ValueError(f"cross_talk has shape {matrix.shape}; allowed is (6, 6)")
        condition = float(np.linalg.cond(matrix))
        if not condition < _LARGEST_CONDITION:
            raise ValueError(
                f"cross_talk has the condition {condition:.3g}; allowed is a matrix with an inverse, of a condition below {_LARGEST_CONDITION:g}"
            )
        object.__setattr__(self, "cross_talk", matrix)

    @property
    def sign(self) -> float:
        """What takes a wrench to the support reaction: −1 where it is given as on the sensor, else
        1.
        """
        return -1.0 if self.wrench == "on_sensor" else 1.0

    @property
    def response(self) -> Float[np.ndarray, "6 6"] | None:
        """Matrix that takes the true wrench in sensor axes to the readings, gain and then
        cross-talk; None for the identity.
        """
        gain = np.asarray(self.gain, dtype=float)
        if self.cross_talk is None:
            return None if np.all(gain == 1) else np.diag(gain)
        return self.cross_talk * gain

    @property
    def reading_variance(self) -> Float[np.ndarray, "6"]:
        """Variance (6,) of one reading's white noise and rounding [N²], [(N m)²].

        Raises
        ------
        ValueError
            If the noise is not known.
        """
        return self.noise**2 + self.resolution**2 / 12

    @property
    def noise(self) -> Float[np.ndarray, "6"]:
        """Standard deviation (6,) of the channels' white noise [N], [N m].

        Raises
        ------
        ValueError
            If it is not known.
        """
        if self.force_noise is None or self.torque_noise is None:
            raise ValueError(
                "force_noise = None: the variance of a reading is not known; allowed is a sensor with force_noise and torque_noise"
            )
        return _six(self.force_noise, self.torque_noise)

    @property
    def resolution(self) -> Float[np.ndarray, "6"]:
        """Steps (6,) of the channels' numbers [N], [N m]; 0 for none."""
        return _six(self.force_resolution, self.torque_resolution)

    @property
    def random_walk(self) -> Float[np.ndarray, "6"]:
        """Standard deviation (6,) of the channels' random walk after a second [N/√s], [N m/√s]; 0
        for none.
        """
        return _six(self.force_random_walk, self.torque_random_walk)

    @property
    def ranges(self) -> list[float | None]:
        """Largest reading of each channel (6,) [N], [N m]; None where it is not known."""
        return [*(self.force_range or (None,) * 3), *(self.torque_range or (None,) * 3)]

    def coloured(
        self, time: Float[np.ndarray, "n"]
    ) -> list[tuple[Pink | RandomWalk, Float[np.ndarray, "6"]]]:
        """Pink noise and random walk over the stamps (n,), each with its scale (6,) on the
        channels; those that the sensor has.
        """
        if not len(time):
            return []
        interval = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
        return self.coloured_within(float(time[0]), float(time[-1] - time[0]), interval)

    def coloured_within(
        self, start: float, duration: float, interval: float
    ) -> list[tuple[Pink | RandomWalk, Float[np.ndarray, "6"]]]:
        """The same for a recording that starts at `start`, of this duration, sampled at this
        interval [s]; without pink noise where that is 0.
        """
        processes: list[tuple[Pink | RandomWalk, np.ndarray]] = []
        if self.noise_corner > 0 and interval > 0 and self.force_noise is not None:
            # One-sided density of white noise: twice its variance over the rate; the pink noise's
            # is that at the corner.
            factor = np.sqrt(2 * self.noise_corner * interval)
            processes.append((Pink.within(duration, interval), factor * self.noise))
        if np.any(self.random_walk):
            processes.append((RandomWalk(start), self.random_walk))
        return processes

    def without_estimates(self) -> "Sensor":
        """Return the same sensor with an offset alone to be found from rest."""
        return replace(self, estimate_drift=False, mount=None)

    def tare(self, raw: RawRecording) -> Tare:
        """What the sensor shows without contact: from rest that is given or found
        (`vibrissa.sensor.rest`), or nothing where `tare_seconds` is 0.

        Raises
        ------
        ValueError
            If rest that is given does not fit the recording, or none can be found.
        """
        if self.tare_seconds == 0 and not self.rest_intervals:
            if self.estimate_drift or (self.mount is not None and self.mount.estimated):
                what = "estimate_drift" if self.estimate_drift else "mount.estimated"
                raise ValueError(
                    f"{what} = True with tare_seconds = 0; allowed are rest_intervals, a tare_seconds greater than 0, or none to find the rest"
                )
            return no_tare(self, raw.time)
        self._check_tare_seconds(raw)
        intervals, found = rest_for_tare(self, raw)
        return fitted_tare(self, raw, intervals, found)

    def reactions(
        self,
        raw: RawRecording,
        tare: Tare | None = None,
        *,
        tolerances: Tolerances | SetupErrors | ArrayLike | None = None,
        velocity: ArrayLike | None = None,
    ) -> Reactions:
        """Support reactions on the rod about the clamp, in world axes, tare removed, with their
        covariance where the noise is known.

        Drift, cross-talk, the mount's weight, frame, sign and reference point are undone; a
        low-pass filter's lag is not. The covariance holds a sample's own noise and the errors of
        tare and drift, also those of pink noise and of a random walk since the tare was taken.

        Parameters
        ----------
        raw
            As logged. A row of the wrench that holds NaN gives a row of NaN.
        tare
            What to take off; by default `tare(raw)`.
        tolerances
            How well the setup's numbers are known, as `vibrissa.Tolerances` or the covariance (15,
            15) of `vibrissa.tolerances.PARAMETERS`: contacts state them then beside the noise.
            `Setup.parameter_covariance` gives those of a setup, and `setup_errors` both seen from
            this mount.
        velocity
            Of the clamp (n, 6), as for `Reactions`.

        Raises
        ------
        ValueError
            If the tare window holds fewer than two samples, or the whole recording, or no rest can
            be found where none is given.
        """
        tare = self.tare(raw) if tare is None else tare
        axes = rotation_matrices(raw.orientation)
        maps = to_reactions(self, axes)
        load = raw.wrench - tare.readings(self, raw.time, raw.orientation)
        load = np.where(np.isnan(load).any(axis=1, keepdims=True), np.nan, load)
        wrench = np.einsum("nij,nj->ni", maps, load)
        position = raw.position + np.einsum("nij,j->ni", axes, self.clamp_position)
        known = self.force_noise is not None
        return Reactions(
            Trail(position, multiplied(raw.orientation, self.clamp_orientation)),
            wrench[:, :3],
            wrench[:, 3:],
            time=raw.time,
            covariance=carried(maps, tare.covariance(self, raw.time, raw.orientation))
            if known
            else None,
            position_covariance=np.eye(3) * self.position_noise**2 if known else None,
            rotation_covariance=np.eye(3) * self.orientation_noise**2
            if known and self.orientation_noise
            else None,
            rotation_center=raw.position if known and self.orientation_noise else None,
            setup_errors=tolerances
            if tolerances is None or isinstance(tolerances, SetupErrors)
            else self.setup_errors(tolerances),
            velocity=velocity,
        )

    def setup_errors(self, tolerances: Tolerances | ArrayLike) -> SetupErrors:
        """Errors of the setup's numbers for `Reactions`, seen from this sensor's mount."""
        covariance = (
            tolerances.covariance
            if isinstance(tolerances, Tolerances)
            else np.asarray(tolerances, dtype=float)
        )
        arm = self.clamp_position - np.asarray(self.wrench_point)
        return SetupErrors(covariance, self.clamp_orientation, arm, self.wrench_frame == "world")

    def measure(
        self,
        reactions: Reactions,
        rng: np.random.Generator,
        *,
        force_tare: ArrayLike = (0.0, 0.0, 0.0),
        torque_tare: ArrayLike = (0.0, 0.0, 0.0),
    ) -> RawRecording:
        """Return what this sensor would log: `reactions` undone, with all that the sensor adds to
        them.

        In this order: the mount's weight, cross-talk, low-pass filter and delay; white, pink and
        random-walk noise, tare and drift; range and rounding; noise of the robot's pose. The stated
        noise is that of the log, behind the filter.

        Parameters
        ----------
        reactions
            On one trail (n, …), with time, in SI units.
        rng
            Source of the noise; sensors of unknown noise are taken as noiseless. The same state
            gives the same recording.
        force_tare, torque_tare
            Offsets of the sensor (3,) [N], [N m], in the axes of the wrench.

        Raises
        ------
        ValueError
            If the reactions are of several trails, or have no time.
        """
        if reactions.time is None or reactions.force.ndim != 2:
            raise ValueError(
                f"reactions of shape {reactions.force.shape}: allowed is one trail (n, …) with time"
            )
        orientation = multiplied(reactions.trail.orientation, inverse(self.clamp_orientation))
        position = reactions.trail.position - np.einsum(
            "nij,j->ni", rotation_matrices(orientation), self.clamp_position
        )
        tare = np.concatenate(
            [
                finite_array(force_tare, "force_tare", last=3, ndim=1),
                finite_array(torque_tare, "torque_tare", last=3, ndim=1),
            ]
        )
        return logged(self, reactions, position, orientation, tare, rng)

    def _check_tare_seconds(self, raw: RawRecording) -> None:
        if self.tare_seconds is None or self.rest_intervals:
            return
        count, total = (
            int(np.count_nonzero(raw.time - raw.time[0] < self.tare_seconds)),
            len(raw.time),
        )
        if count < 2 or count >= total:
            raise ValueError(
                f"tare_seconds = {self.tare_seconds}: {count} of {total} samples lie within it; allowed are at least 2, and fewer than all"
            )


def carried(
    maps: Float[np.ndarray, "n 6 6"], covariance: Float[np.ndarray, "... 6 6"]
) -> Float[np.ndarray, "... 6 6"]:
    """Covariance of readings taken to that of reactions, one for all rows where they agree."""
    carried = maps @ covariance @ np.swapaxes(maps, 1, 2)
    carried = (carried + np.swapaxes(carried, 1, 2)) / 2
    size = np.sqrt(np.einsum("nii->ni", np.abs(carried)))
    same = np.all(np.abs(carried - carried[0]) <= _SAME * size[0][:, None] * size[0])
    return np.asarray(carried[0] if same else carried)
