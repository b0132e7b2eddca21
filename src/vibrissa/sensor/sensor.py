"""A six-axis force/torque sensor that carries the rod's clamp: from what it reads to the reactions
at the clamp, and back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from vibrissa.geometry.checks import finite_array
from vibrissa.geometry.rotation import (
    cross_matrices,
    inverse,
    multiplied,
    rotation_matrices,
    unit_quaternions,
)
from vibrissa.reactions import Reactions
from vibrissa.sensor.figures import Mount, Noise, Response, TarePolicy, Vector
from vibrissa.sensor.noise import NO_STEP
from vibrissa.sensor.raw import Covariance, Covariances, Quaternions, RawRecording, Wrench, Wrenches
from vibrissa.sensor.rest import rest_for_tare
from vibrissa.sensor.tare import Tare, fitted_tare
from vibrissa.tolerances import SetupErrors, Tolerances
from vibrissa.trail import Trail

WrenchSign = Literal["on_sensor", "on_rod"]
WrenchFrame = Literal["sensor", "world"]

_PARTS: dict[str, Any] = {"noise": Noise, "response": Response, "tare_policy": TarePolicy}
# Covariances of rows that differ by less than rounding are one covariance.
_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class Sensor:
    """Where the clamp sits on the sensor, what the wrench's numbers mean, and how good they are. SI
    units.

    Parameters
    ----------
    figures
        Fields of `Noise`, `Response` and `TarePolicy` by their own names, in place of those in
        `noise`, `response` and `tare_policy`: `Sensor(..., force_noise=1e-3, tare_seconds=0.5)`.
        They are read and replaced (`dataclasses.replace`) by these names, too.

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
    mount
        What hangs on the sensor and weighs, or None.
    noise
        Random errors of readings and poses, and the steps of the numbers.
    response
        Gain, cross-talk, range and low-pass filter.
    tare_policy
        Where the zero is taken, and its drift.

    Raises
    ------
    ValueError
        If a number is not finite, a quaternion has zero norm, sign or frame are none of those
        named, or as for the parts.
    TypeError
        If a keyword is neither a field nor a figure.
    """

    clamp_position: Float[np.ndarray, "3"]
    clamp_orientation: Float[np.ndarray, "4"]
    wrench: WrenchSign
    wrench_frame: WrenchFrame
    wrench_point: Vector
    mount: Mount | None
    noise: Noise
    response: Response
    tare_policy: TarePolicy

    def __init__(
        self,
        clamp_position: ArrayLike,
        clamp_orientation: ArrayLike,
        wrench: WrenchSign,
        wrench_frame: WrenchFrame = "sensor",
        wrench_point: ArrayLike = (0.0, 0.0, 0.0),
        *,
        mount: Mount | None = None,
        noise: Noise = Noise(),  # noqa: B008, as it cannot be changed
        response: Response = Response(),  # noqa: B008
        tare_policy: TarePolicy = TarePolicy(),  # noqa: B008
        **figures: Any,
    ) -> None:
        given, fields = locals(), vars(self)
        for name, kind in (("wrench", WrenchSign), ("wrench_frame", WrenchFrame)):
            if given[name] not in get_args(kind):
                allowed = " and ".join(get_args(kind))
                raise ValueError(f"{name} = {given[name]!r}; allowed are {allowed}")
            fields[name] = given[name]
        turn = unit_quaternions(clamp_orientation, "clamp_orientation")
        fields["clamp_position"] = finite_array(clamp_position, "clamp_position", last=3, ndim=1)
        fields["clamp_orientation"] = finite_array(turn, "clamp_orientation", ndim=1)
        point = finite_array(wrench_point, "wrench_point", last=3, ndim=1)
        fields |= {"wrench_point": tuple(point.tolist()), "mount": mount}
        for name, kind in _PARTS.items():
            own = {key: figures.pop(key) for key in kind.__dataclass_fields__ if key in figures}
            fields[name] = replace(given[name], **own)
        if figures:
            raise TypeError(
                f"Sensor has no {', '.join(figures)}; allowed are its attributes and the fields of "
                "Noise, Response and TarePolicy"
            )

    def __getattr__(self, name: str) -> Any:
        """A figure by its own name: `sensor.force_noise` is `sensor.noise.force_noise`."""
        for part, kind in _PARTS.items():
            if name in kind.__dataclass_fields__:
                return getattr(self.__dict__[part], name)
        raise AttributeError(f"Sensor has no attribute {name!r}")

    @property
    def sign(self) -> float:
        """What takes a wrench to the support reaction: −1 where it is given as on the sensor, else
        1.
        """
        return -1.0 if self.wrench == "on_sensor" else 1.0

    @property
    def arm(self) -> Float[np.ndarray, "3"]:
        """From the torque's reference point to the clamp, sensor axes (3,) [m]."""
        return self.clamp_position - np.asarray(self.wrench_point)

    @property
    def reading_variance(self) -> Wrench:
        """Variance (6,) of one reading's white noise and rounding [N²], [(N m)²].

        Raises
        ------
        ValueError
            If the noise is not known.
        """
        return self.noise.variance

    @property
    def estimates(self) -> tuple[str, ...]:
        """What is to be found from rest besides an offset, by its keys in the setup."""
        wanted = {
            "estimate_drift": self.tare_policy.estimate_drift,
            "mount.estimated": self.mount is not None and self.mount.estimated,
        }
        return tuple(key for key, value in wanted.items() if value)

    def updated(self, **changes: Any) -> Sensor:
        """Return the sensor with other attributes or figures, by their own names."""
        return replace(self, **changes)

    def without_estimates(self) -> Sensor:
        """Return the same sensor with an offset alone to be found from rest."""
        return self.updated(estimate_drift=False, mount=None)

    def frame(self, clamp: Trail) -> Trail:
        """Poses of the sensor frame (…, n) that go with these of the clamp."""
        turn = multiplied(clamp.orientation, inverse(self.clamp_orientation))
        return Trail(clamp.position - rotation_matrices(turn) @ self.clamp_position, turn)

    def to_reactions(self, orientation: Quaternions) -> Covariances:
        """Matrices (n, 6, 6) from readings to reactions: gain and cross-talk undone, turned to
        world axes, carried to the clamp, with the support reaction's sign.
        """
        axes = rotation_matrices(orientation)
        both = np.kron(np.eye(2), axes)
        turn = both @ np.linalg.inv(self.response.matrix)
        if self.wrench_frame == "world":
            turn = turn @ np.swapaxes(both, 1, 2)
        # (f, τ) about a point is (f, τ − arm × f) about the point farther by the arm.
        turn[:, 3:] -= cross_matrices(axes @ self.arm) @ turn[:, :3]
        return self.sign * turn

    def to_readings(self, orientation: Quaternions) -> Covariances:
        """Matrices (n, 6, 6) from reactions to readings: the inverse of `to_reactions`."""
        return np.linalg.inv(self.to_reactions(orientation))

    def weight_readings(self, orientation: Quaternions) -> Float[np.ndarray, "n 6 4"]:
        """Matrices that take `Mount.moments` to what the sensor shows of the mount's weight."""
        axes = rotation_matrices(orientation)
        weight = (self.mount or Mount()).weight(axes, self.clamp_position)
        # As a contact would, the weight loads the sensor: reactions are what holds it.
        return -self.to_readings(orientation) @ np.kron(np.eye(2), axes) @ weight

    def tare(self, raw: RawRecording) -> Tare:
        """What the sensor shows without contact: from rest that is given or found
        (`vibrissa.sensor.rest`), or nothing where `tare_seconds` is 0.

        Raises
        ------
        ValueError
            If rest that is given does not fit the recording, or none can be found.
        """
        return fitted_tare(self, raw, *rest_for_tare(self, raw))

    def reactions(
        self,
        raw: RawRecording,
        tare: Tare | None = None,
        *,
        tolerances: Tolerances | SetupErrors | ArrayLike | None = None,
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

        Raises
        ------
        ValueError
            If the tare window holds fewer than two samples, or the whole recording, or no rest can
            be found where none is given.
        """
        tare = self.tare(raw) if tare is None else tare
        maps, noise = self.to_reactions(raw.orientation), self.noise
        load = raw.wrench - tare.readings(self, raw.time, raw.orientation)
        wrench = np.einsum("nij,nj->ni", maps, load)
        errors: dict[str, Any] = {}
        if noise.known:
            readings = tare.covariance(self, raw.time, raw.orientation)
            errors["covariance"] = carried(maps, readings)
            errors["position_covariance"] = np.eye(3) * noise.position_noise**2
            if noise.orientation_noise:
                errors["rotation_covariance"] = np.eye(3) * noise.orientation_noise**2
                errors["rotation_center"] = raw.position
        clamp = Trail(
            raw.position + rotation_matrices(raw.orientation) @ self.clamp_position,
            multiplied(raw.orientation, self.clamp_orientation),
        )
        errors["setup_errors"] = self.setup_errors(tolerances)
        return Reactions(clamp, wrench[:, :3], wrench[:, 3:], time=raw.time, **errors)

    def setup_errors(
        self, tolerances: Tolerances | SetupErrors | ArrayLike | None
    ) -> SetupErrors | None:
        """Errors of the setup's numbers for `Reactions`, seen from this sensor's mount; None
        without tolerances.
        """
        if tolerances is None or isinstance(tolerances, SetupErrors):
            return tolerances
        stated = tolerances.covariance if isinstance(tolerances, Tolerances) else tolerances
        covariance = np.asarray(stated, dtype=float)
        return SetupErrors(
            covariance, self.clamp_orientation, self.arm, self.wrench_frame == "world"
        )

    def filtered_readings(self, reactions: Reactions, orientation: Quaternions) -> Wrenches:
        """Readings (n, 6) of reactions and of the mount's weight at these orientations of the
        sensor, with cross-talk, behind the low-pass filter, without noise.
        """
        shown = np.einsum("nij,nj->ni", self.to_readings(orientation), reactions.wrench)
        if self.mount is not None:
            shown = shown + self.weight_readings(orientation) @ self.mount.moments
        if self.response.low_pass is not None and reactions.time is not None:
            shown = self.response.low_pass.applied(reactions.time, shown)
        return shown

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
        time, noise = reactions.time, self.noise
        if time is None or reactions.force.ndim != 2:
            raise ValueError(
                f"reactions of shape {reactions.force.shape}: allowed is one trail (n, …) with time"
            )
        offsets = {"force_tare": force_tare, "torque_tare": torque_tare}
        tare = np.hstack(
            [finite_array(part, name, last=3, ndim=1) for name, part in offsets.items()]
        )
        pose = self.frame(reactions.trail)
        orientation = pose.orientation
        shown = self.filtered_readings(reactions, orientation)
        position = rng.normal(pose.position, noise.position_noise)
        read = shown + tare + (time - time[0])[:, None] * self.tare_policy.drift
        if noise.known:
            read += np.hstack([*rng.normal(size=(2, len(time), 3))]) * noise.white
        for process, scale in noise.coloured(time):
            read += scale * process.sampled(time, rng, 6)
        if noise.orientation_noise:
            turn = Rotation.from_rotvec(rng.normal(0.0, noise.orientation_noise, (len(time), 3)))
            orientation = (turn * Rotation.from_quat(orientation)).as_quat()
            if self.wrench_frame == "world":
                # World axes are those of the robot, which turns the wrench by the orientation that
                # it logs.
                read += np.hstack([turn.apply(part) for part in np.split(shown, 2, axis=1)]) - shown
        limits = self.response.limits(noise.resolution)
        steps = np.maximum(noise.resolution, NO_STEP)
        read = np.round(np.clip(read, -limits, limits) / steps) * steps
        return RawRecording(time, position, orientation, read[:, :3], read[:, 3:])


def carried(maps: Covariances, covariance: Covariance) -> Covariance:
    """Covariance of readings taken to that of reactions, one for all rows where they agree."""
    carried = maps @ covariance @ np.swapaxes(maps, 1, 2)
    carried = (carried + np.swapaxes(carried, 1, 2)) / 2
    size = np.sqrt(np.diag(carried[0]))
    same = np.all(np.abs(carried - carried[0]) <= _SAME * np.outer(size, size))
    return carried[0] if same else carried
