"""What a sensor shows without a load: offset, drift and the mount's weight, fitted to rest, with
the fit's own errors.
"""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.sensor.maps import weight_readings
from vibrissa.sensor.mount import Mount
from vibrissa.sensor.noise import Coloured, quantisation_of_mean
from vibrissa.sensor.raw import (
    Covariances,
    Interval,
    Quaternions,
    RawRecording,
    Rows,
    Times,
    Wrench,
    Wrenches,
)

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

Gains = Float[np.ndarray, "k p 6"]

# Columns of unit length: with more, solving keeps less than half of the digits.
_LARGEST_CONDITION = 1e7
# Standard deviations by which readings at rest may miss those of a weight.
_SCATTER = 6.0
# A robot that holds its pose does so within its repeatability, well below half a degree.
_STILL = 0.5
# Stamps since 1970 are known to a quarter of a microsecond: a sample at the very end of an interval
# is to be outside of it on any clock.
_SAME_TIME = 1e-6


@dataclass(frozen=True, eq=False)
class Tare:
    """Readings without contact, as a function of time and orientation.

    Attributes
    ----------
    intervals
        Rest intervals (start, stop) [s], on the recording's clock.
    counts
        Good samples in each.
    found
        How the intervals were found, in words.
    epoch
        Time [s] at which `offset` holds.
    offset, drift
        (6,) [N, N m] and their rates (6,) [1/s], in the order fx, fy, fz, tx, ty, tz and the axes
        of the wrench.
    mount
        Its weight is taken off: as given, or as estimated; None for none.
    """

    intervals: tuple[Interval, ...]
    counts: tuple[int, ...]
    found: str
    epoch: float
    offset: Wrench
    drift: Wrench
    mount: Mount | None
    _terms: tuple[str, ...] = ()
    """What was fitted, of "offset", "drift" and "weight"."""
    _gains: Gains = field(default_factory=lambda: np.zeros((0, 0, 6)))
    """What takes the mean readings of each interval to its part of the fitted parameters."""
    coloured: tuple[Coloured, ...] | None = None
    """Processes of pink noise and random walk, with their scales; None for those of the sensor over
    the times of the recording.
    """

    @property
    def seconds(self) -> float:
        """Length of all rest intervals together [s]."""
        return float(sum(stop - start for start, stop in self.intervals))

    def readings(self, sensor: "Sensor", time: Times, orientation: Quaternions) -> Wrenches:
        """What the sensor shows without contact at those times and orientations."""
        shown = self.offset + (time - self.epoch)[:, None] * self.drift
        if self.mount is not None:
            weight = weight_readings(sensor, rotation_matrices(orientation))
            shown = shown + weight @ self.mount.moments
        return shown

    def covariance(
        self,
        sensor: "Sensor",
        time: Times,
        orientation: Quaternions,
        *,
        since: float | None = None,
    ) -> Float[np.ndarray, "... 6 6"]:
        """Of readings after the tare is taken off, (6, 6) where it is the same for all rows, else
        (n, 6, 6): their own noise and the tare's error.

        White noise and rounding, and pink noise and random walk as far as they have moved since the
        tare was taken. They begin at the first time, or at `since`.
        """
        noise, coloured = sensor.noise, self.coloured
        if coloured is None:
            begun = time if since is None else np.concatenate([[since], time])
            coloured = tuple(noise.coloured(begun))
        own = noise.variance
        if self.counts:
            # Rounding errors of the tare that more samples do not average out.
            count = sum(self.counts)
            own = own - noise.resolution**2 / 12 / count
            own += quantisation_of_mean(noise.white, noise.resolution, count)
        rows = _design_rows(sensor, self._terms, time - self.epoch, orientation)
        constant = not coloured and set(self._terms) <= {"offset"}
        # Share of each interval's mean in what is taken off.
        shares = (rows[:1] if constant else rows) @ self._gains[:, None]
        of_means = noise.variance / np.array(self.counts).reshape(-1, 1)
        total = np.diag(own) + np.einsum("knij,kj,knmj->nim", shares, of_means, shares)
        for one in coloured:
            total = total + _moved(one, time, self.intervals, shares)
        return total[0] if constant else (total + np.swapaxes(total, 1, 2)) / 2


def no_tare(sensor: "Sensor", time: Times) -> Tare:
    """Nothing is taken off but a drift and a weight that are given."""
    found, drift = "none: tare_seconds = 0", sensor.tare_policy.drift
    return Tare((), (), found, float(time[0]), np.zeros(6), drift, sensor.mount)


def planned_tare(
    sensor: "Sensor", intervals: tuple[Interval, ...], counts: tuple[int, ...]
) -> Tare:
    """Return the tare that rest of this length will give, without its values: for its covariance.
    The mount's weight is taken as known.
    """
    terms = ("offset", "drift") if sensor.tare_policy.estimate_drift else ("offset",)
    middle = np.mean(intervals, axis=1)
    epoch, nothing = float(middle[0]), np.zeros(6)
    designs = _design_rows(sensor, terms, middle - epoch, np.zeros((len(middle), 4)))
    gains = _fitted_gains(designs, np.array(counts)[:, None] / sensor.noise.variance, terms)
    return Tare(intervals, counts, "planned", epoch, nothing, nothing, None, terms, gains)


def fitted_tare(
    sensor: "Sensor", raw: RawRecording, intervals: tuple[Interval, ...], found: str
) -> Tare:
    """Fit offset, drift and the mount's weight to the readings in rest intervals by least squares.

    Raises
    ------
    ValueError
        If an interval holds fewer than two good samples, drift is to be estimated from fewer than
        two intervals, or a mount from orientations that do not determine it or do not fit.
    """
    policy, first = sensor.tare_policy, float(raw.time[0])
    groups = [raw.whole & raw.during((start, stop - _SAME_TIME)) for start, stop in intervals]
    counts = np.array([np.count_nonzero(group) for group in groups], dtype=int)
    for (start, stop), count in zip(intervals, counts, strict=True):
        if count < 2:
            raise ValueError(
                f"rest from {start - first:g} s to {stop - first:g} s holds {count} good samples; "
                "allowed are at least 2"
            )
    if not intervals:
        raise ValueError(
            "no rest is found in the recording; allowed are rest_intervals that are free of contact"
        )
    if policy.estimate_drift and len(intervals) < 2:
        raise ValueError(
            f"estimate_drift = True with {len(intervals)} rest interval; allowed are at least 2, "
            "at the start and at the end"
        )
    chosen = {"offset": True, "drift": policy.estimate_drift, "weight": sensor.estimates_mount}
    terms = tuple(term for term, fitted in chosen.items() if fitted)
    epoch = float(raw.time[groups[0]].mean())
    readings = without_given(sensor, raw)
    rows = _design_rows(sensor, terms, raw.time - epoch, raw.orientation)
    means, designs = (
        np.stack([part[group].mean(axis=0) for group in groups]) for part in (readings, rows)
    )
    variance = _variance(sensor, readings, groups)
    gains = _fitted_gains(designs, counts[:, None] / variance, terms)
    solution = np.einsum("kpi,ki->p", gains, means)
    mount = sensor.mount
    if mount is not None and mount.estimated:
        misses = (means - designs @ solution) / np.sqrt(variance)
        _check_mount(raw, groups, misses, counts, len(solution))
        mount = _mount(sensor, mount, solution[-4:])
    drift = policy.drift + (solution[6:12] if policy.estimate_drift else 0)
    offset = solution[:6] + (epoch - first) * policy.drift
    numbers = tuple(counts.tolist())
    return Tare(intervals, numbers, found, epoch, offset, drift, mount, terms, gains)


def without_given(sensor: "Sensor", raw: RawRecording) -> Wrenches:
    """Readings (n, 6) with a given drift and a given mount's weight taken off."""
    readings = raw.wrench - (raw.time - raw.time[0])[:, None] * sensor.tare_policy.drift
    if sensor.mount is None or sensor.mount.estimated:
        return readings
    return readings - (
        weight_readings(sensor, rotation_matrices(raw.orientation)) @ sensor.mount.moments
    )


def _design_rows(
    sensor: "Sensor", terms: tuple[str, ...], elapsed: Times, orientation: Quaternions
) -> Float[np.ndarray, "n 6 p"]:
    """What takes the parameters of these terms to readings, a matrix a row."""
    offset = np.tile(np.eye(6), (len(elapsed), 1, 1))
    parts = [offset[..., :0]]
    if "offset" in terms:
        parts.append(offset)
    if "drift" in terms:
        parts.append(elapsed[:, None, None] * offset)
    if "weight" in terms:
        parts.append(weight_readings(sensor, rotation_matrices(orientation)))
    return np.concatenate(parts, axis=2)


def _variance(sensor: "Sensor", readings: Wrenches, groups: list[Rows]) -> Wrench:
    """Of a reading: as stated, or as the forces and the torques scatter at rest."""
    if sensor.noise.known:
        return sensor.noise.variance
    within = [readings[group] - readings[group].mean(axis=0) for group in groups]
    pooled = np.mean(np.concatenate(within).reshape(-1, 2, 3) ** 2, axis=(0, 2))
    return np.repeat(np.where(pooled > 0, pooled, 1.0), 3)


def _fitted_gains(
    designs: Float[np.ndarray, "k 6 p"], weights: Float[np.ndarray, "k 6"], terms: tuple[str, ...]
) -> Gains:
    """Weighted least squares: what takes the mean readings (k, 6) to the parameters (p,)."""
    root, parameters = np.sqrt(weights), designs.shape[2]
    matrix = (root[..., None] * designs).reshape(root.size, parameters)
    scale = np.linalg.norm(matrix, axis=0)
    enough = len(matrix) >= parameters and np.all(scale > 0)
    condition = np.linalg.cond(matrix / scale) if enough else np.inf
    if condition > _LARGEST_CONDITION:
        what = "mount.estimated" if "weight" in terms else "estimate_drift"
        raise ValueError(
            f"{what} = True: the {len(root)} rest intervals do not determine it (condition "
            f"{condition:.3g}); allowed are rest intervals in at least three orientations whose "
            "weights point in different directions, and at different times"
        )
    inverse = np.linalg.pinv(matrix / scale) / scale[:, None] * root.ravel()
    return np.swapaxes(inverse.reshape(parameters, *root.shape), 0, 1)


def _check_mount(
    raw: RawRecording,
    groups: list[Rows],
    misses: Float[np.ndarray, "k 6"],
    counts: Int[np.ndarray, "k"],
    parameters: int,
) -> None:
    """Refuse rest in which the sensor turns, and means (k, 6) that miss those of a weight by many
    standard deviations.
    """
    for group in groups:
        cosine = np.abs(raw.orientation[group] @ raw.orientation[group][0])
        turned = np.degrees(2 * np.arccos(np.clip(cosine, 0, 1)).max())
        if turned > _STILL:
            raise ValueError(
                f"mount.estimated = True: the sensor turns by {turned:.3g}° within a rest "
                f"interval; allowed is at most {_STILL}°"
            )
    freedom = misses.size - parameters
    scatter = float(np.sqrt(np.mean(misses**2)))
    # Weights are not known to the last digit of a long mean: rounding and calibration errors of a
    # few parts in a thousand are let pass.
    if scatter > 1 and np.sum(counts @ misses**2) > _SCATTER**2 * freedom > 0:
        raise ValueError(
            f"mount.estimated = True: readings at rest scatter by {scatter:.3g} standard "
            "deviations about those of a weight; allowed is noise: give rest_intervals that are "
            "free of contact"
        )


def _mount(sensor: "Sensor", stated: Mount, moments: Float[np.ndarray, "4"]) -> Mount:
    mass = float(moments[0])
    if mass < 0:
        raise ValueError(
            f"mount.estimated = True gives the mass {mass:.3g} kg; allowed is at least 0: check "
            f"wrench = {sensor.wrench!r} and mount.gravity"
        )
    x, y, z = (moments[1:] / (mass or 1.0)).tolist()
    return replace(stated, mass=mass, center=(x, y, z))


def _moved(
    coloured: Coloured,
    time: Times,
    intervals: tuple[Interval, ...],
    shares: Float[np.ndarray, "k n 6 6"],
) -> Covariances:
    """Covariance (n, 6, 6) of noise at a time less what the fit takes off of it."""
    process, scale = coloured
    scaled, k = shares * scale, len(intervals)
    mean = np.array([process.with_mean(time, *rest) for rest in intervals]).reshape(k, len(time))
    means = np.array([[process.between_means(a, b) for b in intervals] for a in intervals])
    own = np.einsum("n,ij->nij", process.variance_at(time), np.diag(scale**2))
    taken = np.einsum("kn,knij->nij", mean, scaled * scale)
    both = np.einsum("knij,kl,lnmj->nim", scaled, means.reshape(k, k), scaled, optimize=True)
    return own - taken - np.swapaxes(taken, 1, 2) + both
