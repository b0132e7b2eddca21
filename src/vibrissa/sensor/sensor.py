"""A six-axis force/torque sensor that carries the rod's clamp."""

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array
from vibrissa.geometry.rotation import inverse, multiplied, rotation_matrices, unit_quaternions
from vibrissa.reactions import Reactions
from vibrissa.trail import Trail

WrenchSign = Literal["on_sensor", "on_rod"]
WrenchFrame = Literal["sensor", "world"]

_CHANNELS = 6
_ONES = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class RawRecording:
    """Rows of a log, as the sensor and the robot wrote them.

    Attributes
    ----------
    time
        (n,) [s], increasing.
    position, orientation
        Pose of the sensor frame in the world: (n, 3) [m] and quaternions x, y, z, w (n, 4).
    force, torque
        (n, 3) [N], [N m]: sign, frame and reference point are the sensor's (`Sensor`), tare included.
    """

    time: Float[np.ndarray, "n"]
    position: Float[np.ndarray, "n 3"]
    orientation: Float[np.ndarray, "n 4"]
    force: Float[np.ndarray, "n 3"]
    torque: Float[np.ndarray, "n 3"]


@dataclass(frozen=True, eq=False)
class Sensor:
    """Where the clamp sits on the sensor, what the wrench's numbers mean, and how noisy they are. SI units.

    Attributes
    ----------
    clamp_position, clamp_orientation
        Clamp in the sensor frame: (3,) [m], and the quaternion x, y, z, w that maps clamp axes onto sensor axes. The rod leaves along clamp +z.
    wrench
        "on_sensor": exerted by the rod on the sensor. "on_rod": the support reaction. A wrench message does not say; it must be given.
    wrench_frame
        Axes of the wrench: "sensor" or "world".
    wrench_point
        Reference point of the torque in the sensor frame (3,) [m].
    tare_seconds
        Leading time free of contact, whose mean wrench is taken off; 0 for none.
    force_noise, torque_noise
        Standard deviation of a sample on each axis [N], [N m], greater than 0; None where unknown.
    force_resolution, torque_resolution
        Steps of the numbers [N], [N m].
    position_noise
        Standard deviation of the robot's position on each axis [m]; used where the wrench's noise is known.
    gain
        Reading over true value of the six channels, force x, y, z and torque x, y, z in the sensor's axes.

    Raises
    ------
    ValueError
        If a figure is negative or not finite, a quaternion has zero norm, or sign or frame are none of those named.
    """

    clamp_position: Float[np.ndarray, "3"]
    clamp_orientation: Float[np.ndarray, "4"]
    wrench: WrenchSign
    wrench_frame: WrenchFrame = "sensor"
    wrench_point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tare_seconds: float = 0.0
    force_noise: float | None = None
    torque_noise: float | None = None
    force_resolution: float = 0.0
    torque_resolution: float = 0.0
    position_noise: float = 0.0
    gain: tuple[float, float, float, float, float, float] = _ONES

    def __post_init__(self) -> None:
        object.__setattr__(self, "clamp_position", finite_array(self.clamp_position, "clamp_position", last=3, ndim=1))
        object.__setattr__(self, "clamp_orientation", unit_quaternions(self.clamp_orientation, "clamp_orientation"))
        if self.clamp_orientation.shape != (4,):
            raise ValueError(f"clamp_orientation has shape {self.clamp_orientation.shape}; allowed is (4,)")
        finite_array(self.wrench_point, "wrench_point", last=3, ndim=1)
        if np.any(finite_array(self.gain, "gain", last=_CHANNELS, ndim=1) <= 0):
            raise ValueError(f"gain = {self.gain!r}; allowed are six numbers greater than 0")
        for name, allowed in (("wrench", ("on_sensor", "on_rod")), ("wrench_frame", ("sensor", "world"))):
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name} = {getattr(self, name)!r}; allowed are {' and '.join(allowed)}")
        for name in (field.name for field in fields(self) if field.name.endswith(("seconds", "noise", "resolution"))):
            value = getattr(self, name)
            of_wrench = name in {"force_noise", "torque_noise"}
            if value is not None and not (np.isfinite(value) and (value > 0 if of_wrench else value >= 0)):
                kind = "greater than 0, or none where the noise is not known" if of_wrench else "of at least 0"
                raise ValueError(f"{name} = {value!r}; allowed is a finite number {kind}")
        if (self.force_noise is None) != (self.torque_noise is None):
            raise ValueError("force_noise and torque_noise: one is given without the other; allowed are both or none")

    def reactions(self, raw: RawRecording) -> Reactions:
        """Support reactions on the rod about the clamp, in world axes, tare removed, with their covariance where the noise is known.

        Raises
        ------
        ValueError
            If the tare window holds fewer than two samples, or the whole recording.
        """
        sensor_axes = rotation_matrices(raw.orientation)
        tared = self._amplified(self._tared(raw), sensor_axes, 1 / np.asarray(self.gain))
        arm = np.einsum("nij,j->ni", sensor_axes, self.clamp_position - np.asarray(self.wrench_point))
        in_world = self.wrench_frame == "world"
        force, torque = (part if in_world else np.einsum("nij,nj->ni", sensor_axes, part) for part in tared)
        sign = -1.0 if self.wrench == "on_sensor" else 1.0
        trail = Trail(
            raw.position + np.einsum("nij,j->ni", sensor_axes, self.clamp_position), multiplied(raw.orientation, self.clamp_orientation)
        )
        return Reactions(
            trail,
            sign * force,
            sign * (torque - np.cross(arm, force)),
            time=raw.time,
            covariance=self._covariance(arm, self._tare_count(raw))
            if self.gain == _ONES
            else self._uneven_covariance(arm, sensor_axes, raw),
            position_covariance=np.eye(3) * self.position_noise**2 if self.force_noise is not None else None,
        )

    def measure(
        self,
        reactions: Reactions,
        rng: np.random.Generator,
        *,
        force_tare: ArrayLike = (0.0, 0.0, 0.0),
        torque_tare: ArrayLike = (0.0, 0.0, 0.0),
    ) -> RawRecording:
        """Return what this sensor would log: `reactions` undone, with tare, white noise, quantisation and noise of the robot's position.

        Parameters
        ----------
        reactions
            On one trail (n, …), with time, in SI units.
        rng
            Source of the noise; sensors of unknown noise are taken as noiseless.
        force_tare, torque_tare
            Offsets of the sensor (3,) [N], [N m], in the axes of the wrench.

        Raises
        ------
        ValueError
            If the reactions are of several trails, or have no time.
        """
        if reactions.time is None or reactions.force.ndim != 2:
            raise ValueError(f"reactions of shape {reactions.force.shape}: allowed is one trail (n, …) with time")
        orientation = multiplied(reactions.trail.orientation, inverse(self.clamp_orientation))
        sensor_axes = rotation_matrices(orientation)
        position = reactions.trail.position - np.einsum("nij,j->ni", sensor_axes, self.clamp_position)
        arm = np.einsum("nij,j->ni", sensor_axes, self.clamp_position - np.asarray(self.wrench_point))
        sign = -1.0 if self.wrench == "on_sensor" else 1.0
        force = sign * reactions.force
        torque = sign * reactions.moment + np.cross(arm, force)
        if self.wrench_frame == "sensor":
            force, torque = (np.einsum("nji,nj->ni", sensor_axes, part) for part in (force, torque))
        force, torque = self._amplified((force, torque), sensor_axes, np.asarray(self.gain))
        return RawRecording(
            reactions.time,
            position + rng.normal(0.0, self.position_noise, position.shape),
            orientation,
            _logged(force + np.asarray(force_tare), self.force_noise, self.force_resolution, rng),
            _logged(torque + np.asarray(torque_tare), self.torque_noise, self.torque_resolution, rng),
        )

    def _amplified(
        self,
        wrench: tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]],
        sensor_axes: Float[np.ndarray, "n 3 3"],
        factors: Float[np.ndarray, "6"],
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Multiply the sensor's channels, whatever axes the wrench is in."""
        if self.gain == _ONES:
            return wrench
        force, torque = wrench
        if self.wrench_frame == "sensor":
            return force * factors[:3], torque * factors[3:]
        turned = [np.einsum("nij,j,nkj->nik", sensor_axes, part, sensor_axes) for part in (factors[:3], factors[3:])]
        return np.einsum("nij,nj->ni", turned[0], force), np.einsum("nij,nj->ni", turned[1], torque)

    def _uneven_covariance(
        self, arm: Float[np.ndarray, "n 3"], sensor_axes: Float[np.ndarray, "n 3 3"], raw: RawRecording
    ) -> Float[np.ndarray, "n 6 6"] | None:
        """The same for channels of different gain: noise is that of the readings."""
        even = self._covariance(np.zeros_like(arm[:1]), self._tare_count(raw))
        if even is None:
            return None
        variance = np.diag(even) / np.asarray(self.gain) ** 2
        force, torque = (np.einsum("nij,j,nkj->nik", sensor_axes, part, sensor_axes) for part in (variance[:3], variance[3:]))
        x, y, z = arm.T
        zero = np.zeros_like(x)
        lever = -np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
        mixed = lever @ force
        return np.block([[force, np.swapaxes(mixed, 1, 2)], [mixed, torque + mixed @ np.swapaxes(lever, 1, 2)]])

    def _tare_count(self, raw: RawRecording) -> int:
        return int(np.count_nonzero(raw.time - raw.time[0] < self.tare_seconds))

    def _tared(self, raw: RawRecording) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        if self.tare_seconds == 0:
            return raw.force, raw.torque
        count, total = self._tare_count(raw), len(raw.time)
        if count < 2 or count >= total:
            raise ValueError(
                f"tare_seconds = {self.tare_seconds}: {count} of {total} samples lie within it; allowed are at least 2, and fewer than all"
            )
        return raw.force - raw.force[:count].mean(axis=0), raw.torque - raw.torque[:count].mean(axis=0)

    def _covariance(self, arm: Float[np.ndarray, "n 3"], tare_count: int) -> Float[np.ndarray, "..."] | None:
        """Of (f0, m0): independent axes at the reference point, carried to the clamp; the tare's own error is added."""
        if self.force_noise is None or self.torque_noise is None:
            return None
        tare = 1 + (1 / tare_count if tare_count else 0)
        force_variance = tare * self.force_noise**2 + self.force_resolution**2 / 12
        torque_variance = tare * self.torque_noise**2 + self.torque_resolution**2 / 12
        arms = arm[:1] if np.allclose(arm, arm[0], rtol=0, atol=1e-12 + 1e-9 * np.abs(arm).max()) else arm
        cross = np.zeros((len(arms), 3, 3))
        for axis, (row, column) in enumerate(((2, 1), (0, 2), (1, 0))):
            cross[:, row, column], cross[:, column, row] = arms[:, axis], -arms[:, axis]
        covariance = np.zeros((len(arms), 6, 6))
        covariance[:, :3, :3] = force_variance * np.eye(3)
        covariance[:, 3:, :3] = -force_variance * cross
        covariance[:, :3, 3:] = np.swapaxes(covariance[:, 3:, :3], 1, 2)
        covariance[:, 3:, 3:] = torque_variance * np.eye(3) + force_variance * cross @ np.swapaxes(cross, 1, 2)
        return covariance[0] if len(arms) == 1 else covariance


def _logged(values: Float[np.ndarray, "n 3"], noise: float | None, resolution: float, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    noisy = values + rng.normal(0.0, noise or 0.0, values.shape)
    return np.asarray(np.round(noisy / resolution) * resolution if resolution else noisy)
