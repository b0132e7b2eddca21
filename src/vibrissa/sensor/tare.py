"""What a sensor shows without a load: offset, drift and the mount's weight, fitted to rest, with
the fit's own errors.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.sensor.maps import weight_readings
from vibrissa.sensor.mount import Mount
from vibrissa.sensor.noise import Pink, RandomWalk, quantisation_of_mean
from vibrissa.sensor.raw import RawRecording

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

_LARGEST_CONDITION = 1e7
_SCATTER = 6.0
_STILL = np.radians(0.5)
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

    intervals: tuple[tuple[float, float], ...]
    counts: tuple[int, ...]
    found: str
    epoch: float
    offset: Float[np.ndarray, "6"]
    drift: Float[np.ndarray, "6"]
    mount: Mount | None
    _parameters: Float[np.ndarray, "p p"]
    """Covariance of the fit's parameters for white noise of the variances `_variance`."""
    _rounding: Float[np.ndarray, "6"]
    """Variance of the offset by rounding that more samples do not average out."""
    _designs: Float[np.ndarray, "k 6 p"]
    _variance: Float[np.ndarray, "6"]
    coloured: tuple[tuple[Pink | RandomWalk, Float[np.ndarray, "6"]], ...] | None = None
    """Processes of pink noise and random walk, with their scales; None for those of the sensor over
    the times of the recording.
    """

    @property
    def seconds(self) -> float:
        """Length of all rest intervals together [s]."""
        return float(sum(stop - start for start, stop in self.intervals))

    def readings(
        self, sensor: "Sensor", time: Float[np.ndarray, "n"], orientation: Float[np.ndarray, "n 4"]
    ) -> Float[np.ndarray, "n 6"]:
        """What the sensor shows without contact at those times and orientations."""
        shown = self.offset + (time - self.epoch)[:, None] * self.drift
        if self.mount is not None:
            shown = (
                shown + weight_readings(sensor, rotation_matrices(orientation)) @ self.mount.moments
            )
        return shown

    def covariance(
        self,
        sensor: "Sensor",
        time: Float[np.ndarray, "n"],
        orientation: Float[np.ndarray, "n 4"],
        *,
        since: float | None = None,
    ) -> Float[np.ndarray, "... 6 6"]:
        """Of readings after the tare is taken off, (6, 6) where it is the same for all rows, else
        (n, 6, 6): their own noise and the tare's error.

        White noise and rounding, and pink noise and random walk as far as they have moved since the
        tare was taken. They begin at the first time, or at `since`.
        """
        white = np.diag(sensor.reading_variance)
        coloured = self.coloured
        if coloured is None:
            coloured = tuple(
                sensor.coloured(time if since is None else np.concatenate([[since], time]))
            )
        if not self.intervals:
            if not coloured:
                return white
            total = np.tile(white, (len(time), 1, 1))
            for process, scale in coloured:
                total += np.einsum("n,ij->nij", process.variance_at(time), np.diag(scale**2))
            return total
        rows = _design_rows(sensor, time - self.epoch, orientation, self._designs.shape[2])
        constant = self._designs.shape[2] == 6
        of_rows = rows[:1] if constant else rows
        tare = of_rows @ self._parameters @ np.swapaxes(of_rows, 1, 2) + np.diag(self._rounding)
        if not coloured:
            return white + tare[0] if constant else white + tare
        weights = [
            (rows @ self._parameters @ design.T) * (count / self._variance)
            for design, count in zip(self._designs, self.counts, strict=True)
        ]
        total = white + np.broadcast_to(tare, (len(time), 6, 6))
        for process, scale in coloured:
            total = total + _difference(process, scale, time, self.intervals, weights)
        return (total + np.swapaxes(total, 1, 2)) / 2


def no_tare(sensor: "Sensor", time: Float[np.ndarray, "n"]) -> Tare:
    """Nothing is taken off but a drift and a weight that are given."""
    drift = np.concatenate([sensor.force_drift, sensor.torque_drift])
    nothing = np.zeros((0, 0))
    return Tare(
        (),
        (),
        "none: tare_seconds = 0",
        float(time[0]),
        np.zeros(6),
        drift,
        sensor.mount,
        nothing,
        np.zeros(6),
        np.zeros((0, 6, 0)),
        np.ones(6),
    )


def planned_tare(
    sensor: "Sensor", intervals: tuple[tuple[float, float], ...], counts: tuple[int, ...]
) -> Tare:
    """Return the tare that rest of this length will give, without its values: for its covariance.
    The mount's weight is taken as known.
    """
    epoch = float(np.mean(intervals[0]))
    times = np.array([np.mean(interval) for interval in intervals])
    orientation = np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1))
    designs = _design_rows(sensor, times - epoch, orientation, 12 if sensor.estimate_drift else 6)
    variance = np.asarray(sensor.reading_variance)
    information = sum(
        design.T @ (count / variance[:, None] * design)
        for design, count in zip(designs, counts, strict=True)
    )
    return Tare(
        intervals,
        counts,
        "planned",
        epoch,
        np.zeros(6),
        np.zeros(6),
        None,
        np.linalg.inv(information),
        _rounding(sensor, counts),
        designs,
        variance,
    )


def fitted_tare(
    sensor: "Sensor", raw: RawRecording, intervals: tuple[tuple[float, float], ...], found: str
) -> Tare:
    """Fit offset, drift and the mount's weight to the readings in rest intervals by least squares.

    Raises
    ------
    ValueError
        If an interval holds fewer than two good samples, drift is to be estimated from fewer than
        two intervals, or a mount from orientations that do not determine it or do not fit.
    """
    good = np.isfinite(raw.wrench).all(axis=1) & np.isfinite(raw.time)
    groups = [
        good & (raw.time >= start) & (raw.time < stop - _SAME_TIME) for start, stop in intervals
    ]
    counts = tuple(int(np.count_nonzero(group)) for group in groups)
    first = float(raw.time[0])
    for (start, stop), count in zip(intervals, counts, strict=True):
        if count < 2:
            raise ValueError(
                f"rest from {start - first:g} s to {stop - first:g} s holds {count} good samples; allowed are at least 2"
            )
    if not intervals:
        raise ValueError(
            "no rest is found in the recording; allowed are rest_intervals that are free of contact"
        )
    if sensor.estimate_drift and len(intervals) < 2:
        raise ValueError(
            f"estimate_drift = True with {len(intervals)} rest interval; allowed are at least 2, at the start and at the end"
        )
    epoch = float(raw.time[groups[0]].mean())
    estimated = sensor.mount is not None and sensor.mount.estimated
    readings = raw.wrench - _given(sensor, raw, first)
    width = 6 + 6 * sensor.estimate_drift + 4 * estimated
    rows = _design_rows(sensor, raw.time - epoch, raw.orientation, width)
    means, designs = (
        np.stack([part[group].mean(axis=0) for group in groups]) for part in (readings, rows)
    )
    variance = _weights(sensor, readings, groups)
    solution, parameters = _least_squares(sensor, means, designs, np.array(counts), variance)
    if estimated:
        _check_mount(
            raw,
            means - np.einsum("kip,p->ki", designs, solution),
            groups,
            np.array(counts),
            variance,
            len(solution),
        )
    mount = _mount(sensor, solution[-4:]) if estimated else sensor.mount
    given = np.concatenate([sensor.force_drift, sensor.torque_drift])
    drift = given + (solution[6:12] if sensor.estimate_drift else 0)
    offset = solution[:6] + (epoch - first) * given
    return Tare(
        intervals,
        counts,
        found,
        epoch,
        offset,
        drift,
        mount,
        parameters,
        _rounding(sensor, counts),
        designs,
        variance,
    )


def _given(sensor: "Sensor", raw: RawRecording, first: float) -> Float[np.ndarray, "n 6"]:
    """Readings that need no estimate: a given drift, and a given mount's weight."""
    known = (raw.time - first)[:, None] * np.concatenate([sensor.force_drift, sensor.torque_drift])
    if sensor.mount is not None and not sensor.mount.estimated:
        known = (
            known
            + weight_readings(sensor, rotation_matrices(raw.orientation)) @ sensor.mount.moments
        )
    return np.asarray(known)


def without_given(sensor: "Sensor", raw: RawRecording) -> Float[np.ndarray, "n 6"]:
    """Readings (n, 6) with a given drift and a given mount's weight taken off."""
    return raw.wrench - _given(sensor, raw, float(raw.time[0]))


def _design_rows(
    sensor: "Sensor",
    elapsed: Float[np.ndarray, "n"],
    orientation: Float[np.ndarray, "n 4"],
    width: int,
) -> Float[np.ndarray, "n 6 p"]:
    parts = [np.tile(np.eye(6), (len(elapsed), 1, 1))]
    if sensor.estimate_drift:
        parts.append(elapsed[:, None, None] * parts[0])
    if width in (10, 16):
        parts.append(weight_readings(sensor, rotation_matrices(orientation)))
    return np.concatenate(parts, axis=2)


def _weights(
    sensor: "Sensor", readings: Float[np.ndarray, "n 6"], groups: list[Bool[np.ndarray, "n"]]
) -> Float[np.ndarray, "6"]:
    if sensor.force_noise is not None:
        return np.asarray(sensor.reading_variance)
    within = [readings[group] - readings[group].mean(axis=0) for group in groups]
    variance = np.mean(np.concatenate(within) ** 2, axis=0)
    pooled = np.repeat([variance[:3].mean(), variance[3:].mean()], 3)
    return np.where(pooled > 0, pooled, 1.0) + 1e-300


def _least_squares(
    sensor: "Sensor",
    means: Float[np.ndarray, "k 6"],
    designs: Float[np.ndarray, "k 6 p"],
    counts: np.ndarray,
    variance: Float[np.ndarray, "6"],
) -> tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p p"]]:
    root = np.sqrt(counts[:, None] / variance)
    matrix, right = (
        (root[..., None] * designs).reshape(-1, designs.shape[2]),
        (root * means).reshape(-1),
    )
    scale = np.linalg.norm(matrix, axis=0)
    condition = (
        np.linalg.cond(matrix / np.where(scale > 0, scale, 1))
        if len(matrix) >= len(scale)
        else np.inf
    )
    if not np.all(scale > 0) or condition > _LARGEST_CONDITION:
        what = (
            "mount.estimated = True"
            if sensor.mount is not None and sensor.mount.estimated
            else "estimate_drift = True"
        )
        raise ValueError(
            f"{what}: the {len(means)} rest intervals do not determine it (condition {condition:.3g}); allowed are rest intervals in at least three "
            "orientations whose weights point in different directions, and at different times"
        )
    upper = np.linalg.qr(matrix / scale)[1]
    solution = np.linalg.lstsq(matrix / scale, right, rcond=None)[0] / scale
    inverse = np.linalg.inv(upper)
    return solution, inverse @ inverse.T / np.outer(scale, scale)


def _check_mount(
    raw: RawRecording,
    residual: Float[np.ndarray, "k 6"],
    groups: list[Bool[np.ndarray, "n"]],
    counts: np.ndarray,
    variance: Float[np.ndarray, "6"],
    parameters: int,
) -> None:
    for group in groups:
        turned = 2 * np.arccos(
            np.clip(np.abs(raw.orientation[group] @ raw.orientation[group][0]), 0, 1)
        )
        if turned.max() > _STILL:
            raise ValueError(
                f"mount.estimated = True: the sensor turns by {np.degrees(turned.max()):.3g}° within a rest interval; allowed is at most 0.5°"
            )
    freedom = residual.size - parameters
    chi_square = float(np.sum(counts[:, None] * residual**2 / variance))
    # Weights are not known to the last digit of a long mean: rounding and calibration errors of a
    # few parts in a thousand are let pass.
    if (
        freedom > 0
        and chi_square / freedom > _SCATTER**2
        and np.sqrt(np.mean(residual**2 / variance)) > 1
    ):
        raise ValueError(
            f"mount.estimated = True: readings at rest scatter by {np.sqrt(np.mean(residual**2 / variance)):.3g} standard deviations about those of a weight; "
            "allowed is noise: give rest_intervals that are free of contact"
        )


def _mount(sensor: "Sensor", moments: Float[np.ndarray, "4"]) -> Mount:
    assert sensor.mount is not None
    mass = float(moments[0])
    if mass < 0:
        raise ValueError(
            f"mount.estimated = True gives the mass {mass:.3g} kg; allowed is at least 0: check wrench = {sensor.wrench!r} and mount.gravity"
        )
    x, y, z = (moments[1:] / mass if mass > 0 else np.zeros(3)).tolist()
    return Mount(mass, (x, y, z), sensor.mount.gravity, estimated=True)


def _rounding(sensor: "Sensor", counts: tuple[int, ...]) -> Float[np.ndarray, "6"]:
    """The offset's share of rounding errors that more samples do not average out."""
    if sensor.force_noise is None:
        return np.zeros(6)
    count = sum(counts)
    pairs = zip(sensor.noise.tolist(), sensor.resolution.tolist(), strict=True)
    return np.array(
        [quantisation_of_mean(noise, step, count) - step**2 / 12 / count for noise, step in pairs]
    )


def _difference(
    process: Pink | RandomWalk,
    scale: Float[np.ndarray, "6"],
    time: Float[np.ndarray, "n"],
    intervals: tuple[tuple[float, float], ...],
    weights: list[Float[np.ndarray, "n 6 6"]],
) -> Float[np.ndarray, "n 6 6"]:
    """Covariance of noise at a time less what the fit takes off of it."""
    spread = np.diag(scale**2)
    total = np.einsum("n,ij->nij", process.variance_at(time), spread)
    for interval, weight in zip(intervals, weights, strict=True):
        shared = process.with_mean(time, *interval)[:, None, None] * (weight @ spread)
        total = total - shared - np.swapaxes(shared, 1, 2)
        for other, second in zip(intervals, weights, strict=True):
            total = total + process.between_means(interval, other) * weight @ spread @ np.swapaxes(
                second, 1, 2
            )
    return total
