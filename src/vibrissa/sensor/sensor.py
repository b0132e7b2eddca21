"""A six-axis force/torque sensor that carries the rod's clamp."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array
from vibrissa.geometry.rotation import inverse, multiplied, rotation_matrices, unit_quaternions
from vibrissa.reactions import Reactions
from vibrissa.sensor.figures import Noise, Response, TarePolicy, Vector
from vibrissa.sensor.maps import to_reactions
from vibrissa.sensor.model import logged
from vibrissa.sensor.mount import Mount
from vibrissa.sensor.noise import Coloured
from vibrissa.sensor.raw import Covariances, RawRecording, Times, Wrench
from vibrissa.sensor.rest import rest_for_tare
from vibrissa.sensor.tare import Tare, fitted_tare, no_tare
from vibrissa.tolerances import SetupErrors, Tolerances
from vibrissa.trail import Trail

WrenchSign = Literal["on_sensor", "on_rod"]
WrenchFrame = Literal["sensor", "world"]

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

    clamp_position: Float[np.ndarray, 3]
    clamp_orientation: Float[np.ndarray, 4]
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
        noise: Noise | None = None,
        response: Response | None = None,
        tare_policy: TarePolicy | None = None,
        **figures: Any,
    ) -> None:
        for name, given, allowed in (
            ("wrench", wrench, ("on_sensor", "on_rod")),
            ("wrench_frame", wrench_frame, ("sensor", "world")),
        ):
            if given not in allowed:
                raise ValueError(f"{name} = {given!r}; allowed are {' and '.join(allowed)}")
        orientation = unit_quaternions(clamp_orientation, "clamp_orientation")
        if orientation.shape != (4,):
            raise ValueError(f"clamp_orientation has shape {orientation.shape}; allowed is (4,)")
        point = finite_array(wrench_point, "wrench_point", last=3, ndim=1)
        checked: dict[str, Any] = {
            "clamp_position": finite_array(clamp_position, "clamp_position", last=3, ndim=1),
            "clamp_orientation": orientation,
            "wrench": wrench,
            "wrench_frame": wrench_frame,
            "wrench_point": tuple(point.tolist()),
            "mount": mount,
        }
        parts: tuple[Any, ...] = (
            noise or Noise(),
            response or Response(),
            tare_policy or TarePolicy(),
        )
        for (name, kind), part in zip(_PARTS.items(), parts, strict=True):
            own = {key: figures.pop(key) for key in kind.__dataclass_fields__ if key in figures}
            checked[name] = replace(part, **own)
        if figures:
            raise TypeError(
                f"Sensor has no {', '.join(figures)}; allowed are its attributes and the fields of "
                "Noise, Response and TarePolicy"
            )
        for name, value in checked.items():
            object.__setattr__(self, name, value)

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
    def arm(self) -> Float[np.ndarray, 3]:
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

    def coloured(self, time: Times) -> list[Coloured]:
        """Pink noise and random walk over the stamps (n,), each with its scale (6,) on the
        channels; those that the sensor has.
        """
        return self.noise.coloured(time)

    @property
    def estimates_mount(self) -> bool:
        """Whether mass and centre of the mount are to be found from rest."""
        return self.mount is not None and self.mount.estimated

    def updated(self, **changes: Any) -> Sensor:
        """Return the sensor with other attributes or figures, by their own names."""
        return replace(self, **changes)

    def without_estimates(self) -> Sensor:
        """Return the same sensor with an offset alone to be found from rest."""
        return self.updated(estimate_drift=False, mount=None)

    def tare(self, raw: RawRecording) -> Tare:
        """What the sensor shows without contact: from rest that is given or found
        (`vibrissa.sensor.rest`), or nothing where `tare_seconds` is 0.

        Raises
        ------
        ValueError
            If rest that is given does not fit the recording, or none can be found.
        """
        policy = self.tare_policy
        if not policy.rest_intervals and policy.tare_seconds is not None:
            count = int(np.count_nonzero(raw.time - raw.time[0] < policy.tare_seconds))
            if policy.tare_seconds == 0:
                if policy.estimate_drift or self.estimates_mount:
                    what = "estimate_drift" if policy.estimate_drift else "mount.estimated"
                    raise ValueError(
                        f"{what} = True with tare_seconds = 0; allowed are rest_intervals, a "
                        "tare_seconds greater than 0, or none to find the rest"
                    )
                return no_tare(self, raw.time)
            if count < 2 or count >= len(raw.time):
                raise ValueError(
                    f"tare_seconds = {policy.tare_seconds}: {count} of {len(raw.time)} samples lie "
                    "within it; allowed are at least 2, and fewer than all"
                )
        return fitted_tare(self, raw, *rest_for_tare(self, raw))

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
        if not (tolerances is None or isinstance(tolerances, SetupErrors)):
            tolerances = self.setup_errors(tolerances)
        errors: dict[str, Any] = {}
        if self.noise.known:
            readings = tare.covariance(self, raw.time, raw.orientation)
            errors["covariance"] = carried(maps, readings)
            errors["position_covariance"] = np.eye(3) * self.noise.position_noise**2
            if self.noise.orientation_noise:
                errors["rotation_covariance"] = np.eye(3) * self.noise.orientation_noise**2
                errors["rotation_center"] = raw.position
        return Reactions(
            Trail(
                raw.position + axes @ self.clamp_position,
                multiplied(raw.orientation, self.clamp_orientation),
            ),
            wrench[:, :3],
            wrench[:, 3:],
            time=raw.time,
            setup_errors=tolerances,
            velocity=velocity,
            **errors,
        )

    def setup_errors(self, tolerances: Tolerances | ArrayLike) -> SetupErrors:
        """Errors of the setup's numbers for `Reactions`, seen from this sensor's mount."""
        stated = tolerances.covariance if isinstance(tolerances, Tolerances) else tolerances
        covariance = np.asarray(stated, dtype=float)
        return SetupErrors(
            covariance, self.clamp_orientation, self.arm, self.wrench_frame == "world"
        )

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
        position = reactions.trail.position - rotation_matrices(orientation) @ self.clamp_position
        offsets = (("force_tare", force_tare), ("torque_tare", torque_tare))
        tare = np.concatenate([finite_array(part, name, last=3, ndim=1) for name, part in offsets])
        return logged(self, reactions, position, orientation, tare, rng)


_PARTS: dict[str, Any] = {"noise": Noise, "response": Response, "tare_policy": TarePolicy}


def carried(
    maps: Covariances, covariance: Float[np.ndarray, "... 6 6"]
) -> Float[np.ndarray, "... 6 6"]:
    """Covariance of readings taken to that of reactions, one for all rows where they agree."""
    carried = maps @ covariance @ np.swapaxes(maps, 1, 2)
    carried = (carried + np.swapaxes(carried, 1, 2)) / 2
    size = np.sqrt(np.einsum("nii->ni", np.abs(carried)))
    same = np.all(np.abs(carried - carried[0]) <= _SAME * size[0][:, None] * size[0])
    return np.asarray(carried[0] if same else carried)
