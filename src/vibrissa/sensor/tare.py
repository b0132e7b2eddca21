"""Readings of a sensor without load: offset, drift and mount weight, fitted to rest, with the
errors of the fit.
"""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from vibrissa.sensor.figures import Mount
from vibrissa.sensor.noise import Coloured, quantisation_of_mean
from vibrissa.sensor.raw import (
    Covariance,
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

# Least ratio of singular values, columns scaled to unit length: below it, solving keeps less than
# half of the digits.
_LEAST_RATIO = 1e-7
# Standard deviations by which readings at rest may deviate from a pure weight.
_SCATTER = 6.0
# A robot holds its pose to within its repeatability, well below half a degree.
_STILL = 0.5
# Seconds since 1970 are resolved to a quarter of a microsecond: a sample at the very end of an
# interval must fall outside on any clock.
_SAME_TIME = 1e-6


@dataclass(frozen=True, eq=False)
class Tare:
    """Readings without contact, as a function of time and orientation.

    Attributes
    ----------
    intervals
        Rest intervals (start, stop) [s], on the recording's clock.
    counts
        Number of good samples in each.
    found
        How the intervals were found, in words.
    epoch
        Time [s] at which `offset` holds.
    offset, drift
        Offset (6,) [N, N m] and its rate (6,) [1/s], in the order fx, fy, fz, tx, ty, tz and the
        axes of the wrench.
    mount
        Mount whose weight is subtracted, as given or estimated; None for none.
    """

    intervals: tuple[Interval, ...]
    counts: tuple[int, ...]
    found: str
    epoch: float
    offset: Wrench
    drift: Wrench
    mount: Mount | None
    _terms: tuple[str, ...] = ()
    """Terms fitted besides the offset: `Sensor.estimates`."""
    _gains: Gains = field(default_factory=lambda: np.zeros((0, 6, 6)))
    """Maps from the mean readings of each interval to its contribution to the fitted parameters."""
    coloured: tuple[Coloured, ...] | None = None
    """Processes of pink noise and random walk, with their scales; None for the sensor's own over
    the recording.
    """

    def readings(self, sensor: "Sensor", time: Times, orientation: Quaternions) -> Wrenches:
        """What the sensor reads without contact at these times and orientations."""
        shown = self.offset + (time - self.epoch)[:, None] * self.drift
        if self.mount is not None:
            shown = shown + sensor.weight_readings(orientation) @ self.mount.moments
        return shown

    def covariance(self, sensor: "Sensor", time: Times, orientation: Quaternions) -> Covariance:
        """Covariance of readings after the tare is subtracted, (6, 6) if the same for all rows,
        else (n, 6, 6): their own noise and the tare's error.

        It covers white noise and rounding, and the change of pink noise and random walk since the
        tare was taken.
        """
        noise, coloured = sensor.noise, self.coloured
        coloured = tuple(noise.coloured(time)) if coloured is None else coloured
        rows = _design_rows(sensor, self._terms, time - self.epoch, orientation)
        constant = not coloured and not self._terms
        rows = rows[:1] if constant else rows
        # A reading minus the tare, as a weighted sum of the reading and the means at rest.
        own = np.broadcast_to(np.eye(6), (1, len(rows), 6, 6))
        weights = np.concatenate([own, -rows @ self._gains[:, None]])
        white = np.diag([1.0, *(1 / count for count in self.counts)])[..., None]
        total = _of_sums(weights * np.sqrt(noise.variance), white)
        if self.counts:
            # Rounding errors of the tare that do not average out over its samples.
            count = sum(self.counts)
            kept = quantisation_of_mean(noise.white, noise.resolution, count)
            total = total + np.diag(kept - noise.resolution**2 / 12 / count)
        for process, scale in coloured:
            moved = np.empty((*2 * (len(weights),), len(time)))
            moved[0, 0] = process.variance_at(time)
            for i, rest in enumerate(self.intervals, start=1):
                moved[0, i] = moved[i, 0] = process.with_mean(time, *rest)
                for j, other in enumerate(self.intervals, start=1):
                    moved[i, j] = process.between_means(rest, other)
            total = total + _of_sums(weights * scale, moved)
        return total[0] if constant else total


def _of_sums(
    weights: Float[np.ndarray, "k n 6 6"], between: Float[np.ndarray, "k k #n"]
) -> Covariances:
    """Covariances (n, 6, 6) of weighted sums of k numbers per channel, from their covariances."""
    return np.einsum("knij,kln,lnmj->nim", weights, between, weights, optimize=True)


def fitted_tare(
    sensor: "Sensor", raw: RawRecording, intervals: tuple[Interval, ...], found: str
) -> Tare:
    """Fit offset, drift and mount weight to the readings in rest intervals by least squares;
    without intervals nothing is fitted.

    Raises
    ------
    ValueError
        If an interval holds fewer than two good samples, or the intervals do not determine drift
        or mount, or do not fit a mount.
    """
    policy, terms, first = sensor.tare_policy, sensor.estimates, float(raw.time[0])
    if not intervals:
        return Tare((), (), found, first, np.zeros(6), policy.drift, sensor.mount)
    groups = [raw.whole & raw.during((start, stop - _SAME_TIME)) for start, stop in intervals]
    counts = np.count_nonzero(groups, axis=1)
    for (start, stop), count in zip(intervals, counts, strict=True):
        if count < 2:
            raise ValueError(
                f"rest from {start - first:g} s to {stop - first:g} s holds {count} good samples; "
                "allowed are at least 2"
            )
    epoch, readings = float(raw.time[groups[0]].mean()), without_given(sensor, raw)
    rows = _design_rows(sensor, terms, raw.time - epoch, raw.orientation)
    means, designs = (
        np.stack([part[group].mean(axis=0) for group in groups]) for part in (readings, rows)
    )
    if sensor.noise.known:
        variance = sensor.noise.variance
    else:
        # From the scatter of forces and torques at rest.
        left = np.concatenate([readings[group] - readings[group].mean(axis=0) for group in groups])
        pooled = np.mean(left.reshape(-1, 2, 3) ** 2, axis=(0, 2))
        variance = np.repeat(np.where(pooled > 0, pooled, 1.0), 3)
    gains = _fitted_gains(designs, counts[:, None] / variance, terms)
    solution, mount = np.einsum("kpi,ki->p", gains, means), sensor.mount
    if mount is not None and mount.estimated:
        misses = (means - designs @ solution) / np.sqrt(variance)
        _check_weight(raw, groups, misses, counts @ misses**2, len(solution))
        mass, (x, y, z) = float(solution[-4]), (solution[-3:] / (solution[-4] or 1.0)).tolist()
        if mass < 0:
            raise ValueError(
                f"mount.estimated = True gives the mass {mass:.3g} kg; allowed is at least 0: "
                f"check wrench = {sensor.wrench!r} and mount.gravity"
            )
        mount = replace(mount, mass=mass, center=(x, y, z))
    drift = policy.drift + (solution[6:12] if policy.estimate_drift else 0)
    offset = solution[:6] + (epoch - first) * policy.drift
    numbers = tuple(counts.tolist())
    return Tare(intervals, numbers, found, epoch, offset, drift, mount, terms, gains)


def without_given(sensor: "Sensor", raw: RawRecording) -> Wrenches:
    """Readings (n, 6) with known drift, mount weight and loads along the rod subtracted."""
    readings = raw.wrench - (raw.time - raw.time[0])[:, None] * sensor.tare_policy.drift
    readings = readings - sensor.rod_readings(raw)
    if sensor.mount is None or sensor.mount.estimated:
        return readings
    return readings - sensor.weight_readings(raw.orientation) @ sensor.mount.moments


def _design_rows(
    sensor: "Sensor", terms: tuple[str, ...], elapsed: Times, orientation: Quaternions
) -> Float[np.ndarray, "n 6 p"]:
    """Matrices, one per row, from an offset and the parameters of further terms to readings."""
    parts = [np.tile(np.eye(6), (len(elapsed), 1, 1))]
    if "estimate_drift" in terms:
        parts.append(elapsed[:, None, None] * parts[0])
    if "mount.estimated" in terms:
        parts.append(sensor.weight_readings(orientation))
    return np.concatenate(parts, axis=2)


def _fitted_gains(
    designs: Float[np.ndarray, "k 6 p"], weights: Float[np.ndarray, "k 6"], terms: tuple[str, ...]
) -> Gains:
    """Weighted least squares: maps from the mean readings (k, 6) to the parameters (p,)."""
    root, parameters = np.sqrt(weights), designs.shape[2]
    matrix = (root[..., None] * designs).reshape(-1, parameters)
    scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    if np.linalg.matrix_rank(matrix / scale, rtol=_LEAST_RATIO) < parameters:
        raise ValueError(
            f"{terms[-1]} = True with {len(root)} rest intervals, which do not determine it to "
            "half of the digits; allowed are intervals at different times for a drift, and rest "
            "intervals in at least three orientations whose weights point in different directions "
            "for a mount"
        )
    inverse = np.linalg.pinv(matrix / scale) / scale[:, None] * root.ravel()
    return np.swapaxes(inverse.reshape(parameters, *root.shape), 0, 1)


def _check_weight(
    raw: RawRecording,
    groups: list[Rows],
    misses: Float[np.ndarray, "k 6"],
    squares: Wrench,
    parameters: int,
) -> None:
    """Refuse rest during which the sensor rotates, and means that deviate from those of a weight by
    many standard deviations, given as `misses` (k, 6).
    """
    for group in groups:
        cosine = np.abs(raw.orientation[group] @ raw.orientation[group][0])
        turned = np.degrees(2 * np.arccos(np.clip(cosine, 0, 1)).max())
        if turned > _STILL:
            raise ValueError(
                f"mount.estimated = True: the sensor turns by {turned:.3g}° within a rest "
                f"interval; allowed is at most {_STILL}°"
            )
    # Weights are not exact to the last digit of a long mean: rounding and calibration errors of a
    # few parts per thousand are allowed.
    scatter = np.sqrt(np.mean(misses**2))
    if scatter > 1 and np.sum(squares) > _SCATTER**2 * (misses.size - parameters) > 0:
        raise ValueError(
            f"mount.estimated = True: readings at rest scatter by {scatter:.3g} standard "
            "deviations about those of a weight; allowed is noise: give rest_intervals that are "
            "free of contact"
        )
