"""Expected contact error of a sensor over a scene: forward, through the sensor, and back."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import chdtri

from vibrissa.contacts import Status
from vibrissa.forward import Scan, scan
from vibrissa.geometry.checks import not_negative, positive, whole_number
from vibrissa.inverse import Reconstruction, reconstruct
from vibrissa.numerics.progress import Progress
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor import RawRecording, Sensor
from vibrissa.sensor.noise import quantisation_of_mean
from vibrissa.sensor.sensor import carried
from vibrissa.sensor.tare import fitted_tare
from vibrissa.surfaces import Surface
from vibrissa.tolerances import Tolerances
from vibrissa.trail import Trail

_WITHIN_95 = float(np.sqrt(chdtri(3, 0.05)))


@dataclass(frozen=True, eq=False)
class ExpectedError:
    """What a sensor will make of the contacts of a scan, one row per position (…), in units of the
    rod.

    Attributes
    ----------
    scan
        The scene: contacts and reactions without a sensor.
    found
        The reconstruction of the exact reactions, with the covariances that the sensor's errors
        give.
    covariance
        Of the contact point (…, 3, 3), from noise, rounding, tare, drift and the robot's pose, and
        from tolerances if given; NaN where no contact is detected, or the scan has no solution.
    lag
        Systematic error of the contact point (…, 3) due to the sensor's filter and delay at the
        given speed; 0 without them.
    saturated
        Where a reading would exceed the sensor's range (…), including tare and mount weight as
        given.
    """

    scan: Scan
    found: Reconstruction
    covariance: Float[np.ndarray, "*trail n 3 3"]
    lag: Float[np.ndarray, "*trail n 3"]
    saturated: Bool[np.ndarray, "*trail n"]

    def __repr__(self) -> str:
        """Return five lines: contacts, those detected, those saturated, and their errors."""
        seen, unit = self.detected, self.scan.rod.unit_of("length").replace("1", "L")
        errors = (self.root_mean_square[seen], self.semi_axes[..., -1][seen])
        spread, longest = (f"{np.median(x):.3g} {unit}" if seen.any() else "none" for x in errors)
        return (
            f"ExpectedError at {seen.size} positions {seen.shape}, "
            f"{self.scan.in_contact.sum()} in contact\n"
            f"  detected: {seen.sum()}\n"
            f"  saturated: {self.saturated.sum()}\n"
            f"  root mean square, median: {spread}\n"
            f"  longest semi-axis at 95 %, median: {longest}"
        )

    @property
    def detected(self) -> Bool[np.ndarray, "*trail n"]:
        """Where the load exceeds the noise by enough to detect a contact (…); false where the scan
        has no solution.
        """
        return self.found.in_contact & self.scan.in_contact & (self.scan.status < Status.HEAD_ON)

    @property
    def standard_deviations(self) -> Float[np.ndarray, "*trail n 3"]:
        """Along the axes of the covariance (…, 3), in ascending order; NaN where no contact is
        detected.
        """
        known = np.isfinite(self.covariance).all(axis=(-2, -1))
        values = np.linalg.eigvalsh(np.where(known[..., None, None], self.covariance, np.eye(3)))
        return np.where(known[..., None], np.sqrt(np.maximum(values, 0)), np.nan)

    @property
    def semi_axes(self) -> Float[np.ndarray, "*trail n 3"]:
        """Semi-axes of the 95 % ellipsoids (…, 3), in ascending order."""
        return _WITHIN_95 * self.standard_deviations

    @property
    def root_mean_square(self) -> Float[np.ndarray, "*trail n"]:
        """Expected root-mean-square distance between the point found and the true one (…),
        including the lag.
        """
        return np.sqrt(np.trace(self.covariance, axis1=-2, axis2=-1) + np.sum(self.lag**2, axis=-1))


def expected_error(
    rod: Rod,
    surface: Surface,
    trail: Trail,
    sensor: Sensor,
    *,
    rate: float = 1000.0,
    rest: float = 1.0,
    speed: float | None = None,
    samples: int = 1,
    friction: float = 0.0,
    finite_radius: bool = False,
    false_alarm: float = 1e-3,
    tolerances: Tolerances | None = None,
    progress: Progress | None = None,
) -> ExpectedError:
    """Will this sensor do for this rod? The expected contact error at every position of a scene.

    The scan's exact reactions are reconstructed with the covariance that `Sensor.reactions` would
    give them. Errors are propagated to first order, which overstates them next to first contact, as
    a contact lies within the rod's reach.

    Parameters
    ----------
    rod, surface, trail, friction, finite_radius, progress
        As for `vibrissa.scan`, in SI units like the sensor's.
    sensor
        With known noise.
    rate
        Samples per second [Hz].
    rest
        Duration of the rest in which the tare is taken [s]; 0 for none.
    speed
        Of the clamp [m/s]: determines how far drift, pink noise and random walk have gone at each
        position, and the lag from filter and delay. By default positions follow one another at the
        given rate, without lag.
    samples
        Readings averaged at each position.
    false_alarm
        As for `vibrissa.reconstruct`.
    tolerances
        How well the setup's values are known. The covariance then includes, beside the noise
        (`found.covariance_noise`), what their errors do to all contacts together (`found.shared`),
        which averaging does not reduce. A delay of the poses shifts contacts by the distance that
        the clamp moves in that time, at the given speed.

    Returns
    -------
    ExpectedError
        Covariances, standard deviations and 95 % semi-axes by position.

    Raises
    ------
    ValueError
        If the sensor's noise is not known, a value is out of range, or a tolerance of `pose_delay`
        is given without `speed`.
    TypeError
        If `tolerances` is not a `Tolerances`.
    """
    if sensor.force_noise is None:
        raise ValueError(
            "sensor.force_noise = None; allowed is a sensor with force_noise and "
            "torque_noise, or a preset"
        )
    if tolerances is not None and not isinstance(tolerances, Tolerances):
        raise TypeError(f"tolerances = {tolerances!r}; allowed is vibrissa.Tolerances")
    if tolerances is not None and tolerances.pose_delay > 0 and speed is None:
        raise ValueError("speed = None; a tolerance of pose_delay needs the clamp's speed")
    rate, rest, samples = (
        positive(rate, "rate"),
        not_negative(rest, "rest"),
        whole_number(samples, "samples"),
    )
    swept = scan(
        rod, surface, trail, friction=friction, finite_radius=finite_radius, progress=progress
    )
    exact, shape = swept.reactions, swept.trail.shape
    averaged, rate = _averaged(sensor, samples), rate / samples
    trails = [exact] if len(shape) == 1 else [exact[index] for index in range(len(exact.force))]
    covariance, late, saturated, time = (
        np.stack(part).reshape(*shape, *part[0].shape[1:])
        for part in zip(*(_lane(averaged, one, rate, rest, speed) for one in trails), strict=True)
    )

    def contacts(reactions: Reactions) -> Reconstruction:
        return reconstruct(rod, reactions, friction=friction, false_alarm=false_alarm, check=False)

    found = contacts(
        replace(
            exact,
            covariance=covariance,
            position_covariance=sensor.position_noise**2 / samples * np.eye(3),
            rotation_covariance=sensor.orientation_noise**2 / samples * np.eye(3),
            rotation_center=sensor.frame(swept.trail).position,
            setup_errors=sensor.setup_errors(tolerances),
            time=time,
        )
    )
    assert found.covariance is not None
    lag = np.zeros((*shape, 3))
    if sensor.low_pass is not None and speed is not None:
        shifted = replace(exact, force=late[..., :3], moment=late[..., 3:], covariance=covariance)
        lag = np.nan_to_num(contacts(shifted).point - found.point)
    solved = (swept.status < Status.HEAD_ON)[..., None, None]
    return ExpectedError(swept, found, np.where(solved, found.covariance, np.nan), lag, saturated)


def _averaged(sensor: Sensor, samples: int) -> Sensor:
    """The sensor, with the errors of a single reading replaced by those of a mean of `samples`."""
    noise = sensor.noise
    steps = np.sqrt(12 * quantisation_of_mean(noise.white, noise.resolution, samples))
    names = ("force_noise", "torque_noise", "force_resolution", "torque_resolution")
    figures = np.reshape([noise.white / samples**0.5, steps], (4, 3)).tolist()
    return sensor.updated(**dict(zip(names, map(tuple, figures), strict=True)))


def _lane(
    sensor: Sensor, reactions: Reactions, rate: float, rest: float, speed: float | None
) -> tuple[
    Float[np.ndarray, "n 6 6"],
    Float[np.ndarray, "n 6"],
    Bool[np.ndarray, "n"],
    Float[np.ndarray, "n"],
]:
    """For one trail: the covariance of the reactions, the delayed reactions, where the range is
    exceeded, and the time stamps.
    """
    trail, steps = reactions.trail, np.full(reactions.trail.count - 1, 1 / rate)
    if speed is not None:
        way = np.linalg.norm(np.diff(trail.position, axis=0), axis=1)
        steps = np.maximum(way / positive(speed, "speed"), steps)
    time = rest + np.concatenate([[0.0], np.cumsum(steps)]) + 1 / rate
    orientation, count = sensor.frame(trail).orientation, int(rest * rate)
    end = float(time[-1])
    ends = ((0.0, rest), (end, end + rest))[: (count >= 2) * (1 + sensor.estimate_drift)]
    stamps = np.concatenate([np.arange(count) / rate, time, end + np.arange(1, count) / rate])
    still = np.zeros((len(stamps), 3))
    raw = RawRecording(stamps, still, np.insert(still, 3, 1.0, axis=1), still, still)
    tare = fitted_tare(sensor.updated(mount=None), raw, ends, "planned")
    # Pink noise depends on the whole recording, including the rest.
    tare = replace(tare, coloured=tuple(sensor.noise.coloured(np.append(0.0, time))))
    maps = sensor.to_reactions(orientation)
    covariance = carried(maps, tare.covariance(sensor, time, orientation))
    exact = reactions.wrench
    force, moment = np.hsplit(np.nan_to_num(exact), 2)
    timed = Reactions(trail, force, moment, time=time)
    late = sensor.filtered_readings(timed, orientation)
    shown = sensor.updated(low_pass=None).filtered_readings(timed, orientation)
    beyond = np.any(np.abs(shown) > sensor.response.limits(np.zeros(6)), axis=1)
    return (
        np.broadcast_to(covariance, (len(time), 6, 6)),
        exact + np.einsum("nij,nj->ni", maps, late - shown),
        beyond & np.isfinite(exact).all(axis=1),
        time,
    )
