"""A six-axis force/torque sensor that carries the rod's clamp: from its readings to the reactions
at the clamp, and back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
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
from vibrissa.mechanics.free import free_reactions
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor.figures import Mount, Noise, Response, TarePolicy, Vector
from vibrissa.sensor.noise import NO_STEP
from vibrissa.sensor.raw import (
    Covariance,
    Covariances,
    Quaternions,
    RawRecording,
    Vectors,
    Wrench,
    Wrenches,
)
from vibrissa.sensor.rest import rest_for_tare
from vibrissa.sensor.tare import Tare, fitted_tare
from vibrissa.tolerances import SetupErrors, Tolerances
from vibrissa.trail import Trail

WrenchSign = Literal["on_sensor", "on_rod"]
WrenchFrame = Literal["sensor", "world"]

_PARTS: dict[str, Any] = {"noise": Noise, "response": Response, "tare_policy": TarePolicy}
# Covariances that differ between rows by less than rounding are stored once.
_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class Sensor:
    """Where the clamp sits on the sensor, what the wrench's numbers mean, and how accurate they
    are. SI units.

    Parameters
    ----------
    figures
        Fields of `Noise`, `Response` and `TarePolicy` by their own names, overriding those in
        `noise`, `response` and `tare_policy`: `Sensor(..., force_noise=1e-3, tare_seconds=0.5)`.
        They can also be read and replaced (`dataclasses.replace`) by these names.

    Attributes
    ----------
    clamp_position, clamp_orientation
        Clamp in the sensor frame: (3,) [m], and the quaternion x, y, z, w that maps clamp axes onto
        sensor axes. The rod leaves along clamp +z.
    wrench
        "on_sensor": exerted by the rod on the sensor. "on_rod": the support reaction. Must be
        given, as a wrench message does not say.
    wrench_frame
        Axes of the wrench: "sensor" or "world".
    wrench_point
        Reference point of the torque in the sensor frame (3,) [m].
    mount
        Parts whose weight the sensor carries, or None.
    noise
        Random errors of readings and poses, and resolution.
    response
        Gain, cross-talk, range and low-pass filter.
    tare_policy
        Where the zero is taken, and its drift.
    rod
        The rod in the clamp, if loads act along it: the sensor reads them at rest, too, so that
        they are not part of the zero. None otherwise; `vibrissa.Setup` enters its own rod.

    Raises
    ------
    ValueError
        If a number is not finite, a quaternion has zero norm, `wrench` or `wrench_frame` is not one
        of the above, or as for the parts.
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
    rod: Rod | None

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
        rod: Rod | None = None,
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
        fields["clamp_orientation"] = finite_array(turn, "clamp_orientation", last=4, ndim=1)
        point = finite_array(wrench_point, "wrench_point", last=3, ndim=1)
        fields |= {"wrench_point": tuple(point.tolist()), "mount": mount, "rod": rod}
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
        """Factor from wrench to support reaction: −1 for "on_sensor", else 1."""
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
            If the noise is unknown.
        """
        return self.noise.variance

    @property
    def estimates(self) -> tuple[str, ...]:
        """What is to be estimated from rest besides an offset, by its keys in the setup."""
        wanted = {
            "estimate_drift": self.tare_policy.estimate_drift,
            "mount.estimated": self.mount is not None and self.mount.estimated,
        }
        return tuple(key for key, value in wanted.items() if value)

    def updated(self, **changes: Any) -> Sensor:
        """Return the sensor with other attributes or figures, by their own names."""
        return replace(self, **changes)

    def carrying(self, rod: Rod) -> Sensor:
        """Return the sensor with this rod in its clamp."""
        carried = None if rod.loads is None else rod
        return self if carried is self.rod else self.updated(rod=carried)

    def frame(self, clamp: Trail) -> Trail:
        """Poses of the sensor frame (…, n) for these poses of the clamp."""
        turn = multiplied(clamp.orientation, inverse(self.clamp_orientation))
        return Trail(clamp.position - rotation_matrices(turn) @ self.clamp_position, turn)

    def _clamp(self, position: Vectors, orientation: Quaternions) -> Trail:
        """Poses of the clamp (n,) for these of the sensor frame."""
        return Trail(
            position + rotation_matrices(orientation) @ self.clamp_position,
            multiplied(orientation, self.clamp_orientation),
        )

    def to_reactions(self, orientation: Quaternions) -> Covariances:
        """Matrices (n, 6, 6) from readings to reactions: undo gain and cross-talk, rotate to world
        axes, shift to the clamp, and apply the support reaction's sign.
        """
        axes = rotation_matrices(orientation)
        both = np.kron(np.eye(2), axes)
        turn = both @ np.linalg.inv(self.response.matrix)
        if self.wrench_frame == "world":
            turn = turn @ np.swapaxes(both, 1, 2)
        # (f, τ) about a point is (f, τ − arm × f) about the point displaced by the arm.
        turn[:, 3:] -= cross_matrices(axes @ self.arm) @ turn[:, :3]
        return self.sign * turn

    def to_readings(self, orientation: Quaternions) -> Covariances:
        """Matrices (n, 6, 6) from reactions to readings: the inverse of `to_reactions`."""
        return np.linalg.inv(self.to_reactions(orientation))

    def weight_readings(self, orientation: Quaternions) -> Float[np.ndarray, "n 6 4"]:
        """Matrices that map `Mount.moments` to the mount's weight as read by the sensor."""
        axes = rotation_matrices(orientation)
        weight = (self.mount or Mount()).weight(axes, self.clamp_position)
        # The weight loads the sensor as a contact does: reactions are what supports it.
        return -self.to_readings(orientation) @ np.kron(np.eye(2), axes) @ weight

    def rod_readings(self, raw: RawRecording) -> Wrenches:
        """Readings (n, 6) of the loads along `rod` without contact; NaN without a pose.

        Raises
        ------
        ValueError
            If the rod has no stable shape without contact.
        """
        shown = np.zeros_like(raw.wrench)
        if self.rod is not None:
            known = np.isfinite(np.hstack([raw.position, raw.orientation])).all(axis=1)
            orientation = raw.orientation[known]
            clamp = self._clamp(raw.position[known], orientation)
            own = _free_reactions(self.rod, clamp.position.tobytes(), clamp.orientation.tobytes())
            shown[known] = np.einsum("nij,nj->ni", self.to_readings(orientation), own)
            shown[~known] = np.nan
        return shown

    def tare(self, raw: RawRecording) -> Tare:
        """What the sensor reads without contact, from rest that is given or detected
        (`vibrissa.sensor.rest`); no tare if `tare_seconds` is 0.

        Raises
        ------
        ValueError
            If the given rest does not fit the recording, or none can be found.
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
        covariance if the noise is known.

        Drift, cross-talk, mount weight, frame, sign and reference point are corrected for; the lag
        of a low-pass filter is not. The covariance includes a sample's own noise and the errors of
        tare and drift, including pink noise and random walk since the tare was taken.

        Parameters
        ----------
        raw
            As logged. A wrench row with NaN gives a row of NaN.
        tare
            What to subtract; by default `tare(raw)`.
        tolerances
            How well the setup's numbers are known, as `vibrissa.Tolerances` or the covariance (15,
            15) of `vibrissa.tolerances.PARAMETERS`: contacts then state these errors beside the
            noise. `Setup.parameter_covariance` gives that of a setup, `setup_errors` either as seen
            from this mount.

        Raises
        ------
        ValueError
            If the tare window holds fewer than two samples or the whole recording, or none is given
            and no rest can be found.
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
        clamp = self._clamp(raw.position, raw.orientation)
        errors["setup_errors"] = self.setup_errors(tolerances)
        return Reactions(clamp, wrench[:, :3], wrench[:, 3:], time=raw.time, **errors)

    def setup_errors(
        self, tolerances: Tolerances | SetupErrors | ArrayLike | None
    ) -> SetupErrors | None:
        """Errors of the setup's numbers for `Reactions`, as seen from this sensor's mount; None
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
        """Noise-free readings (n, 6) of reactions and mount weight at these orientations of the
        sensor, with cross-talk, after the low-pass filter.
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
        """Return what this sensor would log: the inverse of `reactions`, with all that the sensor
        adds.

        In this order: mount weight, cross-talk, low-pass filter and delay; white, pink and
        random-walk noise, tare and drift; range and rounding; noise of the robot's pose. The stated
        noise is that of the log, after the filter.

        Parameters
        ----------
        reactions
            On one trail (n, …), with time, in SI units.
        rng
            Random generator; a sensor of unknown noise is taken as noiseless. The same state gives
            the same recording.
        force_tare, torque_tare
            Offsets of the sensor (3,) [N], [N m], in the axes of the wrench.

        Raises
        ------
        ValueError
            If the reactions span several trails, or have no time.
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
                # World axes are the robot's, which rotates the wrench by the orientation that it
                # logs.
                read += np.hstack([turn.apply(part) for part in np.split(shown, 2, axis=1)]) - shown
        limits = self.response.limits(noise.resolution)
        steps = np.maximum(noise.resolution, NO_STEP)
        read = np.round(np.clip(read, -limits, limits) / steps) * steps
        return RawRecording(time, position, orientation, read[:, :3], read[:, 3:])


@lru_cache(maxsize=4)
def _free_reactions(rod: Rod, position: bytes, orientation: bytes) -> Wrenches:
    """One recording is looked at several times."""
    turns = np.frombuffer(orientation).reshape(-1, 4)
    return free_reactions(rod, Trail(np.frombuffer(position).reshape(-1, 3), turns))


def carried(maps: Covariances, covariance: Covariance) -> Covariance:
    """Covariance of readings propagated to reactions; one for all rows if they agree."""
    carried = maps @ covariance @ np.swapaxes(maps, 1, 2)
    carried = (carried + np.swapaxes(carried, 1, 2)) / 2
    size = np.sqrt(np.diag(carried[0]))
    same = np.all(np.abs(carried - carried[0]) <= _SAME * np.outer(size, size))
    return carried[0] if same else carried
